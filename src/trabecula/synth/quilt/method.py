"""The method `quilt`: pack the exemplars, then lay their patches (Liu and Shapiro 2016, section
3.3).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from trabecula.core.errors import RequestError
from trabecula.core.image import Image
from trabecula.core.progress import notify
from trabecula.core.request import Request
from trabecula.core.target import FRAME, densities_of, frame_of, is_apparent
from trabecula.engine.memory import forecast
from trabecula.measure.runs import INSIDE
from trabecula.synth.api.method import Method, Model
from trabecula.synth.quilt import CAPABILITIES
from trabecula.synth.quilt.candidates import HELD
from trabecula.synth.quilt.canvas import PatchGrid, patch_grid, shape_3d
from trabecula.synth.quilt.compatibility import (
    CompatibilityForecast,
    PlacementTrace,
    check_targets,
    forecast_compatibility,
)
from trabecula.synth.quilt.config import QuiltConfig
from trabecula.synth.quilt.connectivity import label_slabwise
from trabecula.synth.quilt.patch_library import PatchLibrary, label_bits, void_label
from trabecula.synth.quilt.period import phase_key, positions_in_phase
from trabecula.synth.quilt.run import QuiltRun, run_stages
from trabecula.synth.quilt.turned import frame_config, frame_targets, turned_library
from trabecula.synth.shared.frames import frames_of
from trabecula.synth.shared.orient import symmetries
from trabecula.synth.shared.turned_exemplars import DIRECTIONS, copied_voxels

_OF_A_COPY = 28  # bytes of an exemplar's voxel in a turned copy, which holds half of them
_PROCESS = 180 << 20  # bytes of the interpreter with NumPy, Numba and the kernels loaded


class Quilt(Method):
    """Graph-cut quilting."""

    capabilities = CAPABILITIES
    config_type = QuiltConfig
    config: QuiltConfig

    def learn(self, exemplars: Sequence[Image]) -> QuiltModel:
        """Pack the exemplars."""
        return QuiltModel(self.config, exemplars)

    def memory(self, exemplars: Sequence[Image]) -> Mapping[str, int]:
        """Forecast the memory: words and a copy of every orientation, and the cleaning."""
        turns = len(
            symmetries(
                self.config.orientations, ndim=exemplars[0].ndim, spacing=exemplars[0].spacing
            )
        )
        planes = label_bits(len(exemplars[0].phases))
        voxels = sum(int(np.prod(exemplar.shape)) for exemplar in exemplars)
        return {
            "interpreter and kernels": _PROCESS,
            "exemplar": turns * voxels * (2 + 16 * planes),
            "working": 18 * voxels,
        }


class QuiltModel(Model):
    """Packed exemplars."""

    capabilities = CAPABILITIES
    config: QuiltConfig

    def __init__(self, config: QuiltConfig, exemplars: Sequence[Image]) -> None:
        super().__init__(config, exemplars)
        self.library = PatchLibrary.build(exemplars, config)
        self._held: dict[str, tuple[float, float]] = {}

    @property
    def patch(self) -> int:
        """Return the side of a patch, voxels."""
        return self.library.patch

    @property
    def overlap(self) -> int:
        """Return the voxels by which patches overlap."""
        return self.library.overlap

    @property
    def periods(self) -> tuple[float | None, ...]:
        """Return the exemplar's period along every axis, voxels; None where it has none."""
        return self.library.periods[-self.facts[0].ndim :]

    def forecast(self, request: Request) -> CompatibilityForecast:
        """Forecast how near the exemplars can come to a request's target, place by place (section
        3.4).
        """
        self._check_request(request)
        request = replace(request, target=densities_of(request.target))
        return forecast_compatibility(
            self.library, self.config, patch_grid(self.library, request), request
        )

    def make_with_trace(self, request: Request) -> tuple[np.ndarray, PlacementTrace]:
        """Make the voxels of a request; return them and the record of every place (its sums are in
        the recipe of `generate`).
        """
        self._check_request(request)
        library, config, target = self.library, self.config, dict(request.target)
        if frame_of(target):
            frames = frames_of(target, DIRECTIONS)
            library = turned_library(self.exemplars, library, config, frames)
            void = [np.mean(one.values == void_label(one.phases)) for one in self.exemplars]
            target = frame_targets(target, float(np.mean(void)))
            config = frame_config(config)
        run = QuiltRun(library, config, request, target)
        values = run.lay_all()
        return values.reshape(request.shape), run.trace

    def _check_request(self, request: Request) -> None:
        apparent = [name for name in request.target if is_apparent(name)]
        if apparent and frame_of(request.target):
            raise RequestError(
                f"{apparent[0]} is measured in the exemplar as it is, not in turned or scaled "
                "copies: ask for it without orientation and size"
            )
        super()._check_request(request)
        axes = zip(request.shape, request.periodic, strict=True)
        if any(wraps and side < self.patch + 4 for side, wraps in axes):
            raise RequestError(
                f"a periodic axis needs at least {self.patch + 4} voxels with a patch of "
                f"{self.patch}, the request is {request.shape}: ask for more, or for a smaller "
                "patch"
            )
        if frame_of(request.target) and self.library.flat:
            named = " and ".join(name for name in FRAME if name in request.target)
            raise RequestError(f"the target {named} is honoured for volumes, the exemplar is 2-D")
        if request.mask is not None and self.config.connected in ("solid", "both"):
            _check_one_form(request.mask, request.periodic)

    def _check_target(self, request: Request) -> None:
        check_targets(self.library, request, self._held)

    def memory(self, request: Request) -> Mapping[str, int]:
        grid, fixed = self._forecast_grid(request)
        return forecast(run_stages(grid, self.config, request), fixed).memory

    def resident_memory(self, request: Request) -> Mapping[str, int]:
        grid, fixed = self._forecast_grid(request)
        stages = run_stages(grid, self.config, request, mapped=True)
        return {**fixed, "slab": max(stage.slab for stage in stages)}

    def _forecast_grid(self, request: Request) -> tuple[PatchGrid, dict[str, int]]:
        """Return the grid of a request, from its first voxel, and the bytes that do not depend on
        the shape (except for the phases of a lattice at the places).
        """
        library, shape = self.library, shape_3d(request)
        wraps = (False,) * (3 - len(request.periodic)) + tuple(request.periodic)
        grid = PatchGrid(shape, wraps, library.box, library.step, (0, 0, 0))
        planes = label_bits(len(library.images[0].phases))
        voxels = sum(image.values.size for image in library.images)
        fixed = {
            "interpreter and kernels": _PROCESS,
            "exemplar": voxels * (2 + 16 * planes),
            "candidates": _candidate_bytes(library, grid, len(request.target)),
        }
        if frame_of(request.target):
            copied = copied_voxels(self.exemplars, frames_of(request.target, DIRECTIONS))
            fixed["turned copies"] = _OF_A_COPY * planes * copied
        return grid, fixed

    def make(self, request: Request) -> tuple[np.ndarray, Mapping[str, Any]]:
        values, trace = self.make_with_trace(request)
        summary = trace.summary()
        if summary["gave_way"]:
            notify(_gave_way_text(summary))
        return values, {
            "patch": self.patch,
            "overlap": self.overlap,
            "periods": list(self.periods),
            **summary,
        }


