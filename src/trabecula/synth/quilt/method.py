"""`quilt`: fit packs the exemplars, generate lays their pieces (Liu and Shapiro 2016, section 3.3)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from trabecula.core.errors import RequestError
from trabecula.core.image import Image
from trabecula.core.progress import notify
from trabecula.core.request import Request
from trabecula.engine.memory import Plan
from trabecula.measure.runs import INSIDE
from trabecula.synth.api.method import Method, Model
from trabecula.synth.quilt import CAPABILITIES
from trabecula.synth.quilt.bit_packing import planes_for
from trabecula.synth.quilt.canvas import frame_for
from trabecula.synth.quilt.compatibility import Forecast, check_held, forecast_of
from trabecula.synth.quilt.components import parts_of
from trabecula.synth.quilt.config import QuiltConfig
from trabecula.synth.quilt.memory import needs_of
from trabecula.synth.quilt.patch_library import Learnt
from trabecula.synth.quilt.run import Run
from trabecula.synth.quilt.trace import Trace
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
