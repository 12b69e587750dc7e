"""An exemplar without its voxels: enough to describe what a model makes, and to tell its origin."""

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
    """An exemplar without its voxels, or the voxels' size of material made from settings alone.

    Attributes
    ----------
    kind, spacing, unit, phases, recipe :
        As of `Image`; the recipe's last step holds the SHA-256 of the voxels.
    shape : tuple of int
        Empty where there is no exemplar (`without_exemplar`).
    shares : tuple of float
        Volume fraction of every phase, 0 .. 1; empty without phases or without an exemplar.
    """

    kind: str
    shape: tuple[int, ...]
    spacing: tuple[float, ...]
    unit: str
    phases: tuple[str, ...]
    shares: tuple[float, ...]
    recipe: Recipe

    def __repr__(self) -> str:
        if self.blank:
            return "<ExemplarInfo: no exemplar>"
        text = outline(self.shape, self.kind, self.spacing, self.unit, self.phases)
        return text.replace("<Image", "<ExemplarInfo", 1)

    @property
    def ndim(self) -> int:
        """Return the number of spatial axes, 2 or 3."""
        return len(self.spacing)

    @property
    def blank(self) -> bool:
        """Tell whether there is no exemplar: the fields then describe the result alone."""
        return not self.shape

    @property
    def empty_label(self) -> int:
        """Return the label outside a mask: that of the phase "void", else 0."""
        return self.phases.index("void") if "void" in self.phases else 0

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON."""
        return {**asdict(self), "recipe": self.recipe.to_json()}

    @classmethod
    def from_json(cls, plain: Mapping[str, Any]) -> ExemplarInfo:
        """Build it from the JSON of `to_json`.

        Raises
        ------
        ValueError, TypeError, LookupError
            Something else.
        """
        check_name(plain["kind"], KINDS, name="kind of image")
        spacing = as_spacing(plain["spacing"], ndim=len(plain["spacing"]))
        phases = tuple(map(str, plain["phases"]))
        shares = tuple(map(float, plain["shares"]))
        expected = len(phases) if plain["shape"] else 0
        if len(shares) != expected or not isinstance(plain["unit"], str):
            raise ValueError(
                f"{len(phases)} phases have {len(shares)} shares, in unit {plain['unit']!r}"
            )
        return cls(
            kind=plain["kind"],
            shape=as_shape(plain["shape"], ndim=len(spacing)) if plain["shape"] else (),
            spacing=spacing,
            unit=plain["unit"],
            phases=phases,
            shares=shares,
            recipe=Recipe.from_json(plain["recipe"]),
        )


def without_exemplar(spacing: float = 1.0, unit: str = "voxel") -> ExemplarInfo:
    """Describe material made from settings alone: void and solid in cubes of edge `spacing`.

    Raises
    ------
    InputError
        The spacing is no number above 0.
    """
    edges = as_spacing((spacing,), ndim=3)
    return ExemplarInfo("labels", (), edges, unit, default_phases(2), (), Recipe())


def exemplar_info(exemplar: Image | ExemplarInfo) -> ExemplarInfo:
    """Return the description of an exemplar."""
    if isinstance(exemplar, ExemplarInfo):
        return exemplar
    values = exemplar.values
    return ExemplarInfo(
        kind=exemplar.kind,
        shape=exemplar.shape,
        spacing=exemplar.spacing,
        unit=exemplar.unit,
        phases=exemplar.phases,
        shares=tuple(
            np.count_nonzero(values == label) / values.size for label in range(len(exemplar.phases))
        ),
        recipe=exemplar.recipe,
    )
