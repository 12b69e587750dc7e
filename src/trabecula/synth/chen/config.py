"""Settings of `chen`: the only home of its defaults, beside those of `SolidConfig`."""

from __future__ import annotations

from dataclasses import dataclass

from trabecula.synth.shared.settings import keep_choices, keep_numbers
from trabecula.synth.shared.solid.config import SolidConfig


@dataclass(frozen=True)
class ChenConfig(SolidConfig):
    """Settings of `chen`. Voxels are those of the level in question unless said otherwise."""

    index_penalty: float = 1.0
    """How much being chosen too often adds to a distance in the search, 0 .. 10: a neighbourhood
    chosen n times as often as even use has its distance multiplied by 1 + this times (n - 1)."""

    position_penalty: float = 1.0
    """How much less a pixel counts in the vote that is the source of too many voxels, 0 .. 10: the
    source of n times as many as even use by 1 / (1 + this times (n - 1))."""

    discrete: bool = True
    """Whether a voxel takes the value of the pixel nearest to the vote's mean, or the mean itself.
    """

    nearest: int = 10
    """Neighbourhoods that the exact search looks at, 1 .. 100, for the index penalty to choose
    from.
    """

    tries: int = 8
    """Pairs of random candidates per neighbourhood and sweep, 0 .. 64: one anywhere, one around the
    best, ever nearer.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        keep_numbers(self, {"position_penalty": (0, 10)})
        keep_choices(self, {"discrete": (True, False)})
