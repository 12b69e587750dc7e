"""Image -> numbers. Every measure is a pure function of an Image, or of an array of labels;
`__all__` is the whole of it for other rooms.
"""

# Imported plainly, not lazily: several functions bear their module's name, and whichever of the two
# is set last wins.
from trabecula.measure.blockwise import describe_slabs
from trabecula.measure.bodies import Bodies, bodies
from trabecula.measure.bone import bone_figures, structure_model_index
from trabecula.measure.coating import Coating, coating
from trabecula.measure.components import (
    component_distance,
    component_sizes,
    components,
    floating,
    floating_voxels,
    label_components,
    largest_fraction,
    size_distribution,
)
from trabecula.measure.confidence import Interval, confidence
from trabecula.measure.contacts import contact, contacts
from trabecula.measure.copying import (
    TurnedCopies,
    coherence,
    coherent_patches,
    diversity,
    sources,
    turned_copies,
)
from trabecula.measure.correlation import (
    axis_preference,
    correlation_length,
    covariance_form,
    cross_correlation,
    lineal_path,
    two_point,
    two_point_cluster,
)
from trabecula.measure.curvatures import Curvatures, curvatures, shape_index
from trabecula.measure.describe import describe, describe_texture
from trabecula.measure.disector import disector_along, disector_euler_density
from trabecula.measure.displacement import Displacement
from trabecula.measure.distance import distance_transform, signed_distance
from trabecula.measure.drainage import drainage, entry_radius
from trabecula.measure.each_phase import describe_phases
from trabecula.measure.effective_properties import describe_network, describe_physics
from trabecula.measure.evenness import Evenness, evenness
from trabecula.measure.fabric import anisotropy, fabric
from trabecula.measure.fractions import porosity, specific_surface, volume_fractions
from trabecula.measure.grey import autocorrelation, histogram, kullback_leibler, ten_bins
from trabecula.measure.imbibition import imbibition
from trabecula.measure.mean_variance import SpatialCovariance, variance_of_means
from trabecula.measure.mechanics import Stiffness, stiffness
from trabecula.measure.minkowski import Minkowski, euler, euler_density, mean_curvature, minkowski
from trabecula.measure.morphometry import connectivity_density, morphometry
from trabecula.measure.network import (
    PoreNetwork,
    Throats,
    coordination,
    network,
    throat_radius,
)
from trabecula.measure.orientation import orientation, structure_tensor
from trabecula.measure.percolation import percolates, percolating_fraction
from trabecula.measure.phase_lists import phase_curves, phase_numbers
from trabecula.measure.plane_cells import PlaneCells, plane_cells
from trabecula.measure.plates import PlatesAndRods, plates_and_rods
from trabecula.measure.properties import measure_property
from trabecula.measure.relative_permeability import (
    RelativePermeability,
    relative_permeability,
)
from trabecula.measure.skeleton import SkeletonGraph, skeleton_graph, thin
from trabecula.measure.thickness import chord_length, local_thickness, pore_size, thickness
from trabecula.measure.transport import (
    Effective,
    conductivity,
    diffusivity,
    permeability,
    streamlines,
    tortuosity,
)
from trabecula.measure.triple_lines import (
    TripleLine,
    triple_phase_active_share,
    triple_phase_line_density,
    triple_phase_lines,
)

__all__ = [
    "Bodies",
    "Coating",
    "Curvatures",
    "Displacement",
    "Effective",
    "Evenness",
    "Interval",
    "Minkowski",
    "PlaneCells",
    "PlatesAndRods",
    "PoreNetwork",
    "RelativePermeability",
    "SkeletonGraph",
    "SpatialCovariance",
    "Stiffness",
    "Throats",
    "TripleLine",
    "TurnedCopies",
    "anisotropy",
    "autocorrelation",
    "axis_preference",
    "bodies",
    "bone_figures",
    "chord_length",
    "coating",
    "coherence",
    "coherent_patches",
    "component_distance",
    "component_sizes",
    "components",
    "conductivity",
    "confidence",
    "connectivity_density",
    "contact",
    "contacts",
    "coordination",
    "correlation_length",
    "covariance_form",
    "cross_correlation",
    "curvatures",
    "describe",
    "describe_network",
    "describe_phases",
    "describe_physics",
    "describe_slabs",
    "describe_texture",
    "diffusivity",
    "disector_along",
    "disector_euler_density",
    "distance_transform",
    "diversity",
    "drainage",
    "entry_radius",
    "euler",
    "euler_density",
    "evenness",
    "fabric",
    "floating",
    "floating_voxels",
    "histogram",
    "imbibition",
    "kullback_leibler",
    "label_components",
    "largest_fraction",
    "lineal_path",
    "local_thickness",
    "mean_curvature",
    "measure_property",
    "minkowski",
    "morphometry",
    "network",
    "orientation",
    "percolates",
    "percolating_fraction",
    "permeability",
    "phase_curves",
    "phase_numbers",
    "plane_cells",
    "plates_and_rods",
    "pore_size",
    "porosity",
    "relative_permeability",
    "shape_index",
    "signed_distance",
    "size_distribution",
    "skeleton_graph",
    "sources",
    "specific_surface",
    "stiffness",
    "streamlines",
    "structure_model_index",
    "structure_tensor",
    "ten_bins",
    "thickness",
    "thin",
    "throat_radius",
    "tortuosity",
    "triple_phase_active_share",
    "triple_phase_line_density",
    "triple_phase_lines",
    "turned_copies",
    "two_point",
    "two_point_cluster",
    "variance_of_means",
    "volume_fractions",
]
