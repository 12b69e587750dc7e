"""`bone_figures`: what a micro-CT report of trabecular bone holds, all of it.

Bouxsein et al. 2010 (doi:10.1002/jbmr.141) list the figures that a report should give at the least;
`morphometry` has the ones that most are after.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.engine.compile import kernel
from trabecula.engine.parallel import for_slabs
from trabecula.measure.curvatures import derivatives
from trabecula.measure.fabric import fabric
from trabecula.measure.minkowski import minkowski
from trabecula.measure.morphometry import MORPHOMETRY_POWERS, morphometry
from trabecula.measure.phases import as_mask, as_periodic, indicator, indicator_in_mask
from trabecula.measure.plates import plates_and_rods
from trabecula.measure.smooth import gaussian, reach_of
from trabecula.measure.thickness import sphere_diameters

_SIGMA = 1.0  # of the smoothing, in voxels

BONE_POWERS = {
    "TV": 3,
    "BV": 3,
    "BS": 2,
    "BV/TV": 0,
    "BS/TV": -1,
    "BS/BV": -1,
    "Tb.N": -1,
    "Tb.Th": 1,
    "Tb.Th.SD": 1,
    "Tb.Sp": 1,
    "Tb.Sp.SD": 1,
    "Conn.D": -3,
    "SMI": 0,
    "DA": 0,
    "MIL.ratio": 0,
    "pBV/BV": 0,
    "rBV/BV": 0,
    "EF": 0,
    "EF.SD": 0,
}
"""The power of the image's unit of length that each value of `bone_figures` has."""


def structure_model_index(
    image: Image | ArrayLike,
    *,
    phase: str | int | None = None,
    mask: ArrayLike | None = None,
    periodic: bool | Sequence[bool] = False,
) -> float | None:
    """Return the structure model index SMI of a phase: 0 for plates, 3 for rods, 4 for balls.

    Hildebrand and Ruegsegger 1997 (doi:10.1080/01495739708936692): 6 S' V / S^2, where S' is the
    change of the surface with its thickening, twice the integral of its mean curvature. That is
    taken from the levels of the phase smoothed over one voxel, which no direction biases; volume
    and surface are those of `minkowski`.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X)
    phase : str or int, optional
        Default: "solid", which is every phase but "void".
    mask, periodic
        As for `morphometry`.

    Returns
    -------
    index : float or None
        None without any surface. Below 0 where the surface is concave on the mean, as in dense
        bone: the index depends on BV/TV more than on plates and rods (Salmon et al. 2015,
        doi:10.3389/fendo.2015.00162).

    Raises
    ------
    InputError
        A 2-D image, and as `minkowski`.
    """
    # the phase goes on beyond the mask, whose rim is no surface
    image, inside = indicator(image, phase)
    region = as_mask(mask, image.shape)
    if image.ndim != 3:
        raise InputError("the structure model index is of a volume: the image is 2-D")
    found = minkowski(image, phase=phase, mask=mask, periodic=periodic)
    if not found.surface > 0:
        return None
    curvature = _mean_curvature(inside, region, image.spacing, as_periodic(periodic, 3))
    return 12 * curvature * found.volume / found.surface**2


def _mean_curvature(
    inside: np.ndarray,
    region: np.ndarray | None,
    spacing: tuple[float, ...],
    wraps: tuple[bool, ...],
) -> float:
    """Return the integral of the mean curvature of a phase's surface per volume, 1 / length^2.

    With f the smoothed phase and n = -grad f / |grad f| the mean over its levels is the integral of
    div n |grad f| / 2 = (g . H g / |g|^2 - trace H) / 2, g the gradient and H the second
    derivatives of f. `measure.mean_curvature` counts sections along the axes, which is right for
    materials without direction alone.
    """
    margin = reach_of(_SIGMA) + 1
    field, own = inside.astype(np.float32), np.ones(inside.shape, bool)
    if region is not None:
        own = np.ascontiguousarray(region)
    for axis, wrap in enumerate(wraps):  # beyond faces that do not repeat, the last voxel does
        sides = [(margin, margin) if a == axis else (0, 0) for a in range(3)]
        field = np.pad(field, sides, mode="wrap" if wrap else "edge")
    smooth = gaussian(field, _SIGMA)[(slice(margin - 1, 1 - margin),) * 3]
    smooth = np.ascontiguousarray(smooth)
    total = np.zeros(len(own))
    scale = min(spacing)
    edges = np.array(spacing) / scale
    for_slabs(lambda a, b: _curvatures(smooth, own, edges, total, a, b), len(own))
    return float(total.sum() / max(1, int(np.count_nonzero(own)))) / scale**2


