"""`packing`: fit finds the bodies of a phase, and how they are packed; generate turns them and
packs them anew.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from math import prod
from typing import Any

import numpy as np

from trabecula.core.errors import InputError, RequestError
from trabecula.core.image import Image
from trabecula.core.request import Request
from trabecula.core.target import porosity_of
from trabecula.engine.parallel import thread_count
from trabecula.synth.api.method import Method, Model
from trabecula.synth.api.model import ModelState
from trabecula.synth.packing import CAPABILITIES
from trabecula.synth.packing.arrangement import Arrangement, arrange
from trabecula.synth.packing.config import PackingConfig
from trabecula.synth.packing.drawing import deepest_by_share, deepest_share, draw_depth
from trabecula.synth.packing.radial_shapes import SIZE
from trabecula.synth.packing.scan_bodies import LEAST, Bodies, find_bodies
from trabecula.synth.packing.trials import BOX, Packed, choose
from trabecula.synth.shared.content.fields import phases_present
from trabecula.synth.shared.own_figures import OwnFigures, figure_stages, tell_off

_ROUND = 0.12
"""What surfaces may be off the radii of bodies, over their size: materials that are no bodies have
more (bone .18, layers of fibres .15; grains of a soil .08, beads .02)."""

_ALIKE, _GOOD, _POOR = 1.5, 1.0, 3.0
"""A phase is tried as well whose misfit is so many times the other's at most, where that one's
figures are off by more than so many spreads; from so many on a line says that they are far off."""

_PROCESS = 200 << 20  # bytes of the interpreter with NumPy, Numba and the kernels loaded
_VOXEL = 14  # bytes of a voxel and its share of the margin while a depth is drawn and cut
_FIELD = 8  # bytes of a voxel more with a target field or a mask
_BODY = 1000  # bytes of a body with its neighbours
_LEARNT, _SHAPES = 85, 28 << 20  # bytes of a voxel of the exemplar, and more, to find its bodies


class Packing(Method):
    """Bodies of a scan, packed anew."""

    capabilities = CAPABILITIES
    config_type = PackingConfig
    config: PackingConfig
    learning_cost = 20.0

    def learn(self, exemplars: Sequence[Image]) -> PackingModel:
        image = exemplars[0]
        present = phases_present([image])
        if len(present) != 2:
            raise InputError(
                f"packing makes material of two phases, the exemplar has {len(present)}: "
                "choose one as bodies and join the others (tb.segment), or use --method texture"
            )
        label, bodies, packed = self._chosen(image, present)
        return PackingModel(self.config, exemplars, label, bodies, packed)

    def _chosen(self, image: Image, present: tuple[int, ...]) -> tuple[int, Bodies, Packed]:
        """Return the phase of the bodies, these, and how they are packed."""
        config = self.config
        if config.phase is not None and config.phase not in [image.phases[one] for one in present]:
            known = ", ".join(image.phases[one] for one in present)
            raise InputError(f"phase={config.phase!r} is no phase of the exemplar: it has {known}")
        named = [one for one in present if config.phase in (None, image.phases[one])]
        found = {label: find_bodies(image, label, config.degree) for label in named}
        whole = {label: bodies for label, bodies in found.items() if bodies is not None}
        if config.phase is None:
            whole = {label: one for label, one in whole.items() if one.misfit <= _ROUND}
        if not whole:
            raise InputError(
                f"the exemplar has fewer than {LEAST} whole round bodies: "
                f"{self._advice(image, found)}"
            )
        rounder = sorted(whole, key=lambda label: (whole[label].misfit, label))
        tried: dict[int, Packed] = {}
        for label in rounder:
            one = whole[label]
            near = one.misfit <= _ALIKE * whole[rounder[0]].misfit
            if near and not any((packed.score or 0) <= _GOOD for packed in tried.values()):
                tried[label] = choose(
                    image,
                    one,
                    label,
                    separation=config.separation,
                    fillet=config.fillet,
                    any_way=self._any_way(one),
                )
        best = min(tried, key=lambda label: (tried[label].score or 0, label))
        if (tried[best].score or 0) > _POOR:
            notify(
                f"packings of the {image.phases[best]}'s bodies are far from the scan, "
                f"{tried[best].score:.1f} of its spreads: --method texture may be nearer"
            )
        return best, whole[best], tried[best]

    def _advice(self, image: Image, found: Mapping[int, Bodies | None]) -> str:
        """Return what to do where there are no bodies."""
        if self.config.phase is None and any(one is not None for one in found.values()):
            return "its phases are no bodies; use --method texture, or name phase="
        return "give a larger crop, or use --method texture"

    def _any_way(self, bodies: Bodies) -> bool:
        return self.config.turns == "any" or (self.config.turns == "auto" and not bodies.lie)

    def from_state(self, exemplars: Sequence[Image], state: ModelState) -> PackingModel:
        """Build the model of what was learned, as `PackingModel.state` gives it."""
        plain = dict(state.plain)
        radii, weights = state.arrays["radii"], state.arrays["weights"]
        if radii.ndim != 2 or radii.shape[1] != SIZE or weights.shape != radii.shape[:1]:
            raise ValueError("these are no bodies")
        label, packed = int(plain.pop("label")), Packed(**plain.pop("packed"))
        bodies = Bodies(radii=radii, weights=weights, **plain)
        return PackingModel(self.config, exemplars, label, bodies, packed)

    def memory(self, exemplars: Sequence[Image]) -> Mapping[str, int]:
        """Forecast the bodies of the exemplar, or the trials."""
        shape = exemplars[0].shape
        trial = _VOXEL * prod(min(side, BOX) for side in shape)
        trial += sum(stage.working for stage in figure_stages(shape, shape, box=BOX))
        return {
            "interpreter and kernels": _PROCESS,
            "bodies or trials": max(_SHAPES + _LEARNT * prod(shape), thread_count() * trial),
        }


class PackingModel(Model):
    """Bodies, and how they are packed."""

    capabilities = CAPABILITIES
    config: PackingConfig

    def __init__(
        self,
        config: PackingConfig,
        exemplars: Sequence[Image],
        label: int,
        bodies: Bodies,
        packed: Packed,
    ) -> None:
        super().__init__(config, exemplars)
        self.label, self.bodies, self.packed = label, bodies, packed

    def state(self) -> ModelState:
        """Return the bodies and what trials chose."""
        own, packed = self.bodies, self.packed
        plain = {
            "label": self.label,
            "density": own.density,
            "fraction": own.fraction,
            "misfit": own.misfit,
            "lie": own.lie,
            "packed": {
                "separation": packed.separation,
                "fillet": packed.fillet,
                "score": packed.score,
            },
        }
        return ModelState({"radii": own.radii, "weights": own.weights}, plain)

    def make(self, request: Request) -> tuple[np.ndarray, Mapping[str, Any]]:
        """Pack the bodies, and cut their depth at the phase's share."""
        wanted, packed = self._share(request), self.packed
        share = float(np.mean(np.asarray(wanted)[_where(wanted, request.mask)]))
        arrangement = arrange(
            self.bodies,
            self._torus(request),
            separation=packed.separation,
            any_way=self._any_way,
            density=self.bodies.density * share / self.bodies.fraction,
            seed=request.seed,
        )
        values = self._phases(self._deepest(arrangement, request, share, wanted), request)
        report = {
            "bodies": len(arrangement.places),
            "phase": self.facts[0].phases[self.label],
            "separation": packed.separation,
            "fillet": packed.fillet,
            "lacking": round(arrangement.lacking, 4),
        }
        return values, report | self._compare(request, values)

    def _deepest(
        self, arrangement: Arrangement, request: Request, share: float, wanted: float | np.ndarray
    ) -> np.ndarray:
        """Return the voxels of the bodies: as many as are wanted, everywhere or around each."""
        depth = draw_depth(arrangement, request.shape, self._steps, self.packed.fillet)
        if isinstance(wanted, np.ndarray):
            return deepest_by_share(depth, wanted, request.mask)
        return deepest_share(depth, share, request.mask)

    def _phases(self, chosen: np.ndarray, request: Request) -> np.ndarray:
        """Return the labels of a result, empty outside the mask."""
        other = next(one for one in phases_present(self.exemplars) if one != self.label)
        values = np.where(chosen, np.uint8(self.label), np.uint8(other))
        if request.mask is not None:
            values[~request.mask] = self.facts[0].empty_label
        return values

    def _compare(self, request: Request, values: np.ndarray) -> dict[str, Any]:
        """Tell what is off in a result, and return its figures for the report; none where it is to
        differ from the exemplar.
        """
        if request.asks_for() - {"periodic"} or self._figures is None:
            return {}
        figures = self._figures.compare(self.exemplars[0], values)
        tell_off(figures)
        return {"figures": {name: one.to_json() for name, one in figures.items()}}

    def _figure_bytes(self, request: Request) -> int:
        """Return the bytes that it takes to tell what is off."""
        if request.asks_for() - {"periodic"}:
            return 0
        stages = figure_stages(request.shape, self.exemplars[0].shape, box=BOX)
        return sum(stage.working for stage in stages)

    @cached_property
    def _figures(self) -> OwnFigures | None:
        return OwnFigures.of(self.exemplars[0], box=BOX)

    @property
    def _steps(self) -> np.ndarray:
        """Return the edges of a voxel in units of the smallest."""
        spacing = np.array(self.facts[0].spacing)
        return np.asarray(spacing / spacing.min())

    @property
    def _any_way(self) -> bool:
        turns = self.config.turns
        return turns == "any" or (turns == "auto" and not self.bodies.lie)

    def _share(self, request: Request) -> float | np.ndarray:
        """Return the share of bodies that is wanted, everywhere or around every place."""
        porosity = porosity_of(request.target)
        if porosity is None:
            return self.bodies.fraction
        return porosity if self.label == self.facts[0].empty_label else 1 - porosity

    def _torus(self, request: Request) -> np.ndarray:
        """Return the sides of the box that repeats, edges: with room for the bodies that faces cut
        along axes that do not repeat.
        """
        room = 2 * float(self.bodies.radii.max())
        sides = np.array(request.shape) * self._steps
        return np.asarray(np.where(request.periodic, sides, sides + room))

    def _check_request(self, request: Request) -> None:
        super()._check_request(request)
        largest = 2 * float(self.bodies.radii.max())
        short = [
            axis
            for axis, (side, wraps) in enumerate(
                zip(self._torus(request), request.periodic, strict=True)
            )
            if wraps and side < largest
        ]
        if short:
            raise RequestError(
                f"the largest body is {largest:.0f} voxels wide, and axis {'zyx'[short[0]]} "
                f"repeats after {request.shape[short[0]]}: ask for a larger shape"
            )

    def memory(self, request: Request) -> Mapping[str, int]:
        """Forecast the depth of the voxels, and the bodies."""
        margin = 2 * np.ceil(3.5 * self.packed.fillet / self._steps)
        voxels = prod(int(side + m) for side, m in zip(request.shape, margin, strict=True))
        more = _FIELD if request.mask is not None or request.target else 0
        bodies = self.bodies.density * float(np.prod(self._torus(request)))
        drawn = (_VOXEL + more) * voxels + _BODY * bodies
        return {
            "interpreter and kernels": _PROCESS,
            "exemplar": sum(image.values.nbytes for image in self.exemplars),
            "output": self.output_bytes(request),
            "depth or figures": int(max(drawn, self._figure_bytes(request))),
        }


def _where(wanted: float | np.ndarray, mask: np.ndarray | None) -> Any:
    """Return where a field of what is wanted counts; everywhere for a number."""
    return mask if mask is not None and isinstance(wanted, np.ndarray) else ...
