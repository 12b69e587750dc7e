"""What the certificate judges: every figure with its title, its group, its unit and the rule that it is judged by."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

DISTANCE = "distance"
"""0 for the exemplar itself; passes up to the largest that a part of the exemplar would have."""
INSIDE = "inside"
"""Passes inside the band."""
AT_LEAST = "at least"
AT_MOST = "at most"
COUNT = "count"
"""Grows with the volume: the band is scaled to the image's; passes below its upper end."""
AXES = "axes"
"""One truth value an axis: fails along an axis where the exemplar's holds and the image's does not."""
SHOWN = "shown"
"""A distance with its band, and no verdict."""
TOLD = "told"
"""Neither band nor verdict."""


@dataclass(frozen=True)
class Figure:
    """One figure of the certificate."""

    name: str
    """As scripts know it."""
    title: str
    group: str
    rule: str = INSIDE
    power: int = 0
    """Of the unit of length."""
    share: bool = False
    """Of something: 1 at most."""


GROUPS = {
    "amount": "Amount",
    "two-point": "Two-point function",
    "shape": "Sizes and shape",
    "connectivity": "Connectivity",
    "physics": "Transport and stiffness",
    "texture": "Grey values and texture",
    "copying": "Novelty (copying)",
}

FIGURES = (
    Figure("porosity_error", "Porosity error, relative", "amount", DISTANCE),
    Figure("porosity", "Porosity", "amount", share=True),
    Figure("fraction", "Fraction", "amount", share=True),
    Figure("two_point_distance", "Two-point function, raw distance", "two-point", DISTANCE),
    Figure("two_point_relative", "Two-point function, relative", "two-point", DISTANCE),
    Figure("two_point_covariance", "Two-point function, covariance form", "two-point", DISTANCE),
    Figure("two_point_axial", "Two-point function, covariance form, worst axis", "two-point", DISTANCE),
    Figure("axis_preference", "Covariance, axes against diagonals", "two-point", AT_MOST),
    Figure("lineal_path_distance", "Lineal path, relative", "shape", DISTANCE),
    Figure("specific_surface", "Specific surface", "shape", power=-1),
    Figure("mean_curvature", "Mean curvature, integral per volume", "shape", power=-2),
    Figure("chord_length", "Chord length of the solid", "shape", power=1),
    Figure("thickness", "Thickness of the solid", "shape", power=1),
    Figure("pore_size", "Pore size", "shape", power=1),
    Figure("trabecular_number", "Trabecular number (Tb.N)", "shape", power=-1),
    Figure("anisotropy", "Degree of anisotropy", "shape", share=True),
    Figure("two_point_cluster_distance", "Two-point cluster function, relative", "connectivity", DISTANCE),
    # One piece where the exemplar has specks is far from it, and better: so this one is not judged.
    Figure("component_distance", "Component sizes, Wasserstein distance", "connectivity", SHOWN),
    Figure("components", "Components", "connectivity", COUNT),
    Figure("floating", "Floating parts", "connectivity", COUNT),
    Figure("floating_voxels", "Floating parts, voxels", "connectivity", COUNT),
    Figure("largest_fraction", "Largest component, share of the solid", "connectivity", AT_LEAST, share=True),
    Figure("percolating_fraction", "Share of the solid that spans the image", "connectivity", AT_LEAST, share=True),
    Figure("percolates", "Percolates along", "connectivity", AXES),
    Figure("euler_density", "Euler number per volume", "connectivity", power=-3),
    Figure("euler", "Euler number of the image as cut", "connectivity", TOLD),
    Figure("diffusivity", "Effective diffusivity of the void", "physics", share=True),
    Figure("conductivity", "Effective conductivity of the solid", "physics", share=True),
    Figure("permeability", "Permeability of the void", "physics", power=2),
    Figure("stiffness", "Young's modulus over the solid's own", "physics", share=True),
    Figure("texture_preference", "Autocorrelation, axes against diagonals", "texture", AT_MOST),
    Figure("mean", "Mean value", "texture"),
    Figure("standard_deviation", "Standard deviation", "texture"),
    Figure("histogram_divergence", "Histogram, Kullback-Leibler divergence", "texture", DISTANCE),
    Figure("ten_bins_distance", "Histogram in ten bins, largest difference", "texture", DISTANCE),
    Figure("autocorrelation_distance", "Autocorrelation, relative", "texture", DISTANCE),
    Figure("orientation_divergence", "Local orientations, Kullback-Leibler divergence", "texture", DISTANCE),
    Figure("coherence", "Coherence over 4 voxels (1: copied)", "copying", AT_MOST, share=True),
)
_PLACE = {figure.name: place for place, figure in enumerate(FIGURES)}


VOLUME = "3d"
"""Suffix of what is told of a volume whose exemplar is a picture."""


def figure_of(name: str) -> Figure:
    """The figure of a name, or of one with a suffix: of an axis (`diffusivity_z`), of a phase (`fraction_binder`), of planes
    (`porosity_yx_zx`), of the volume beside a picture (`components_3d`)."""
    stem, suffix = _split(name)
    figure = FIGURES[_PLACE[stem]]
    if not suffix:
        return figure
    if stem == "fraction":  # any word may be the name of a phase
        return replace(figure, name=name, title=f"{figure.title}, of {suffix}")
    first, *others = suffix.split("_")
    if first == VOLUME:
        what = "".join(f", {_joint(part)}" for part in others)
        return replace(figure, name=name, title=f"{figure.title}, in 3-D{what}", rule=TOLD)
    title = figure.title + "".join(f"{' and' if n else ','} {_joint(part)}" for n, part in enumerate((first, *others)))
    return replace(figure, name=name, title=title)


def _joint(part: str) -> str:
    if part in ("z", "y", "x"):
        return f"along {part}"
    return f"in {part}" if len(part) == 2 and set(part) < set("zyx") else f"of {part}"


def stem_of(name: str) -> str:
    """The name of a figure without its suffix."""
    return _split(name)[0]


def in_order(names: Iterable[str]) -> list[str]:
    """Names in the order of the table; those of axes and phases follow their figure, in the order given."""
    return sorted(names, key=lambda name: _PLACE[_split(name)[0]])


def _split(name: str) -> tuple[str, str]:
    stem = max((known for known in _PLACE if name == known or name.startswith(f"{known}_")), key=len)
    return stem, name[len(stem) + 1 :]
