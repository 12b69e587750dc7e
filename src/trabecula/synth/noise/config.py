"""Settings of `noise`: the only home of its defaults."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from trabecula.core.checks import as_number, check_name
from trabecula.core.errors import InputError

KINDS = ("gaussian", "perlin", "voronoi", "voronoi_cells", "voronoi_edges", "white", "worley")
COVARIANCES = ("auto", "exponential", "gaussian", "matern32", "matern52", "wave")
WALLED = ("voronoi", "voronoi_edges")
_TURNED = (*WALLED, "worley")
_LONGEST = 1e20


@dataclass(frozen=True)
class NoiseConfig:
    """Settings of `noise`."""

    kind: str = "gaussian"
    """What is cut at a level: "gaussian", a Gaussian random field; "white", every voxel by chance;
    "perlin", blended slopes at the corners of a lattice; "worley", the distance to the nearest of
    scattered points, solid where it is short (balls that run into each other); of the cells around
    such points "voronoi" the walls, "voronoi_edges" the struts where walls meet, "voronoi_cells"
    whole cells, solid or void by chance."""

    porosity: float | None = None
    """Share of void, above 0 and below 1. None: the exemplar's; without one 0.5, or what
    `thickness` leaves.
    """

    length: float | tuple[float, ...] | None = None
    """Size of the pattern in the image's unit, one number or three (z, y, x): the edge of a cell of
    the lattice, the length of the covariance, the edge of the cubes of white noise. At least 2
    voxels, of white noise 1. None: 10 voxels, of white noise 1, of a Gaussian field that of the
    exemplar's covariance."""

    covariance: str = "auto"
    """Of a Gaussian field at distance r, with the length L: "exponential", exp(-r/L); "matern32",
    (1 + s) exp(-s) with s = sqrt(3) r/L; "matern52", (1 + s + s^2/3) exp(-s) with s = sqrt(5) r/L;
    "gaussian", exp(-(r/L)^2); "wave", sin(q)/q times exp(-(r/L)^2 / 2) with q = 2 pi r/L, even
    waves such as spinodal structures have. "auto": the exemplar's; without one "gaussian"."""

    cones: tuple[float, ...] | None = None
    """Of a Gaussian field of a named covariance: half angles, 0 .. 90 degrees, of the cones about
    z, y and x that hold its waves, 0 for none about that axis; volumes alone. With covariance
    "wave" they make spinodoids: (0, 30, 30) columns along z, (30, 0, 0) layers across z, (15, 15,
    15) cubes. None: waves in all directions."""

    thickness: float | None = None
    """Of the walls of "voronoi" and the struts of "voronoi_edges", in the image's unit, above 0.
    The porosity then follows from it. None: the thickness follows from the porosity."""

    jitter: float = 1.0
    """How far the points of "worley" and the Voronoi kinds lie from the middles of their cells,
    0 .. 1: 0 is a regular lattice, 1 anywhere in the cell."""

    octaves: int = 1
    """Perlin noises that are summed, 1 .. 8, each of half the length of the one before."""

    persistence: float = 0.5
    """Weight of each octave against the one before, 0 .. 1."""

    invert: bool = False
    """Whether void and solid change places at the same porosity: of "worley" round pores, of
    "voronoi" cracks.
    """

    reach: int = 40
    """Offset up to which the exemplar's two-point function is followed, voxels, 4 .. 200, and at
    most half of the exemplar; from half of it on it fades to that of independent points. Farther
    costs memory and adds the chance of few pairs."""

    corrections: int = 20
    """Rounds of fitting the exemplar's spectrum once its negative part is cut off, 0 .. 200."""

    isotropic: bool = False
    """Whether all directions of the exemplar are alike: the two-point function is averaged over
    them. A picture as a flat exemplar (1, Y, X) then gives a volume. Voxel edges count as equal."""

    exact: bool = False
    """Whether the shares of the phases come out to the voxel instead of scattering as those of any
    window do. Then all voxels are ranked at once, and no box can be made alone."""

    def __post_init__(self) -> None:
        check_name(self.kind, KINDS, name="kind of noise")
        check_name(self.covariance, COVARIANCES, name="covariance")
        for name in ("isotropic", "exact", "invert"):
            if getattr(self, name) not in (True, False):
                raise InputError(f"{name}={getattr(self, name)!r} should be true or false")
        for name, low, high, whole in (
            ("reach", 4, 200, True),
            ("corrections", 0, 200, True),
            ("octaves", 1, 8, True),
            ("jitter", 0, 1, False),
            ("persistence", 0, 1, False),
        ):
            object.__setattr__(
                self,
                name,
                as_number(getattr(self, name), name=name, low=low, high=high, whole=whole),
            )
        object.__setattr__(self, "porosity", _as_porosity(self.porosity))
        object.__setattr__(self, "length", _as_length(self.length))
        if self.thickness is not None:
            object.__setattr__(self, "thickness", _as_positive(self.thickness, name="thickness"))
        self._check_together()

    @classmethod
    def recorded(cls, settings: Mapping[str, Any]) -> dict[str, Any]:
        """Complete the settings of a recipe or a model that is older than some of them."""
        return {"cones": None, **settings}

    def _check_together(self) -> None:
        """Check for settings without a meaning for this kind, or against each other."""
        if self.thickness is not None and self.kind not in WALLED:
            raise InputError(
                f"thickness is that of {' and '.join(WALLED)}: leave it out of kind={self.kind!r}"
            )
        if self.thickness is not None and (self.porosity is not None or self.exact):
            other = "exact" if self.exact else "porosity"
            raise InputError(f"thickness and {other} both say how much is solid: give one of them")
        if self.invert and self.kind not in _TURNED:
            raise InputError(
                f"invert is for {', '.join(_TURNED)}: kind={self.kind!r} is the same either way, "
                "set porosity instead"
            )
        if self.cones is not None:
            object.__setattr__(self, "cones", _as_cones(self.cones))
            if self.kind != "gaussian" or self.covariance == "auto":
                raise InputError(
                    "cones hold the waves of a Gaussian field of a named covariance: give "
                    "kind='gaussian' and a covariance, such as 'wave'"
                )
        if self.covariance != "auto" and self.kind != "gaussian":
            raise InputError(
                f"covariance is that of a Gaussian field: leave it out of kind={self.kind!r}"
            )


