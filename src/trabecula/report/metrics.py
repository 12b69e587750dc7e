"""What the certificate judges: every figure with its title, its group, its unit and the rule that
it is judged by.
"""

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
"""One truth value an axis: fails along an axis where the exemplar's holds and the image's does not.
"""
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
    of: str = ""
    """Phase that the figure is of where its name says none."""


GROUPS = {
    "amount": "Amount",
    "evenness": "Evenness in space",
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
    Figure("fraction_spread", "Local fraction, standard deviation", "evenness"),
    Figure("fraction_lowest", "Local fraction, lowest", "evenness", AT_LEAST),
    Figure("fraction_highest", "Local fraction, highest", "evenness", AT_MOST),
    Figure("fraction_trend", "Local fraction, change", "evenness"),
    Figure("surface_spread", "Local surface over its mean, standard deviation", "evenness"),
    Figure("surface_lowest", "Local surface over its mean, lowest", "evenness", AT_LEAST),
    Figure("surface_highest", "Local surface over its mean, highest", "evenness", AT_MOST),
    Figure("surface_trend", "Local surface over its mean, change", "evenness"),
    Figure("direction_spread", "Local direction of the surface, standard deviation", "evenness"),
    Figure("two_point_distance", "Two-point function, raw distance", "two-point", DISTANCE),
    Figure(
        "two_point_relative",
        "Two-point function, relative (D2 is 100 times this)",
        "two-point",
        DISTANCE,
    ),
    Figure("two_point_covariance", "Two-point function, covariance form", "two-point", DISTANCE),
    Figure("cross_correlation_distance", "Cross-correlation, relative", "two-point", DISTANCE),
    Figure("axis_preference", "Covariance, axes against diagonals", "two-point", AT_MOST),
    Figure("lineal_path_distance", "Lineal path, relative", "shape", DISTANCE, of="the solid"),
    Figure("specific_surface", "Specific surface", "shape", power=-1),
    Figure("contact", "Contact area per volume", "shape", power=-1),
    Figure("triple_line_density", "Triple-phase line per volume", "shape", power=-2),
    Figure("triple_line_active", "Triple-phase line, active share", "connectivity", share=True),
    Figure("mean_curvature", "Mean curvature, integral per volume", "shape", power=-2),
    Figure("chord_length", "Chord length", "shape", power=1, of="the solid"),
    Figure("thickness", "Thickness", "shape", power=1, of="the solid"),
    Figure("pore_size", "Pore size", "shape", power=1),
    Figure("trabecular_number", "Trabecular number (Tb.N)", "shape", power=-1),
    Figure("anisotropy", "Degree of anisotropy", "shape", share=True),
    Figure(
        "two_point_cluster_distance",
        "Two-point cluster function, relative",
        "connectivity",
        DISTANCE,
    ),
    # One piece where the exemplar has specks is far from it, and better: so this one is not judged.
    Figure("component_distance", "Component sizes, Wasserstein distance", "connectivity", SHOWN),
    Figure("components", "Components", "connectivity", COUNT, of="the solid"),
    Figure("floating", "Floating parts", "connectivity", COUNT, of="the solid"),
    Figure("floating_voxels", "Floating parts, voxels", "connectivity", COUNT, of="the solid"),
    Figure(
        "largest_fraction",
        "Largest component, share",
        "connectivity",
        AT_LEAST,
        share=True,
        of="the solid",
    ),
    Figure(
        "percolating_fraction",
        "Share that spans the image",
        "connectivity",
        AT_LEAST,
        share=True,
        of="the solid",
    ),
    Figure("percolates", "Percolates", "connectivity", AXES, of="the solid"),
    Figure("euler_density", "Euler number per volume", "connectivity", power=-3, of="the solid"),
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
    Figure(
        "orientation_divergence",
        "Local orientations, Kullback-Leibler divergence",
        "texture",
        DISTANCE,
    ),
    Figure("coherence", "Coherence over 4 voxels (1: copied)", "copying", AT_MOST, share=True),
)
_PLACE = {figure.name: place for place, figure in enumerate(FIGURES)}


VOLUME = "3d"
"""Suffix of what is told of a volume whose exemplar is a picture."""

_OF_PHASES = ("fraction", "contact", "cross_correlation_distance")
_SIZES = ("small", "medium", "large")
_AXES = {"z": "along z", "y": "along y", "x": "along x", "centre": "from the faces to the centre"}


def figure_of(name: str) -> Figure:
    """Return the figure of a name with or without a suffix.

    Suffixes are an axis (`diffusivity_z`), a phase (`fraction_binder`), a window's size
    (`fraction_spread_large`), a pair of phases (`contact_active_binder`), planes
    (`porosity_yx_zx`), the volume beside a picture (`components_3d`), and these one after another.
    """
    stem, suffix = _split(name)
    figure = FIGURES[_PLACE[stem]]
    if stem in _OF_PHASES:  # any word may be the name of a phase
        return replace(figure, name=name, title=f"{figure.title} of {suffix}") if suffix else figure
    words = suffix.split("_") if suffix else []
    volume, words = (True, words[1:]) if words[:1] == [VOLUME] else (False, words)
    size, words = (words[0], words[1:]) if words and words[0] in _SIZES else ("", words)
    axis = next((word for word in (*words[:1], *words[-1:]) if word in _AXES), "")
    if axis:
        words = words[1:] if words[0] == axis else words[:-1]
    planes = [word for word in words if len(word) == 2 and set(word) < set("zyx")]
    phase = "_".join(word for word in words if word not in planes)
    of = phase or figure.of
    title = figure.title + (f", {size} windows" if size else "") + (f" of {of}" if of else "")
    title += f" {_AXES[axis]}" if axis else ""
    title += f" in {' and '.join(planes)}" if planes else ""
    if volume:
        return replace(figure, name=name, title=f"{title}, in 3-D", rule=TOLD)
    return replace(figure, name=name, title=title)


def stem_of(name: str) -> str:
    """The name of a figure without its suffix."""
    return _split(name)[0]


def in_order(names: Iterable[str]) -> list[str]:
    """Names in the order of the table; those of axes and phases follow their figure, in the order
    given.
    """
    return sorted(names, key=lambda name: _PLACE[_split(name)[0]])


def _split(name: str) -> tuple[str, str]:
    stem = max(
        (known for known in _PLACE if name == known or name.startswith(f"{known}_")), key=len
    )
    return stem, name[len(stem) + 1 :]
