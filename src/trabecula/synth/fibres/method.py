"""`fibres`: fit learns directions and thicknesses, and how fibres lie; generate lays others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.core.request import Request
from trabecula.synth.api.model import ModelState
from trabecula.synth.fibres import CAPABILITIES
from trabecula.synth.fibres.config import FibresConfig
from trabecula.synth.fibres.laying import APART, Laid, draw_fibres, lay
from trabecula.synth.fibres.strands import Strands, find_strands
from trabecula.synth.shared.own_figures import OwnFigures
from trabecula.synth.shared.packed.method import PackedMethod, PackedModel
from trabecula.synth.shared.packed.trials import Packed, SmallPackings, choose

_CLEAR = 0.3
"""Clarity of what are fibres, at least: of polymer fibres and bundles .4, of the struts of a foam
.27, of bone's .2, of grains .1 to .2."""

_SEPARATIONS = (1.0, 0.8, 0.6, 0.4, 0.2, 0.0)
_BENDS = (0.1, 0.25, 0.5)  # that are tried where straight fibres are not given
_PLACE = 250  # bytes of a place of a fibre with its neighbours


@dataclass(frozen=True)
class _Lies:
    """How fibres lie: what trials chose."""

    packed: Packed
    bend: float


class Fibres(PackedMethod):
    """Fibres of a scan, laid anew."""

    capabilities = CAPABILITIES
    config_type = FibresConfig
    config: FibresConfig
    voxel_bytes, more_bytes = 80, 0

    def learn(self, exemplars: Sequence[Image]) -> FibresModel:
        image = exemplars[0]
        found = {label: find_strands(image, label) for label in self._phases(image)}
        label = max(found, key=lambda one: (_thin(found[one]) and found[one].clarity, -one))
        strands = found[label]
        if self.config.phase is None and strands.clarity < _CLEAR:
            raise InputError(
                f"no phase of the exemplar is of long fibres (clarity {strands.clarity:.2f}, "
                f"fibres have {_CLEAR} at least): use --method texture, or name phase="
            )
        lies = self._tried(image, label, strands)
        self._say_score(lies.packed, image.phases[label])
        return FibresModel(self.config, exemplars, label, strands, lies)

    def _tried(self, image: Image, label: int, strands: Strands) -> _Lies:
        """Return how fibres lie: straight ones first, then with bends where they are nearest."""
        config = self.config
        bend = 0.0 if config.bend is None else config.bend
        figures = self._measured(image)
        lies = _Lies(self._chosen(image, label, figures, strands, bend), bend)
        if config.bend is not None or lies.packed.score is None:
            return lies
        near = lies.packed
        at = _SEPARATIONS.index(near.separation) if near.separation in _SEPARATIONS else 0
        around = _SEPARATIONS[max(at - 1, 0) : at + 1]
        for bend in _BENDS:
            packed = self._chosen(image, label, figures, strands, bend, around)
            if packed.score is None or packed.score >= (lies.packed.score or 0):
                break
            lies = _Lies(packed, bend)
        return lies

    def _chosen(
        self,
        image: Image,
        label: int,
        figures: OwnFigures | None,
        strands: Strands,
        bend: float,
        separations: tuple[float, ...] = _SEPARATIONS,
    ) -> Packed:
        """Return separation and fillet of fibres that bend so much."""

        def pack(sides: np.ndarray, separation: float, seed: int) -> Laid:
            return lay(
                strands,
                sides,
                separation=separation,
                bend=bend,
                share=strands.fraction,
                length=self.config.length,
                seed=seed,
                quiet=True,
            )

        return choose(
            SmallPackings(image, label, figures, pack, draw_fibres),
            separation=self.config.separation,
            fillet=self.config.fillet,
            separations=separations,
        )

    def from_state(self, exemplars: Sequence[Image], state: ModelState) -> FibresModel:
        """Build the model of what was learned, as `FibresModel.state` gives it."""
        plain = dict(state.plain)
        directions, radii = state.arrays["directions"], state.arrays["radii"]
        if directions.ndim != 2 or directions.shape[1] != 3 or radii.ndim != 1:
            raise ValueError("these are no fibres")
        lies = _Lies(Packed(**plain.pop("packed")), float(plain.pop("bend")))
        label = int(plain.pop("label"))
        strands = Strands(directions=directions, radii=radii, **plain)
        return FibresModel(self.config, exemplars, label, strands, lies)


class FibresModel(PackedModel):
    """Directions and thicknesses of fibres, and how they lie."""

    capabilities = CAPABILITIES
    config: FibresConfig

    def __init__(
        self,
        config: FibresConfig,
        exemplars: Sequence[Image],
        label: int,
        strands: Strands,
        lies: _Lies,
    ) -> None:
        super().__init__(config, exemplars)
        self.label, self.strands, self.packed, self.bend = label, strands, lies.packed, lies.bend
        self.fraction = strands.fraction

    def state(self) -> ModelState:
        """Return the fibres and what trials chose."""
        plain = asdict(self.strands)
        arrays = {name: plain.pop(name) for name in ("directions", "radii")}
        plain |= {"label": self.label, "bend": self.bend, "packed": asdict(self.packed)}
        return ModelState(arrays, plain)

    @property
    def largest(self) -> float:
        """Return the largest radius of a fibre, edges."""
        return float(self.strands.radii.max())

    def _depth(
        self, request: Request, sides: np.ndarray, share: float
    ) -> tuple[np.ndarray, dict[str, Any]]:
        laid = lay(
            self.strands,
            sides,
            separation=self.packed.separation,
            bend=self.bend,
            share=share,
            length=self.config.length,
            seed=request.seed,
        )
        depth = draw_fibres(laid, request.shape, self._steps, self.packed.fillet)
        report = {"fibres": len(laid.radii), "bend": self.bend, "lacking": round(laid.lacking, 4)}
        return depth, report

    def _body_bytes(self, sides: np.ndarray) -> float:
        step = APART * self.strands.mean_radius
        return _PLACE * float(np.prod(sides)) * self.fraction / (self.strands.section * step)


def _thin(strands: Strands) -> bool:
    """Return whether fibres fill less than half: what is between them is drawn out as well."""
    return strands.fraction < 0.5
