"""The base of every method: `Method`, which learns from exemplars and gives a `Model`.

A method's folder holds `CAPABILITIES` in its `__init__.py`, a frozen dataclass in `config.py`, and
a `Method` and a `Model` in `method.py`. The checks and the memory budget are here, once.
"""

from __future__ import annotations

import math
from abc import ABC
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
from trabecula.synth.api.model import Model, ModelState, as_request, nondefault_settings

__all__ = ["Capabilities", "Method", "Model", "ModelState", "as_exemplars", "as_request"]


class Method(ABC):
    """A way to make material, with its settings.

    A subclass names its `capabilities`, `config_type` and `model_type`, and may override three
    hooks: `learn`, `from_state` and `memory`.

    Attributes
    ----------
    capabilities : Capabilities
    config_type : type
        Frozen dataclass of the settings. It may have two class methods: `preset(name)` gives the
        settings of a preset; `recorded(settings)` completes those of a recipe or a model that are
        older than some field, so that the default of a new field need not be what held before it.
        A method `alternatives(effort)` of its own lists settings to try beside them.
    model_type : type
        `Model` that the default `learn` builds.
    learning_cost : float
        Time of learning from a voxel of the exemplar over that of making one, for a progress bar.
    """

    capabilities: ClassVar[Capabilities]
    config_type: ClassVar[type]
    model_type: ClassVar[type[Model]]
    learning_cost: ClassVar[float] = 0.1

    def __init__(self, config: Any) -> None:
        self.config = config

    def __repr__(self) -> str:
        return f"<Method {self.capabilities.name}: {nondefault_settings(self.config)}>"

    @classmethod
    def configure(cls, /, *, preset: str | None = None, **settings: Any) -> Method:
        """Build the method with a preset's settings, changed by `settings`.

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

    def learn(self, exemplars: Sequence[Any]) -> Model:
        """Build the model of exemplars (hook).

        Parameters
        ----------
        exemplars : sequence of Image
            Checked against the capabilities, each with a recipe. Where the settings alone are
            enough and none was given: one `ExemplarInfo`, which tells spacing and unit.
        """
        return self.model_type(self.config, exemplars)

    def from_state(self, exemplars: Sequence[Any], state: ModelState) -> Model:
        """Build the model that gave a `Model.state` (hook).

        Parameters
        ----------
        exemplars : sequence of Image, or of ExemplarInfo
            The exemplars that it learned from; without voxels where a model `stores_exemplar`
            not, or learned from settings alone.
        state : ModelState
            Arrays and plain values of a file: to be checked.

        Raises
        ------
        ValueError, TypeError, LookupError
            No state of such a model.
        """
        return self.learn(exemplars)

    def memory(self, exemplars: Sequence[Any]) -> Mapping[str, int]:
        """Forecast the bytes that `learn` takes at its peak beside the exemplars, by purpose
        (hook); empty where nothing is known.
        """
        return {}

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
            Edge of the result's voxels, without an exemplar. Default: 1 "voxel".
        memory : int, optional
            Budget in bytes. Default: the memory that the machine has available.

        Raises
        ------
        InputError
            An exemplar has the wrong dimensions or kind, one phase only, or is too small; several
            that differ; none where one is needed; a spacing beside an exemplar, which has its own.
        MemoryBudgetError
            Learning would take more memory than the budget.
        """
        if exemplar is None and self.capabilities.alone:
            edge, name = 1.0 if spacing is None else spacing, "voxel" if unit is None else unit
            return self.learn([without_exemplar(edge, name)])
        if spacing is not None or unit is not None:
            raise InputError(
                "spacing and unit are those of the exemplar: set them there (tb.read(..., "
                "spacing=, unit=))"
            )
        images = as_exemplars(exemplar)
        self._check_exemplars(images)
        _notify_margins(images)
        advice = "learn from a smaller crop (--crop)"
        check_budget(self.plan_fit(images), budget=memory, advice=advice)
        return self.learn([_with_recipe(image) for image in images])

    def restore(self, exemplars: Sequence[Image | ExemplarInfo], state: ModelState) -> Model:
        """Build the model that `fit` made of the same exemplars, from its state.

        Raises
        ------
        InputError
            As `fit`.
        ValueError, TypeError, LookupError
            No state of such a model.
        """
        images = [one for one in exemplars if isinstance(one, Image)]
        if images:
            self._check_exemplars(images)
            exemplars = [_with_recipe(image) for image in images]
        return self.from_state(exemplars, state)

    def learning_share(self, exemplars: Sequence[Image] | None, shape: Sequence[int]) -> float:
        """Return the part of a run's time, 0..1, that learning takes, for a progress bar."""
        learning = self.learning_cost * sum(one.values.size for one in exemplars or ())
        return learning / (learning + math.prod(shape))

    def plan_fit(self, exemplar: Image | np.ndarray | Sequence[Image] | None = None) -> Plan:
        """Forecast the memory that learning takes, the exemplars themselves left out."""
        if exemplar is None and self.capabilities.alone:
            return Plan()
        return Plan(dict(self.memory(as_exemplars(exemplar))))

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
                        f"exemplars of one material agree in {name}: got {getattr(first, name)} "
                        f"and {getattr(image, name)}; resample or rename them first"
                    )

    def _check_exemplar(self, image: Image) -> None:
        known = self.capabilities
        if known.exemplar is None:
            raise InputError(
                f"method {known.name!r} takes no exemplar: leave it out, its settings are enough"
            )
        if not known.accepts(image.ndim):
            raise InputError(
                f"method {known.name!r} learns from a {known.exemplar} exemplar, got {image.ndim}d "
                f"of shape {image.shape}: tb.inspect(image).recommendation names one that fits"
            )
        if image.kind not in known.kinds:
            raise InputError(
                f"method {known.name!r} takes {' or '.join(known.kinds)}, got {image.kind}: "
                "segment it first (tb.segment, or --threshold auto)"
            )
        if image.kind == "labels" and len(np.unique(image.values)) < 2:
            phase = image.phases[int(image.values.flat[0])]
            raise InputError(
                f"the exemplar holds one phase only ({phase}): "
                "give a crop with both, or another threshold"
            )


def _notify_margins(images: Sequence[Image]) -> None:
    """Report exemplars that have margins without material, since results have as much of them."""
    for number, image in enumerate(images, start=1):
        note = margin_note(image)
        if note is not None:
            notify(note if len(images) == 1 else f"exemplar {number}: {note}")


def _with_recipe(image: Image) -> Image:
    """Give an exemplar a recipe that names it, by its voxels at least."""
    if image.recipe:
        return image
    return with_values(image, image.values, recipe=Recipe().then("array", image.values))


def as_exemplars(given: Any) -> list[Image]:
    """Return one or several exemplars as a list of images."""
    images = list(given) if isinstance(given, (list, tuple)) else [] if given is None else [given]
    if not images:
        raise InputError("no exemplar was given: give one, or several of one material")
    return [as_image(image, name="the exemplar") for image in images]
