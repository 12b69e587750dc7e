"""Fields: descriptors that vary in space, measured, interpolated, drawn, or from topology
optimisation.

A field is a grey Image of float32 with the spacing of its grid; a request takes it as a target if
it has the result's shape. `windowed` returns the descriptors of every window as arrays.
"""

from collections.abc import Callable

from trabecula.core.directions import Directions
from trabecula.core.image import Image
from trabecula.fields.density import density_like
from trabecula.fields.directions import (
    continue_directions,
    direction_errors,
    direction_formula,
    fabric_directions,
    read_directions,
    resample_directions,
    smooth_directions,
)
from trabecula.fields.grid import formula, picture, radial, ramp
from trabecula.fields.interpolate import fill, interpolate, resample, rescale
from trabecula.fields.local import directions, measure, windowed
from trabecula.fields.property_law import PropertyLaw, fraction_for, property_law
from trabecula.fields.solver_result import import_result
from trabecula.fields.topology import (
    PrincipalStress,
    case,
    part_stress,
    principal_stress,
    simp,
)

# By their names in a recipe's step, so that it can be replayed.
FROM_AN_IMAGE: dict[str, Callable[..., Image]] = {
    "measure": measure,
    "density_like": density_like,
    "picture": picture,
    "resample": resample,
    "rescale": rescale,
    "fill": fill,
    "part_stress": part_stress,
    "fraction_for": fraction_for,
}
FROM_NOTHING: dict[str, Callable[..., Image]] = {
    "ramp": ramp,
    "radial": radial,
    "formula": formula,
    "interpolate": interpolate,
    "simp": simp,
    "import_result": import_result,
}

__all__ = [
    "FROM_AN_IMAGE",
    "FROM_NOTHING",
    "Directions",
    "PrincipalStress",
    "PropertyLaw",
    "case",
    "continue_directions",
    "density_like",
    "direction_errors",
    "direction_formula",
    "directions",
    "fabric_directions",
    "fill",
    "formula",
    "fraction_for",
    "import_result",
    "interpolate",
    "measure",
    "part_stress",
    "picture",
    "principal_stress",
    "property_law",
    "radial",
    "ramp",
    "read_directions",
    "resample",
    "resample_directions",
    "rescale",
    "simp",
    "smooth_directions",
    "windowed",
]
