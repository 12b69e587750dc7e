"""What a model knows of its exemplar apart from the voxels: enough to describe what it makes, and
to tell where it is from.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from trabecula.core.checks import as_shape, as_spacing, check_name
from trabecula.core.image import KINDS, Image, default_phases, outline
from trabecula.core.recipe import Recipe


@dataclass(frozen=True)
class ExemplarInfo:
    """An exemplar without its voxels.

    Attributes
    ----------
    kind, spacing, unit, phases, recipe :
        As of `Image`; the recipe's last step holds the SHA-256 of the voxels.
    shape : tuple of int
        Empty where there is no exemplar (`without_exemplar`).
    shares : tuple of float
        Of every phase, 0 .. 1; of what has no phases, none.
    """

    kind: str
    shape: tuple[int, ...]
    spacing: tuple[float, ...]
    unit: str
    phases: tuple[str, ...]
    shares: tuple[float, ...]
    recipe: Recipe

    def __repr__(self) -> str:
        made = outline(self.shape, self.kind, self.spacing, self.unit, self.phases)
        return (
            made.replace("<Image", "<Facts of an image", 1)
            if self.shape
            else "<Facts: no exemplar>"
        )

    @property
    def ndim(self) -> int:
        """Number of spatial axes, 2 or 3."""
        return len(self.spacing)

    @property
    def blank(self) -> bool:
        """Whether there is no exemplar, and these say no more than what is made."""
        return not self.shape

    def to_json(self) -> dict[str, Any]:
        """Plain JSON."""
        return {**asdict(self), "recipe": self.recipe.to_json()}

    @classmethod
    def from_json(cls, plain: Mapping[str, Any]) -> ExemplarInfo:
        """What `to_json` gave.

        Raises
        ------
        ValueError, TypeError, LookupError
            Something else.
        """
        check_name(plain["kind"], KINDS, name="kind of image")
        spacing = as_spacing(plain["spacing"], ndim=len(plain["spacing"]))
        phases, shares = (
            tuple(map(str, plain["phases"])),
            tuple(float(share) for share in plain["shares"]),
        )
        if len(shares) != (len(phases) if plain["shape"] else 0) or not isinstance(
            plain["unit"], str
        ):
            raise ValueError(
                f"{len(phases)} phases have {len(shares)} shares, in unit {plain['unit']!r}"
            )
        shape = as_shape(plain["shape"], ndim=len(spacing)) if plain["shape"] else ()
        return cls(
            plain["kind"],
            shape,
            spacing,
            plain["unit"],
            phases,
            shares,
            Recipe.from_json(plain["recipe"]),
        )


def without_exemplar(spacing: float = 1.0, unit: str = "voxel") -> ExemplarInfo:
    """Of material that is made from settings alone, in cubes of edge `spacing`: void and solid.

    Raises
    ------
    InputError
        The spacing is no number above 0.
    """
    return ExemplarInfo(
        "labels", (), as_spacing((spacing,), ndim=3), unit, default_phases(2), (), Recipe()
    )


def exemplar_info(exemplar: Image | ExemplarInfo) -> ExemplarInfo:
    """The facts of an exemplar."""
    if isinstance(exemplar, ExemplarInfo):
        return exemplar
    values = exemplar.values
    shares = tuple(
        np.count_nonzero(values == label) / values.size for label in range(len(exemplar.phases))
    )
    fields = (exemplar.spacing, exemplar.unit, exemplar.phases, shares, exemplar.recipe)
    return ExemplarInfo(exemplar.kind, exemplar.shape, *fields)
