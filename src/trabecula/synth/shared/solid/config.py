"""Settings of the methods that optimise a volume over the slices through it, stated once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from trabecula.synth.shared.settings import (
    keep_choices,
    keep_gap,
    keep_numbers,
    keep_rounds,
    keep_views,
)

_PRESETS: dict[str, dict[str, Any]] = {
    "fast": {"first_rounds": 12, "rounds": (2, 4, 8), "sweeps": (1, 2), "tries": 2},
    "best": {"first_rounds": 40, "rounds": (8, 16, 24), "sweeps": (2, 4), "tries": 8},
    "paper": {
        "levels": 3,
        "first_rounds": 30,
        "rounds": (8, 16, 30),
        "histogram": False,
        "corrections": (0,),
        "interface_rounds": 0,
        "search": "exact",
        "components": 128,
        "trim": 0,
    },
}

_RANGES = {
    "gap": (0, 32),
    "neighbourhood": (4, 12),
    "levels": (1, 8),
    "first_rounds": (1, 200),
    "robustness": (0, 2),
    "interface_rounds": (0, 10),
    "clip": (2, 20),
    "nearest": (1, 100),
    "tries": (0, 64),
    "index_penalty": (0, 10),
    "variance": (0.5, 1),
    "components": (4, 128),
}

_CHOICES = {
    "histogram": (True, False),
    "feature": (True, False),
    "search": ("coherent", "exact"),
    "orientations": ("none", "mirrors", "all"),
}


@dataclass(frozen=True)
class SolidConfig:
    """Settings of every such method. Voxels are those of the level in question unless said
    otherwise.
    """

    neighbourhood: int = 8
    """Width w of the square neighbourhoods in the planes of the views, voxels, 4 .. 12 (the paper:
    8).
    """

    views: tuple[str, ...] = ()
    """Planes in which the result is to look like the pictures, such as yx, zx: two or three. Empty:
    one picture in all three; two pictures in yx and zx, and in zy; three in one each."""

    gap: int = 0
    """Pixels from one to the next of two or more parallel sections of a material that is alike from
    all sides, 0 .. 32: the first is the picture, and flips (`interface_rounds`) bring the volume to
    the Euler numbers that all of them say. Labels, and no target. 0: pictures are of different
    planes."""

    step: int = 2
    """Distance between neighbourhoods in a plane, voxels, 1 .. w / 2. Every plane has its own."""

    levels: int = 4
    """Resolutions at most, each half the next, 1 .. 8 (the paper: 3). As many are used as leave
    room in picture and result.
    """

    first_rounds: int = 20
    """Rounds of search and vote on the coarsest level, which starts from random patches, 1 .. 200.
    """

    rounds: tuple[int, ...] = (4, 8, 12)
    """Rounds on the other levels, finest first, each 1 .. 200; the last counts for the rest."""

    robustness: float = 0.8
    """Exponent r of the distances that are minimised, 0 .. 2, by weights d^(r - 2) (the paper:
    0.8).
    """

    histogram: bool = True
    """Whether every round also matches the histogram exactly, and the result holds the picture's
    fractions.
    """

    corrections: tuple[int, ...] = (1,)
    """Steps towards the picture's two-point function after every round, for labels, finest level
    first, each 0 .. 10; the last counts for the rest. Beside fixed voxels there are none."""

    interface_rounds: int = 2
    """Of labels of two or three phases: rounds over the voxels of interfaces in the end, 0 .. 10,
    in which single ones change their phase until chords and squares of pixels occur in the planes
    as often as in the pictures, where the fractions are theirs. Recipes and models that do not
    name it: 0.
    """

    clip: float = 4.2
    """Signed distance of labels, or from a feature's rim, at which the field saturates, voxels,
    2 .. 20.
    """

    feature: bool = True
    """Whether grey values and colours have a feature channel beside them: the signed distance to
    the rim of what stands out from the most frequent colour, or of the bright class of greys."""

    search: str = "coherent"
    """"coherent": each site tries its own match, its neighbours' moved along, and random ones.
    "exact": the nearest in the space of the principal components."""

    sweeps: tuple[int, ...] = (1, 3)
    """Search sweeps per round, finest level first, each 1 .. 10; the last counts for the rest."""

    nearest: int = 1
    """Neighbourhoods that the exact search looks at, 1 .. 100; more than one only with an index
    penalty.
    """

    tries: int = 4
    """Pairs of random candidates per neighbourhood and sweep, 0 .. 64: one anywhere, one around the
    best, ever nearer.
    """

    index_penalty: float = 0.0
    """How much being chosen too often adds to a distance in the search, 0 .. 10: a neighbourhood
    chosen n times as often as even use has its distance multiplied by 1 + this times (n - 1)."""

    variance: float = 0.95
    """Share of the neighbourhoods' variance that the principal components keep, 0.5 .. 1 (the
    paper: 0.95).
    """

    components: int = 32
    """At most so many principal components, 4 .. 128."""

    orientations: str = "none"
    """Copies of a picture to learn from besides itself: "none", "mirrors" (4), "all" (8, turned as
    well).
    """

    trim: int = 1
    """Voxels at the rim of a neighbourhood that do not vote on the finest level, 0 .. (w - step) /
    2: less averaging.
    """

    def __post_init__(self) -> None:
        keep_views(self)
        keep_rounds(self, "rounds")
        keep_rounds(self, "sweeps", high=10)
        keep_rounds(self, "corrections", low=0, high=10)
        keep_numbers(self, _RANGES)
        keep_gap(self)
        keep_numbers(self, {"step": (1, self.neighbourhood // 2)})
        keep_numbers(self, {"trim": (0, (self.neighbourhood - self.step) // 2)})
        keep_choices(self, _CHOICES)

    @classmethod
    def recorded(cls, settings: Mapping[str, Any]) -> dict[str, Any]:
        """Complete the settings of a recipe or a model that is older than some of them."""
        return {"feature": False, "interface_rounds": 0, "gap": 0, **settings}

    @classmethod
    def preset(cls, name: str) -> dict[str, Any]:
        """Return the settings of a preset."""
        return dict(_PRESETS[name])
