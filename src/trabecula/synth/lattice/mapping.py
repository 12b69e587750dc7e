"""Cell coordinates that follow a field of directions and sizes.

Cells that follow a field need coordinates u with the gradients g_i = e_i / size_i, of a frame e_i
whose principal axis is the field's direction d. Such u seldom exist. They are found by least
squares (Groen and Sigmund 2018, doi:10.1002/nme.5575, section 3):

    minimise  sum over i of the integral of |grad u_i - g_i|^2 + STIFF (d . grad u_i - d . g_i)^2

The second term holds the direction, along which the coordinates across it may not change, at the
cost of the sizes across. What is left over is measured: `CellMap.report`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from trabecula.core.errors import RequestError
from trabecula.engine.compile import kernel
from trabecula.fields.directions import continue_directions, resample_directions
from trabecula.fields.grid import resample_array
from trabecula.numerics.krylov import Iterate, LinearSystem, conjugate_gradients

_NODES = 40  # along the longest side: fields vary slowly, and between nodes u is linear
STIFF = 30.0
"""Weight of the direction against the size of the cells."""

_BALANCE, _STEPS = 1e-6, 400
_SMOOTHING = 60  # rounds in which the axes across are made alike
_STRETCHED = 3.0  # beyond which a cell counts as lost,
_LOST = 0.1  # and the share of such cells that is refused


@dataclass(frozen=True, eq=False)
class CellMap:
    """Cell coordinates on the nodes of a coarse grid.

    Attributes
    ----------
    values : (3, nz, ny, nx) float64
        In cells; at the middles of as many equal boxes.
    shape : three ints
        Voxels of the whole.
    report : dict
        Plain JSON: angle between the field and the cells, and how much longer or shorter than
        asked their edges are.
    """

    values: np.ndarray
    shape: tuple[int, ...]
    report: dict[str, Any]

    def at(self, place: tuple[np.ndarray, np.ndarray, np.ndarray]) -> list[np.ndarray]:
        """Return the coordinates at positions in voxels, one array an axis (they broadcast)."""
        found = self.values
        for axis, (line, side) in enumerate(zip(place, self.shape, strict=True), start=1):
            count = self.values.shape[axis]
            at = np.ravel(line) * count / side - 0.5
            lower = np.clip(np.floor(at).astype(np.int64), 0, count - 2)
            share = (at - lower).reshape([-1 if k == axis else 1 for k in range(4)])
            found = found.take(lower, axis) * (1 - share) + found.take(lower + 1, axis) * share
        return list(found)


def cell_map(
    ways: np.ndarray | None,
    size: float | np.ndarray | None,
    shape: tuple[int, ...],
    edges: np.ndarray,
    mask: np.ndarray | None,
) -> CellMap:
    """Find the coordinates of cells that follow a field.

    Parameters
    ----------
    ways : (3,) or (Z, Y, X, 3) array, optional
        Directions of the cells' longest axis (of cubes their z axis).
    size : float or (Z, Y, X) array, optional
        Factor on the edges.
    shape : three ints
    edges : (3,) array
        Of a cell along z, y, x, in voxels.
    mask : (Z, Y, X) bool array, optional
        What counts in the report.

    Raises
    ------
    RequestError
        More than a tenth of the cells would be stretched three times.
    """
    step = max(2.0, max(shape) / _NODES)
    counts = tuple(max(3, round(side / step)) for side in shape)
    steps = np.array(shape) / np.array(counts)
    axis = int(np.argmax(edges))
    along = _along(ways, counts, axis)
    factor = np.broadcast_to(
        resample_array(size, counts) if isinstance(size, np.ndarray) else float(size or 1.0), counts
    )
    frame = _frames(along, axis)
    wanted = frame / (edges[:, None, None, None, None] * factor[None, ..., None])
    values = np.stack([_integrate(one, along, steps) for one in wanted])
    inside = None if mask is None else resample_array(mask.astype(np.float32), counts) > 0.5
    report = _report(values, wanted, along, steps, axis, inside)
    if report["lost"] > _LOST:
        raise RequestError(
            f"cells cannot follow this field: {report['lost']:.0%} of them would be stretched or "
            f"shrunk more than {_STRETCHED:g} times, since directions spread from a line or a "
            "point; ask for a field without poles, or for method noise, bubbles or texture"
        )
    return CellMap(values, shape, report)


def _along(ways: np.ndarray | None, counts: tuple[int, ...], axis: int) -> np.ndarray:
    """Return directions (nz, ny, nx, 3) on the nodes, of signs that agree."""
    if ways is None or ways.ndim == 1:
        one = np.eye(3)[axis] if ways is None else np.asarray(ways, np.float64)
        return np.broadcast_to(one, (*counts, 3)).copy()
    known = continue_directions(ways).values
    found = resample_directions(known, counts).values.astype(np.float64)
    align_signs(found, np.eye(3)[axis])
    return np.asarray(found / np.linalg.norm(found, axis=-1, keepdims=True))


def _frames(along: np.ndarray, axis: int) -> np.ndarray:
    """Return the axes of the cells (3, nz, ny, nx, 3): `axis` along the directions, the others
    across, changing as little as they can.
    """
    start = np.eye(3)
    first, second = (axis + 1) % 3, (axis + 2) % 3
    # Of the two the one that lies farther from the directions everywhere: it is projected.
    least = [np.abs(along[..., k]).max() for k in (first, second)]
    if least[1] < least[0]:
        first, second = second, first
    across = np.broadcast_to(start[first], along.shape).copy()
    for _ in range(_SMOOTHING):
        across = _unit_across(across, along, start[second])
        mean = across.copy()
        for k in range(3):
            padded = np.pad(across, [(int(k == n), int(k == n)) for n in range(4)], mode="edge")
            mean += padded.take(range(along.shape[k]), k) + padded.take(
                range(2, along.shape[k] + 2), k
            )
        across = mean
    across = _unit_across(across, along, start[second])
    third = np.cross(along, across)
    # right-handed as the voxels' axes are
    if np.linalg.det(np.eye(3)[[axis, first, second]]) < 0:
        third = -third
    frame = np.empty((3, *along.shape))
    frame[axis], frame[first], frame[second] = along, across, third
    return frame


def _unit_across(vectors: np.ndarray, along: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the parts of vectors across the directions, of length 1."""
    part = vectors - (vectors * along).sum(-1, keepdims=True) * along
    length = np.linalg.norm(part, axis=-1, keepdims=True)
    spare = other - (other * along).sum(-1, keepdims=True) * along
    spare /= np.maximum(np.linalg.norm(spare, axis=-1, keepdims=True), 1e-9)
    return np.asarray(np.where(length > 1e-3, part / np.maximum(length, 1e-9), spare))


