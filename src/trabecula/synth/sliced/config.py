"""Settings of `sliced`: the only home of its defaults."""

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


@dataclass(frozen=True)
class SlicedConfig:
    """Settings of `sliced`. Voxels are those of the level in question unless said otherwise."""

    views: tuple[str, ...] = ()
    """Planes in which the result is to look like the pictures, such as yx, zx: two or three. Empty:
    one picture in all three; two pictures in yx and zx, and in zy; three in one each."""

    gap: int = 0
    """Pixels from one to the next of two or more parallel sections of a material that is alike from
    all sides, 0 .. 32: the first is the picture, and flips (`interface_rounds`) bring the volume to
    the Euler numbers that all of them say. Labels, and no target. 0: pictures are of different
    planes."""

    levels: int = 3
    """Resolutions at most, each half the next, 1 .. 6. As many are used as leave room in picture
    and result.
    """

    orientations: str = "auto"
    """Copies of a picture to learn from besides itself: "none", "mirrors" (4), "all" (8, turned as
    well). "auto": all where one picture is seen in three planes and the voxel is a cube, which says
    that no axis is preferred; else none."""

    layout_rounds: int = 30
    """Sliced rounds on the coarsest level, 1 .. 500."""

    layout_width: int = 6
    """Width of the square neighbourhoods of sliced rounds, voxels, 3 .. 8."""

    layout_clip: float = 8.0
    """Signed distance at which the field saturates while it is laid out, voxels of the result, 1 ..
    40. Less suits small components far apart (air voids), more connects."""

    strength: float = 2.5
    """How far sliced rounds move neighbourhoods, 0.1 .. 5: 1 is to the picture's distribution, more
    makes up for averaging.
    """

    layout_steps: int = 2
    """Steps towards the picture's two-point function after every third sliced round, 0 .. 10."""

    neighbourhood: int = 7
    """Width of the square neighbourhoods of search and vote, voxels, 4 .. 12."""

    step: int = 2
    """Distance between these in a plane of the finest level, voxels, 1 .. half their width; on
    other levels 1.
    """

    rounds: tuple[int, ...] = (3, 4)
    """Rounds of search and vote on every level, finest first, each 0 .. 200; the last counts for
    the rest but the coarsest, which has none but beside fixed voxels."""

    clip: float = 3.0
    """Signed distance at which the field of search and vote saturates, voxels, 1 .. 20."""

    corrections: tuple[int, ...] = (4,)
    """Steps towards the picture's two-point function after every round, finest level first, each 0
    .. 10; the last counts for the rest."""

    softness: float = 1.6
    """Width of the interface that steps move, voxels, 0.5 .. 4."""

    sweeps: int = 2
    """Search sweeps per round, 1 .. 10."""

    tries: int = 2
    """Pairs of random candidates per neighbourhood and sweep, 0 .. 64: one anywhere, one around the
    best, ever nearer.
    """

    robustness: float = 0.8
    """Exponent r of the distances that are minimised, 0 .. 2, by weights d^(r - 2)."""

    variance: float = 0.95
    """Share of the neighbourhoods' variance that the principal components keep, 0.5 .. 1."""

    components: int = 24
    """At most so many principal components, 4 .. 128."""

    specks: int = 12
    """Connected components of a phase of fewer voxels go to their surroundings at the end, 0 ..
    1000.
    """

    interface_rounds: int = 2
    """Of labels of two or three phases: rounds over the voxels of interfaces in the end, 0 .. 10,
    in which single ones change their phase until chords and squares of pixels occur in the planes
    as often as in the pictures, where the fractions are theirs. Recipes and models that do not
    name it: 0.
    """

    def __post_init__(self) -> None:
        keep_views(self)
        keep_rounds(self, "rounds", low=0)
        keep_rounds(self, "corrections", low=0, high=10)
        keep_numbers(self, _RANGES)
        keep_gap(self)
        keep_numbers(self, {"step": (1, self.neighbourhood // 2)})
        keep_choices(self, {"orientations": ("auto", "none", "mirrors", "all")})

    @classmethod
    def recorded(cls, settings: Mapping[str, Any]) -> dict[str, Any]:
        """Complete the settings of a recipe or a model that is older than some of them."""
        return {"interface_rounds": 0, "gap": 0, **settings}

    @classmethod
    def preset(cls, name: str) -> dict[str, Any]:
        """Return the settings of a preset."""
        return dict(_PRESETS[name])


_PRESETS: dict[str, dict[str, Any]] = {
    "fast": {"layout_rounds": 15, "rounds": (2, 2), "corrections": (3,), "sweeps": 1},
    "best": {"layout_rounds": 60, "rounds": (4, 8), "corrections": (6,), "sweeps": 4, "tries": 4},
}

_RANGES = {
    "gap": (0, 32),
    "levels": (1, 6),
    "layout_rounds": (1, 500),
    "layout_width": (3, 8),
    "layout_clip": (1, 40),
    "strength": (0.1, 5),
    "layout_steps": (0, 10),
    "neighbourhood": (4, 12),
    "clip": (1, 20),
    "softness": (0.5, 4),
    "sweeps": (1, 10),
    "tries": (0, 64),
    "robustness": (0, 2),
    "variance": (0.5, 1),
    "components": (4, 128),
    "specks": (0, 1000),
    "interface_rounds": (0, 10),
}
