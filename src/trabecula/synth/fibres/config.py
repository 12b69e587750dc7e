"""Settings of `fibres`: the only home of its defaults."""

from __future__ import annotations

from dataclasses import dataclass

from trabecula.synth.shared.settings import keep_numbers, keep_phase

_LIMITS = {
    "length": (0.1, 10.0),
    "separation": (0.0, 1.5),
    "fillet": (0.0, 4.0),
    "bend": (0.0, 1.0),
}


@dataclass(frozen=True)
class FibresConfig:
    """Settings of `fibres`. Lengths are in the smallest edge of a voxel."""

    phase: str | None = None
    """Phase of the fibres. None: the one that is more clearly drawn out along lines."""

    separation: float | None = None
    """Distance to which two fibres push each other apart, over the sum of their radii, 0 .. 1.5. 0:
    they run through each other; 1: they touch. None: the one whose fibres are nearest to the scan.
    """

    fillet: float | None = None
    """Standard deviation of the Gaussian that rounds the edges where fibres meet, voxels, 0 .. 4.
    None: the one whose fibres are nearest to the scan."""

    bend: float | None = None
    """How far a fibre wanders from its mean direction, 0 .. 1: the standard deviation of what is
    added to that unit vector across. None: the one whose fibres are nearest to the scan."""

    length: float = 1.0
    """Of a fibre, over the longest side of the box that repeats, 0.1 .. 10. At 1 a fibre along an
    axis meets its own end."""

    def __post_init__(self) -> None:
        keep_numbers(self, _LIMITS)
        keep_phase(self, "phase")
