"""Settings of `kopf`: the only home of its defaults, beside those of `SolidConfig`."""

from __future__ import annotations

from dataclasses import dataclass

from trabecula.synth.shared.settings import keep_numbers
from trabecula.synth.shared.solid.config import SolidConfig


@dataclass(frozen=True)
class KopfConfig(SolidConfig):
    """Settings of `kopf`. Voxels are those of the level in question unless said otherwise."""

    reweighting: float = 1.0
    """How strongly a value that is too frequent in the vote before weighs less in the next, by 1 +
    this times its excess share, 0 .. 1000 (the paper: 1)."""

    def __post_init__(self) -> None:
        super().__post_init__()
        keep_numbers(self, {"reweighting": (0, 1000)})
