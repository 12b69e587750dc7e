"""What a method is: `Spec` (what it can do), `Method` (fit) and `Model` (generate).

A method's folder holds `SPEC` in its `__init__.py`, a frozen dataclass in `config.py` and a `Method` in `method.py`.
The checks, the memory budget and the recipe are here, once; a method fills in `_fit`, `_plan` and `_generate`.
"""

from __future__ import annotations

import hashlib
import os
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from trabecula.core.checks import as_seed, check_name
from trabecula.core.errors import InputError, RequestError
from trabecula.core.image import Image, as_image, with_values
from trabecula.core.recipe import Recipe
from trabecula.core.request import Request, check_exemplar
from trabecula.core.target import OF_A_PHASE
from trabecula.engine import checkpoint
from trabecula.engine.plan import Plan, check_budget
from trabecula.exemplar.target import check_target_porosity
from trabecula.synth.facts import Facts, blank, facts_of


@dataclass(frozen=True)
class Spec:
    """What the registry, the contract tests, the command line and the docs know of a method without importing it.

    Parameters
    ----------
    name, summary, paper : str
    exemplar : {"2d", "3d", None}
        What it learns from; None where it needs no exemplar.
    kinds : tuple of str
        Kinds of exemplar that it accepts.
    honours : frozenset of str
        Parts of a `Request` beyond shape and seed: "periodic", "mask", "target", "fixed".
    scaling : {"window", "sweep", "whole"}
        How it runs on volumes larger than memory (DESIGN: big and repeatable).
    target : str
        "module:Class" of the method.
    extras : tuple of str
        Extras of the package that it needs.
    presets : tuple of str
        Names of ready settings.
    several : bool
        Whether it learns from more than one exemplar at once.
    targets : tuple of str
        Descriptors of a request's target that a method that honours "target" knows; "volume_fraction:" stands for the share of
        any phase.
    learns : bool
        Whether a model holds what it learned instead of its exemplars, so that its file is needed to make a result again.
    flat : bool
        Whether it also makes pictures: 2-D of 2-D, beside 3-D of 3-D; without an exemplar, whichever is asked for.
    alone : bool
        Whether it also makes material from its settings alone, without an exemplar.
    trial : mapping
        Settings with which learning takes seconds where the defaults take minutes, for tests; what comes out is of no use.
    """

    name: str
    summary: str
    paper: str
    exemplar: str | None
    kinds: tuple[str, ...]
    scaling: str
    target: str
    honours: frozenset[str] = frozenset()
    extras: tuple[str, ...] = ()
    presets: tuple[str, ...] = ()
    several: bool = False
    targets: tuple[str, ...] = ("porosity", "volume_fraction")
    learns: bool = False
    flat: bool = False
    alone: bool = False
    trial: Mapping[str, Any] = field(default_factory=dict)


