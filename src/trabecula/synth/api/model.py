"""The base of every model: `Model`, a method that has learned, which generates.

The checks, the memory budget and the recipe are here, once.
"""

from __future__ import annotations

import hashlib
import json
import os
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from math import prod
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from trabecula.core.checks import as_number, as_seed
from trabecula.core.errors import InputError, RequestError
from trabecula.core.image import Image, outline
from trabecula.core.progress import whole_run
from trabecula.core.recipe import Recipe, versions
from trabecula.core.request import Request, check_exemplar
from trabecula.core.target import OF_A_PHASE, TWO_POINT, is_apparent
from trabecula.engine import checkpoint, tensors
from trabecula.engine.files import replacing
from trabecula.engine.memory import Plan, check_budget, largest_within
from trabecula.engine.parts import write_parts
from trabecula.exemplar.target import check_target_porosity, porosity_range
from trabecula.synth.api.capabilities import Capabilities
from trabecula.synth.api.exemplar_info import ExemplarInfo, exemplar_info, result_voxels

FORMAT = 1
"""Format of model files; `serialize` says what is in one."""

KEY, VOXELS, STATE = "trabecula", "exemplar.", "learned."
"""The word of a model's file, and the prefixes of its arrays."""

_WRITING = 24 << 20  # bytes of the code that writes a store, loaded


@dataclass(frozen=True)
class ModelState:
    """Everything that a model learned and that is not in its settings.

    Attributes
    ----------
    arrays : mapping of str to array
    plain : mapping
        Plain JSON.
    history : mapping
        Course of the learning, plain JSON: stored in the model's file, and no part of its identity.
    """

    arrays: Mapping[str, np.ndarray] = field(default_factory=dict)
    plain: Mapping[str, Any] = field(default_factory=dict)
    history: Mapping[str, Any] = field(default_factory=dict)


