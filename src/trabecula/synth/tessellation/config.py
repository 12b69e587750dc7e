"""Settings of `tessellation`: the only home of its defaults."""

from __future__ import annotations

from dataclasses import dataclass

from trabecula.core.checks import as_number
from trabecula.core.errors import InputError
from trabecula.synth.shared.settings import keep_numbers, keep_views


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
        keep_numbers(self, {"neck": (0.05, 1)})
        if self.boundary is not None and not isinstance(self.boundary, str):
            raise InputError(f"boundary={self.boundary!r} should be the name of a phase")
        limits = {"volume_spread": 1.5, "lloyd_steps": 50, "rounding": 0.5}
        for name, most in limits.items():
            if getattr(self, name) is not None:
                whole = name == "lloyd_steps"
                value = as_number(getattr(self, name), name=name, low=0, high=most, whole=whole)
                object.__setattr__(self, name, value if whole else float(value))