@kernel
def _curvatures(f, own, edges, total, start, stop):
    """Sum half of div n |grad f| over the voxels of every plane; `f` has a margin of 1."""
    _, height, width = own.shape
    for plane in range(start, stop):
        z = plane + 1
        for y in range(1, height + 1):
            for x in range(1, width + 1):
                if not own[plane, y - 1, x - 1]:
                    continue
                gz, gy, gx, zz, yy, xx, zy, zx, yx = derivatives(f, z, y, x, edges)
                square = gz * gz + gy * gy + gx * gx
                if square < 1e-8:
                    continue
                along = gz * gz * zz + gy * gy * yy + gx * gx * xx
                along += 2 * (gz * gy * zy + gz * gx * zx + gy * gx * yx)
                total[plane] += (along / square - zz - yy - xx) / 2


def bone_figures(
    image: Image | ArrayLike,
    *,
    phase: str | int | None = None,
    mask: ArrayLike | None = None,
    periodic: bool | Sequence[bool] = False,
) -> dict[str, float | None]:
    """Measure every figure of a report of trabecular bone, in the image's unit of length.

    Bouxsein et al. 2010 (doi:10.1002/jbmr.141), and plates and rods beside it.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X)
    phase : str or int, optional
        The bone. Default: "solid", which is every phase but "void".
    mask : bool array, the image's shape, optional
        The region of interest.
    periodic : bool or one per axis
        The image repeats beyond its faces.

    Returns
    -------
    figures : dict
        Those of `morphometry`, and
        "TV", "BV", "BS": total volume, bone volume, bone surface; "BS/TV".
        "Tb.Th.SD", "Tb.Sp.SD": standard deviations over the voxels.
        "SMI": `structure_model_index`.
        "DA": degree of anisotropy, 0..1 (`anisotropy`; without a mask alone), "MIL.ratio": longest
        over shortest mean intercept length, 1 for none, which Bouxsein et al. call DA.
        "pBV/BV", "rBV/BV": shares of plates and rods, "EF", "EF.SD": mean and standard deviation of
        their factor (`plates_and_rods`).
        None where a value does not exist.

    Raises
    ------
    InputError
        As `morphometry`.
    """
    found = morphometry(image, phase=phase, mask=mask, periodic=periodic)
    image, bone, region = indicator_in_mask(image, phase, mask)
    wraps = as_periodic(periodic, 3)
    voxels = bone.size if region is None else int(np.count_nonzero(region))
    figures: dict[str, float | None] = dict.fromkeys(BONE_POWERS)
    figures |= {name: found[name] for name in MORPHOMETRY_POWERS}
    total = voxels * float(np.prod(image.spacing))
    share = int(np.count_nonzero(bone)) / voxels
    figures["TV"], figures["BV"] = total, share * total
    if found["BS/BV"] is not None:
        figures["BS"] = found["BS/BV"] * share * total
        figures["BS/TV"] = found["BS/BV"] * share
        figures["SMI"] = structure_model_index(image, phase=phase, mask=mask, periodic=wraps)
    if not 0 < share < 1:
        return figures
    marrow = ~bone if region is None else region & ~bone
    for name, part in (("Tb.Th.SD", bone), ("Tb.Sp.SD", marrow)):
        diameter = sphere_diameters(part, region, image.spacing, wraps, what="bone or marrow")
        figures[name] = float(diameter[part].std(dtype=np.float64))
    if region is None and min(image.shape) >= 4:
        directed = fabric(image, phase=phase)
        figures["DA"] = directed.anisotropy
        figures["MIL.ratio"] = float(directed.lengths[0] / directed.lengths[-1])
        if not np.isfinite(directed.lengths).all():
            figures["MIL.ratio"] = None
    shapes = plates_and_rods(image, phase=phase, mask=mask, periodic=wraps)
    figures["pBV/BV"], figures["rBV/BV"] = shapes.plates, shapes.rods
    figures["EF"], figures["EF.SD"] = shapes.factor, shapes.spread
    return figures
