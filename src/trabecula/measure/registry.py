"""Every descriptor of the package, declared once.

`describe`, the certificate, its page, the viewer and the documentation read this table: a new
descriptor is a function that measures it and one entry here. The order of the table is that of the
certificate.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from trabecula.core.image import Image
from trabecula.measure.components import components, floating, floating_voxels, largest_fraction
from trabecula.measure.contacts import contact
from trabecula.measure.copying import coherence, turned_copies
from trabecula.measure.correlation import (
    axis_preference,
    cross_correlation,
    lineal_path,
    two_point,
    two_point_cluster,
)
from trabecula.measure.curvatures import shape_index
from trabecula.measure.drainage import entry_radius
from trabecula.measure.fabric import anisotropy
from trabecula.measure.fractions import porosity, specific_surface, volume_fractions
from trabecula.measure.grey import autocorrelation, histogram, ten_bins
from trabecula.measure.local_fields import (
    LocalField,
    chord_field,
    curvature_field,
    euler_field,
    fraction_field,
    pore_size_field,
    surface_field,
    thickness_field,
)
from trabecula.measure.mechanics import stiffness
from trabecula.measure.minkowski import euler, euler_density, mean_curvature
from trabecula.measure.morphometry import morphometry
from trabecula.measure.network import coordination, throat_radius
from trabecula.measure.orientation import orientation
from trabecula.measure.percolation import percolates, percolating_fraction
from trabecula.measure.thickness import chord_length, pore_size, thickness
from trabecula.measure.transport import conductivity, diffusivity, permeability, tortuosity
from trabecula.measure.triple_lines import triple_phase_active_share, triple_phase_line_density

LEVELS = ("quick", "default", "full")
"""How much is measured; each level holds the ones before it."""

LABELS, TEXTURE, EVERY = ("labels",), ("grey", "colour"), ("labels", "grey", "colour")

# Rules of judgement
DISTANCE = "distance"
"""0 for the exemplar itself; passes up to the largest that a part of the exemplar would have."""
INSIDE = "inside"
"""Passes inside the band."""
AT_LEAST = "at least"
"""Passes above the lower end of the band."""
AT_MOST = "at most"
"""Passes below the upper end of the band."""
COUNT = "count"
"""Grows with the volume: the band is scaled to the image's; passes below its upper end."""
AXES = "axes"
"""One truth value an axis: fails along an axis where the exemplar's holds and the image's does not.
"""
SHOWN = "shown"
"""A distance with its band, and no verdict."""
REPORTED = "reported"
"""Neither band nor verdict."""

# Passes that measure several descriptors together
PLANES = "planes"
"""One pass over the planes, see `measure.streaming`."""
SIZES = "sizes"
"""Largest spheres and mean intercepts, which share their distances."""
CURVES = "curves"
"""Functions of the distance."""
PHYSICS = "physics"
"""The solvers of transport and stiffness, and the network of pores."""
PHASES = "phases"
"""Single phases, pairs and triples, which share components and configurations."""
GREYS = "greys"
"""Values as they are: `describe_texture`."""
JUDGED = "judged"
"""The certificate's comparison of an image with its exemplar."""

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
"""Groups of the certificate by name, with their titles."""