class _Gradient(LinearSystem):
    """The normal equations of one coordinate."""

    def __init__(self, along: np.ndarray, steps: np.ndarray) -> None:
        self.steps = steps
        self.along = np.moveaxis(_to_cells(along), -1, 0)
        counts = along.shape[:3]
        waves = [
            (2 - 2 * np.cos(np.pi * np.arange(n) / n)) / step**2
            for n, step in zip(counts, steps, strict=True)
        ]
        self.waves = np.asarray(sum(np.ix_(*waves)))
        self.waves[0, 0, 0] = 1.0

    def apply(self, vector: np.ndarray) -> np.ndarray:
        found = np.zeros_like(vector)
        for axis, step in enumerate(self.steps):
            _add_edges(found, np.diff(vector, axis=axis) / step**2, axis)
        slope = sum(a * g for a, g in zip(self.along, self.slopes(vector), strict=True))
        return found + STIFF * self.transpose(self.along * slope)

    def slopes(self, vector: np.ndarray) -> list[np.ndarray]:
        """Return the gradient in the middle of every box between eight nodes."""
        found = []
        for axis, step in enumerate(self.steps):
            part = np.diff(vector, axis=axis) / step
            for other in range(3):
                part = part if other == axis else _means(part, other)
            found.append(part)
        return found

    def transpose(self, parts: np.ndarray) -> np.ndarray:
        """Apply the transpose of `slopes`."""
        shape = tuple(side + 1 for side in parts.shape[1:])
        found = np.zeros(shape)
        for axis, step in enumerate(self.steps):
            part = parts[axis]
            for other in range(3):
                part = part if other == axis else _spread_means(part, other)
            _add_edges(found, part / step, axis)
        return found

    def right(self, wanted: np.ndarray) -> np.ndarray:
        """Return the right-hand side for gradients (nz, ny, nx, 3) on the nodes."""
        found = np.zeros(wanted.shape[:3])
        for axis, step in enumerate(self.steps):
            _add_edges(found, _means(wanted[..., axis], axis) / step, axis)
        middle = np.moveaxis(_to_cells(wanted), -1, 0)
        slope = (self.along * middle).sum(axis=0)
        return found + STIFF * self.transpose(self.along * slope)

    def precondition(self, residual: np.ndarray) -> np.ndarray:
        """Solve Poisson's equation with free faces: the even continuation is transformed."""
        wide = residual
        for axis in range(3):
            wide = np.concatenate([wide, np.flip(wide, axis)], axis)
        spectrum = np.fft.rfftn(wide)
        shape = residual.shape
        waves = self.waves
        for axis in range(3):
            count = spectrum.shape[axis]
            number = np.minimum(np.arange(count), 2 * shape[axis] - np.arange(count))
            # the wave of half the period is 0 in the continuation
            waves = waves.take(np.minimum(number, shape[axis] - 1), axis)
        found = np.fft.irfftn(spectrum / waves, wide.shape, axes=(0, 1, 2))
        part = found[tuple(slice(0, side) for side in shape)]
        return np.asarray(part - part.mean())

    def dot(self, a: np.ndarray, b: np.ndarray) -> float:
        return float((a * b).sum())


