"""Settings of `kopf`: the only home of its defaults, besides those that it shares with its rivals."""

from __future__ import annotations

from dataclasses import dataclass

from trabecula.synth.shared.settings import keep_numbers
from trabecula.synth.shared.solid_config import SolidConfig


@dataclass(frozen=True)
class KopfConfig(SolidConfig):
    """Settings of `kopf`. Voxels are those of the level in question unless said otherwise."""

    reweighting: float = 1.0
    """How strongly a value that is too frequent in the vote before weighs less in the next, by 1 + this times its excess share,
    0 .. 1000 (the paper: 1)."""

    nearest: int = 1
    """Neighbourhoods that the exact search looks at, 1 .. 100; more than one only with an index penalty."""

    tries: int = 4
    """Pairs of random candidates per neighbourhood and sweep, 0 .. 64: one anywhere, one around the best, ever nearer."""

    index_penalty: float = 0.0
    """How much being chosen too often adds to a distance, 0 .. 10; 0 as in the paper (`chen` is the method that has it)."""

    def __post_init__(self) -> None:
        super().__post_init__()
        keep_numbers(self, _RANGES)


_RANGES = {"reweighting": (0, 1000), "index_penalty": (0, 10), "nearest": (1, 100), "tries": (0, 64)}