@dataclass(frozen=True, kw_only=True)
class Descriptor:
    """What a descriptor is called, how it is measured and how it is judged."""

    name: str
    """As scripts know it: a key of `describe` and of the certificate."""
    title: str
    group: str = ""
    """Of `GROUPS`; empty where the certificate does not show the descriptor."""
    meaning: str = ""
    """Definition in one sentence, for the documentation."""
    measure: Callable[..., Any] | None = None
    """Function of an image; takes `phase=` where `each` names phases."""
    field: Callable[..., LocalField] | None = None
    """Local field whose mean over the image it is, so that one scan gives an interval."""
    source: str = ""
    """Pass that measures it together with others; empty: `describe` calls `measure`."""
    kinds: tuple[str, ...] = LABELS
    """Kinds of image that have it."""
    level: str = "quick"
    """First of `LEVELS` at which it is measured."""
    rule: str = INSIDE
    power: int = 0
    """Power of the unit of length that the value has."""
    share: bool = False
    """A share of something: 1 at most."""
    of: str = ""
    """Phase that it is of where the name of a figure says none."""
    each: tuple[str, ...] = ()
    """Measured of every "phase", "pair" or "triple" of phases as well."""
    by_axis: bool = False
    """One value for each axis, by its name; the certificate adds their mean."""
    curve: bool = False
    """A function of the distance (then `measure` takes `r_max=`) or a histogram, not a number."""
    compares: str = ""
    """Curve of the certificate whose relative l2 distance to the exemplar's it is."""
    streams: bool = False
    """Measured of volumes that are read in slabs as well."""
    normalised: bool = False
    """Takes the density, or the mean value, out: long waves of the density do not move it."""
    fault: str = ""
    """"broken" or "uneven": what a material is where this figure fails."""
    key: bool = False
    """Shown beside a volume in the viewer."""
    in_slices: bool = True
    """Measured of slices of a volume; False where that of one slice is chance."""
    in_volume: bool = False
    """Reported of the whole volume beside its slices."""
    implied: bool = False
    """Of a volume judged by what slices imply, where they do."""
    worst: tuple[str, ...] = ()
    """Endings of the names for which the worst plane of slices counts: a mean over planes would
    hide one that is wrong."""
    by_plane: bool = False
    """Reported of each plane of slices as well."""

    @property
    def unit(self) -> str:
        """Return the power of the unit of length in words: "", "length", "1 / length^2"."""
        words = "length" if abs(self.power) == 1 else f"length^{abs(self.power)}"
        return "" if self.power == 0 else words if self.power > 0 else f"1 / {words}"

    def is_measured(self, level: str) -> bool:
        """Return whether a level measures the descriptor."""
        return LEVELS.index(self.level) <= LEVELS.index(level)


_amount = partial(Descriptor, group="amount")
_evenness = partial(Descriptor, group="evenness", kinds=EVERY, source=JUDGED, streams=True)
_distance = partial(Descriptor, source=JUDGED, rule=DISTANCE)
_curve = partial(Descriptor, curve=True)
_shape = partial(Descriptor, group="shape")
_connectivity = partial(Descriptor, group="connectivity")
_solid = partial(Descriptor, group="connectivity", of="the solid", source=PLANES, streams=True)
_physics = partial(
    Descriptor, group="physics", source=PHYSICS, level="full", by_axis=True, in_volume=True
)
_network = partial(
    Descriptor, group="connectivity", source=PHYSICS, level="full", in_slices=False, in_volume=True
)
_texture = partial(Descriptor, group="texture", kinds=TEXTURE, source=JUDGED)

