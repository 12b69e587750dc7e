"""Settings of `mrf`: the only home of its defaults."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from trabecula.core.checks import as_number, check_name
from trabecula.core.errors import InputError
from trabecula.exemplar.views import as_planes


@dataclass(frozen=True)
class MrfConfig:
    """Settings of `mrf`. Sweeps and temperatures are given finest scale first; the last one holds
    for all coarser scales.
    """

    views: tuple[str, ...] = ()
    """Planes whose slices should look like the picture, such as [yx, zx]; empty: all three, or by
    the number of pictures.
    """

    neighbourhood: int = 7
    """Width w of the square neighbourhoods, pixels of the scale, odd, 3 .. 15 (section V.A: 7)."""

    scales: int = 3
    """Resolutions at most, each half the next by decimation, 1 .. 6 (section V.A: 3). Fewer where
    the picture has no room.
    """

    relaxation: str = "gibbs"
    """"gibbs": a draw from the conditional density; "icm": its mode, with the pixels' temperatures
    (equations 8, 9); "annealing": a level at random, accepted by the ratio of densities (figure 1).
    """

    order: str | None = None
    """Order of the sites in a sweep: "random", as in the paper; "classes": sites of a regular
    lattice at once, lattice after lattice. Default: random for icm, which never gets rid of that
    lattice; classes otherwise."""

    heuristic: str = "h2b"
    """Rule that combines the views' densities: "h2b" the product, "h2a" the least; "h1a" and "h1b"
    (icm only) take the most probable level of the least certain view, or the mean of all (equations
    12 to 15)."""

    sweeps: tuple[int, ...] = (8, 12, 24)
    """Sweeps per scale, each 1 .. 1000. For icm the most."""

    heat: tuple[float, ...] = (1.0,)
    """Temperature of the draw at the start of each scale, 0 .. 10: the density to the power 1 /
    heat; 1 is exact, 0 the mode. (gibbs)"""

    final_heat: tuple[float, ...] = (0.7,)
    """Temperature at the end of each scale, 0 .. 10; in between it falls evenly. (gibbs)"""

    polish: int | None = None
    """Sweeps by the mode after those of the finest scale, 0 .. 20. Default: 2 for labels, 0 for
    grey and colour, whose rare values they would lose. (gibbs, annealing)"""

    correction: float = 1.0
    """Power of the marginal that the product of views is divided by, over (views - 1), 0 .. 2: 1 is
    Bayes' rule, 0 the paper. (h2b)"""

    shares: bool = True
    """Whether every class of sites is drawn with the target shares of the levels; without, as in
    the paper, they drift.
    """

    feedback: float | None = None
    """Rate at which a bias learns, from sweep to sweep, the joint statistic of levels and the sums
    around them, 0 .. 20; 0: not, as in the paper. Default: 1 for two phases, 5 for more, 0 for grey
    and colour."""

    coupling: float | None = None
    """Rate at which couplings of pairs of voxels learn the picture's autocorrelation, 0 .. 100; 0:
    none, as in the paper. Default: 0.75 for two phases, 0.4 for more, 0.4 for grey, 0.35 for
    colour. Too high a rate oscillates."""

    reach: int = 20
    """Largest distance of coupled pairs, voxels of the finest scale, 2 .. 200."""

    oblique: bool | None = None
    """Whether sweeps also use planes rotated by 45 degrees. Default: for gibbs, where one isotropic
    picture with square pixels serves all three planes."""

    cells: int = 12
    """Cells of the local sum of a neighbourhood, for the feedback, 1 .. 48; 1 leaves the levels'
    shares alone.
    """

    bandwidth: float | None = None
    """Factor on h_opt, the Parzen window of equation 6, .05 .. 4; 1 as in the paper. Default: 1 for
    labels, 0.35 for grey and colour, which at h_opt are noise."""

    candidates: int = 4096
    """Neighbourhoods of the picture that the density sums over, at most, 64 .. 65536: evenly spread
    ones of more.
    """

    every: bool = True
    """Whether a coarse scale learns from all of the 4^s pictures that begin at another pixel, not
    from the first alone.
    """

    levels: int = 64
    """Grey levels at most, 2 .. 256; fewer are quantiles."""

    colours: int = 128
    """Colours of the palette, 2 .. 255, each a colour of the picture."""

    spread: bool = True
    """Whether a voxel of the result takes, at random, the value of one of the pixels of its level;
    without, the level's middle."""

    upsampling: str = "all"
    """Start of a finer scale: "one", a coarse voxel in one of its eight and the others at random
    (1/8); "all": in all (8/8)."""

    resynthesis: bool = True
    """Whether voxels inherited from a coarser scale are synthesised again, with full confidence for
    their neighbours. (icm)
    """

    xi: float = -3.0
    """Rate at which temperatures fall, -1000 .. 0, exclusive (equation 8). (icm)"""

    start: tuple[float, ...] = (1.0,)
    """Temperature of the voxels at the start of each scale, .01 .. 1, but of those that a coarser
    scale knew. At 1, as in the paper, nothing of the start is seen: voxels visited early take the
    commonest level. (icm)"""

    stop: float = 0.95
    """The fall of the global temperature, as a share, that ends a scale, .5 .. 1. (icm)"""

    proposals: int = 1
    """Levels proposed at each visit of a site, 1 .. 256. (annealing)"""

    def __post_init__(self) -> None:
        object.__setattr__(self, "views", as_planes(self.views))
        for name, (low, high) in _RANGES.items():
            if getattr(self, name) is not None:
                self._check_number(name, low, high)
        self._check_schedule("sweeps", 1, 1000, whole=True)
        self._check_schedule("heat", 0, 10, whole=False)
        self._check_schedule("final_heat", 0, 10, whole=False)
        self._check_schedule("start", 0.01, 1, whole=False)
        if self.order is None:  # kept as found: a recipe names it
            object.__setattr__(self, "order", "random" if self.relaxation == "icm" else "classes")
        for name, allowed in _CHOICES.items():
            check_name(getattr(self, name), allowed, name=name)
        for name in ("every", "resynthesis", "shares", "spread"):
            if not isinstance(getattr(self, name), bool):
                raise InputError(f"{name}={getattr(self, name)!r} should be true or false")
        if self.neighbourhood % 2 == 0:
            raise InputError(
                f"neighbourhood={self.neighbourhood} has no middle: give an odd width, such as 7, "
                "9 or 11"
            )
        if self.heuristic in ("h1a", "h1b") and self.relaxation != "icm":
            raise InputError(
                f"heuristic={self.heuristic} gives a level and no density: it goes with "
                "relaxation=icm, or take h2a or h2b"
            )

    def _check_number(self, name: str, low: float, high: float) -> None:
        """Store a number after checking its range."""
        whole = isinstance(getattr(MrfConfig, name, None), int) or name == "polish"
        object.__setattr__(
            self, name, as_number(getattr(self, name), name=name, low=low, high=high, whole=whole)
        )

    def _check_schedule(self, name: str, low: float, high: float, *, whole: bool) -> None:
        """Store one number per scale after checking their range."""
        given = getattr(self, name)
        counts = tuple(given) if isinstance(given, (list, tuple)) else (given,)
        if not counts:
            raise InputError(
                f"{name} is empty: give one number, or one for each scale, finest first"
            )
        checked = tuple(
            as_number(count, name=name, low=low, high=high, whole=whole) for count in counts
        )
        object.__setattr__(self, name, checked)

    def setting_for(self, name: str, sort: str) -> Any:
        """Return a setting, or its default for a sort of picture (`PictureLevels.sort`)."""
        given = getattr(self, name)
        return _BY_SORT[name][sort] if given is None else given

    @classmethod
    def recorded(cls, settings: Mapping[str, Any]) -> dict[str, Any]:
        """Complete the settings of a recipe or a model that is older than some of them."""
        return {"order": "classes", "start": (1.0,), **settings}

    @classmethod
    def preset(cls, name: str) -> dict[str, Any]:
        """Return the settings of a preset."""
        return dict(_PRESETS[name])


