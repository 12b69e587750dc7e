"""`packing`: fit finds the bodies of a phase, and how they are packed; generate turns them and
packs them anew.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from math import prod
from typing import Any

import numpy as np

from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.core.request import Request
from trabecula.synth.api.model import ModelState
from trabecula.synth.packing import CAPABILITIES
from trabecula.synth.packing.arrangement import Arrangement, arrange
from trabecula.synth.packing.config import PackingConfig
from trabecula.synth.packing.drawing import draw_depth
from trabecula.synth.packing.known_bodies import KnownBodies
from trabecula.synth.packing.radial_shapes import SIZE
from trabecula.synth.packing.scan_bodies import LEAST, ScanBodies, find_bodies
from trabecula.synth.packing.standing import lines_beside
from trabecula.synth.shared.content.kinds import Labels, free_voxels
from trabecula.synth.shared.own_figures import OwnFigures
from trabecula.synth.shared.packed.method import PackedMethod, PackedModel
from trabecula.synth.shared.packed.trials import Packed, SmallPackings, choose

_ROUND = 0.12
"""What surfaces may be off the radii of bodies, over their size: materials that are no bodies have
more (bone .18, layers of fibres .15; grains of a soil .08, beads .02)."""

_ALIKE, _GOOD = 1.5, 1.0
"""A phase is tried as well whose misfit is so many times the other's at most, where that one's
figures are off by more than so many spreads."""

_BODY = 1000  # bytes of a body with its neighbours
_BESIDE, _CUT = 38, 38  # bytes of a voxel beside known ones, and of one near the joint


class Packing(PackedMethod):
    """Bodies of a scan, packed anew."""

    capabilities = CAPABILITIES
    config_type = PackingConfig
    config: PackingConfig

    def learn(self, exemplars: Sequence[Image]) -> PackingModel:
        label, bodies, packed = self._chosen(exemplars[0])
        return PackingModel(self.config, exemplars, label, bodies, packed)

    def _chosen(self, image: Image) -> tuple[int, ScanBodies, Packed]:
        """Return the phase of the bodies, these, and how they are packed."""
        labels = self._phases(image)
        found = {label: find_bodies(image, label, self.config.degree) for label in labels}
        whole = {label: bodies for label, bodies in found.items() if bodies is not None}
        if self.config.phase is None:
            whole = {label: one for label, one in whole.items() if one.misfit <= _ROUND}
        if not whole:
            raise InputError(
                f"the exemplar has fewer than {LEAST} whole round bodies: {self._advice(found)}"
            )
        figures = self._measured(image)
        rounder = sorted(whole, key=lambda label: (whole[label].misfit, label))
        tried: dict[int, Packed] = {}
        for label in rounder:
            near = whole[label].misfit <= _ALIKE * whole[rounder[0]].misfit
            if near and not any((packed.score or 0) <= _GOOD for packed in tried.values()):
                tried[label] = self._tried(image, label, whole[label], figures)
        best = min(tried, key=lambda label: (tried[label].score or 0, label))
        self._say_score(tried[best], image.phases[best])
        return best, whole[best], tried[best]

    def _tried(
        self, image: Image, label: int, bodies: ScanBodies, figures: OwnFigures | None
    ) -> Packed:
        """Return how the bodies of a phase are packed."""
        any_way = is_any_way(self.config, bodies)

        def pack(sides: np.ndarray, separation: float, seed: int) -> Arrangement:
            return arrange(
                bodies,
                sides,
                separation=separation,
                any_way=any_way,
                density=bodies.density,
                seed=seed,
                quiet=True,
            )

        trial = SmallPackings(image, label, figures, pack, draw_depth)
        return choose(trial, separation=self.config.separation, fillet=self.config.fillet)

    def _advice(self, found: Mapping[int, ScanBodies | None]) -> str:
        """Return what to do where there are no bodies."""
        if self.config.phase is None and any(one is not None for one in found.values()):
            return "its phases are no bodies; use --method texture, or name phase="
        return "give a larger crop, or use --method texture"

    def from_state(self, exemplars: Sequence[Image], state: ModelState) -> PackingModel:
        """Build the model of what was learned, as `PackingModel.state` gives it."""
        plain = dict(state.plain)
        radii, weights = state.arrays["radii"], state.arrays["weights"]
        if radii.ndim != 2 or radii.shape[1] != SIZE or weights.shape != radii.shape[:1]:
            raise ValueError("these are no bodies")
        label, packed = int(plain.pop("label")), Packed(**plain.pop("packed"))
        bodies = ScanBodies(radii=radii, weights=weights, **plain)
        return PackingModel(self.config, exemplars, label, bodies, packed)


class PackingModel(PackedModel):
    """Bodies, and how they are packed."""

    capabilities = CAPABILITIES
    config: PackingConfig

    def __init__(
        self,
        config: PackingConfig,
        exemplars: Sequence[Image],
        label: int,
        bodies: ScanBodies,
        packed: Packed,
    ) -> None:
        super().__init__(config, exemplars)
        self.label, self.bodies, self.packed = label, bodies, packed
        self.fraction = bodies.fraction

    def state(self) -> ModelState:
        """Return the bodies and what trials chose."""
        plain = asdict(self.bodies) | {"label": self.label, "packed": asdict(self.packed)}
        arrays = {name: plain.pop(name) for name in ("radii", "weights")}
        return ModelState(arrays, plain)

    @property
    def largest(self) -> float:
        """Return the largest radius of a body, edges."""
        return float(self.bodies.radii.max())

    def _depth(
        self, request: Request, sides: np.ndarray, share: float
    ) -> tuple[np.ndarray, dict[str, Any]]:
        apart, known, beside = self.packed.separation, None, None
        if request.fixed is not None:
            known = KnownBodies.of(request, self.label, self._steps)
            beside = known.measure_free(self.bodies, self.config.degree, apart, sides)
        arrangement = arrange(
            self.bodies,
            sides,
            separation=apart,
            any_way=is_any_way(self.config, self.bodies),
            density=self.bodies.density * share / self.fraction,
            seed=request.seed,
            beside=beside,
        )
        del beside  # its distances
        depth = draw_depth(arrangement, request.shape, self._steps, self.packed.fillet)
        report: dict[str, Any] = {
            "bodies": arrangement.count,
            "lacking": round(arrangement.lacking, 4),
        }
        if known is not None:
            free = free_voxels(request)
            depth = known.join(depth, float(np.quantile(depth[free], 1 - share)))
            stand = len(arrangement.places) - arrangement.count
            report |= {"standing": stand, "cut": arrangement.cut}
        return depth, report

    def _share(self, request: Request) -> float | np.ndarray:
        """Return the share of bodies among the free voxels: beside known ones by the same rule as
        for `texture`.
        """
        wanted = super()._share(request)
        if request.fixed is None or np.ndim(wanted):
            return wanted
        content = Labels(self.exemplars, histogram=True)
        shares = content.free_fractions(request, free_voxels(request))
        return float(shares[content.present.index(self.label)])

    def memory(self, request: Request) -> Mapping[str, int]:
        """Forecast the depth of the voxels, and the bodies; and distances beside known voxels."""
        found = dict(super().memory(request))
        if request.known is not None:
            lines = lines_beside(request.known, request.periodic, 2 * self.largest / self._steps)
            held = max(_BESIDE * prod(request.shape), _CUT * prod(map(len, lines)))
            beside = held + int(self._body_bytes(self._torus(request)))
            found["depth or figures"] = max(found["depth or figures"], beside)
        return found

    def _body_bytes(self, sides: np.ndarray) -> float:
        return _BODY * self.bodies.density * float(np.prod(sides))


def is_any_way(config: PackingConfig, bodies: ScanBodies) -> bool:
    """Return whether bodies are turned any way."""
    return config.turns == "any" or (config.turns == "auto" and not bodies.lie)
