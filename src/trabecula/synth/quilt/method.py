"""METHOD"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trabecula.core.errors import RequestError
from trabecula.core.image import Image
from trabecula.core.progress import notify
from trabecula.core.request import Request
from trabecula.engine.plan import Plan
from trabecula.measure.runs import INSIDE
from trabecula.synth.api.method import Method, Model
from trabecula.synth.quilt import CAPABILITIES
from trabecula.synth.quilt.candidates import HELD
from trabecula.synth.quilt.canvas import Frame, deep_shape, frame_for
from trabecula.synth.quilt.compatibility import Forecast, Trace, check_held, forecast_of
from trabecula.synth.quilt.config import QuiltConfig
from trabecula.synth.quilt.connectivity import parts_of
from trabecula.synth.quilt.patch_library import Learnt, planes_for
from trabecula.synth.quilt.period import in_phase, phase_key
from trabecula.synth.quilt.run import Run
from trabecula.synth.shared.orient import symmetries

_PROCESS = 180 << 20  # bytes of the interpreter with NumPy, Numba and the kernels loaded


class Quilt(Method):
    """Graph-cut quilting."""

    capabilities = CAPABILITIES
    config_type = QuiltConfig
    config: QuiltConfig

    def learn(self, exemplars: Sequence[Image]) -> QuiltModel:
        return QuiltModel(self.config, exemplars)

    def _plan_fit(self, exemplars: Sequence[Image]) -> Plan:
        """Words and a copy of every orientation, and what cleaning takes."""
        turns = len(
            symmetries(
                self.config.orientations, ndim=exemplars[0].ndim, spacing=exemplars[0].spacing
            )
        )
        planes = planes_for(len(exemplars[0].phases))
        voxels = sum(int(np.prod(exemplar.shape)) for exemplar in exemplars)
        return Plan(
            {
                "interpreter and kernels": _PROCESS,
                "exemplar": turns * voxels * (2 + 16 * planes),
                "working": 18 * voxels,
            }
        )


class QuiltModel(Model):
    """Exemplars as words."""

    capabilities = CAPABILITIES
    config: QuiltConfig
    spills = True

    def __init__(self, config: QuiltConfig, exemplars: Sequence[Image]) -> None:
        super().__init__(config, exemplars)
        self.learnt = Learnt.of(exemplars, config)
        self._held: dict[str, tuple[float, float]] = {}

    @property
    def patch(self) -> int:
        """Side of a neighbourhood, voxels."""
        return self.learnt.patch

    @property
    def overlap(self) -> int:
        """Voxels by which neighbourhoods overlap."""
        return self.learnt.overlap

    @property
    def periods(self) -> tuple[float | None, ...]:
        """The exemplar's period along every axis, voxels; None where it has none."""
        return self.learnt.periods[-self.facts[0].ndim :]

    def forecast(self, request: Request) -> Forecast:
        """What the exemplars can give of a request's target, place by place, before anything is
        made (section 3.4).
        """
        self._check_request(request)
        return forecast_of(self.learnt, self.config, frame_for(self.learnt, request), request)

    def traced(self, request: Request) -> tuple[np.ndarray, Trace]:
        """The voxels of a request, and what happened at every place (the recipe of `generate` has
        its sums).
        """
        self._check_request(request)
        run = Run(self.learnt, self.config, request)
        values = run.made()
        return values.reshape(request.shape), run.trace

    def _check_request(self, request: Request) -> None:
        super()._check_request(request)
        axes = zip(request.shape, request.periodic, strict=True)
        if any(wraps and side < self.patch + 4 for side, wraps in axes):
            raise RequestError(
                f"a periodic axis needs at least {self.patch + 4} voxels with a patch of {self.patch}, the request is "
                f"{request.shape}: ask for more, or for a smaller patch"
            )
        if request.mask is not None and self.config.connected in ("solid", "both"):
            _check_one_form(request.mask, request.periodic)

    def _check_target(self, request: Request) -> None:
        check_held(self.learnt, request, self._held)

    def _plan(self, request: Request) -> Plan:
        kept = needs_of(self.learnt, self.config, request)
        return Plan(
            {"interpreter and kernels": _PROCESS, **kept.fixed, **kept.growing}, disk=kept.voxels
        )

    def _plan_spilled(self, request: Request) -> dict[str, int]:
        kept = needs_of(self.learnt, self.config, request)
        return {"interpreter and kernels": _PROCESS, **kept.fixed, "slab": kept.slab}

    def make(self, request: Request) -> tuple[np.ndarray, Mapping[str, Any]]:
        values, trace = self.traced(request)
        told = trace.told()
        if told["gave_way"]:
            at = told["gave_way_at"][0]
            notify(
                f"{told['gave_way']} of {told['places']} places gave way in {at['in']}, the first at voxel {at['voxel']}: "
                "look at more candidates, or finish the part (finish.connect)"
            )
        return values, {
            "patch": self.patch,
            "overlap": self.overlap,
            "periods": list(self.periods),
            **told,
        }