_BY_SORT: dict[str, dict[str, float]] = {
    "feedback": {"two phases": 1.0, "phases": 5.0, "grey": 0.0, "colour": 0.0},
    "coupling": {"two phases": 0.75, "phases": 0.4, "grey": 0.4, "colour": 0.35},
    "polish": {"two phases": 2, "phases": 2, "grey": 0, "colour": 0},
    "bandwidth": {"two phases": 1.0, "phases": 1.0, "grey": 0.35, "colour": 0.35},
}

_CHOICES = {
    "relaxation": ("gibbs", "icm", "annealing"),
    "order": ("classes", "random"),
    "heuristic": ("h1a", "h1b", "h2a", "h2b"),
    "upsampling": ("one", "all"),
}

_PRESETS: dict[str, dict[str, Any]] = {
    "fast": {"sweeps": (4, 6, 12), "candidates": 2048, "colours": 64},
    "best": {"sweeps": (12, 20, 40), "candidates": 8192, "levels": 256, "colours": 255},
    "paper": {
        "relaxation": "icm",
        "sweeps": (100,),
        "correction": 0.0,
        "shares": False,
        "order": "random",
        "bandwidth": 0.2,
        "feedback": 0.0,
        "coupling": 0.0,
        "oblique": False,
        "candidates": 65536,
        "every": True,
        "levels": 32,
        "colours": 255,
        "spread": False,
        "upsampling": "all",
        "xi": -8.0,
        "start": (0.1, 0.1, 0.3),
        "polish": 0,
    },
}

_RANGES = {
    "neighbourhood": (3, 15),
    "scales": (1, 6),
    "polish": (0, 20),
    "correction": (0, 2),
    "feedback": (0, 20),
    "coupling": (0, 100),
    "reach": (2, 200),
    "cells": (1, 48),
    "bandwidth": (0.05, 4),
    "candidates": (64, 65536),
    "levels": (2, 256),
    "colours": (2, 255),
    "xi": (-1000, -1e-3),
    "stop": (0.5, 1),
    "proposals": (1, 256),
}