class Model(ABC):
    """A method that has seen its exemplar.

    Attributes
    ----------
    facts : tuple of Facts
        What is known of the exemplars apart from their voxels; without any, of what is made (`facts.blank`).
    exemplars : tuple of Image
        The exemplars themselves; none where the method `learns` all that it needs of them.
    name : str, optional
        Of the file that it was saved to or loaded from, or of the shipped model.
    """

    spec: ClassVar[Spec]
    name: str | None = None

    def __init__(self, config: Any, exemplars: Sequence[Image | Facts]) -> None:
        self.config = config
        self.facts = tuple(facts_of(exemplar) for exemplar in exemplars)
        self.exemplars = () if self.spec.learns else tuple(one for one in exemplars if isinstance(one, Image))

    def learned(self) -> tuple[Mapping[str, np.ndarray], Mapping[str, Any]]:
        """Arrays and plain JSON from which `Method.restored` makes the same model, of a method that `learns`."""
        raise NotImplementedError

    @property
    def history(self) -> Mapping[str, Any]:
        """How the learning went, plain JSON: kept in the model's file, and no part of what the model is."""
        return {}

    @property
    def sha256(self) -> str:
        """Digest of all that its results depend on: of the file it is saved as, without its history and versions."""
        from trabecula.synth.saved import encoded  # which knows the registry, and that knows us

        return hashlib.sha256(encoded(self)).hexdigest()

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the model to a file that `tb.load_model` reads; it holds no voxels where the method `learns`.

        Raises
        ------
        FileError
            The file cannot be written.
        """
        from trabecula.synth.saved import save_model

        return save_model(self, path)

    def plan(self, request: Request) -> Plan:
        """Forecast memory and disk of a request, without starting it."""
        self._check_request(request)
        return self._plan(request)

    def generate(
        self, shape: Request | int | Sequence[int], *, seed: int | None = None, memory: int | None = None, **parts: Any
    ) -> Image:
        """Make material.

        Parameters
        ----------
        shape : int, sequence of int, or Request
            Voxels along z, y, x (one number: a cube), or the whole request.
        seed : int
            0 .. 2**63 - 1; 0 where neither this nor the request says otherwise. Same seed, same voxels.
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
        check_budget(self.plan(request), budget=memory)
        with checkpoint.running(self.spec.name, self.settings(), request, self.exemplars):
            made = self._generate(request)
        values, report = made if isinstance(made, tuple) else (made, {})
        recipe = Recipe().then("generate", values, **self._step(request, report))
        return Image(values, **self.fields(request), recipe=recipe)

    def fields(self, request: Request) -> dict[str, Any]:
        """Kind, spacing, unit and phases of the result of a request."""
        found = self._result_fields()
        return {**found, "spacing": found["spacing"][-len(request.shape) :]}

    def settings(self) -> dict[str, Any]:
        """All that tells one model of a method from another, beside its exemplars: plain JSON."""
        return {**asdict(self.config), **self._voxel()}

    def _voxel(self) -> dict[str, Any]:
        """The size of the voxels, where no exemplar tells it."""
        return {"voxel": {"spacing": self.facts[0].spacing[0], "unit": self.facts[0].unit}} if self._is_alone() else {}

    def _is_alone(self) -> bool:
        return bool(self.facts) and self.facts[0].blank

    def _check_request(self, request: Request) -> None:
        refused = sorted(request.asks_for() - self.spec.honours)
        if refused:
            can = ", ".join(sorted(self.spec.honours)) or "shape and seed alone"
            raise RequestError(f"method {self.spec.name!r} cannot honour {', '.join(refused)}: it honours {can}")
        strange = [name for name in request.target if name not in self.spec.targets and not self._knows_share(name)]
        if strange:
            can = ", ".join(self.spec.targets)
            raise RequestError(
                f"method {self.spec.name!r} cannot honour the target {', '.join(strange)}: it honours {can}"
            )
        axes = self._axes()
        if len(request.shape) not in axes:
            raise RequestError(
                f"method {self.spec.name!r} makes {axes[0]}-D images{'' if self._is_alone() else ' of this exemplar'}, the "
                f"request is for {request.shape}: give {axes[0]} numbers"
            )
        if self.exemplars:
            check_exemplar(request, self.exemplars[0], spacing=self._result_fields()["spacing"])
            self._check_target(request)

    def _axes(self) -> tuple[int, ...]:
        """Of what can be made: 3 for volumes, 2 for pictures."""
        if not (self.spec.flat and self.facts):
            return (3,)
        return (3, 2) if self._is_alone() else (self.facts[0].ndim,)

    def _knows_share(self, name: str) -> bool:
        return OF_A_PHASE in self.spec.targets and name.startswith(OF_A_PHASE)

    def _check_target(self, request: Request) -> None:
        """Raise where the exemplars hold nothing like the target; a method that comes as near as it can overrides this."""
        check_target_porosity(request.target, self.exemplars, mask=request.mask)

    def _result_fields(self) -> dict[str, Any]:
        first = self.facts[0]
        return {"kind": first.kind, "spacing": first.spacing, "unit": first.unit, "phases": first.phases}

    def _step(self, request: Request, report: Mapping[str, Any]) -> dict[str, Any]:
        """What the recipe of a result says of how it was made."""
        return {
            "method": self.spec.name,
            "settings": asdict(self.config),
            "request": request.to_json(),
            "exemplars": [facts.recipe.to_json() for facts in self.facts if not facts.blank],
            **self._voxel(),
            **({"model": {"name": self.name, "sha256": self.sha256}} if self.spec.learns else {}),
            **({"report": dict(report)} if report else {}),
        }

    @abstractmethod
    def _plan(self, request: Request) -> Plan: ...

    @abstractmethod
    def _generate(self, request: Request) -> np.ndarray | tuple[np.ndarray, Mapping[str, Any]]:
        """The values, or the values and what there is to tell of how they came to be (plain JSON)."""