_TABLE = (
    _distance(
        name="porosity_error", title="Porosity error, relative", group="amount", streams=True,
        key=True,
        meaning="Relative difference in porosity. Easy to match, and says little by itself.",
    ),
    _amount(
        name="porosity", title="Porosity", measure=porosity, source=PLANES, share=True,
        field=fraction_field, streams=True, key=True, by_plane=True,
        meaning="Share of the void.",
    ),
    Descriptor(
        name="fractions", title="Fractions", measure=volume_fractions, source=PLANES, share=True,
        streams=True,
        meaning="Share of every phase, by name.",
    ),
    _amount(
        name="fraction", title="Fraction", source=PHASES, share=True, each=("phase",), streams=True,
        field=fraction_field,
        meaning="Share of each phase, where there are more than two.",
    ),
    _evenness(
        name="fraction_spread", title="Local fraction, standard deviation", fault="uneven",
        meaning="Standard deviation of the local fraction over all windows of one size: small, "
        "medium or large.",
    ),
    _evenness(
        name="fraction_lowest", title="Local fraction, lowest", rule=AT_LEAST, fault="uneven",
        meaning="Smallest local fraction of all windows of one size.",
    ),
    _evenness(
        name="fraction_highest", title="Local fraction, highest", rule=AT_MOST, fault="uneven",
        meaning="Largest local fraction of all windows of one size.",
    ),
    _evenness(
        name="fraction_trend", title="Local fraction, change", fault="uneven",
        meaning="Change of a straight line fitted from face to face along an axis, and from the "
        "faces to the centre.",
    ),
    _evenness(
        name="fraction_hellinger", title="Local fraction, Hellinger distance", rule=REPORTED,
        meaning="Hellinger distance between the distributions of the local fraction over all "
        "windows of one size, 0 to 1, in tenths of the exemplar's windows. Hollow, graded and "
        "halved fakes that it sees fail by the figures above, and it misses some that they see: "
        "not judged.",
    ),
    _evenness(
        name="surface_spread", title="Local surface over its mean, standard deviation",
        meaning="As `fraction_spread`, of the interface area over its mean.",
    ),
    _evenness(
        name="surface_lowest", title="Local surface over its mean, lowest", rule=AT_LEAST,
        meaning="As `fraction_lowest`, of the interface area over its mean.",
    ),
    _evenness(
        name="surface_highest", title="Local surface over its mean, highest", rule=AT_MOST,
        meaning="As `fraction_highest`, of the interface area over its mean.",
    ),
    _evenness(
        name="surface_trend", title="Local surface over its mean, change",
        meaning="As `fraction_trend`, of the interface area over its mean.",
    ),
    _evenness(
        name="direction_spread", title="Local direction of the surface, standard deviation",
        meaning="Standard deviation, over windows, of the share of the interface that faces z, y "
        "and x.",
    ),
    _curve(
        name="two_point", title="Two-point function", measure=two_point, source=CURVES,
        each=("phase",), by_axis=True, streams=True,
        meaning="Probability S2(r) that both ends of a segment of length r lie in the solid; along "
        "each axis and radial.",
    ),
    _distance(
        name="two_point_distance", title="Two-point function, raw distance", group="two-point",
        streams=True, key=True,
        meaning="l2 norm of the difference of the radial S2 of the solid over r = 1 .. r_max.",
    ),
    _distance(
        name="two_point_relative", title="Two-point function, relative (D2 is 100 times this)",
        group="two-point", streams=True, key=True,
        meaning="`two_point_distance` over the norm of the exemplar's S2: the 2017 paper's figure; "
        "D2 of the 2021 paper is 100 times this.",
    ),
    _distance(
        name="two_point_covariance", title="Two-point function, covariance form", group="two-point",
        compares="two_point", streams=True, normalised=True, worst=("_y", "_x"), by_plane=True,
        meaning="Relative l2 of (S2 - phi^2) / (phi - phi^2), which takes porosity out: the "
        "strictest of the three. Along each axis it finds lost anisotropy.",
    ),
    _curve(
        name="cross_correlation", title="Cross-correlation", measure=cross_correlation,
        source=PHASES, each=("pair",),
        meaning="Probability that the ends of a segment of length r lie in two different phases.",
    ),
    _distance(
        name="cross_correlation_distance", title="Cross-correlation, relative", group="two-point",
        level="default", compares="cross",
        meaning="Relative l2 of the cross-correlation of two phases, where there are more than "
        "two.",
    ),
    Descriptor(
        name="axis_preference", title="Covariance, axes against diagonals", group="two-point",
        measure=axis_preference, source=JUDGED, rule=AT_MOST, normalised=True, worst=("",),
        meaning="Of slices held against a picture: relative l2 by which the covariance along the "
        "axes differs from that along the diagonals, over three correlation lengths; rods along "
        "the axes raise it. Only too much fails.",
    ),
    Descriptor(
        name="axes_apart", title="Interface crossings, axes apart", group="two-point",
        source=JUDGED, rule=AT_MOST, normalised=True,
        meaning="Of a volume held against one picture of all planes: largest difference between "
        "the axes in how often lines along them cross the interface, over the mean.",
    ),
    Descriptor(
        name="oblique_covariance", title="Covariance, body diagonals against slices",
        group="two-point", source=JUDGED, rule=AT_MOST, normalised=True,
        meaning="Of a volume held against one picture of all planes: relative l2 by which the "
        "covariance along the body diagonals, which lie in no slice along the axes, differs from "
        "the radial one of the slices, over three correlation lengths. Only too much fails.",
    ),
    _curve(
        name="two_point_cluster", title="Two-point cluster function", measure=two_point_cluster,
        source=CURVES, level="default",
        meaning="Probability that both ends of a segment of length r lie in one connected "
        "component of the solid.",
    ),
    _curve(
        name="lineal_path", title="Lineal path", measure=lineal_path, source=CURVES,
        each=("phase",), streams=True,
        meaning="Probability that a segment of length r lies wholly in the solid.",
    ),
    _distance(
        name="lineal_path_distance", title="Lineal path, relative", group="shape", of="the solid",
        compares="lineal_path", streams=True, worst=("_y", "_x", "_void_y", "_void_x"),
        meaning="Relative l2 of the lineal path, which feels how far the solid reaches without a "
        "break; with `_void` that of the pores, with `_z` along an axis.",
    ),
    _shape(
        name="specific_surface", title="Specific surface", measure=specific_surface, source=PLANES,
        power=-1, field=surface_field, each=("phase",), streams=True, key=True, implied=True,
        meaning="Area of the interface per volume; with `_z` twice the crossings of lines along z "
        "per length, which is the same in isotropic material.",
    ),
    _shape(
        name="contact", title="Contact area per volume", measure=contact, source=PHASES,
        power=-1, each=("pair",), streams=True,
        meaning="Area per volume where two phases touch.",
    ),
    _shape(
        name="triple_line_density", title="Triple-phase line per volume",
        measure=triple_phase_line_density, source=PHASES, power=-2,
        each=("triple",),
        meaning="Length per volume of the lines where three phases meet.",
    ),
    Descriptor(
        name="cell_area", title="Cells of slices, mean area", group="shape", source=JUDGED,
        rule=INSIDE, power=2,
        meaning="Of a volume held against a picture of closed boundaries: the mean area of a cell "
        "in its slices (`plane_cells`), its share of the boundaries included.",
    ),
    Descriptor(
        name="cell_area_variation", title="Cells of slices, variation of area", group="shape",
        source=JUDGED, rule=INSIDE, normalised=True,
        meaning="As `cell_area`: the standard deviation of the area over its mean.",
    ),
    Descriptor(
        name="cell_neighbours", title="Cells of slices, neighbours", group="shape", source=JUDGED,
        rule=INSIDE, normalised=True,
        meaning="As `cell_area`: the mean number of cells that a cell shares a line with, near 6 "
        "where three meet in every point.",
    ),
    Descriptor(
        name="cell_triple_points", title="Cells of slices, triple points", group="shape",
        source=JUDGED, rule=INSIDE, power=-2,
        meaning="As `cell_area`: points where three cells meet, per area.",
    ),
    Descriptor(
        name="cell_boundary_length", title="Cells of slices, boundary length", group="shape",
        source=JUDGED, rule=INSIDE, power=-1,
        meaning="As `cell_area`: length of the lines between cells, per area.",
    ),
    _connectivity(
        name="triple_line_active", title="Triple-phase line, active share",
        measure=triple_phase_active_share, source=PHASES, share=True,
        each=("triple",),
        meaning="Share of the triple-phase lines whose three phases all percolate there.",
    ),
    _shape(
        name="mean_curvature", title="Mean curvature, integral per volume", measure=mean_curvature,
        source=PLANES, power=-2,
        field=curvature_field, each=("phase",), streams=True,
        meaning="Integral of the mean curvature per volume; specks and rough surfaces raise it.",
    ),
    _curve(
        name="shape_index", title="Shape index of the interface", measure=shape_index,
        source=CURVES, level="default", each=("phase",), in_slices=False,
        meaning="Share of the interface by its shape, 17 bins around -1 (a round pore), -7/8, .. 1 "
        "(a ball); -1/2 is a channel, 0 a saddle, 1/2 a rod. 3-D.",
    ),
    _distance(
        name="shape_index_distance", title="Shape index of the interface, relative", group="shape",
        level="default", compares="shape_index", in_slices=False,
        meaning="Relative l2 of the distribution of the shape index: straight fibres that came out "
        "as knots, or grains as lumps, differ here though sizes agree.",
    ),
    _shape(
        name="chord_length", title="Chord length", measure=chord_length, source=PLANES, power=1,
        field=chord_field,
        of="the solid", each=("phase",), streams=True,
        meaning="Mean length of the chords that lines cut out of the solid, over all axes and "
        "along each.",
    ),
    _shape(
        name="thickness", title="Thickness", measure=thickness, source=SIZES, level="default",
        power=1, streams=True, field=thickness_field, of="the solid", each=("phase",), key=True,
        in_volume=True,
        meaning="Mean diameter of the largest spheres in the solid.",
    ),
    _shape(
        name="pore_size", title="Pore size", measure=pore_size, source=SIZES, level="default",
        power=1, streams=True, field=pore_size_field, key=True, in_volume=True,
        meaning="Mean diameter of the largest spheres in the void.",
    ),
    Descriptor(
        name="morphometry", title="Bone morphometry", measure=morphometry, source=SIZES,
        level="default",
        meaning="Figures of a solid by the names of bone histomorphometry (Tb.Th, Tb.Sp, Tb.N, "
        "...). 3-D.",
    ),
    _shape(
        name="trabecular_number", title="Trabecular number (Tb.N)", source=SIZES, level="default",
        power=-1,
        meaning="One over the mean distance between the mid-axes of the solid: Tb.N of "
        "`morphometry`. 3-D.",
    ),
    _shape(
        name="anisotropy", title="Degree of anisotropy", measure=anisotropy, source=SIZES,
        level="default", share=True, normalised=True, key=True, in_volume=True,
        meaning="Degree of anisotropy of the mean intercept lengths, 0 to 1.",
    ),
    _distance(
        name="two_point_cluster_distance", title="Two-point cluster function, relative",
        group="connectivity", level="default", compares="two_point_cluster",
        meaning="Relative l2 of the two-point cluster function: both points in the same component.",
    ),
    # One component where the exemplar has specks is far from it, and better: not judged.
    _connectivity(
        name="component_distance", title="Component sizes, Wasserstein distance", source=JUDGED,
        rule=SHOWN, streams=True,
        meaning="Wasserstein distance between the distributions of component sizes. A connected "
        "result is far from a scan with specks, and one in hundreds of specks may be near it: it "
        "is shown with its band and not judged.",
    ),
    _solid(
        name="components", title="Components", measure=components, rule=COUNT, each=("phase",),
        fault="broken", in_volume=True,
        meaning="Connected components of the solid, scaled to the volume. Only more than the band "
        "fails: fewer loose parts than the scan has are no fault.",
    ),
    _solid(
        name="floating", title="Floating parts", measure=floating, rule=COUNT, each=("phase",),
        fault="broken", key=True, in_volume=True,
        meaning="Components of the solid besides the largest, scaled to the volume.",
    ),
    _solid(
        name="floating_voxels", title="Floating parts, voxels", measure=floating_voxels, rule=COUNT,
        each=("phase",), fault="broken", in_volume=True,
        meaning="Voxels of the floating parts, scaled to the volume.",
    ),
    _solid(
        name="largest_fraction", title="Largest component, share", measure=largest_fraction,
        rule=AT_LEAST, share=True, each=("phase",), fault="broken", key=True, in_volume=True,
        implied=True,
        meaning="Share of the solid in its largest component. Only less than the band fails.",
    ),
    _solid(
        name="percolating_fraction", title="Share that spans the image",
        measure=percolating_fraction, rule=AT_LEAST, share=True, each=("phase",), by_axis=True,
        fault="broken", in_volume=True,
        meaning="Share of the solid in components that join opposite faces, mean of the axes. Only "
        "less than the band fails.",
    ),
    _solid(
        name="percolates", title="Percolates", measure=percolates, rule=AXES, each=("phase",),
        by_axis=True, fault="broken", in_slices=False, in_volume=True, implied=True,
        meaning="Fails along an axis where the exemplar is connected from face to face and the "
        "result is not.",
    ),
    _solid(
        name="euler_density", title="Euler number per volume", measure=euler_density, power=-3,
        field=euler_field,
        each=("phase",), key=True, in_volume=True,
        meaning="Euler number per volume, free of what the faces cut.",
    ),
    Descriptor(
        name="disector_euler_density", title="Euler number per volume, by sections",
        group="shape", source=JUDGED, power=-3, of="the solid",
        meaning="Of a volume held against parallel sections: Euler number per volume from pairs of "
        "sections, `gap` apart, and from pairs of the volume's slices along all axes.",
    ),
    _connectivity(
        name="euler", title="Euler number of the image as cut", measure=euler, source=PLANES,
        rule=REPORTED, streams=True, in_slices=False, in_volume=True,
        meaning="Euler number of the whole image, for information: it grows with the volume and is "
        "not judged.",
    ),
    _physics(
        name="diffusivity", title="Effective diffusivity of the void", measure=diffusivity,
        share=True,
        meaning="Effective diffusivity of the void, relative to free diffusion.",
    ),
    Descriptor(
        name="tortuosity", title="Tortuosity of the void", measure=tortuosity, source=PHYSICS,
        level="full", by_axis=True,
        meaning="Porosity over the effective diffusivity; infinite where the void does not span "
        "the image.",
    ),
    _physics(
        name="conductivity", title="Effective conductivity of the solid", measure=conductivity,
        share=True,
        meaning="Effective conductivity of the solid, relative to the solid's own.",
    ),
    _physics(
        name="permeability", title="Permeability of the void", measure=permeability, power=2,
        key=True,
        meaning="Permeability of the void, in the square of the unit.",
    ),
    _physics(
        name="stiffness", title="Young's modulus over the solid's own", measure=stiffness,
        share=True, key=True,
        meaning="Apparent Young's modulus over the solid's own.",
    ),
    _physics(
        name="entry_radius", title="Drainage: radius at breakthrough", measure=entry_radius,
        power=1,
        meaning="Radius of the largest ball that passes through the void from end to end: where a "
        "non-wetting fluid breaks through.",
    ),
    _network(
        name="coordination", title="Coordination of pores", measure=coordination,
        meaning="Mean number of throats of a pore, of pores that no face of the image cuts.",
    ),
    _network(
        name="throat_radius", title="Throat radius", measure=throat_radius, power=1, of="the void",
        meaning="Mean radius of the largest balls centred on the throats between pores.",
    ),
    Descriptor(
        name="physics", title="Convergence of the solvers", source=PHYSICS, level="full",
        meaning="For each solver: convergence, imbalance of the flux, and what halving the voxel "
        "changes.",
    ),
    _texture(
        name="texture_preference", title="Autocorrelation, axes against diagonals", rule=AT_MOST,
        normalised=True, worst=("",),
        meaning="As `axis_preference`, of the autocorrelation.",
    ),
    _texture(
        name="mean", title="Mean value", source=GREYS, by_plane=True,
        meaning="Mean of the grey values, or of a colour's luminance.",
    ),
    _texture(
        name="standard_deviation", title="Standard deviation", source=GREYS,
        meaning="Standard deviation of the grey values, or of a colour's luminance.",
    ),
    _texture(
        name="histogram_divergence", title="Histogram, Kullback-Leibler divergence", rule=DISTANCE,
        by_plane=True,
        meaning="Kullback-Leibler divergence of the histograms, 64 bins over the exemplar's range.",
    ),
    _texture(
        name="ten_bins_distance", title="Histogram in ten bins, largest difference", rule=DISTANCE,
        meaning="Largest difference in the ten bins of the 2017 paper; bytes only.",
    ),
    _texture(
        name="autocorrelation_distance", title="Autocorrelation, relative", rule=DISTANCE,
        normalised=True, worst=("",),
        meaning="Relative l2 of the autocorrelation, of the worst axis, up to 32 voxels.",
    ),
    _texture(
        name="orientation_divergence", title="Local orientations, Kullback-Leibler divergence",
        rule=DISTANCE, normalised=True,
        meaning="Kullback-Leibler divergence of the histograms of local orientation.",
    ),
    _curve(
        name="histogram", title="Histogram", measure=histogram, source=GREYS, kinds=TEXTURE,
        meaning="Share of the voxels in every bin of values, 256 bins; of a colour image one "
        "histogram a channel.",
    ),
    _curve(
        name="ten_bins", title="Histogram in ten bins", measure=ten_bins, source=GREYS,
        kinds=TEXTURE,
        meaning="Histogram of the 2017 paper: bins of 25 levels; bytes only.",
    ),
    _curve(
        name="autocorrelation", title="Autocorrelation", measure=autocorrelation, source=GREYS,
        kinds=TEXTURE, by_axis=True,
        meaning="Autocorrelation of the grey value along each axis, lag 0 first.",
    ),
    _curve(
        name="orientation", title="Local orientations", measure=orientation, source=GREYS,
        kinds=TEXTURE,
        meaning="Histogram of the local orientation, the direction of least change.",
    ),
    Descriptor(
        name="coherence", title="Coherence over 4 voxels (1: copied)", group="copying",
        measure=coherence, source=JUDGED, level="default", rule=AT_MOST, share=True, key=True,
        meaning="Share of voxels whose source in the exemplar moves along over 4 voxels: near 1 in "
        "a copy.",
    ),
    Descriptor(
        name="turned_copies", title="Copies mirrored or turned (1: all)", group="copying",
        measure=turned_copies, source=JUDGED, level="default", rule=AT_MOST, share=True,
        meaning="Share of voxels whose neighbourhood recurs in the exemplar mirrored or turned, in "
        "any of the other 47 symmetries of the cube (7 of the square); of those whose own source "
        "differs most.",
    ),
)  # fmt: skip

