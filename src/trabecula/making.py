"""From a model to a file: in memory where the result fits, else block by block into a store."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from trabecula.core.errors import MemoryBudgetError
from trabecula.core.image import outline
from trabecula.core.progress import say
from trabecula.core.recipe import Recipe
from trabecula.core.request import Request
from trabecula.engine.blocks import Volume, stream
from trabecula.engine.checkpoint import kept_at
from trabecula.engine.plan import Plan, available_memory, check_budget, format_bytes
from trabecula.engine.store import CHUNK, open_unfinished
from trabecula.io import files
from trabecula.io.formats import suffix_of
from trabecula.io.units import long_name
from trabecula.synth.base import Model
from trabecula.synth.windows import WindowModel


@dataclass(frozen=True)
class Written:
    """A result that is in a file.

    Attributes
    ----------
    path : Path
    shape : tuple of int
    text : str
        What it is, in a line.
    recipe : Recipe
    sha256 : str
        Of its voxels.
    """

    path: Path
    shape: tuple[int, ...]
    text: str
    recipe: Recipe

    @property
    def sha256(self) -> str:
        """Digest of the voxels."""
        return str(self.recipe.steps[-1]["sha256"])


def part_of(path: str | os.PathLike[str]) -> Path:
    """Where the state of an unfinished run is kept: beside its result, as rock.zarr.part of rock.zarr."""
    target = Path(path).absolute()
    return target.with_name(target.name + ".part")


def generate_to(model: Model, request: Request, path: str | os.PathLike[str], *, memory: int | None = None) -> Written:
    """Make material into a file. A run that was interrupted goes on from what it left beside it.

    Parameters
    ----------
    model : Model
    request : Request
    path : path
        The suffix chooses the format. Into a Zarr store a model of an unlimited material (a `WindowModel`) makes what does
        not fit into the budget block by block: the same voxels, and only a block in memory.
    memory : int, optional
        Budget in bytes. Default: what the machine has available.

    Raises
    ------
    MemoryBudgetError
        The forecast exceeds the budget.
    FileError
        The file cannot be written.
    """
    side = block_for(model, request, path, memory=memory)
    if side is not None and isinstance(model, WindowModel):
        return _streamed(model, request, Path(path), side)
    with kept_at(part_of(path)):
        material = model.generate(request, memory=memory)
        files.write(material, path)
    return Written(Path(path), material.shape, repr(material), material.recipe)


def block_for(model: Model, request: Request, path: str | os.PathLike[str], *, memory: int | None = None) -> int | None:
    """The edge of the blocks that a run makes, voxels; None where it makes everything at once.

    Raises
    ------
    MemoryBudgetError
        It fits neither at once nor in blocks.
    """
    plan = model.plan(request)
    budget = available_memory() if memory is None else memory
    store = suffix_of(os.fspath(path)) == ".zarr"
    if not isinstance(model, WindowModel):
        return None
    if plan.peak <= budget and not (store and _was_left(model, request, path)):
        return None
    if not store:
        check_budget(
            plan, budget=memory, advice="write a .zarr, which is made block by block; ask for a smaller --shape"
        )
        return None
    return _fitting(model, request, budget)


def _fitting(model: WindowModel, request: Request, budget: int) -> int:
    """The largest block, of the model's own edge or less, that fits into the budget."""
    sides = [side for side in range(model.block, CHUNK, -CHUNK)] + [CHUNK]
    for side in sides:
        if model.plan_block(request, side).peak <= budget:
            return side
    need = model.plan_block(request, CHUNK).peak
    raise MemoryBudgetError(
        f"a block of {CHUNK} voxels needs about {format_bytes(need)} of memory, {format_bytes(budget)} may be used: use "
        "fewer --threads, or raise --memory"
    )


def plan_to(model: Model, request: Request, path: str | os.PathLike[str], *, memory: int | None = None) -> Plan:
    """Forecast of `generate_to`."""
    side = block_for(model, request, path, memory=memory)
    if side is None or not isinstance(model, WindowModel):
        return model.plan(request)
    return model.plan_block(request, side)


def _was_left(model: WindowModel, request: Request, path: str | os.PathLike[str]) -> bool:
    """Whether a run of the same request in blocks was interrupted."""
    part = part_of(path)
    left = open_unfinished(part) if part.is_dir() else None
    return left is not None and left.identity == model.identity(request)


def _streamed(model: WindowModel, request: Request, path: Path, side: int) -> Written:
    fields = model.fields(request)
    plain = {name: list(value) if isinstance(value, tuple) else value for name, value in fields.items()}
    say(f"making {path.name} in blocks of {side} voxels")
    volume = Volume(
        shape=request.shape,
        dtype=model.dtype,
        make=lambda box: model.values_of(request, box),
        describe=lambda sha256: {**plain, "recipe": model.recipe(request, sha256).to_json()},
        identity=model.identity(request),
        scale=fields["spacing"],
        unit=long_name(fields["unit"]),
    )
    sha256 = stream(volume, path, part=part_of(path), side=side)
    return Written(path, request.shape, outline(request.shape, **fields), model.recipe(request, sha256))