class Method(ABC):
    """A way to make material, with its settings."""

    spec: ClassVar[Spec]
    config_type: ClassVar[type]

    def __init__(self, config: Any) -> None:
        self.config = config

    @classmethod
    def configured(cls, /, *, preset: str | None = None, **settings: Any) -> Method:
        """The method with a preset's settings, changed by `settings`.

        Raises
        ------
        UnknownNameError
            No such preset or setting; the nearest name is suggested.
        """
        if preset is not None:
            check_name(preset, cls.spec.presets, name=f"preset of {cls.spec.name}")
            settings = {**cls.config_type.preset(preset), **settings}  # type: ignore[attr-defined]
        known = {field.name for field in fields(cls.config_type)}
        for name in settings:
            check_name(name, known, name=f"setting of {cls.spec.name}")
        return cls(cls.config_type(**settings))

    def fit(
        self,
        exemplar: Image | np.ndarray | Sequence[Image] | None = None,
        *,
        spacing: float | None = None,
        unit: str | None = None,
        memory: int | None = None,
    ) -> Model:
        """Learn from an exemplar, or from several of one material; or from none, where the method works from settings alone.

        Parameters
        ----------
        exemplar : Image or array of labels, or a list or tuple of them, optional
            Several need one kind, one spacing and the same phases.
        spacing, unit : float and str, optional
            Edge of the voxels that are made, where there is no exemplar to tell it. Default: 1 "voxel".
        memory : int, optional
            Budget in bytes. Default: what the machine has available.

        Raises
        ------
        InputError
            An exemplar has the wrong dimensions or kind, one phase only, or is too small; several that differ; none where one
            is needed; a spacing beside an exemplar, which has its own.
        MemoryBudgetError
            Learning would take more memory than the budget.
        """
        if exemplar is None and self.spec.alone:
            return self._blank(blank(1.0 if spacing is None else spacing, "voxel" if unit is None else unit))
        if spacing is not None or unit is not None:
            raise InputError(
                "spacing and unit are those of the exemplar: set them there (tb.read(..., spacing=, unit=))"
            )
        images = as_exemplars(exemplar)
        self._check_exemplars(images)
        check_budget(self.plan_fit(images), budget=memory, advice="learn from a smaller crop (--crop)")
        named = [
            image if image.recipe else with_values(image, image.values, recipe=Recipe().then("array", image.values))
            for image in images
        ]
        return self._fit(named)

    def _check_exemplars(self, images: Sequence[Image]) -> None:
        if len(images) > 1 and not self.spec.several:
            raise InputError(f"method {self.spec.name!r} learns from one exemplar, got {len(images)}")
        for image in images:
            self._check_exemplar(image)
        first = images[0]
        for image in images[1:]:
            for name in ("kind", "phases", "spacing", "unit"):
                if getattr(image, name) != getattr(first, name):
                    raise InputError(
                        f"exemplars of one material agree in {name}: got {getattr(first, name)} and "
                        f"{getattr(image, name)}; resample or rename them first"
                    )

    def _check_exemplar(self, image: Image) -> None:
        spec = self.spec
        if spec.exemplar is None:
            raise InputError(f"method {spec.name!r} takes no exemplar")
        if f"{image.ndim}d" != spec.exemplar and not (spec.flat and image.ndim == 2):
            raise InputError(
                f"method {spec.name!r} learns from a {spec.exemplar} exemplar, got {image.ndim}d of shape {image.shape}"
            )
        if image.kind not in spec.kinds:
            raise InputError(
                f"method {spec.name!r} takes {' or '.join(spec.kinds)}, got {image.kind}: "
                "segment it first (tb.segment, or --threshold auto)"
            )
        if image.kind == "labels" and len(np.unique(image.values)) < 2:
            raise InputError(
                f"the exemplar holds one phase only ({image.phases[int(image.values.flat[0])]}): "
                "give a crop with both, or another threshold"
            )

    def plan_fit(self, exemplar: Image | np.ndarray | Sequence[Image] | None = None) -> Plan:
        """Forecast the memory that learning takes, the exemplars themselves left out."""
        return Plan() if exemplar is None and self.spec.alone else self._plan_fit(as_exemplars(exemplar))

    @abstractmethod
    def _plan_fit(self, exemplars: Sequence[Image]) -> Plan: ...

    @abstractmethod
    def _fit(self, exemplars: Sequence[Image]) -> Model: ...

    def _blank(self, facts: Facts) -> Model:
        """The model of the settings alone, of a method whose Spec says `alone`."""
        raise NotImplementedError

    def restored(
        self,
        facts: Sequence[Facts],
        arrays: Mapping[str, np.ndarray],
        plain: Mapping[str, Any],
        *,
        history: Mapping[str, Any],
    ) -> Model:
        """The model that told `Model.learned`, of a method whose Spec says `learns`.

        Raises
        ------
        ValueError, TypeError, LookupError
            Arrays or words that are not such a model's.
        """
        raise NotImplementedError


def as_exemplars(given: Any) -> list[Image]:
    """One or several exemplars as a list of images."""
    images = list(given) if isinstance(given, (list, tuple)) else [] if given is None else [given]
    if not images:
        raise InputError("no exemplar was given: give one, or several of one material")
    return [as_image(image, name="the exemplar") for image in images]


def as_request(shape: Any, seed: int | None, parts: dict[str, Any]) -> Request:
    """A request as it is, or one of a shape, a seed and other parts."""
    if isinstance(shape, Request):
        if parts or seed is not None:
            raise InputError("give a Request, or shape, seed and parts, not both")
        return shape
    return Request(shape, seed=0 if seed is None else as_seed(seed), **parts)
