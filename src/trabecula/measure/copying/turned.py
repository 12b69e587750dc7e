"""Turned copies: material that was mirrored or turned before it was copied from the exemplar."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import as_number, as_seed
from trabecula.core.image import Image
from trabecula.measure.copying.coherence import SourceSample, sample_sources
from trabecula.measure.copying.index import pack_neighbourhoods
from trabecula.measure.copying.pair import Pair
from trabecula.measure.copying.sources import start_sources

NEARER = 3
"""A turned source counts where it differs in less than this part of what the voxel's own source
differs in. Of independent material 0 to 5 % of the voxels have one (twelve scans, parts of 48 to 96
voxels a side); at one half it is up to 12 %.
"""

LEAST = 9
"""Differing voxels of a neighbourhood: one that is nearer to its own source recurs everywhere."""

FEWEST, ENOUGH = 20, 64
"""Voxels to look at: with fewer nothing is known, and more are not worth their time."""


@dataclass(frozen=True)
class TurnedCopies:
    """Voxels that were taken from the exemplar mirrored or turned.

    Attributes
    ----------
    share : float
        Of the voxels looked at, 0..1.
    axes : tuple of str
        Axis of the exemplar that each axis of the image runs along, such as ("z", "-x", "y"): of
        the symmetry that most of them share. Empty where none has half of them.
    """

    share: float
    axes: tuple[str, ...]

    @property
    def text(self) -> str:
        """Return the symmetry in words, such as "mirrored along z"."""
        return name_symmetry(self.axes) if self.axes else "mirrored or turned in several ways"


def turned_copies(
    exemplar: Image | ArrayLike,
    image: Image | ArrayLike,
    *,
    size: int | None = None,
    samples: int = 500,
    seed: int = 0,
) -> TurnedCopies:
    """Return the share of voxels whose neighbourhood recurs in the exemplar mirrored or turned,
    0..1, and how it was turned.

    Looked at are those of `samples` voxels near an interface whose own source, in the exemplar as
    it is, differs most: the half above the median. One counts where a neighbourhood of the exemplar
    under one of the other 47 symmetries of the cube (7 of the square) differs in less than a third
    of that. So material that is its own mirror image has none, and independent material hardly any.

    Parameters
    ----------
    exemplar, image : Image or array of labels, (Z, Y, X) or (Y, X)
        Labels mean the same in both.
    size : int, optional
        Width of a neighbourhood, odd, 3..15. Default: 9 in 3-D, 15 in 2-D.
    samples : int
        Voxels drawn, 1 and more; fewer where fewer are near an interface.
    seed : int
        Of the sample of voxels.

    Returns
    -------
    copies : TurnedCopies

    Raises
    ------
    InputError
        Images that do not go together or are too small, no interface.

    Notes
    -----
    A turned source is looked for in one leaf of the tree that `coherence` searches: exact for true
    copies, and nearly so for those that were smoothed a little.

    Examples
    --------
    >>> scan = (np.random.default_rng(0).random((24, 24, 24)) < 0.3).astype(np.uint8)
    >>> found = turned_copies(scan, scan[:, ::-1].transpose(2, 1, 0), size=5, samples=60)
    >>> found.share, found.axes
    (1.0, ('x', '-y', 'z'))
    >>> found.text
    'turned by 180 degrees about the diagonal of z and x'
    """
    samples = int(as_number(samples, name="samples", low=1, high=1 << 30, whole=True))
    found = sample_sources(
        exemplar, image, steps=[], size=size, samples=samples, seed=as_seed(seed)
    )
    return find_turned(found)


def find_turned(found: SourceSample) -> TurnedCopies:
    """Look for turned sources of the voxels of a sample whose own sources differ most."""
    pair, differing = found.pair, found.differing
    chosen = np.flatnonzero(differing >= max(LEAST, float(np.median(differing))))
    chosen = chosen[:: max(1, len(chosen) // ENOUGH)]
    if len(chosen) < min(FEWEST, len(differing)):
        return TurnedCopies(0.0, ())
    turns = list_symmetries(3 - pair.lifted)[1:]
    # below a third of the own source's, never of none
    bounds = (differing[chosen] + NEARER - 1) // NEARER
    hits = _find_nearer(found, found.sites[chosen], turns, bounds)
    any_hit, by_turn = hits.any(axis=0), hits.sum(axis=1)
    most = int(np.argmax(by_turn))
    named = by_turn[most] > 0 and 2 * by_turn[most] >= any_hit.sum()
    return TurnedCopies(float(any_hit.mean()), axis_names(*turns[most]) if named else ())


def list_symmetries(ndim: int) -> list[tuple[tuple[int, ...], tuple[bool, ...]]]:
    """List the symmetries of the grid, the identity first: the order of the axes, and whether each
    is reversed afterwards.
    """
    return list(product(permutations(range(ndim)), product((False, True), repeat=ndim)))


def axis_names(order: tuple[int, ...], back: tuple[bool, ...]) -> tuple[str, ...]:
    """Return the axis of the exemplar that each axis of the image runs along, where the image
    becomes the exemplar by this symmetry.
    """
    names = "zyx"[3 - len(order) :]
    return tuple(
        ("-" if back[order.index(axis)] else "") + names[order.index(axis)]
        for axis in range(len(order))
    )


def name_symmetry(axes: tuple[str, ...]) -> str:
    """Return a symmetry in words.

    Examples
    --------
    >>> name_symmetry(("-z", "y", "x")), name_symmetry(("z", "-x", "y"))
    ('mirrored along z', 'turned by 90 degrees about z')
    """
    names = "zyx"[3 - len(axes) :]
    matrix = np.zeros((len(axes),) * 2, int)
    for row, axis in enumerate(axes):
        matrix[row, names.index(axis[-1])] = -1 if axis[0] == "-" else 1
    back, moved = (
        [name for name, found in zip(names, which, strict=True) if found]
        for which in (matrix.diagonal() == -1, matrix.diagonal() == 0)
    )
    turned = round(np.linalg.det(matrix)) == 1
    still = [name for name in names if name not in moved]
    if not moved:
        about = "".join(f" about {name}" for name in names if name not in back)
        return f"turned by 180 degrees{about}" if turned else f"mirrored along {_join(back)}"
    if len(moved) == 3:
        turn = "turned by 120 degrees about a diagonal of the cube"
        return turn if turned else f"mirrored along {_join([*names])} and {turn}"
    if (matrix == matrix.T).all():  # two axes change places
        diagonal = f"the diagonal of {_join(moved)}"
        return (
            f"turned by 180 degrees about {diagonal}" if turned else f"mirrored across {diagonal}"
        )
    turn = "turned by 90 degrees" + "".join(f" about {name}" for name in still)
    return turn if turned else f"mirrored along {_join(still)} and {turn}"


def _join(names: list[str]) -> str:
    """Return "z", "z and y", "z, y and x"."""
    return " and ".join([*([", ".join(names[:-1])] if len(names) > 1 else []), names[-1]])


def _find_nearer(
    found: SourceSample,
    sites: np.ndarray,
    turns: list[tuple[tuple[int, ...], tuple[bool, ...]]],
    bounds: np.ndarray,
) -> np.ndarray:
    """Return whether a leaf of the tree holds a candidate that differs in fewer voxels than the
    bound of a site, (turns, sites) bool, from the neighbourhood of the site, turned.
    """
    pair, tree, geometry = found.pair, found.tree, found.pair.geometry
    stack = _turned_neighbourhoods(pair, sites, turns)
    planes, blocks = pack_neighbourhoods(stack, geometry)
    # One neighbourhood behind the other: those that begin between two of them are not asked.
    depth = geometry.width[0]
    first = np.arange(0, len(stack), depth)
    wanted = np.zeros((len(stack) - depth + 1, 1, 1), bool)
    wanted[first] = True
    source, distance = np.empty((2, *wanted.shape), np.int32)
    distance[first, 0, 0] = np.tile(bounds, len(turns))
    start_sources(
        planes, tree.cubes.planes, tree.features, tree.corners,
        np.asarray(tree.cubes.counts.shape), tree.nodes, tree.low, tree.high, blocks,
        geometry.offsets, wanted, depth, geometry.step, geometry.bits, source, distance, 0,
        len(wanted),
    )  # fmt: skip
    return source[first, 0, 0].reshape(len(turns), len(sites)) >= 0


def _turned_neighbourhoods(
    pair: Pair, sites: np.ndarray, turns: list[tuple[tuple[int, ...], tuple[bool, ...]]]
) -> np.ndarray:
    """Return the neighbourhoods of these corners under every symmetry, one behind the other,
    (turns * sites * depth, height, breadth).
    """
    depth, height, breadth = pair.geometry.width
    cut = np.stack(
        [pair.image[z : z + depth, y : y + height, x : x + breadth] for z, y, x in sites]
    )
    lead = tuple(range(1 + pair.lifted))
    stack = []
    for order, back in turns:
        turned = cut.transpose(*lead, *(len(lead) + axis for axis in order))
        stack.append(np.flip(turned, [len(lead) + axis for axis, b in enumerate(back) if b]))
    return np.ascontiguousarray(np.stack(stack)).reshape(-1, height, breadth)