def _gave_way_text(summary: Mapping[str, Any]) -> str:
    """Say how many places gave way, and what joined the solid that they left, or may join it."""
    at = summary["gave_way_at"][0]
    found = (
        f"{summary['gave_way']} of {summary['places']} places gave way in {at['in']}, the first at "
        f"voxel {at['voxel']}: "
    )
    if "loose" not in summary:
        return found + "look at more candidates, or finish the part (finish.connect)"
    joined = f"{summary['joins']} joins of {summary['join_voxels']} voxels connect the solid"
    if not summary["loose"]:
        return found + (joined if summary["joins"] else "the solid is one component all the same")
    return (
        f"{found}{joined} but for {summary['loose']} voxels: look at more candidates, or finish "
        "the part (finish.connect)"
    )


def _check_one_form(mask: np.ndarray, periodic: Sequence[bool]) -> None:
    """Raise where the form is not connected: no solid that fills it can be."""
    deep = mask.reshape((1,) * (3 - mask.ndim) + mask.shape)
    wraps = (False,) * (3 - mask.ndim) + tuple(periodic)
    _, sizes = label_slabwise(deep.view(np.uint8), INSIDE, wraps)
    if len(sizes) > 1:
        raise RequestError(
            f"the mask has {len(sizes)} connected components, which no solid can connect: fill "
            "them one by one, or ask for connected=none"
        )


def _candidate_bytes(library: PatchLibrary, grid: PatchGrid, named: int) -> int:
    """Return the bytes of candidates: their descriptors, their ranking, and the pools of all phases
    of the places.
    """
    count = sum(int(np.prod(counts)) for counts in library.counts)
    pooled = sum(_count_pooled(library, grid, source) for source in range(len(library.counts)))
    return count * (40 + 8 * named) + max(0, min(pooled, (HELD + 1) * count) - count) * (
        4 + 2 * max(named, 1)
    )


def _count_pooled(library: PatchLibrary, grid: PatchGrid, source: int) -> int:
    """Count the candidates of an exemplar in all pools together."""
    total = 1
    for axis, period in enumerate(library.periods):
        firsts = range(0, grid.counts[axis] * grid.step[axis], grid.step[axis])
        keys = {phase_key((first,), (period,))[0] for first in firsts}
        total *= sum(
            len(
                positions_in_phase(
                    library.counts[source][axis], k, library.shifts[source][axis], period
                )
            )
            for k in keys
        )
    return total
