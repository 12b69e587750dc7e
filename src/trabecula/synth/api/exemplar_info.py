"""An exemplar without its voxels: enough to describe what a model makes, to tell its origin, and to
find the size of its voxels: the exemplar's, or the form's where the exemplar states none.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from trabecula.core.checks import as_shape, as_spacing, check_name
from trabecula.core.errors import RequestError
from trabecula.core.image import KINDS, Image, default_phases, outline
from trabecula.core.recipe import Recipe
from trabecula.core.request import Request
from trabecula.io.units import NO_LENGTH, has_length, to_metres

_ALIKE = 1e-4
"""Relative difference of edges that are the same: files keep few digits of some."""


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


def result_voxels(
    request: Request, spacing: Sequence[float], unit: str
) -> tuple[tuple[float, ...], str]:
    """Return spacing and unit of the result of a request.

    Parameters
    ----------
    request : Request
    spacing : sequence of float
        Of the model's results, along as many axes as the request has.
    unit : str

    Raises
    ------
    RequestError
        The form has other voxels.
    """
    if request.voxel is None:
        return tuple(spacing), unit
    edges, named = request.voxel
    if unit == NO_LENGTH and all(edge == 1 for edge in spacing):
        return edges, named  # all that is known
    both = has_length(named) and has_length(unit)
    factor = to_metres(named) / to_metres(unit) if both else 1.0
    if np.allclose(np.array(edges) * factor, spacing, rtol=_ALIKE, atol=0):
        return (
            (tuple(spacing), unit) if has_length(unit) or not has_length(named) else (edges, named)
        )
    no_unit = (
        ""
        if has_length(named)
        else "; a surface without a unit is read with one by tb.read_mesh(..., unit=)"
    )
    raise RequestError(
        f"the mask's voxels are {_edges_text(edges)} {named}, "
        f"the result's {_edges_text(spacing)} {unit}: "
        "voxelise the form at the result's spacing (tb.voxelise), resample it, or correct the "
        f"spacing of either (--spacing, --unit){no_unit}"
    )


def _edges_text(edges: Sequence[float]) -> str:
    return " x ".join(f"{edge:.6g}" for edge in edges)
