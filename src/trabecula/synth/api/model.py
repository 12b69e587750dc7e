"""What a method becomes once it has seen its exemplar: `Model`, which generates.

The checks, the memory budget and the recipe are here, once; a method's own model fills in `_plan`
and `make`.
"""

from __future__ import annotations

import hashlib
import os
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from trabecula.core.checks import as_seed
from trabecula.core.errors import InputError, RequestError
from trabecula.core.image import Image, outline
from trabecula.core.recipe import Recipe
from trabecula.core.request import Request, check_exemplar
from trabecula.core.target import OF_A_PHASE
from trabecula.engine import checkpoint
from trabecula.engine.memory import Plan, check_budget, largest_within
from trabecula.exemplar.target import check_target_porosity
from trabecula.synth.api.capabilities import Capabilities
from trabecula.synth.api.exemplar_info import ExemplarInfo, exemplar_info
from trabecula.synth.api.result_voxels import result_voxels

_WRITING = 24 << 20  # bytes of what writes a store, loaded


class Model(ABC):
    """A method that has seen its exemplar.

    Attributes
    ----------
    facts : tuple of Facts
        What is known of the exemplars apart from their voxels; without any, of what is made
        (`facts.blank`).
    exemplars : tuple of Image
        The exemplars themselves; none where the method `learns` all that it needs of them.
    spills : bool
        Whether volumes that do not fit into memory are made in scratch files (`plan_spilled`).
    name : str, optional
        Of the file that it was saved to or loaded from, or of the shipped model.
    """

    capabilities: ClassVar[Capabilities]
    spills: ClassVar[bool] = False
    name: str | None = None

    def __init__(self, config: Any, exemplars: Sequence[Image | ExemplarInfo]) -> None:
        self.config = config
        self.facts = tuple(exemplar_info(exemplar) for exemplar in exemplars)
        self.exemplars = (
            ()
            if self.capabilities.learns
            else tuple(one for one in exemplars if isinstance(one, Image))
        )

    def __repr__(self) -> str:
        name = f" {self.name!r}" if self.name else ""
        seen = [
            outline(one.shape, one.kind, one.spacing, one.unit, one.phases)
            for one in self.facts
            if not one.blank
        ]
        of = (
            f" of {seen[0][1:-1]}{f' and {len(seen) - 1} more' if seen[1:] else ''}" if seen else ""
        )
        return f"<Model{name}: {self.capabilities.name}{of}; {changed_settings(self.config)}>"

    def state(self) -> tuple[Mapping[str, np.ndarray], Mapping[str, Any]]:
        """Arrays and plain JSON from which `Method.from_state` makes the same model, of a method
        that `learns`.
        """
        raise NotImplementedError

    def looked_up(self) -> Mapping[str, Any]:
        """What fitting took long to find in the exemplars, plain JSON from which `Method.fit_again`
        makes the same model at once; empty where learning them anew is as good."""
        return {}

    @property
    def history(self) -> Mapping[str, Any]:
        """How the learning went, plain JSON: kept in the model's file, and no part of what the
        model is.
        """
        return {}

    @property
    def sha256(self) -> str:
        """Digest of all that its results depend on: of the file it is saved as, without its history
        and versions.
        """
        # which knows the registry, and that knows us
        from trabecula.synth.api.serialize import encoded

        return hashlib.sha256(encoded(self)).hexdigest()

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the model to a file that `tb.load_model` reads; it holds no voxels where the method
        `learns`.

        Raises
        ------
        FileError
            The file cannot be written.
        """
        from trabecula.synth.api.serialize import save_model

        return save_model(self, path)

    def plan(self, request: Request) -> Plan:
        """Forecast memory and disk of a request, without starting it."""
        self._check_request(request)
        return self._plan(request)

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
            Budget in bytes. Default: what the machine has available.
        **parts
            Other fields of `Request`: periodic, mask, target, fixed.

        Raises
        ------
        RequestError
            The method cannot honour a part of the request.
        MemoryBudgetError
            The forecast exceeds the budget.
        """
        request = as_request(shape, seed, parts)
        check_budget(
            self.plan(request), budget=memory, advice=lambda limit: self._smaller(request, limit)
        )
        values, report = self.made(request)
        recipe = Recipe().then("generate", values, **self._step(request, report))
        return Image(values, **self.fields(request), recipe=recipe)

    def made(self, request: Request) -> tuple[np.ndarray, Mapping[str, Any]]:
        """The values of a request that was checked, and what there is to tell of how they came to
        be (plain JSON); a run that keeps its state goes on from it."""
        asked = {"step": lambda: self.recipe(request, "").to_json()[0]}
        with checkpoint.running(
            self.capabilities.name, self._decisive(), request, self.exemplars, **asked
        ):
            made = self.make(request)
        return made if isinstance(made, tuple) else (made, {})

    def recipe(
        self, request: Request, sha256: str, report: Mapping[str, Any] | None = None
    ) -> Recipe:
        """The recipe of a result whose voxels have this digest."""
        return Recipe().then_made("generate", sha256, **self._step(request, report or {}))

    @property
    def dtype(self) -> np.dtype:
        """Of the values."""
        kind = self.facts[0].kind
        return (
            np.dtype(np.uint8)
            if kind == "labels" or not self.exemplars
            else self.exemplars[0].values.dtype
        )

    def plan_spilled(self, request: Request, memory: int) -> Plan:
        """Forecast of making a request in scratch files within a budget of bytes, of a method that
        `spills`.

        "pages" is what may be resident of the files.
        """
        whole, fixed = self.plan(request), {**self._plan_spilled(request), "writing": _WRITING}
        kept = sum(fixed.values())
        files = max(0, whole.peak - kept)
        pages = max(0, min(memory - kept, files))
        return Plan({**fixed, "pages": pages}, disk=whole.disk * 8 // 7, scratch=files + whole.disk)

    def _plan_spilled(self, request: Request) -> Mapping[str, int]:
        """Bytes needed in memory where arrays lie in scratch files: "interpreter and kernels",
        "exemplar", and "slab", what the thinnest slabs take."""
        raise NotImplementedError

    def _smaller(self, request: Request, budget: int) -> str:
        """Advice to one whose request is over the budget: what fits, where nothing in it is tied to
        its shape.
        """
        advice = "ask for a smaller --shape"
        if request.is_tied:
            return advice
        found = largest_within(
            request.shape, lambda shape: self._plan(replace(request, shape=shape)).peak, budget
        )
        return advice if found is None else f"{advice} ({' '.join(map(str, found))} fits)"

    def fields(self, request: Request) -> dict[str, Any]:
        """Kind, spacing, unit and phases of the result of a request."""
        found = self._result_fields()
        unit = found.get("unit", "voxel")
        spacing, unit = result_voxels(request, found["spacing"][-len(request.shape) :], unit)
        return {**found, "spacing": spacing, "unit": unit}

    def settings(self) -> dict[str, Any]:
        """All that tells one model of a method from another, beside its exemplars: plain JSON."""
        return {**asdict(self.config), **self._voxel()}

    def identity(self, request: Request) -> str:
        """SHA-256 of all that the voxels of a request depend on."""
        return checkpoint.identity_of(
            self.capabilities.name, self._decisive(), request, self.exemplars
        )

    def _decisive(self) -> dict[str, Any]:
        """All that tells this model from another, beside its exemplars."""
        return {"model": self.sha256} if self.capabilities.learns else self.settings()

    def _voxel(self) -> dict[str, Any]:
        """The size of the voxels, where no exemplar tells it."""
        return (
            {"voxel": {"spacing": self.facts[0].spacing[0], "unit": self.facts[0].unit}}
            if self._is_alone()
            else {}
        )

    def _is_alone(self) -> bool:
        return bool(self.facts) and self.facts[0].blank

    def _check_request(self, request: Request) -> None:
        refused = sorted(request.asks_for() - self.capabilities.honours)
        if refused:
            can = ", ".join(sorted(self.capabilities.honours)) or "shape and seed alone"
            raise RequestError(
                f"method {self.capabilities.name!r} cannot honour {', '.join(refused)}: it honours {can}"
            )
        strange = [
            name
            for name in request.target
            if name not in self.capabilities.targets and not self._knows_share(name)
        ]
        if strange:
            can = ", ".join(self.capabilities.targets)
            raise RequestError(
                f"method {self.capabilities.name!r} cannot honour the target {', '.join(strange)}: it honours {can}"
            )
        axes = self._axes()
        if len(request.shape) not in axes:
            raise RequestError(
                f"method {self.capabilities.name!r} makes {axes[0]}-D images{'' if self._is_alone() else ' of this exemplar'}, the "
                f"request is for {request.shape}: give {axes[0]} numbers"
            )
        if self.exemplars:
            check_exemplar(request, self.exemplars[0], spacing=self._result_fields()["spacing"])
            self._check_target(request)
        if self.facts:
            self.fields(request)  # a form of other voxels is refused before any work

    def _axes(self) -> tuple[int, ...]:
        """Of what can be made: 3 for volumes, 2 for pictures."""
        if not (self.capabilities.flat and self.facts):
            return (3,)
        return (3, 2) if self._is_alone() else (self.facts[0].ndim,)

    def _knows_share(self, name: str) -> bool:
        return OF_A_PHASE in self.capabilities.targets and name.startswith(OF_A_PHASE)

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
        """What the recipe of a result says of how it was made."""
        return {
            "method": self.capabilities.name,
            "settings": asdict(self.config),
            "request": request.to_json(),
            "exemplars": [facts.recipe.to_json() for facts in self.facts if not facts.blank],
            **self._voxel(),
            **(
                {"model": {"name": self.name, "sha256": self.sha256}}
                if self.capabilities.learns
                else {}
            ),
            **({"report": dict(report)} if report else {}),
        }

    @abstractmethod
    def _plan(self, request: Request) -> Plan: ...

    @abstractmethod
    def make(self, request: Request) -> np.ndarray | tuple[np.ndarray, Mapping[str, Any]]:
        """The values, or the values and what there is to tell of how they came to be (plain JSON)."""


def as_request(shape: Any, seed: int | None, parts: dict[str, Any]) -> Request:
    """A request as it is, or one of a shape, a seed and other parts."""
    if isinstance(shape, Request):
        if parts or seed is not None:
            raise InputError("give a Request, or shape, seed and parts, not both")
        return shape
    return Request(shape, seed=0 if seed is None else as_seed(seed), **parts)


def changed_settings(config: Any) -> str:
    """Return the settings that differ from a method's defaults, as NAME=VALUE."""
    usual = type(config)()
    changed = [
        one.name for one in fields(config) if getattr(config, one.name) != getattr(usual, one.name)
    ]
    return ", ".join(f"{name}={getattr(config, name)!r}" for name in changed) or "default settings"
