"""Settings of `tessellation`: the only home of its defaults."""

from __future__ import annotations

from dataclasses import dataclass

from trabecula.core.checks import as_number
from trabecula.synth.shared.settings import keep_numbers, keep_phase, keep_views

_LIMITS = {"neck": (0.05, 1.0), "volume_spread": (0.0, 1.5), "rounding": (0.0, 0.5)}


@dataclass(frozen=True)
class TessellationConfig:
    """Settings of `tessellation`."""

    views: tuple[str, ...] = ()
    """Planes that the pictures are sections in, such as yx, zx: two or three. Empty: one picture in
    all three; two pictures in yx and zx, and in zy; three in one each."""

    boundary: str | None = None
    """Phase of the boundaries. None: the phase whose rest falls into most cells."""

    neck: float = 0.75
    """Width of a gap in a boundary of the picture over that of the narrower of the two cells beside
    it, from which they count as one cell, 0.05 .. 1."""

    volume_spread: float | None = None
    """Standard deviation of the logarithm of cell volumes, 0 .. 1.5. None: the one whose sections
    are most like the picture."""

    lloyd_steps: int | None = None
    """Moves of the seeds to the centroids of their cells, 0 .. 50: more makes cells rounder. None:
    as many as make sections most like the picture."""

    rounding: float | None = None
    """Radius with which the corners of a cell's interior are rounded, over the edge of a cube of
    its mean volume, 0 .. 0.5. None: the one whose sections are most like the picture."""

    def __post_init__(self) -> None:
        keep_views(self)
        keep_numbers(self, _LIMITS)
        keep_phase(self, "boundary")
        if self.lloyd_steps is not None:
            steps = as_number(self.lloyd_steps, name="lloyd_steps", low=0, high=50, whole=True)
            object.__setattr__(self, "lloyd_steps", steps)
