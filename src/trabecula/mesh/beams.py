"""Beam lattices: a solid as beams along its skeleton, with balls where they meet.

1. Thin the phase to its skeleton, read it as joints and branches (`measure.skeleton`).
2. Smooth the lines of the branches and leave out the points that a straight, evenly tapering beam
   passes near.
3. A beam's radius is the distance to the boundary; all radii times one factor give the solid's
   volume.

Plates have a skeleton of lines as well, and come out as nets of beams: `compare_beams` tells how
far off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_number
from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image, check_labels
from trabecula.core.recipe import Recipe
from trabecula.engine.compile import kernel
from trabecula.measure.components import components
from trabecula.measure.distance import distance_transform
from trabecula.measure.phases import indicator
from trabecula.measure.skeleton import SkeletonGraph, skeleton_graph

_SMOOTHED = 2  # rounds of means over three points
_TRIALS = 12  # of the factor of radii
_THINNEST, _THICKEST = 0.5, 3.0


@dataclass(frozen=True, eq=False)
class BeamLattice:
    """Round beams that taper evenly, with a ball at each end.

    Parameters
    ----------
    vertices : (V, 3) float64
        x, y, z in `unit`; the origin is the corner of voxel (0, 0, 0).
    beams : (B, 2) int32
        Vertex numbers.
    radii : (B, 2) float64
        At both ends, in `unit`.
    unit : str
    recipe : Recipe
    """

    vertices: np.ndarray
    beams: np.ndarray
    radii: np.ndarray
    unit: str = "voxel"
    recipe: Recipe = field(default_factory=Recipe)

    def __repr__(self) -> str:
        return f"<BeamLattice {len(self.vertices)} vertices, {len(self.beams)} beams, {self.unit}>"


def beam_lattice(
    image: Image | ArrayLike, *, phase: str | int | None = None, tolerance: float = 0.25
) -> BeamLattice:
    """Return a phase as beams along its skeleton.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X)
    phase : str or int, optional
        Default: the solid, which is every phase but "void".
    tolerance : float
        Voxels by which a beam's axis or radius may be off the skeleton's, 0 to 10.

    Returns
    -------
    BeamLattice
        Its volume is the phase's to 1 %, where radii between .5 and 3 times those of the skeleton
        can have it.

    Raises
    ------
    InputError
        Not labels, not 3-D, or an empty phase.

    References
    ----------
    Lee, Kashyap and Chu 1994, doi:10.1006/cgip.1994.1042 (the skeleton).
    """
    image = as_image(image)
    check_labels(image)
    if image.ndim != 3:
        raise InputError(f"beams need a volume, the image has shape {image.shape}: give 3 axes")
    limit = as_number(tolerance, name="tolerance", low=0, high=10)
    inside = indicator(image, phase)[1]
    if not inside.any():
        raise InputError("the phase is empty, there is nothing to make beams of: name another")
    graph = skeleton_graph(image, phase=phase)
    points, beams = _lines(graph, _radius_of(inside, image.spacing), limit)
    vertices = (points[:, :3] + 0.5) * image.spacing
    radii = points[:, 3][beams]
    factor = _factor(vertices, beams, radii, inside, image.spacing)
    lattice = vertices[:, ::-1].copy()
    recipe = image.recipe.then("beam_lattice", lattice, phase=phase, tolerance=limit)
    return BeamLattice(lattice, beams, radii * factor, image.unit, recipe)


def compare_beams(
    image: Image | ArrayLike, lattice: BeamLattice, *, phase: str | int | None = None
) -> dict[str, Any]:
    """Measure how far a beam lattice is from the phase that it was made of.

    Returns
    -------
    dict
        `volume` over the phase's, `overlap` (Dice: twice the voxels in both over the sum of both),
        `distance_mean` and `distance_99` (of the voxels that are in one of them alone to the
        other's nearest voxel: mean, and the distance that 99 in 100 are within, in voxels),
        `components` of both.
    """
    image, inside = indicator(as_image(image), phase)
    made = rasterise_beams(lattice, image.shape, image.spacing)
    both = int((made & inside).sum())
    distances = [
        _distances_to(inside, made & ~inside),
        _distances_to(made, inside & ~made),
    ]
    off = np.concatenate(distances)
    return {
        "volume": float(made.sum() / inside.sum()),
        "overlap": float(2 * both / (made.sum() + inside.sum())),
        "distance_mean": float(off.mean()) if len(off) else 0.0,
        "distance_99": float(np.quantile(off, 0.99)) if len(off) else 0.0,
        "components": [int(components(one.astype(np.uint8))) for one in (inside, made)],
    }


def rasterise_beams(
    lattice: BeamLattice, shape: Sequence[int], spacing: Sequence[float]
) -> np.ndarray:
    """Return the voxels whose centres lie in a beam, (Z, Y, X) bool."""
    return _rasterise(lattice.vertices[:, ::-1], lattice.beams, lattice.radii, shape, spacing)


def _rasterise(
    vertices: np.ndarray,
    beams: np.ndarray,
    radii: np.ndarray,
    shape: Sequence[int],
    spacing: Sequence[float],
) -> np.ndarray:
    made = np.zeros(tuple(shape), np.bool_)
    _fill(vertices, beams, radii, np.array(spacing, np.float64), made)
    return made


def _distances_to(solid: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return the distance of places outside of a solid to its nearest voxel, in voxels."""
    return distance_transform(~solid)[places]


def _radius_of(inside: np.ndarray, spacing: Sequence[float]) -> np.ndarray:
    """Return the distance of every voxel's centre to the phase's boundary."""
    distance = distance_transform(inside, spacing=spacing)
    half = min(spacing) / 2
    longest = max(side * edge for side, edge in zip(inside.shape, spacing, strict=True))
    return np.clip(distance - half, half, longest)  # of a phase without a boundary


def _lines(
    graph: SkeletonGraph, radius: np.ndarray, tolerance: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the points (V, 4), z, y, x in voxels and the radius, and the beams between them."""
    edge = min(graph.spacing)
    joint_radius = np.zeros(len(graph.joints))
    np.maximum.at(joint_radius, graph.joint_of, radius[tuple(graph.joint_voxels.T)])
    points = [np.column_stack([graph.joints, joint_radius])]
    beams, count = [], len(graph.joints)
    for branch in range(graph.branches):
        path = graph.path(branch)
        line = np.column_stack([path, radius[tuple(path.T)]]).astype(np.float64)
        start, stop = int(graph.start[branch]), int(graph.stop[branch])
        if start >= 0:
            line[0] = points[0][start]
        if stop >= 0:
            line[-1] = points[0][stop]
        if len(line) == 1:  # a ball is a beam that hardly leaves its place
            line = np.repeat(line, 2, axis=0)
            line[1, 2] += 0.1
        kept = line[simplify(_smooth(line), np.array([*np.ones(3), 1 / edge]), tolerance)]
        own = kept[int(start >= 0) : len(kept) - int(stop >= 0)]  # the others are joints
        points.append(own)
        numbers = [*([start] if start >= 0 else []), *range(count, count + len(own))]
        numbers += [stop] if stop >= 0 else []
        count += len(own)
        beams.append(np.column_stack([numbers[:-1], numbers[1:]]))
    found = np.concatenate(beams).astype(np.int32) if beams else np.empty((0, 2), np.int32)
    return np.concatenate(points), found[found[:, 0] != found[:, 1]]


def _smooth(line: np.ndarray) -> np.ndarray:
    """Return a line of means over three points; its ends stay."""
    smooth = line.copy()
    for _ in range(_SMOOTHED):
        smooth[1:-1] = (smooth[:-2] + smooth[1:-1] + smooth[2:]) / 3
    return smooth


def simplify(line: np.ndarray, scale: np.ndarray, tolerance: float) -> np.ndarray:
    """Return the numbers of the points of a line (N, D) that are kept so that no other is farther
    than `tolerance` from the straight pieces between them.

    Douglas and Peucker 1973, doi:10.3138/FM57-6770-U75U-7727; columns count `scale` times.
    """
    scaled, kept, todo = line * scale, [0, len(line) - 1], [(0, len(line) - 1)]
    while todo:
        first, last = todo.pop()
        if last - first < 2:
            continue
        along = scaled[last] - scaled[first]
        between = scaled[first + 1 : last] - scaled[first]
        length = float(along @ along)
        share = np.clip(between @ along / length, 0, 1) if length else np.zeros(len(between))
        off = np.linalg.norm(between - share[:, None] * along, axis=1)
        worst = int(off.argmax())
        if off[worst] > tolerance:
            middle = first + 1 + worst
            kept.append(middle)
            todo += [(first, middle), (middle, last)]
    return np.array(sorted(set(kept)))


def _factor(
    vertices: np.ndarray,
    beams: np.ndarray,
    radii: np.ndarray,
    inside: np.ndarray,
    spacing: Sequence[float],
) -> float:
    """Return the factor of all radii that gives the volume, by halving the range."""
    low, high, wanted = _THINNEST, _THICKEST, int(inside.sum())
    factor = 1.0
    for _ in range(_TRIALS):
        found = int(_rasterise(vertices, beams, radii * factor, inside.shape, spacing).sum())
        if abs(found / wanted - 1) < 0.002:
            break
        low, high = (factor, high) if found < wanted else (low, factor)
        factor = (low + high) / 2
    return factor


@kernel
def _fill(vertices, beams, radii, spacing, made):
    """Mark the voxels in every beam: those whose nearest place on its axis is within the radius
    there.
    """
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    for b in range(len(beams)):
        one, other = vertices[beams[b, 0]], vertices[beams[b, 1]]
        r1, r2 = radii[b, 0], radii[b, 1]
        most = max(r1, r2)
        length = 0.0
        for axis in range(3):
            start, stop = min(one[axis], other[axis]) - most, max(one[axis], other[axis]) + most
            low[axis] = max(0, int(np.floor(start / spacing[axis] - 0.5)))
            high[axis] = min(made.shape[axis], int(np.ceil(stop / spacing[axis] + 0.5)))
            length += (other[axis] - one[axis]) ** 2
        for z in range(low[0], high[0]):
            pz = (z + 0.5) * spacing[0] - one[0]
            for y in range(low[1], high[1]):
                py = (y + 0.5) * spacing[1] - one[1]
                for x in range(low[2], high[2]):
                    px = (x + 0.5) * spacing[2] - one[2]
                    dot = (
                        pz * (other[0] - one[0])
                        + py * (other[1] - one[1])
                        + px * (other[2] - one[2])
                    )
                    t = min(max(dot / length, 0.0), 1.0) if length > 0 else 0.0
                    dz = pz - t * (other[0] - one[0])
                    dy = py - t * (other[1] - one[1])
                    dx = px - t * (other[2] - one[2])
                    r = r1 + t * (r2 - r1)
                    if dz * dz + dy * dy + dx * dx <= r * r:
                        made[z, y, x] = True