DESCRIPTORS: dict[str, Descriptor] = {descriptor.name: descriptor for descriptor in _TABLE}
"""Every descriptor by its name, in the order of the certificate."""


def select(
    *, source: str | None = None, each: str | None = None, kind: str | None = None
) -> list[Descriptor]:
    """Select descriptors, in the order of the table.

    Parameters
    ----------
    source : str, optional
        Only those of this pass ("" for those that `describe` measures one by one).
    each : {"phase", "pair", "triple"}, optional
        Only those that are measured of each.
    kind : {"labels", "grey", "colour"}, optional
        Only those of this kind of image.
    """
    return [
        one
        for one in DESCRIPTORS.values()
        if (source is None or one.source == source)
        and (each is None or each in one.each)
        and (kind is None or kind in one.kinds)
    ]


def measure_one_by_one(
    image: Image, *, level: str, each: str | None = None, curve: bool = False, **options: Any
) -> dict[str, Any]:
    """Measure the descriptors of an image that belong to no pass; None above the level.

    Parameters
    ----------
    image : Image
    level : str
        One of `LEVELS`.
    each : {"phase"}, optional
        Only those that are measured of each phase.
    curve : bool
        Measure curves, else numbers.
    **options
        For every function: `phase`; of curves `r_max`.
    """
    return {
        one.name: one.measure(image, **options) if one.is_measured(level) else None
        for one in select(source="", each=each, kind=image.kind)
        if one.measure is not None and one.curve == curve
    }
