"""Settings of `packing`: the only home of its defaults."""

from __future__ import annotations

from dataclasses import dataclass

from trabecula.synth.shared.settings import keep_choices, keep_numbers, keep_phase

_LIMITS = {"degree": (0, 10), "separation": (0.5, 1.5), "fillet": (0.0, 4.0)}


@dataclass(frozen=True)
class PackingConfig:
    """Settings of `packing`. Lengths are in the smallest edge of a voxel."""

    phase: str | None = None
    """Phase of the bodies. None: the one whose bodies are rounder and whose packing is nearer to
    the scan."""

    separation: float | None = None
    """Distance to which two bodies push each other apart, over the sum of their radii along the
    line between them, 0.5 .. 1.5. 1: they touch; below they overlap, as cemented grains do. None:
    the one whose packings are nearest to the scan."""

    fillet: float | None = None
    """Standard deviation of the Gaussian that rounds the edges where bodies meet, voxels, 0 .. 4.
    None: the one whose packings are nearest to the scan."""

    turns: str = "auto"
    """How bodies are turned: "any" way, or as they lie, with "mirrors" only. "auto": any way, where
    the scan's are not longer along one axis."""

    degree: int = 6
    """Degree of the spherical harmonics that describe a body, 0 .. 10, at most: 0 are balls, 2
    ellipsoids, more have corners. Small bodies have less."""

    def __post_init__(self) -> None:
        keep_choices(self, {"turns": ("auto", "any", "mirrors")})
        keep_numbers(self, _LIMITS)
        keep_phase(self, "phase")