def _check_one_form(mask: np.ndarray, periodic: Sequence[bool]) -> None:
    """Raise where the form is in pieces: what fills them cannot hang together."""
    deep = mask.reshape((1,) * (3 - mask.ndim) + mask.shape)
    wraps = (False,) * (3 - mask.ndim) + tuple(periodic)
    _, sizes = parts_of(deep.view(np.uint8), INSIDE, wraps)
    if len(sizes) > 1:
        raise RequestError(
            f"the mask is {len(sizes)} separate pieces, which no solid can connect: fill them one by one, or ask for "
            "connected=none"
        )


_A_PLACE = 29 + 72
"""Bytes of a place: its piece, what the trace says of it, and a body or two that begin there, of 24
in a book that doubles.
"""

_AT_ONCE = 32
"""Bytes a voxel of a slab while parts of what is given are found in it: runs, labels, masks."""


@dataclass(frozen=True)
class Needs:
    """Bytes, by what they are for.

    Attributes
    ----------
    fixed : dict of str to int
        That do not depend on the request's size, but for the phases of a lattice that its places
        have.
    growing : dict of str to int
        That grow with it.
    slab : int
        Of one plane of it, with what work on it takes, and of the windows of one row.
    voxels : int
        Of the result.
    """

    fixed: dict[str, int]
    growing: dict[str, int]
    slab: int
    voxels: int


def needs_of(learnt: Learnt, config: QuiltConfig, request: Request) -> Needs:
    """The needs of a request."""
    shape = deep_shape(request)
    wraps = (False,) * (3 - len(request.periodic)) + tuple(request.periodic)
    frame = Frame(shape, wraps, learnt.box, learnt.step, (0, 0, 0))
    plane, row = shape[1] * shape[2], shape[2]
    voxels, places = shape[0] * plane, int(np.prod(frame.counts, dtype=np.int64))
    planes = planes_for(len(learnt.images[0].phases))
    window = int(
        np.prod([side + 2 * margin for side, margin in zip(frame.patch, frame.margin, strict=True)])
    )
    each = 1 + (4 if config.connected != "none" else 0)
    given = _given(request)
    return Needs(
        {
            "exemplar": sum(image.values.size for image in learnt.images) * (2 + 16 * planes),
            "candidates": _candidates(learnt, frame, len(request.target)),
            "windows": 160 * window,
        },
        {"result": voxels * (each + given) + places * _A_PLACE},
        plane * (each + (_AT_ONCE if given else 0))
        + window // (learnt.box[2] + 2 * frame.margin[2]) * row * each,
        voxels,
    )


def _given(request: Request) -> int:
    """Bytes a voxel while what is given is entered, where all is in memory."""
    if request.fixed is not None:
        return 16
    return 1 if request.mask is not None else 0


def _candidates(learnt: Learnt, frame: Frame, named: int) -> int:
    """Of candidates: their descriptors, what ranking them takes, and the pools of all phases that
    places have.
    """
    count = sum(int(np.prod(counts)) for counts in learnt.counts)
    pooled = sum(_pooled(learnt, frame, source) for source in range(len(learnt.counts)))
    return count * (40 + 8 * named) + max(0, min(pooled, (HELD + 1) * count) - count) * (
        4 + 2 * max(named, 1)
    )


def _pooled(learnt: Learnt, frame: Frame, source: int) -> int:
    """Candidates of an exemplar in all pools together."""
    total = 1
    for axis, period in enumerate(learnt.periods):
        firsts = range(0, frame.counts[axis] * frame.step[axis], frame.step[axis])
        keys = {phase_key((first,), (period,))[0] for first in firsts}
        total *= sum(
            len(in_phase(learnt.counts[source][axis], k, learnt.shifts[source][axis], period))
            for k in keys
        )
    return total
