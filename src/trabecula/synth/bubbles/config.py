"""Settings of `bubbles`: the only home of their defaults (those of the flow: flow/config.py)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from trabecula.core.checks import as_number, check_name
from trabecula.core.errors import InputError
from trabecula.synth.bubbles.flow import FlowConfig

GROWTHS = ("fronts", "particles")

_RANGES = {
    "distance": (2, 1e6),
    "thickness": (0, 2),
    "spread": (0, 0.6),
    "roughness": (0, 1),
    "regularity": (0, 1),
    "grain": (0.25, 4),
    "coalescence": (0, 1),
    "randomness": (0.05, 1),
}
_OPTIONAL = {
    "density": (1e-60, 1e60),
    "separation": (0, 1e20),
    "time": (0.01, 10),
    "porosity": (0, 1),
}


@dataclass(frozen=True)
class BubblesConfig(FlowConfig):
    """Settings of `bubbles`.

    L stands for the mean distance between bubbles: there are as many of them as cubes of edge L.
    """

    density: float | None = None
    """Bubbles per cubic unit of the voxels' spacing (of a picture: per square unit). L is its
    inverse cubic (square) root. Default: `distance`."""

    distance: float = 16.0
    """L in voxels, where no density is given, 2 .. 1e6: then the grid decides how large bubbles
    are.
    """

    separation: float | None = None
    """Thickness of the wall between two bubbles, in the unit of the voxels' spacing; 0: none.
    Default: `thickness`.
    """

    thickness: float = 0.08
    """Thickness of the walls in units of L, where no separation is given, 0 .. 2."""

    spread: float = 0.25
    """Of sizes: standard deviation of the logarithm of how fast bubbles grow (lognormal, cut off at
    2.5 of them), 0 .. 0.6.
    """

    regularity: float = 0.5
    """How evenly bubbles are spread, 0 .. 1: 0 is chance (a Poisson process), 1 has one in every
    cube of edge L, repelled from each other.
    """

    randomness: float = 1.0
    """How little bubbles heed the flow, 0.05 .. 1: they grow `randomness` times as fast across it
    as along it; 1 is round.
    """

    roughness: float = 0.2
    """How uneven bubbles and walls are, 0 .. 1: all is shifted by up to 0.35 `roughness` `grain` L
    along every axis.
    """

    grain: float = 0.5
    """Length over which the unevenness changes, in units of L, 0.25 .. 4."""

    coalescence: float = 0.0
    """Share of the pairs of neighbours that have no wall between them, 0 .. 1: two bubbles merged,
    or an open cell.
    """

    time: float | None = None
    """When growth stops: the radius of a free bubble of ordinary size by then, in units of L,
    0.01 .. 10. Default: at fullness, when all bubbles have met others everywhere."""

    porosity: float | None = None
    """Share of void at which growth stops instead, 0 .. 1, within the room that bubbles have (the
    crust is left out). A request's target goes before it."""

    growth: str = "fronts"
    """"fronts": the first arrival of any bubble at every voxel, found at once. "particles": the
    paper's own rounds of claims on the lattice, for volumes that are made whole."""

    trials: int = 100
    """Settings that are tried, at most, to come near an exemplar, 0 .. 1000. Settings at
    their defaults are found, the others stay. 0: no search; the exemplar gives voxels and phases
    alone."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_name(self.growth, GROWTHS, name="growth")
        object.__setattr__(
            self, "trials", as_number(self.trials, name="trials", low=0, high=1000, whole=True)
        )
        for name, (low, high) in _RANGES.items():
            object.__setattr__(
                self, name, as_number(getattr(self, name), name=name, low=low, high=high)
            )
        for name, (low, high) in _OPTIONAL.items():
            if getattr(self, name) is not None:
                object.__setattr__(
                    self, name, as_number(getattr(self, name), name=name, low=low, high=high)
                )
        if self.time is not None and self.porosity is not None:
            raise InputError(
                f"time={self.time} and porosity={self.porosity} both say when growth stops: give "
                "one of them"
            )

    @classmethod
    def preset(cls, name: str) -> dict[str, Any]:
        """Return the settings of a preset."""
        return dict(PRESETS[name])


# Materials by name. Lengths are shares of the mean distance between bubbles, so that they hold in
# any unit; that distance is in voxels until a density is given.
PRESETS: dict[str, dict[str, Any]] = {
    # A fine, uneven crumb, flattened as the loaf is, with a thin crust that the outer bubbles
    # follow.
    "bread": {
        "distance": 10.0,
        "thickness": 0.2,
        "spread": 0.45,
        "regularity": 0.7,
        "roughness": 0.4,
        "coalescence": 0.25,
        "time": 0.8,
        "flow": "elliptic",
        "flow_axis": "x",
        "randomness": 0.65,
        "silhouette_share": 1.5,
        "crust_share": 0.4,
    },
    # Large holes beside small ones, drawn out along the windings of the rolled dough; a thick
    # crust.
    "baguette": {
        "distance": 11.0,
        "thickness": 0.18,
        "spread": 0.55,
        "regularity": 0.5,
        "roughness": 0.5,
        "coalescence": 0.2,
        "time": 0.85,
        "flow": "roll",
        "flow_axis": "x",
        "randomness": 0.5,
        "silhouette_share": 1.5,
        "crust_share": 0.45,
    },
    # Open cells of one size, alike in all directions.
    "sponge": {
        "distance": 12.0,
        "thickness": 0.1,
        "spread": 0.25,
        "regularity": 0.9,
        "roughness": 0.3,
        "coalescence": 0.95,
        "porosity": 0.66,
    },
    # Round eyes that were stopped before they met, below a rind.
    "cheese": {
        "distance": 34.0,
        "thickness": 0.08,
        "spread": 0.35,
        "regularity": 0.7,
        "roughness": 0.15,
        "time": 0.4,
        "crust_share": 0.12,
    },
    # Fewer and uneven vesicles in much mass, a little flattened, some of them run together.
    "stone": {
        "thickness": 0.08,
        "spread": 0.6,
        "regularity": 0.2,
        "roughness": 0.6,
        "coalescence": 0.3,
        "porosity": 0.4,
        "flow": "horizontal",
        "randomness": 0.75,
    },
    # Closed polyhedral cells that have grown until they met.
    "foam": {
        "distance": 20.0,
        "thickness": 0.11,
        "spread": 0.12,
        "regularity": 0.8,
        "roughness": 0.0,
    },
    # Plates and rods between open cells, what is left of their walls; drawn out along the principal
    # axis.
    "bone": {
        "thickness": 0.2,
        "spread": 0.2,
        "regularity": 0.9,
        "roughness": 0.7,
        "coalescence": 0.82,
        "time": 0.72,
        "flow": "axial",
        "randomness": 0.6,
        "crust_share": 0.3,
    },
}
