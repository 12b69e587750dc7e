"""Settings of `noise`: the only home of its defaults."""

from __future__ import annotations

from dataclasses import dataclass

from trabecula.core.checks import as_number, check_name
from trabecula.core.errors import InputError

KINDS = ("gaussian",)


@dataclass(frozen=True)
class NoiseConfig:
    """Settings of `noise`."""

    kind: str = "gaussian"
    """What field: "gaussian", a Gaussian random field cut at a threshold."""

    reach: int = 40
    """Offset up to which the two-point function is followed, voxels, 4 .. 200, and at most half of the exemplar; from half
    of it on it fades to that of independent points. Farther costs memory and adds the chance of few pairs."""

    corrections: int = 20
    """Rounds of fitting the spectrum once its negative part is cut off, 0 .. 200."""

    isotropic: bool = False
    """Whether all directions are alike: the two-point function is averaged over them. A picture as a flat exemplar (1, Y, X)
    then gives a volume. Voxel edges count as equal."""

    exact: bool = False
    """Whether the shares of the phases come out to the voxel instead of scattering as those of any window do. Then all
    voxels are ranked at once, and no box can be made alone."""

    def __post_init__(self) -> None:
        check_name(self.kind, KINDS, name="kind of noise")
        for name in ("isotropic", "exact"):
            if getattr(self, name) not in (True, False):
                raise InputError(f"{name}={getattr(self, name)!r} should be true or false")
        object.__setattr__(self, "reach", as_number(self.reach, name="reach", low=4, high=200, whole=True))
        object.__setattr__(
            self, "corrections", as_number(self.corrections, name="corrections", low=0, high=200, whole=True)
        )
