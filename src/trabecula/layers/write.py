"""`write_layers`: the layers of a volume as files, one by one; an interrupted run resumes."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from trabecula.core.checks import as_number, as_spacing, check_name, check_type, quote
from trabecula.core.errors import FileError, InputError
from trabecula.core.image import Image, as_image
from trabecula.core.progress import notify, track
from trabecula.core.recipe import digest
from trabecula.engine.files import replacing
from trabecula.engine.lazy_volume import Slabs, as_slabs
from trabecula.engine.memory import Plan, check_budget
from trabecula.io.units import NO_LENGTH, to_metres
from trabecula.layers.contour_files import CLI_END, cli_header, cli_layer
from trabecula.layers.drawings import (
    FINE,
    Drawing,
    Droplets,
    Masks,
    Outlines,
    area_within,
    contours_of,
)
from trabecula.layers.droplets import Palette
from trabecula.layers.forms import LayerForm, form_of
from trabecula.layers.sampling import LayerSampler

MANIFEST = "layers.json"
_MOST_PIXELS = 1 << 29  # of a layer
_FINEST, _COARSEST = 0.001, 10.0  # millimetres of a pitch
_PER_PIXEL = 40  # bytes, of a phase


@dataclass(frozen=True)
class LayerStack:
    """Layers that were written, or planned.

    Attributes
    ----------
    form : str
    layers : int
        Of the whole part.
    shape : (rows, columns)
        Pixels of each layer; of contours the points across which they are drawn.
    pitch : (z, y, x)
        Millimetres.
    size : (z, y, x)
        Of the part, millimetres.
    written : int
        Layers that this run wrote; the others were there, or were not asked for.
    materials : dict
        Volume in cubic millimetres of each material in the layers that this run wrote.
    """

    form: str
    layers: int
    shape: tuple[int, int]
    pitch: tuple[float, float, float]
    size: tuple[float, float, float]
    written: int = 0
    materials: dict[str, float] = field(default_factory=dict)

    def to_json(self) -> dict[str, Any]:
        """Return plain values."""
        return json.loads(json.dumps(asdict(self)))


def plan_layers(
    volume: Image | Slabs | ArrayLike,
    *,
    form: str = "polyjet",
    pitch: float | Sequence[float] | None = None,
) -> LayerStack:
    """Return the layers that `write_layers` would write; nothing is read or written.

    Parameters
    ----------
    volume, form, pitch
        As of `write_layers`.

    Returns
    -------
    LayerStack

    Raises
    ------
    InputError, UnknownNameError
        As `write_layers`.
    """
    slabs = volume if isinstance(volume, Slabs) else as_slabs(as_image(volume))
    return _stack(_sampler(slabs, form_of(form), pitch), form)


def write_layers(
    volume: Image | Slabs | ArrayLike,
    path: str | os.PathLike[str],
    *,
    form: str = "polyjet",
    pitch: float | Sequence[float] | None = None,
    phase: str | int | None = None,
    materials: Mapping[str, str] | None = None,
    mixtures: Mapping[str, tuple[Any, str, str]] | None = None,
    only: tuple[int, int] | None = None,
    seed: int = 0,
    memory: int | None = None,
) -> LayerStack:
    """Write a volume layer by layer, as a printer builds it; no mesh is made.

    A layer is sampled at its middle height, over pixels that need not be cubes. An interrupted
    folder resumes: layers that are there are kept where the same was asked for.

    Parameters
    ----------
    volume : Image, Slabs or array of labels, (Z, Y, X)
        In a unit of length. z is the direction of the layers. `Slabs` are read plane by plane:
        a store, or an unlimited model (`trabecula.pipeline.layers.slabs_of_model`).
    path : path
        A folder, of "cli" a file.
    form : str
        "polyjet" (PNG with a colour for each material), "dlp" (grey PNG masks, 255 is solid, edges
        anti-aliased), "svg" or "cli" (contours).
    pitch : float or (z, y, x), optional
        Layer thickness, row and column pitch in millimetres, .001 to 10. Default: that of
        `trabecula.layers.forms`; of contours the volume's voxels.
    phase : str or int, optional
        The phase that is printed. Default: every phase but "void".
    materials : mapping of str to str, optional
        Phase -> name of its material ("polyjet"). Default: the phase's own name.
    mixtures : mapping of str to (field, first, second), optional
        Phase -> the share of the second material, 0 to 1, as a volume over the whole part, and the
        names of both materials ("polyjet"). Each droplet is of one of them.
    only : (first, last), optional
        Layers to write, `last` not included; the others are planned alone.
    seed : int
        Of the droplets of mixtures.
    memory : int, optional
        Bytes that may be used. Default: what is available.

    Returns
    -------
    LayerStack

    Raises
    ------
    InputError
        No unit of length, a pitch out of range, no phase but void, materials for another form,
        layers that do not exist.
    UnknownNameError
        An unknown form or phase.
    FileError
        The folder holds other files, or layers of something else; the disk is full.
    MemoryBudgetError
        A layer would not fit into memory.

    References
    ----------
    Floyd and Steinberg 1976, for mixtures.
    """
    for name, given in (("materials", materials), ("mixtures", mixtures)):
        check_type(
            {} if given is None else given, Mapping, name=name, advice="give a mapping from phases"
        )
    chosen = form_of(form)
    slabs = volume if isinstance(volume, Slabs) else as_slabs(as_image(volume))
    sampler = _sampler(slabs, chosen, pitch)
    printed = _printed(slabs, phase)
    if (materials or mixtures) and form != "polyjet":
        raise InputError(f"{form} has no materials: leave them out, or write polyjet")
    stack = _stack(sampler, form)
    first, last = _range(only, stack.layers)
    finer = FINE**2 if form == "dlp" else 1
    count = len(printed) + len(materials or {}) + len(mixtures or {})
    check_budget(
        Plan({"a layer": stack.shape[0] * stack.shape[1] * _PER_PIXEL * max(1, count) * finer}),
        budget=memory,
        advice="give a coarser pitch",
    )
    path = Path(path)
    if chosen.single:
        return _write_single(sampler, printed, stack, path, range(first, last))
    drawn: Drawing
    if form == "polyjet":
        palette = Palette.of(slabs.phases, printed, materials or {}, mixtures or {})
        drawn = Droplets(sampler, palette, seed)
    else:
        drawn = Masks(sampler, printed) if form == "dlp" else Outlines(sampler, printed)
    about = {
        **{k: v for k, v in stack.to_json().items() if k not in ("written", "materials")},
        **drawn.about,
        "recipe": slabs.recipe.to_json(),
    }
    if not isinstance(volume, Slabs):  # their recipes hold a digest, those of arrays may not
        about["sha256"] = digest(as_image(volume).values)
    return _write_folder(drawn, stack, path, chosen.suffix, range(first, last), about)


def _write_folder(
    drawn: Drawing,
    stack: LayerStack,
    path: Path,
    suffix: str,
    chosen: range,
    about: Mapping[str, Any],
) -> LayerStack:
    """Write the layers that are not there yet."""
    text = json.dumps(about, indent=1) + "\n"
    _prepare(path, text)
    digits = max(4, len(str(stack.layers - 1)))
    names = {k: path / f"layer_{k:0{digits}d}{suffix}" for k in chosen}
    missing = [k for k, name in names.items() if not name.exists()]
    if len(missing) < len(names):
        notify(f"{path}: {len(names) - len(missing)} of {len(names)} layers are there already")
    volumes: dict[str, float] = {}
    for layer in track(missing, "layers", total=len(missing)):
        with replacing(names[layer]) as temporary:
            areas = drawn.write(layer, temporary)
        for material, area in areas.items():
            volumes[material] = volumes.get(material, 0.0) + area * stack.pitch[0]
    if missing and not sum(volumes.values()):
        notify(f"{path}: nothing is printed in these layers")
    return replace(stack, written=len(missing), materials=volumes)


def _prepare(path: Path, text: str) -> None:
    """Make the folder and its manifest, or raise where it holds anything else."""
    there = path / MANIFEST
    if path.exists() and not path.is_dir():
        raise FileError(f"cannot write layers to {path}: it is a file; name a folder")
    if there.exists():
        if there.read_text(encoding="ascii") != text:
            raise FileError(
                f"{path} holds layers of another volume, or with other settings: name a new folder"
            )
        return
    if path.is_dir() and any(path.iterdir()):
        raise FileError(f"{path} holds other files: name a new folder")
    with replacing(there) as temporary:
        temporary.write_text(text, encoding="ascii")


def _write_single(
    sampler: LayerSampler, printed: Sequence[int], stack: LayerStack, path: Path, chosen: range
) -> LayerStack:
    """Write all layers into one file, which appears whole or not at all."""
    if path.suffix.lower() != ".cli":
        raise InputError(f"{path}: contours in one file are written as .cli; name it so")
    volume = 0.0
    with replacing(path) as temporary, temporary.open("w", encoding="ascii") as file:
        file.write(cli_header(stack.size, len(chosen), path.stem))
        for layer in track(chosen, "layers", total=len(chosen)):
            lines = contours_of(sampler, printed, layer)
            file.write(cli_layer(lines, (layer + 1) * stack.pitch[0]))
            volume += area_within(lines) * stack.pitch[0]
        file.write(CLI_END)
    return replace(stack, written=len(chosen), materials={"solid": volume})


def _stack(sampler: LayerSampler, form: str) -> LayerStack:
    """Plan the layers."""
    layers, rows, columns = sampler.shape
    if rows * columns > _MOST_PIXELS:
        raise InputError(
            f"a layer would have {rows} x {columns} pixels: give a coarser pitch, or a smaller "
            "--scale"
        )
    return LayerStack(form, layers, (rows, columns), sampler.pitch, sampler.size)


def _sampler(slabs: Slabs, form: LayerForm, pitch: float | Sequence[float] | None) -> LayerSampler:
    if slabs.unit == NO_LENGTH:
        raise InputError(
            "the volume has no unit of length, and a printer needs one: give --spacing and --unit"
        )
    factor = 1000 * to_metres(slabs.unit)
    z, y, x = (edge * factor for edge in slabs.spacing)
    if pitch is None:
        steps = (z, y, x) if form.pitch is None else form.pitch
    else:
        a, b, c = as_spacing(pitch, ndim=3)
        steps = (a, b, c)
    for step in steps:
        if not _FINEST <= step <= _COARSEST:
            raise InputError(
                f"a pitch of {step:g} mm is out of range: give {_FINEST} to {_COARSEST:g} mm, z y "
                "x, or another --scale"
            )
    return LayerSampler(slabs, (z, y, x), steps)


def _printed(slabs: Slabs, phase: str | int | None) -> list[int]:
    """Return the labels that are printed."""
    if phase is None:
        found = [n for n, name in enumerate(slabs.phases) if name != "void"]
    elif isinstance(phase, str):
        check_name(phase, slabs.phases, name="phase")
        found = [slabs.phases.index(phase)]
    else:
        high = len(slabs.phases) - 1
        found = [int(as_number(phase, name="phase", low=0, high=high, whole=True))]
    if not found:
        raise InputError("the volume has no phase but void, nothing to print: give the phase")
    return found


def _range(only: tuple[int, int] | None, layers: int) -> tuple[int, int]:
    if only is None:
        return 0, layers
    try:
        first, last = (int(as_number(n, name="only", low=0, high=2**31, whole=True)) for n in only)
    except (TypeError, ValueError):
        raise InputError(
            f"only {quote(only)} is no pair of layers: give first and last, as in (0, 10)"
        ) from None
    if not 0 <= first < last <= layers:
        raise InputError(
            f"layers {first}:{last} do not exist: the part has 0:{layers}; give first:last"
        )
    return first, last
