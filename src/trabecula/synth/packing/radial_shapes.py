"""Radii of a body in all directions: spherical harmonics fitted to its surface (Garboczi 2002,
doi:10.1016/S0008-8846(02)00836-0), kept as a table on the faces of a cube.
"""

from __future__ import annotations

import math

import numpy as np

from trabecula.engine.compile import inline

NODES = 13
"""Of the table along an edge of the cube; faces share those on their edges, so radii are
continuous."""

SIZE = 6 * NODES * NODES

FINE = 256.0
"""Steps of a length: the last bits of a fit differ between processors."""

_SMOOTHNESS = 1e-4  # weight of (l (l + 1))^2 beside the mean square of what the fit leaves
_PER_TERM = 8  # faces of voxels that a coefficient needs
_ROUND = 2  # degree of the harmonics that say where a body ends behind a contact
_HIDDEN = 0.3  # weight of that beside what is seen


def table_directions() -> np.ndarray:
    """Return the directions of a table's entries, (SIZE, 3): face 2 axis + (1 where positive), then
    the two other axes in their order.
    """
    line = np.linspace(-1, 1, NODES)
    across, along = np.meshgrid(line, line, indexing="ij")
    faces = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            parts = [across, along]
            parts.insert(axis, np.full_like(across, sign))
            faces.append(np.stack(parts, axis=-1).reshape(-1, 3))
    found = np.concatenate(faces)
    return np.asarray(found / np.linalg.norm(found, axis=1, keepdims=True))


@inline
def radius_towards(table, z, y, x):
    """Return the radius (edges) in a direction (not 0, of any length), of one body's table."""
    sizes = (abs(z), abs(y), abs(x))
    if sizes[0] >= sizes[1] and sizes[0] >= sizes[2]:
        most, first, second, face = sizes[0], y, x, 1 if z > 0 else 0
    elif sizes[1] >= sizes[2]:
        most, first, second, face = sizes[1], z, x, 3 if y > 0 else 2
    else:
        most, first, second, face = sizes[2], z, y, 5 if x > 0 else 4
    half = 0.5 * (NODES - 1)
    u, v = (first / most + 1) * half, (second / most + 1) * half
    i, j = min(int(u), NODES - 2), min(int(v), NODES - 2)
    u, v = u - i, v - j
    at = (face * NODES + i) * NODES + j
    near = (1 - v) * table[at] + v * table[at + 1]
    far = (1 - v) * table[at + NODES] + v * table[at + NODES + 1]
    return (1 - u) * near + u * far


def harmonics(directions: np.ndarray, degree: int) -> np.ndarray:
    """Return the real spherical harmonics up to a degree, each of mean square 1, of unit vectors
    (n, 3) as (z, y, x): (n, (degree + 1)^2), by degree.
    """
    z, y, x = directions.T
    columns: list[list[np.ndarray]] = [[] for _ in range(degree + 1)]
    cosine, sine, first = np.ones_like(x), np.zeros_like(x), 1.0
    for order in range(degree + 1):
        before, now = np.zeros_like(z), np.full_like(z, first)
        for rank in range(order, degree + 1):
            size = math.factorial(rank - order) / math.factorial(rank + order)
            size *= 2 * rank + 1
            if order:
                columns[rank] += [math.sqrt(2 * size) * now * part for part in (cosine, sine)]
            else:
                columns[rank].append(math.sqrt(size) * now)
            after = (2 * rank + 1) * z * now - (rank + order) * before
            before, now = now, after / (rank + 1 - order)
        cosine, sine = x * cosine - y * sine, x * sine + y * cosine
        first *= 2 * order + 1
    return np.stack([column for part in columns for column in part], axis=1)


def degree_for(faces: int, most: int) -> int:
    """Return the degree that so many faces of voxels tell, at most `most`; 0 may be none at all."""
    return max(0, min(most, math.isqrt(faces // _PER_TERM) - 1))


def fit_radii(
    offsets: np.ndarray, contact: np.ndarray, degree: int, ball: np.ndarray | None = None
) -> tuple[np.ndarray, float]:
    """Fit the radii of a body.

    Parameters
    ----------
    offsets : (n, 3) float
        Faces of voxels around the body from its centre, edges.
    contact : (n,) bool
        Those towards another body: no surface, but the body reaches as far at least.
    degree : int
        Of the harmonics.
    ball : (k, 3) float, optional
        Points of `table_directions` times the radius of a ball, where nothing is seen of the body:
        the ellipsoid that says where the body ends there is drawn towards them.

    Returns
    -------
    radii : (SIZE,) float32
    misfit : float
        Root mean square of the distances of its free faces from them.
    """
    if ball is not None:
        offsets = np.concatenate([offsets, ball])
        contact = np.concatenate([contact, np.zeros(len(ball), bool)])
    unseen = np.arange(len(offsets)) >= len(offsets) - (0 if ball is None else len(ball))
    far = np.linalg.norm(offsets, axis=1)
    keep = far > 0
    far, contact, unseen = far[keep], contact[keep], unseen[keep]
    terms = harmonics(offsets[keep] / far[:, None], degree)
    wanted, weight = far.copy(), np.where(contact, _HIDDEN, 1.0)
    # as many points of the ball a solid angle as it had faces of voxels
    weight[unseen] = _HIDDEN * 6 * np.pi * far[unseen] ** 2 / SIZE
    guessed = contact | unseen
    if guessed.any():
        round_ = terms[:, : (min(degree, _ROUND) + 1) ** 2]
        clues = _solved(round_[~contact], far[~contact], weight[~contact], min(degree, _ROUND))
        least = np.where(unseen, 0, far)
        wanted[guessed] = np.maximum(least, round_ @ clues)[guessed]
    found = _solved(terms, wanted, weight, degree)
    radii = np.maximum(harmonics(table_directions(), degree) @ found, 0.3 * far.min())
    misfit = float(np.sqrt(np.mean((terms @ found - far)[~guessed] ** 2)))
    return (np.rint(radii * FINE) / FINE).astype(np.float32), misfit


def _solved(
    terms: np.ndarray, wanted: np.ndarray, weight: np.ndarray | float, degree: int
) -> np.ndarray:
    """Return the coefficients of terms (n, k) that come nearest to what is wanted, smoothly."""
    rank = np.repeat(np.arange(degree + 1), 2 * np.arange(degree + 1) + 1)
    penalty = _SMOOTHNESS * len(wanted) * (rank * (rank + 1.0)) ** 2 + 1e-6
    weighted = terms.T * weight
    return np.asarray(np.linalg.solve(weighted @ terms + np.diag(penalty), weighted @ wanted))


def ball_radii(volume: float) -> np.ndarray:
    """Return the table of a ball of this volume."""
    radius = (3 * volume / (4 * math.pi)) ** (1 / 3)
    return np.full(SIZE, round(radius * FINE) / FINE, np.float32)
