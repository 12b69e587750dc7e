"""`bubbles`: starts and speeds are drawn by cell; the bubbles around a voxel decide it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from trabecula.core.errors import InputError, RequestError
from trabecula.core.image import Image
from trabecula.core.request import Request
from trabecula.core.target import densities_of, frame_of, porosity_of
from trabecula.engine.blocks import Box, slices_of
from trabecula.engine.memory import Array, Stage, forecast, within
from trabecula.synth.api.exemplar_info import ExemplarInfo
from trabecula.synth.api.method import Method, ModelState
from trabecula.synth.api.windows import WindowModel
from trabecula.synth.bubbles import CAPABILITIES
from trabecula.synth.bubbles.calibrate import calibrate
from trabecula.synth.bubbles.config import BubblesConfig
from trabecula.synth.bubbles.fit_objective import bytes_of_search
from trabecula.synth.bubbles.flow import flow_of
from trabecula.synth.bubbles.flow.field import bytes_of_flow
from trabecula.synth.bubbles.growth import Growth, SizeField, box_stages, expected_sizes
from trabecula.synth.bubbles.growth_law import Law, distance_of, law_of
from trabecula.synth.bubbles.kernels import BLOCK
from trabecula.synth.bubbles.particles import grow_request, particle_stages
from trabecula.synth.bubbles.porosity_level import Arrivals, arrivals_of, level_stages
from trabecula.synth.shared.frames import check_room

_PROCESS = 180 << 20  # bytes of the interpreter with NumPy, Numba and the kernels loaded
_TABLES = 200_000  # bytes of tables and the recipe
_LEAST = 8  # voxels along an axis of the exemplar


class Bubbles(Method):
    """Bubbles that grow."""

    capabilities = CAPABILITIES
    config_type = BubblesConfig

    def memory(self, exemplars: Sequence[Image]) -> Mapping[str, int]:
        shape = exemplars[0].shape
        search = bytes_of_search(shape) if self.config.trials else 0
        return {
            "interpreter and kernels": _PROCESS,
            "search": search,
            "its phases": 3 * math.prod(shape) + 4096,
        }

    def learn(self, exemplars: Sequence[Any]) -> BubblesModel:
        exemplar = exemplars[0]
        if isinstance(exemplar, ExemplarInfo):  # the settings alone
            return BubblesModel(self.config, exemplars)
        present = np.unique(exemplar.values)
        if len(exemplar.phases) != 2:
            names = ", ".join(exemplar.phases[label] for label in present)
            raise InputError(
                f"the exemplar is of {names}: bubbles and what is between them are two phases, "
                "name two"
            )
        if min(exemplar.shape) < _LEAST:
            raise InputError(
                f"the exemplar is {exemplar.shape}: give at least {_LEAST} voxels along every axis"
            )
        found, report = calibrate(self.config, exemplar, BubblesModel)
        return BubblesModel(self.config, exemplars, found, report)

    def from_state(self, exemplars: Sequence[Any], state: ModelState) -> BubblesModel:
        found = BubblesConfig(**state.plain["settings"])
        return BubblesModel(self.config, exemplars, found, state.plain["report"])


@dataclass
class _RequestGrowth:
    """Shared state of the boxes of one request: growth, and arrivals by extent.

    The arrivals are those in all of its box (True), or in its mask (False).
    """

    request: Request
    growth: Growth
    arrivals: dict[bool, Arrivals] = field(default_factory=dict)

    def serves(self, request: Request) -> bool:
        """Return whether another request is of the same material."""
        own = self.request
        alike = all(
            getattr(request, name) == getattr(own, name) for name in ("shape", "seed", "periodic")
        )
        framed = all(
            request.target.get(name) is own.target.get(name) for name in ("orientation", "size")
        )
        return alike and framed and request.mask is own.mask


class BubblesModel(WindowModel):
    """Settings of growth for voxels of a known size.

    Attributes
    ----------
    found : BubblesConfig
        Settings of growth: as they were given, or found for an exemplar.
    report : dict
        Report of the search (`calibrate.calibrate`); empty where they were given.
    """

    capabilities = CAPABILITIES
    config: BubblesConfig
    block = 256

    def __init__(
        self,
        config: BubblesConfig,
        exemplars: Sequence[Image | ExemplarInfo],
        found: BubblesConfig | None = None,
        report: Mapping[str, Any] | None = None,
    ) -> None:
        super().__init__(config, exemplars)
        self.found = config if found is None else found
        self.report = dict(report or {})
        self._last: _RequestGrowth | None = None

    def state(self) -> ModelState:
        """Return the settings that were found for an exemplar, and the report of the search."""
        if not self.report:
            return ModelState()
        return ModelState(plain={"settings": asdict(self.found), "report": self.report})

    def report_run(self) -> Mapping[str, Any]:
        return {"fit": self.report} if self.report else {}

    def make_box(self, request: Request, box: Box) -> np.ndarray:
        run = self._run(request)
        level = self._level(run, request, box)
        growth, deep = run.growth, _deep(box, (0, 1))
        once = tuple(map(_first_turn, deep, growth.periods))
        labels = np.empty([stop - start for start, stop in once], self.dtype)
        growth.fill(labels, [start for start, _ in once], self._phases(), level)
        if once != deep:
            labels = labels[np.ix_(*map(_indices_in_turn, deep, once, growth.periods))]
        return labels[0] if len(box) == 2 else labels

    def make(self, request: Request) -> tuple[np.ndarray, Mapping[str, Any]]:
        if self.found.growth == "fronts":
            return super().make(request)
        wanted = self._target_porosity(request)
        if np.ndim(wanted):
            raise RequestError(
                "particles stop all at once: ask for one number as the porosity, or for "
                "growth='fronts'"
            )
        made = grow_request(self._growth(request), self._settings(request), request, wanted)
        void, solid = self._phases()
        values = np.where(made.air, np.uint8(void), np.uint8(solid))
        if request.mask is not None:
            values[~request.mask] = void
        return values, {"rounds": made.rounds, "alive": made.alive}

    def _check_windows(self) -> None:
        if self.found.growth == "particles":
            raise RequestError(
                "particles grow in rounds over the whole volume, no box of which is made alone: "
                "set growth to fronts"
            )

    def _run(self, request: Request) -> _RequestGrowth:
        if self._last is None or not self._last.serves(request):
            self._last = _RequestGrowth(request, self._growth(request))
        return self._last

    def _growth(self, request: Request) -> Growth:
        law, settings = self._law(request), self._settings(request)
        spacing, length = self._lengths(request)
        flow = flow_of(settings, request.shape, spacing, request.mask, distance=length)
        periods = [
            side if wraps else 0
            for side, wraps in zip(request.shape, request.periodic, strict=True)
        ]
        sizes = None
        if "size" in request.target:
            factors = np.asarray(request.target["size"], np.float32) / _least_size(request)
            sizes = SizeField(factors.reshape(_deep(factors.shape, 1)) if factors.ndim else factors)
        shape = _deep(request.shape, 1)
        return Growth(law, request.seed, _deep(periods, 0), shape, flow, sizes)

    def _settings(self, request: Request) -> BubblesConfig:
        """Return the settings of growth for a request: those of the smallest bubbles, which follow
        the target's orientation where it has one.
        """
        given: dict[str, Any] = {}
        least = _least_size(request)
        if least != 1:
            ndim = len(request.shape)
            given["distance"] = self.found.distance * least
            if self.found.density is not None:
                given["density"] = self.found.density * least**-ndim
        if "orientation" in request.target:
            ways = np.asarray(request.target["orientation"])
            ways = ways.reshape((1,) * 3 + (3,)) if ways.ndim == 1 else ways
            given |= {"flow": ways, "flow_regions": (), "flow_aspect": 0.0}
            given |= {"silhouette": 0.0}
        return replace(self.found, **given) if given else self.found

    def _lengths(self, request: Request) -> tuple[tuple[float, ...], float]:
        """Return the edges of a voxel, and the mean distance between bubbles in the same unit."""
        ndim = len(request.shape)
        spacing = self.facts[0].spacing[-ndim:]
        return spacing, distance_of(self._settings(request), spacing[0], ndim) * spacing[0]

    def _law(self, request: Request) -> Law:
        law = law_of(self._settings(request), self.facts[0].spacing[0], len(request.shape))
        largest = float(np.max(request.target.get("size", 1.0))) / _least_size(request)
        return law if largest <= 1 else replace(law, reach=law.reach * largest)

    def _level(self, run: _RequestGrowth, request: Request, box: Box) -> Any:
        """Return T^2 at the end of growth: a number, or a field of the box."""
        wanted = self._target_porosity(request)
        if wanted is None:
            return np.float32(run.growth.law.latest**2)
        # A porosity found for an exemplar is that of the material, in any form cut of it; a
        # porosity from settings or target is that of the form.
        own = self.config.porosity is None and not densities_of(request.target)
        mask = None if own else request.mask
        whole = mask is None
        if whole not in run.arrivals:
            run.arrivals[whole] = arrivals_of(run.growth, _deep(request.shape, 1), mask)
        arrivals = run.arrivals[whole]
        if np.ndim(wanted):
            wanted = _porosity_in_box(wanted, mask, box)
        if not arrivals.reaches(float(np.max(wanted))):
            raise RequestError(
                f"porosity {np.max(wanted):.4g} is out of reach, {arrivals.most:.4g} is the most "
                "that walls and the time to grow leave: ask for less (one number, or a field that "
                "is nowhere above it), or for thinner walls (separation, thickness) or more "
                "coalescence"
            )
        return arrivals.level(wanted)

    def _target_porosity(self, request: Request) -> Any:
        wanted = porosity_of(request.target)
        return self.found.porosity if wanted is None else wanted

    def _phases(self) -> tuple[int, int]:
        """Return the labels of void and solid."""
        phases = self.facts[0].phases
        void = phases.index("void") if "void" in phases else 0
        return void, 1 - void

    def _check_target(self, request: Request) -> None:
        """Accept any porosity: growth finds the most that walls leave room for."""

    def _check_request(self, request: Request) -> None:
        super()._check_request(request)
        if frame_of(request.target):
            self._check_frame(request)
        self._law(request)

    def _check_frame(self, request: Request) -> None:
        """Raise where bubbles cannot follow a direction or a size."""
        if "orientation" in request.target:
            if len(request.shape) != 3:
                raise RequestError("a target orientation is for volumes: give three sides")
            if self.found.randomness >= 1:
                raise RequestError(
                    "bubbles are as long along every axis with randomness=1, so that no "
                    "orientation shows: set randomness below 1 (0.3 makes them longer)"
                )
        if "size" in request.target and self.found.growth == "particles":
            raise RequestError("particles are of one size: leave size out, or set growth to fronts")
        if len(request.shape) == 3:
            spacing, length = self._lengths(request)
            check_room(request.mask, length / spacing[0], what="distance between bubbles")

    def box_memory(self, request: Request, shape: tuple[int, ...]) -> Mapping[str, int]:
        masked = request.mask is not None
        settings = self._settings(request)
        flows = settings.randomness < 1 and settings.has_direction(masked=masked)
        fixed = {
            "interpreter and kernels": _PROCESS,
            "exemplar": self._exemplar_bytes(),
            "tables": _TABLES,
        }
        if flows or masked:
            spacing, length = self._lengths(request)
            fixed["flow"] = bytes_of_flow(
                settings, request.shape, spacing, masked=masked, distance=length, step=BLOCK
            )
        return forecast(self._stages(request, shape, flows=flows), fixed).memory

    def _stages(
        self, request: Request, shape: tuple[int, ...], *, flows: bool
    ) -> tuple[Stage, ...]:
        """Declare the arrays of a box of a request beside its labels."""
        law, masked = self._law(request), request.mask is not None
        box = box_stages(law, expected_sizes(law, _deep(shape, 1), flows=flows, room=masked))
        if self.found.growth == "particles":
            return (*box, *particle_stages(shape, flows=flows))
        wanted = self._target_porosity(request)
        if wanted is None:
            return box
        level = level_stages(law, _deep(request.shape, 1), masked=masked, flows=flows)
        held: dict[str, Array | None] = {"arrivals": level[0].arrays["arrivals"]}
        if np.ndim(wanted):
            held["levels"] = Array(_deep(shape, 1), np.float32)
        # ranks of the porosity's field in 8 bytes, and 16 for the porosity
        ranks = Stage("look up levels", held, 24 * math.prod(shape) * (np.ndim(wanted) > 0))
        return (*level, ranks, *within(held, box))

    def _exemplar_bytes(self) -> int:
        return sum(image.values.nbytes for image in self.exemplars)


def _least_size(request: Request) -> float:
    """Return the smallest factor of a target size; 1 without one."""
    return float(np.min(request.target.get("size", 1.0)))


def _deep(axes: Sequence[Any], first: Any) -> tuple[Any, ...]:
    """Extend the values of a picture by the first one, for z."""
    return tuple(axes) if len(axes) == 3 else (first, *axes)


def _first_turn(ends: tuple[int, int], period: int) -> tuple[int, int]:
    """Return a range within the first period of an axis that holds the voxels of a range."""
    start, stop = ends
    if not period:
        return ends
    lap = start // period * period
    return (start - lap, stop - lap) if stop - lap <= period else (0, period)


def _indices_in_turn(ends: tuple[int, int], once: tuple[int, int], period: int) -> np.ndarray:
    """Return the index within the range `once` of every voxel of a range."""
    voxels = np.arange(*ends)
    return (voxels % period if period else voxels) - once[0]


def _porosity_in_box(wanted: np.ndarray, mask: np.ndarray | None, box: Box) -> np.ndarray:
    """Return the field of porosity in a box (Z, Y, X), 0 outside of the mask."""
    if any(start < 0 or stop > side for (start, stop), side in zip(box, wanted.shape, strict=True)):
        raise InputError(
            f"the box {box} leaves the porosity's field of shape {wanted.shape}: nothing says "
            "what it is there"
        )
    cut = slices_of(box)
    part = wanted[cut] if mask is None else np.where(mask[cut], wanted[cut], np.float32(0))
    return np.ascontiguousarray(part).reshape([stop - start for start, stop in _deep(box, (0, 1))])