class Model(ABC):
    """A method that has learned.

    A subclass names its `capabilities` and gives the hook `make` (a `WindowModel`: `make_box`). It
    may override `state`, `memory` and `resident_memory`; to refuse what the base class lets pass,
    `_check_request` and `_check_target`; where a result differs from the exemplar in kind, spacing,
    unit or phases, `_result_fields`.

    Attributes
    ----------
    facts : tuple of ExemplarInfo
        Descriptions of the exemplars; without any, one of the result (`ExemplarInfo.blank`).
    exemplars : tuple of Image
        The exemplars themselves; none where the model does not store them.
    name : str, optional
        Name of the file that it was saved to or loaded from, or of the shipped model.
    """

    capabilities: ClassVar[Capabilities]
    name: str | None = None

    def __init__(self, config: Any, exemplars: Sequence[Image | ExemplarInfo]) -> None:
        self.config = config
        self.facts = tuple(exemplar_info(exemplar) for exemplar in exemplars)
        images = tuple(one for one in exemplars if isinstance(one, Image))
        self.exemplars = images if self.capabilities.stores_exemplar else ()

    def __repr__(self) -> str:
        name = f" {self.name!r}" if self.name else ""
        seen = [
            outline(one.shape, one.kind, one.spacing, one.unit, one.phases)[1:-1]
            for one in self.facts
            if not one.blank
        ]
        more = f" and {len(seen) - 1} more" if seen[1:] else ""
        of = f" of {seen[0]}{more}" if seen else ""
        return f"<Model{name}: {self.capabilities.name}{of}; {nondefault_settings(self.config)}>"

    @abstractmethod
    def make(self, request: Request) -> np.ndarray | tuple[np.ndarray, Mapping[str, Any]]:
        """Return the values of a checked request, or the values and a report (hook).

        Returns
        -------
        array (Z, Y, X), of a picture (Y, X), colour last
        report : mapping, optional
            Plain JSON for the recipe.
        """

    def state(self) -> ModelState:
        """Return the state from which `Method.from_state` makes the same model at once (hook);
        empty where learning anew is as good.
        """
        return ModelState()

    def memory(self, request: Request) -> Mapping[str, int]:
        """Forecast the bytes of a request at its peak, by purpose (hook).

        "interpreter and kernels" and "exemplar" are those that are there before it starts. The
        default counts the result alone.
        """
        return {"output": self.output_bytes(request)}

    def resident_memory(self, request: Request) -> Mapping[str, int]:
        """Forecast the bytes that stay in memory where arrays are memory-mapped (hook).

        For methods whose large volumes are "memmap": "interpreter and kernels", "exemplar", and
        "slab", the bytes of the thinnest slabs that are worked on.
        """
        return self.memory(request)

    @property
    def history(self) -> Mapping[str, Any]:
        """Return the course of the learning, plain JSON: no part of the model's identity."""
        return self.state().history

    @property
    def sha256(self) -> str:
        """Return the digest of all that its results depend on: of the bytes of its file, without
        history and versions.
        """
        return hashlib.sha256(self.to_bytes()).hexdigest()

    def to_bytes(self, **more: Any) -> bytes:
        """Return the bytes of the model's file; `more` is plain JSON that is stored as well."""
        about: dict[str, Any] = {
            "format": FORMAT,
            "method": self.capabilities.name,
            "settings": asdict(self.config),
            "exemplars": [one.to_json() for one in self.facts],
        }
        state = self.state()
        arrays = {f"{STATE}{name}": array for name, array in state.arrays.items()}
        if not self.capabilities.stores_exemplar:
            about["learned"] = dict(state.plain)
        else:
            arrays |= {f"{VOXELS}{n}": image.values for n, image in enumerate(self.exemplars)}
            about |= {"found": dict(state.plain)} if state.plain else {}
        plain = json.dumps({**about, **more}, sort_keys=True, allow_nan=False)
        return tensors.encode(arrays, {KEY: plain})

    def save(self, path: str | os.PathLike[str], *, part_bytes: int | None = None) -> Path:
        """Write the model to a file that `tb.load_model` reads; it holds no voxels where the model
        does not store its exemplars.

        Parameters
        ----------
        path : path or str
        part_bytes : int, optional
            Write parts of at most so many bytes, 1024 at least: PATH.1of4 and so on;
            `load_model(PATH)` reads them as one.

        Raises
        ------
        FileError
            The file cannot be written.
        """
        place = Path(path)
        data = self.to_bytes(history=dict(self.history), versions=versions())
        if part_bytes is not None:
            most = as_number(part_bytes, name="part_bytes", low=1024, high=2**62, whole=True)
            write_parts(place, data, int(most))
        else:
            with replacing(place) as temporary:
                temporary.write_bytes(data)
        self.name = place.name
        return place

    def plan(self, request: Request) -> Plan:
        """Forecast memory and disk of a request, without starting it."""
        self._check_request(request)
        return self._plan(request)

    def plan_mapped(self, request: Request, memory: int) -> Plan:
        """Forecast a request that is made out of core within a budget of bytes: in memory-mapped
        arrays, or ("memory") in memory and then copied to a file.

        "pages" are the bytes of the files that may be resident.
        """
        whole = self.plan(request)
        if self.capabilities.large == "memory":
            memory_there = {**whole.memory, "writing": _WRITING, "pages": 0, "slab": 0}
            return Plan(memory_there, disk=whole.disk * 8 // 7, scratch=whole.disk)
        fixed = {**self.resident_memory(request), "writing": _WRITING}
        resident = sum(fixed.values())
        files = max(0, whole.peak - resident)
        pages = max(0, min(memory - resident, files))
        return Plan({**fixed, "pages": pages}, disk=whole.disk * 8 // 7, scratch=files + whole.disk)

    def generate(
        self,
        shape: Request | int | Sequence[int],
        *,
        seed: int | None = None,
        memory: int | None = None,
        **parts: Any,
    ) -> Image:
        """Make material.

        Parameters
        ----------
        shape : int, sequence of int, or Request
            Voxels along z, y, x (one number: a cube), or the whole request.
        seed : int
            0 .. 2**63 - 1; 0 where neither this nor the request says otherwise. Same seed, same
            voxels.
        memory : int, optional
            Budget in bytes. Default: the memory that the machine has available.
        **parts
            Other fields of `Request`: periodic, mask, target, fixed, coarse, like.

        Raises
        ------
        RequestError
            The method cannot honour a part of the request.
        MemoryBudgetError
            The forecast exceeds the budget.
        """
        request = as_request(shape, seed, parts)
        check_budget(
            self.plan(request),
            budget=memory,
            advice=lambda limit: self._advise_smaller(request, limit),
        )
        with whole_run("making"):
            values, report = self.compute(request)
        recipe = Recipe().then("generate", values, **self._step(request, report))
        return Image(values, **self.fields(request), recipe=recipe)

    def compute(self, request: Request) -> tuple[np.ndarray, Mapping[str, Any]]:
        """Return the values of a checked request and the report (plain JSON); a run that stores
        checkpoints resumes from its own.
        """
        step = {"step": lambda: self.recipe(request, "").to_json()[0]}
        running = checkpoint.running(
            self.capabilities.name, self._decisive(), request, self.exemplars, **step
        )
        with running:
            result = self.make(request)
        return result if isinstance(result, tuple) else (result, {})

    def recipe(
        self, request: Request, sha256: str, report: Mapping[str, Any] | None = None
    ) -> Recipe:
        """Return the recipe of a result whose voxels have this digest."""
        return Recipe().then_digest("generate", sha256, **self._step(request, report or {}))

    @property
    def dtype(self) -> np.dtype:
        """Return the type of a result's values."""
        if self.facts[0].kind == "labels" or not self.exemplars:
            return np.dtype(np.uint8)
        return self.exemplars[0].values.dtype

    @property
    def spacing(self) -> tuple[float, ...]:
        """Return the edges of a result's voxels, in the exemplar's unit."""
        return tuple(self._result_fields()["spacing"])

    def output_bytes(self, request: Request) -> int:
        """Return the bytes of a result's values."""
        channels = 3 if self.facts[0].kind == "colour" else 1
        return self.dtype.itemsize * channels * prod(request.shape)

    def fields(self, request: Request) -> dict[str, Any]:
        """Return kind, spacing, unit and phases of the result of a request."""
        found = self._result_fields()
        unit = found.get("unit", "voxel")
        spacing, unit = result_voxels(request, found["spacing"][-len(request.shape) :], unit)
        return {**found, "spacing": spacing, "unit": unit}

    def settings(self) -> dict[str, Any]:
        """Return everything beside the exemplars that tells one model of a method from another:
        plain JSON.
        """
        return {**asdict(self.config), **self._voxel()}

    def identity(self, request: Request) -> str:
        """Return the SHA-256 of all that the voxels of a request depend on."""
        return checkpoint.identity_of(
            self.capabilities.name, self._decisive(), request, self.exemplars
        )

    def _plan(self, request: Request) -> Plan:
        return Plan(dict(self.memory(request)), disk=self.output_bytes(request))

    def _advise_smaller(self, request: Request, budget: int) -> str:
        """Return advice for a request over its budget: the largest shape that fits, where nothing
        in the request is tied to its shape.
        """
        advice = "ask for a smaller --shape"
        if request.is_tied:
            return advice
        found = largest_within(
            request.shape, lambda shape: self._plan(replace(request, shape=shape)).peak, budget
        )
        return advice if found is None else f"{advice} ({' '.join(map(str, found))} fits)"

    def _decisive(self) -> dict[str, Any]:
        """Return everything beside the exemplars that the results depend on.

        A setting that came later counts only where it is not what held before it: so the unfinished
        run of an earlier version is resumed.
        """
        if not self.capabilities.stores_exemplar:
            return {"model": self.sha256}
        before: dict[str, Any] = getattr(type(self.config), "recorded", dict)({})
        settings = self.settings().items()
        return {
            name: value for name, value in settings if name not in before or value != before[name]
        }

    def _voxel(self) -> dict[str, Any]:
        """Return the size of the voxels of a model without exemplar."""
        if not self._is_alone():
            return {}
        return {"voxel": {"spacing": self.facts[0].spacing[0], "unit": self.facts[0].unit}}

    def _is_alone(self) -> bool:
        return bool(self.facts) and self.facts[0].blank

    def _check_request(self, request: Request) -> None:
        known = self.capabilities
        refused = sorted(request.asks_for() - known.honours)
        if refused:
            can = ", ".join(sorted(known.honours)) or "shape and seed alone"
            raise RequestError(
                f"method {known.name!r} cannot honour {', '.join(refused)}: it honours {can}"
            )
        strange = [name for name in request.target if not self._knows_target(name)]
        if strange:
            raise RequestError(
                f"method {known.name!r} cannot honour the target {', '.join(strange)}: it honours "
                f"{', '.join(known.targets)}"
            )
        axes = known.output_axes(None if self._is_alone() or not self.facts else self.facts[0].ndim)
        if len(request.shape) not in axes:
            of = "" if self._is_alone() else " of this exemplar"
            raise RequestError(
                f"method {known.name!r} makes {axes[0]}-D images{of}, the request is for "
                f"{request.shape}: give {axes[0]} numbers"
            )
        if self.exemplars:
            check_exemplar(request, self.exemplars[0], spacing=self.spacing)
            self._check_target(request)
        if self.facts:
            self.fields(request)  # a form of other voxels is refused before any work

    def _knows_target(self, name: str) -> bool:
        known = self.capabilities.targets
        if is_apparent(name):
            return name.partition(":")[0] in known
        return name in known or any(
            head in known and name.startswith(head) for head in (OF_A_PHASE, TWO_POINT)
        )

    def porosities(self) -> tuple[float, float] | None:
        """Return the least and greatest porosity that can be a target: by the exemplars' places;
        None where nothing bounds it.
        """
        ranges = [porosity_range(exemplar) for exemplar in self.exemplars]
        return (min(low for low, _ in ranges), max(high for _, high in ranges)) if ranges else None

    def _check_target(self, request: Request) -> None:
        """Raise where the exemplars hold nothing like the target; a method that comes as near as it
        can overrides this.
        """
        check_target_porosity(request.target, self.exemplars, mask=request.mask)

    def _result_fields(self) -> dict[str, Any]:
        first = self.facts[0]
        return {
            "kind": first.kind,
            "spacing": first.spacing,
            "unit": first.unit,
            "phases": first.phases,
        }

    def _step(self, request: Request, report: Mapping[str, Any]) -> dict[str, Any]:
        """Return the step of a result's recipe."""
        step = {
            "method": self.capabilities.name,
            "settings": asdict(self.config),
            "request": request.to_json(),
            "exemplars": [one.recipe.to_json() for one in self.facts if not one.blank],
            **self._voxel(),
        }
        if not self.capabilities.stores_exemplar:
            step["model"] = {"name": self.name, "sha256": self.sha256}
        return {**step, "report": dict(report)} if report else step


def as_request(shape: Any, seed: int | None, parts: dict[str, Any]) -> Request:
    """Return a request as it is, or build one of a shape, a seed and other parts."""
    if isinstance(shape, Request):
        if parts or seed is not None:
            raise InputError("give a Request, or shape, seed and parts, not both")
        return shape
    return Request(shape, seed=0 if seed is None else as_seed(seed), **parts)


def nondefault_settings(config: Any) -> str:
    """Return the settings that differ from a method's defaults, as NAME=VALUE."""
    usual = type(config)()
    changed = [
        one.name for one in fields(config) if getattr(config, one.name) != getattr(usual, one.name)
    ]
    return ", ".join(f"{name}={getattr(config, name)!r}" for name in changed) or "default settings"
