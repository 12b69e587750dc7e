"""`noise`: fit chooses a field, generate makes it and cuts it at a level.

The fields are in gaussian.py and pattern.py. Of several phases one comes after another, each within
the rest of those before: the field of a phase is independent of the others', so that the
conditional S2 (pairs in the phase over pairs in the rest) is that of a cut Gaussian field.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from trabecula.core.errors import InputError, RequestError
from trabecula.core.image import Image
from trabecula.core.request import Request
from trabecula.engine.blocks import Box
from trabecula.engine.memory import Array, Stage, forecast
from trabecula.numerics.transforms import fast_side
from trabecula.synth.api.exemplar_info import ExemplarInfo
from trabecula.synth.api.method import Method
from trabecula.synth.api.windows import WindowModel
from trabecula.synth.noise import CAPABILITIES
from trabecula.synth.noise.config import NoiseConfig
from trabecula.synth.noise.covariance import fit_filters, reach_of
from trabecula.synth.noise.fields import (
    Field,
    Phases,
    choose_field,
    label_by_rank,
    phases_of,
    stages_of_ranking,
)
from trabecula.synth.noise.turned import TurnedField, principal_axis, turned_stages, wanted_share
from trabecula.synth.shared.gaussian.domain import domain_of, lift_box
from trabecula.synth.shared.gaussian.field import PIECE, GaussianField
from trabecula.synth.shared.gaussian.filters import Filter

_PROCESS = 180 << 20  # bytes of the interpreter with NumPy, Numba and the kernels loaded
_TABLES = 300_000  # bytes of the joint probability's table and what makes it
_LEAST = 8  # voxels along an axis of the exemplar, unless it is 1 thick


class Noise(Method):
    """Noise, cut at a level."""

    capabilities = CAPABILITIES
    config_type = NoiseConfig

    def learn(self, exemplars: Sequence[Image]) -> NoiseModel:
        exemplar = exemplars[0]
        if any(1 < side < _LEAST for side in exemplar.shape):
            raise InputError(
                f"the exemplar is {exemplar.shape}, the two-point function needs {_LEAST} voxels "
                "along an axis (or 1, for a flat image): give a larger exemplar"
            )
        return NoiseModel(self.config, exemplars)

    def memory(self, exemplars: Sequence[Image]) -> Mapping[str, int]:
        """Forecast the transforms of an indicator, and those of the covariance."""
        values = _volume(exemplars[0].values)
        fixed = {"interpreter and kernels": _PROCESS, "exemplar": 3 * values.size + _TABLES}
        if not _fits_covariance(self.config):
            return fixed
        reach = reach_of(values.shape, self.config, flat=exemplars[0].ndim == 2)
        padded = np.prod(
            [fast_side(side + far) for side, far in zip(values.shape, reach, strict=True)],
            dtype=np.int64,
        )
        offsets = int(np.prod([2 * far + 1 for far in reach], dtype=np.int64))
        filters = {"filters": Array((len(np.unique(values)) - 1, offsets), np.float32)}
        stages = (
            Stage("two-point function", filters, 21 * int(padded) + 8 * offsets),
            Stage("filter", filters, 72 * offsets),
        )
        return forecast(stages, fixed).memory


class NoiseModel(WindowModel):
    """A field, and the phases that are cut out of it.

    Attributes
    ----------
    filters : list of Filter
        Of the exemplar's covariance: one per phase but the last, each with the share of its
        spectrum that had to be clipped. Empty where something else is made.
    """

    capabilities = CAPABILITIES
    config: NoiseConfig
    block = PIECE

    def __init__(self, config: NoiseConfig, exemplars: Sequence[Image | ExemplarInfo]) -> None:
        super().__init__(config, exemplars)
        self.phases: Phases = phases_of(config, self.facts[0], self.exemplars)
        values = [_volume(exemplar.values) for exemplar in self.exemplars]
        self.filters = (
            fit_filters(values[0], self.phases.labels, config, flat=self.facts[0].ndim == 2)
            if values and _fits_covariance(config)
            else []
        )
        self._fields: dict[bool, Field] = {}
        self._turned: tuple[Request, TurnedField] | None = None
        two = isinstance(config.length, tuple) and len(config.length) == 2
        # so that impossible settings raise before any request
        self._field(two or self.facts[0].ndim == 2)

    def _field(self, flat: bool) -> Field:
        """Return the field of volumes, or of pictures."""
        if flat not in self._fields:
            self._fields[flat] = choose_field(self.config, self.facts[0], self.filters, flat=flat)
        return self._fields[flat]

    def make_box(self, request: Request, box: Box) -> np.ndarray:
        if request.target:
            return self._make_turned(request, box)
        domain, field, last = domain_of(request), self._field(len(box) == 2), self.phases.labels[-1]
        box = lift_box(box)
        result = np.full([stop - start for start, stop in box], last, np.uint8)
        for i, label in enumerate(self.phases.labels[:-1]):
            level = field.level(i, self.phases.share(i))
            # looking up is many times faster than picking voxels
            choice = np.array([last, label], np.uint8)

            def cut(
                piece: tuple[slice, ...],
                z: int,
                plane: np.ndarray,
                choice: np.ndarray = choice,
                level: float = level,
                first: bool = i == 0,
            ) -> None:
                target, found = result[piece][z], choice[(plane > level).view(np.uint8)]
                target[:] = found if first else np.where(target == last, found, target)

            field.each(i, domain, box, cut, most=level)
        return result[0] if domain.flat else result

    def _make_turned(self, request: Request, box: Box) -> np.ndarray:
        """Return a box of material that is turned, scaled and as dense as its target says."""
        if self._turned is None or self._turned[0] is not request:
            self._turned = request, TurnedField(self._filter(), request)
        first, last = self.phases.labels
        void_first = first == self._void()
        share = wanted_share(request, box, self._porosity(), void_first=void_first)
        high = self._turned[1].cut(request, box, share, exact=self.config.exact)
        return np.where(high, np.uint8(first), np.uint8(last))

    def _filter(self) -> Filter:
        """Return the filter of the one field of void and solid."""
        field = self._field(False)
        assert isinstance(field, GaussianField)  # checked with the request
        return field.filters[0]

    def _void(self) -> int:
        phases = self.facts[0].phases
        return phases.index("void") if "void" in phases else self.phases.labels[0]

    def _porosity(self) -> float:
        """Return the fraction of the void where the target has none."""
        return dict(zip(self.phases.labels, self.phases.fractions, strict=True))[self._void()]

    def _check_request(self, request: Request) -> None:
        super()._check_request(request)
        if not request.target:
            return
        if self.config.kind != "gaussian" or len(self.phases.labels) != 2:
            what = "several phases" if len(self.phases.labels) > 2 else f"kind={self.config.kind!r}"
            raise RequestError(
                f"a target is honoured by Gaussian fields of two phases, this is {what}: change "
                "that, or leave the target out"
            )
        if len(request.shape) != 3:
            raise RequestError("a target of noise is for volumes: give three sides")
        turned_stages(self._filter(), request, (1, 1, 1))  # refuses what reaches too far
        if "orientation" in request.target:
            principal_axis(self._filter())

    def _check_target(self, request: Request) -> None:
        """Accept any porosity: the level is known for all."""

    def make(self, request: Request) -> tuple[np.ndarray, Mapping[str, Any]]:
        if not self.config.exact:
            return super().make(request)
        if request.target:
            values = self._make_turned(request, tuple((0, side) for side in request.shape))
            if request.mask is not None:
                values[~request.mask] = self._void()
            return values, {}
        void = self.facts[0].phases.index("void") if "void" in self.facts[0].phases else 0
        return label_by_rank(
            request, self._field(len(request.shape) == 2), self.phases, outside=void
        ), {}

    def memory(self, request: Request) -> Mapping[str, int]:
        if not self.config.exact or request.target:
            return super().memory(request)
        field, shape = self._field(len(request.shape) == 2), domain_of(request).shape
        return forecast(stages_of_ranking(field, shape), self._constant_bytes()).memory

    def _check_windows(self) -> None:
        if self.config.exact:
            raise RequestError(
                "exact shares are found by rank over all voxels at once, no box of which is made "
                "alone: leave exact out"
            )

    def box_memory(self, request: Request, shape: tuple[int, ...]) -> Mapping[str, int]:
        if request.target:
            stages = turned_stages(self._filter(), request, shape)
            return forecast(stages, self._constant_bytes()).memory
        field = self._field(len(shape) == 2)
        stages = field.stages((1,) * (3 - len(shape)) + tuple(shape))
        return forecast(stages, self._constant_bytes()).memory

    def _constant_bytes(self) -> dict[str, int]:
        """Return the bytes that do not depend on the request."""
        filters = sum(part.values.nbytes for part in self.filters)
        exemplars = sum(image.values.size for image in self.exemplars)
        return {"interpreter and kernels": _PROCESS, "exemplar": filters + exemplars}


def _volume(values: np.ndarray) -> np.ndarray:
    """Return a picture as a volume of one plane."""
    return values[None] if values.ndim == 2 else values


def _fits_covariance(config: NoiseConfig) -> bool:
    """Return whether the field has an exemplar's covariance, where there is an exemplar."""
    return config.kind == "gaussian" and config.covariance == "auto"
