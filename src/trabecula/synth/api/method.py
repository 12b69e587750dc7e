"""What a method's folder builds on: `Capabilities` (what it can do), `Method` (fit) and `Model`
(generate).

A method's folder holds `CAPABILITIES` in its `__init__.py`, a frozen dataclass in `config.py` and a
`Method` in `method.py`, which fills in `_plan_fit` and `learn`; the checks and the memory budget
are here, once.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any, ClassVar

import numpy as np

from trabecula.core.checks import check_name
from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image, with_values
from trabecula.core.progress import notify
from trabecula.core.recipe import Recipe
from trabecula.engine.memory import Plan, check_budget
from trabecula.measure.margins import margin_note
from trabecula.synth.api.capabilities import Capabilities
from trabecula.synth.api.exemplar_info import ExemplarInfo, without_exemplar
from trabecula.synth.api.model import Model, as_request, changed_settings

__all__ = ["Capabilities", "Method", "Model", "as_exemplars", "as_request"]


class Method(ABC):
    """A way to make material, with its settings."""

    capabilities: ClassVar[Capabilities]
    config_type: ClassVar[type]

    def __init__(self, config: Any) -> None:
        self.config = config

    def __repr__(self) -> str:
        return f"<Method {self.capabilities.name}: {changed_settings(self.config)}>"

    @classmethod
    def configured(cls, /, *, preset: str | None = None, **settings: Any) -> Method:
        """The method with a preset's settings, changed by `settings`.

        Raises
        ------
        UnknownNameError
            No such preset or setting; the nearest name is suggested.
        """
        if preset is not None:
            check_name(preset, cls.capabilities.presets, name=f"preset of {cls.capabilities.name}")
            settings = {**cls.config_type.preset(preset), **settings}  # type: ignore[attr-defined]
        known = {field.name for field in fields(cls.config_type)}
        for name in settings:
            check_name(name, known, name=f"setting of {cls.capabilities.name}")
        return cls(cls.config_type(**settings))

    def fit(
        self,
        exemplar: Image | np.ndarray | Sequence[Image] | None = None,
        *,
        spacing: float | None = None,
        unit: str | None = None,
        memory: int | None = None,
    ) -> Model:
        """Learn from an exemplar, or from several of one material; or from none, where the method
        works from settings alone.

        Parameters
        ----------
        exemplar : Image or array of labels, or a list or tuple of them, optional
            Several need one kind, one spacing and the same phases.
        spacing, unit : float and str, optional
            Edge of the voxels that are made, where there is no exemplar to tell it. Default: 1
            "voxel".
        memory : int, optional
            Budget in bytes. Default: what the machine has available.

        Raises
        ------
        InputError
            An exemplar has the wrong dimensions or kind, one phase only, or is too small; several
            that differ; none where one is needed; a spacing beside an exemplar, which has its own.
        MemoryBudgetError
            Learning would take more memory than the budget.
        """
        if exemplar is None and self.capabilities.alone:
            return self._blank(
                without_exemplar(
                    1.0 if spacing is None else spacing, "voxel" if unit is None else unit
                )
            )
        if spacing is not None or unit is not None:
            raise InputError(
                "spacing and unit are those of the exemplar: set them there (tb.read(..., spacing=, unit=))"
            )
        images = as_exemplars(exemplar)
        self._check_exemplars(images)
        _say_margins(images)
        check_budget(
            self.plan_fit(images), budget=memory, advice="learn from a smaller crop (--crop)"
        )
        return self.learn([_named(image) for image in images])

    def fit_again(self, exemplars: Sequence[Image], found: Mapping[str, Any]) -> Model:
        """The model that `fit` made of the same exemplars, from what it had found in them
        (`Model.looked_up`).

        Raises
        ------
        InputError
            As `fit`.
        ValueError, TypeError, LookupError
            Something else than had been found.
        """
        self._check_exemplars(exemplars)
        return self._fit_again([_named(image) for image in exemplars], found)

    def _fit_again(self, exemplars: Sequence[Image], found: Mapping[str, Any]) -> Model:
        """As `learn`, of a method whose models tell what they `looked_up`."""
        raise NotImplementedError

    def _check_exemplars(self, images: Sequence[Image]) -> None:
        if len(images) > 1 and not self.capabilities.several:
            raise InputError(
                f"method {self.capabilities.name!r} learns from one exemplar, got {len(images)}"
            )
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
        spec = self.capabilities
        if spec.exemplar is None:
            raise InputError(f"method {spec.name!r} takes no exemplar")
        if f"{image.ndim}d" != spec.exemplar and not (spec.flat and image.ndim == 2):
            raise InputError(
                f"method {spec.name!r} learns from a {spec.exemplar} exemplar, got {image.ndim}d of shape {image.shape}: "
                "tb.inspect(image).recommendation names one that fits"
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
        return (
            Plan()
            if exemplar is None and self.capabilities.alone
            else self._plan_fit(as_exemplars(exemplar))
        )

    @abstractmethod
    def _plan_fit(self, exemplars: Sequence[Image]) -> Plan: ...

    @abstractmethod
    def learn(self, exemplars: Sequence[Image]) -> Model: ...

    def _blank(self, facts: ExemplarInfo) -> Model:
        """The model of the settings alone, of a method whose Spec says `alone`."""
        raise NotImplementedError

    def from_state(
        self,
        facts: Sequence[ExemplarInfo],
        arrays: Mapping[str, np.ndarray],
        plain: Mapping[str, Any],
        *,
        history: Mapping[str, Any],
    ) -> Model:
        """The model that told `Model.state`, of a method whose Spec says `learns`.

        Raises
        ------
        ValueError, TypeError, LookupError
            Arrays or words that are not such a model's.
        """
        raise NotImplementedError


def _say_margins(images: Sequence[Image]) -> None:
    """Say which exemplars have margins without material, since what is made has as much of them."""
    for number, image in enumerate(images, start=1):
        note = margin_note(image)
        if note is not None:
            notify(note if len(images) == 1 else f"exemplar {number}: {note}")


def _named(image: Image) -> Image:
    """An exemplar whose recipe names it, by its voxels at least."""
    return (
        image
        if image.recipe
        else with_values(image, image.values, recipe=Recipe().then("array", image.values))
    )


def as_exemplars(given: Any) -> list[Image]:
    """One or several exemplars as a list of images."""
    images = list(given) if isinstance(given, (list, tuple)) else [] if given is None else [given]
    if not images:
        raise InputError("no exemplar was given: give one, or several of one material")
    return [as_image(image, name="the exemplar") for image in images]