def _integrate(wanted: np.ndarray, along: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Return the coordinate (nz, ny, nx) whose gradient is nearest to the wanted one, 0 at its
    first node.
    """
    system = _Gradient(along, steps)
    # from the mean gradient, which is all there is of a field that is alike everywhere
    mean = wanted.mean(axis=(0, 1, 2))
    nodes = np.ix_(*(np.arange(n) * step for n, step in zip(along.shape[:3], steps, strict=True)))
    start = np.asarray(sum(g * line for g, line in zip(mean.tolist(), nodes, strict=True)))
    right = system.right(wanted)
    residual = right - system.apply(start)
    goal = _BALANCE * np.sqrt(system.dot(right, right))

    def accept(at: Iterate) -> bool:
        return bool(np.sqrt(system.dot(at.residual, at.residual)) <= goal)

    last, _ = conjugate_gradients(system, start, residual, accept=accept, most=_STEPS)
    return np.asarray(last.x - last.x[0, 0, 0])


def _report(
    values: np.ndarray,
    wanted: np.ndarray,
    along: np.ndarray,
    steps: np.ndarray,
    axis: int,
    inside: np.ndarray | None,
) -> dict[str, Any]:
    """Measure what a map distorts, in the boxes between nodes."""
    system = _Gradient(along, steps)
    have = np.stack([np.stack(system.slopes(one), axis=-1) for one in values], axis=-2)
    asked = np.stack([_to_cells(one) for one in wanted], axis=-2)
    # Columns of the inverse: how a place moves with each coordinate, which is an edge of its cell.
    det = np.linalg.det(have)
    whole = np.abs(det) > 1e-9 * np.abs(np.linalg.det(asked))
    edge = np.swapaxes(np.linalg.inv(np.where(whole[..., None, None], have, np.eye(3))), -1, -2)
    ratio = np.linalg.norm(edge, axis=-1) * np.linalg.norm(asked, axis=-1)
    direction = np.moveaxis(system.along, 0, -1)
    cosine = np.abs((edge[..., axis, :] * direction).sum(-1))
    cosine /= np.linalg.norm(edge[..., axis, :], axis=-1)
    angle = np.degrees(np.arccos(np.clip(cosine / np.linalg.norm(direction, axis=-1), 0, 1)))
    off = (ratio > _STRETCHED) | (ratio < 1 / _STRETCHED)
    bad = ~whole | (det <= 0) | off.any(axis=-1)
    counts = np.ones(bad.shape, bool)
    if inside is not None:
        counts = _to_cells(inside.astype(np.float64)[..., None])[..., 0] > 0.5
        counts = counts if counts.any() else np.ones(bad.shape, bool)
    low, high = np.quantile(ratio[counts & whole], (0.05, 0.95)) if whole.any() else (0.0, 0.0)
    return {
        "angle": round(float(angle[counts].mean()), 2),
        "largest angle": round(float(angle[counts].max()), 2),
        "edges": [round(float(low), 3), round(float(high), 3)],
        "lost": round(float(bad[counts].mean()), 4),
    }


def _means(values: np.ndarray, axis: int) -> np.ndarray:
    """Return the means of neighbours along an axis."""
    side = values.shape[axis]
    return (values.take(range(side - 1), axis) + values.take(range(1, side), axis)) / 2


def _spread_means(values: np.ndarray, axis: int) -> np.ndarray:
    """Apply the transpose of `_means`."""
    pad = [(int(k == axis), int(k == axis)) for k in range(values.ndim)]
    return _means(np.pad(values, pad), axis)


def _add_edges(found: np.ndarray, flux: np.ndarray, axis: int) -> None:
    """Add the transpose of differences along an axis."""
    before = (slice(None),) * axis
    found[(*before, slice(None, -1))] -= flux
    found[(*before, slice(1, None))] += flux


def _to_cells(values: np.ndarray) -> np.ndarray:
    """Return the means of eight nodes."""
    for axis in range(3):
        values = _means(values, axis)
    return values


@kernel
def align_signs(ways, start):
    """Turn vectors (Z, Y, X, 3) so that each agrees with the neighbour it is reached from.

    From the middle outwards, whose own sign is that of `start`.
    """
    depth, height, width = ways.shape[:3]
    queue = np.empty((depth * height * width, 3), np.int64)
    seen = np.zeros((depth, height, width), np.uint8)
    queue[0, 0], queue[0, 1], queue[0, 2] = depth // 2, height // 2, width // 2
    first = ways[depth // 2, height // 2, width // 2]
    if first[0] * start[0] + first[1] * start[1] + first[2] * start[2] < 0.0:
        for c in range(3):
            first[c] = -first[c]
    seen[depth // 2, height // 2, width // 2] = 1
    head, tail = 0, 1
    while head < tail:
        z, y, x = queue[head, 0], queue[head, 1], queue[head, 2]
        head += 1
        for n in range(6):
            u, v, w = z, y, x
            move = 1 if n % 2 else -1
            if n < 2:
                u += move
            elif n < 4:
                v += move
            else:
                w += move
            if u < 0 or v < 0 or w < 0 or u >= depth or v >= height or w >= width:
                continue
            if seen[u, v, w]:
                continue
            seen[u, v, w] = 1
            a, b = ways[z, y, x], ways[u, v, w]
            if a[0] * b[0] + a[1] * b[1] + a[2] * b[2] < 0.0:
                for c in range(3):
                    b[c] = -b[c]
            queue[tail, 0], queue[tail, 1], queue[tail, 2] = u, v, w
            tail += 1
