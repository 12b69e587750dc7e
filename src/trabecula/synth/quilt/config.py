"""Settings of `quilt`: the only home of its defaults."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from trabecula.core.checks import as_number
from trabecula.core.errors import InputError
from trabecula.synth.shared.settings import keep_choices, keep_numbers


@dataclass(frozen=True)
class QuiltConfig:
    """Settings of `quilt`. Lengths are voxels."""

    patch: int = 0
    """Side s of a neighbourhood, voxels, 4 .. 64 (section 3.1). 0: from the exemplar, two or three
    of its structures wide, and a whole number of periods and an overlap of a lattice."""

    overlap: int = 0
    """o, by how much neighbourhoods overlap, voxels, 1 .. s - 1; they step by s - o (section 3.3).
    0: two fifths of the patch, at least 3."""

    alpha: float = 0.7
    """Weight of the mismatch in the overlap, 0 .. 1; the descriptors have the rest (equation 4; the
    paper: 0.9).
    """

    weights: Mapping[str, float] = field(default_factory=dict)
    """Weight of a descriptor by its name, 0 .. 1000; 1 where nothing is said (equation 6)."""

    share: float = 0.03
    """Share of all neighbourhoods (of those in phase) that are looked at for a place, 0 .. 1: those
    nearest in descriptors.
    """

    candidates: int = 8000
    """Candidates looked at for a place at most, 8 .. 2**31."""

    mismatch: float = 0.15
    """Share of differing voxels in an overlap, 0 .. 1, above which four times as many candidates
    are looked at.
    """

    sieve: int = 4
    """Of many candidates one in so many words of the overlap is compared first, 1 .. 16, and only
    the nearest eighth in full. 1: all in full."""

    variety: float = 0.0
    """By how much a candidate may be worse than the best and still be taken, as a share, 0 .. 10.
    """

    orientations: str = "none"
    """Copies of the exemplar to choose from besides itself: "none", "mirrors" (8; 4 in 2-D),
    "upright" (16, that keep the first axis), "all" (48; 8 in 2-D)."""

    period: str = "auto"
    """"auto": of an exemplar with a period (a lattice) only neighbourhoods in phase with a place
    are looked at; "none": all.
    """

    connected: str = "solid"
    """Phases that become one connected component (section 4.3): "solid" (every phase but void),
    "void" (all of it reaches a face of the volume or the form), "both", "none"."""

    joins: bool = True
    """Whether components of the solid that places which gave way have left are joined in the end,
    by the shortest paths, as thick as struts (`connected` = "solid" alone). Recipes and models that
    do not name it: False."""

    feature: int = 1
    """Least thickness of the solid, voxels, 1 .. 8: no seam leaves less. 1: no condition."""

    seams: int = 0
    """Of so many candidates with the least distance the one with the cheapest seam is taken,
    1 .. 64. 0: 8, of a lattice 4."""

    tries: int = 12
    """Candidates that are cut in and judged at a place, 1 .. 1000, before more are looked at."""

    backtrack: int = 2
    """Patches that are taken back, 0 .. 8, where no candidate fits, before struts are laid or a
    place gives way.
    """

    def __post_init__(self) -> None:
        keep_numbers(self, _RANGES)
        keep_choices(self, _CHOICES)
        if self.patch and self.patch < 4:
            raise InputError(
                f"patch={self.patch} should be 4 .. 64, or 0 to take it from the exemplar"
            )
        if self.patch and self.overlap >= self.patch:
            raise InputError(
                f"overlap={self.overlap} is not smaller than patch={self.patch}: the step between "
                "patches would be 0"
            )
        if not isinstance(self.weights, Mapping):
            raise InputError(
                f"weights={self.weights!r} should name descriptors, such as "
                "{'volume_fraction': 2}"
            )
        kept = {
            str(name): float(as_number(value, name=f"the weight of {name}", low=0, high=1000))
            for name, value in self.weights.items()
        }
        object.__setattr__(self, "weights", kept)

    @classmethod
    def recorded(cls, settings: Mapping[str, Any]) -> dict[str, Any]:
        """Complete the settings of a recipe or a model that is older than some of them."""
        return {"joins": False, **settings}

    @classmethod
    def preset(cls, name: str) -> dict[str, Any]:
        """Return the settings of a preset."""
        return dict(_PRESETS[name])


_PRESETS: dict[str, dict[str, Any]] = {
    "fast": {"candidates": 1000, "seams": 1, "tries": 8, "mismatch": 1.0},
    "paper": {
        "patch": 14,
        "overlap": 4,
        "alpha": 0.9,
        "share": 1.0,
        "candidates": 1 << 31,
        "sieve": 1,
        "seams": 1,
    },
}

_CHOICES: dict[str, tuple[Any, ...]] = {
    "orientations": ("none", "mirrors", "upright", "all"),
    "period": ("auto", "none"),
    "connected": ("none", "solid", "void", "both"),
}

_RANGES = {
    "patch": (0, 64),
    "overlap": (0, 63),
    "alpha": (0, 1),
    "share": (0, 1),
    "candidates": (8, 1 << 31),
    "mismatch": (0, 1),
    "sieve": (1, 16),
    "variety": (0, 10),
    "feature": (1, 8),
    "seams": (0, 64),
    "tries": (1, 1000),
    "backtrack": (0, 8),
}