def _as_cones(value: Any) -> tuple[float, ...]:
    """Check three half angles, one of them above 0."""
    if not isinstance(value, Sequence) or isinstance(value, str) or len(value) != 3:
        raise InputError(f"cones={value!r} should be three angles, about z, y and x")
    found = tuple(float(as_number(one, name="cones", low=0, high=90)) for one in value)
    if not any(found):
        raise InputError("cones are 0 about every axis, which leaves no wave: open one of them")
    return found


def _as_porosity(value: Any) -> float | None:
    """Check a porosity."""
    if value is None:
        return None
    found = float(as_number(value, name="porosity", low=0, high=1))
    if found in (0.0, 1.0):
        raise InputError(
            f"porosity={value} leaves one phase alone: give a number above 0 and below 1"
        )
    return found


def _as_length(value: Any) -> float | tuple[float, ...] | None:
    """Check one length, or one an axis."""
    if value is None or not isinstance(value, Sequence) or isinstance(value, str):
        return None if value is None else _as_positive(value, name="length")
    if len(value) not in (2, 3):
        raise InputError(
            f"length={value!r} has {len(value)} numbers: give one, or one an axis (z, y, x)"
        )
    return tuple(_as_positive(one, name="length") for one in value)


def _as_positive(value: Any, *, name: str) -> float:
    """Check a number above 0."""
    found = float(as_number(value, name=name, low=0, high=_LONGEST))
    if found == 0:
        raise InputError(f"{name}={value!r} should be above 0")
    return found
