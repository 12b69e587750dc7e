"""Small bodies of new material: isolated grains, voids and specks, as many of each size as the
exemplars have.

A mean of neighbourhoods keeps no body that is smaller than they are: those that the layout did not
foresee are voted away, and a few arise where none should be. So they are counted in the end, by
size, and what is missing is placed anew: a body of the exemplars, turned about its centre or not,
where its surroundings are those it had. A body that lies inside a box stands for more than one of
its kind, the more, the wider it is (Miles 1974, "On the elimination of edge effects in planar
sampling").
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trabecula.core.image import Image
from trabecula.core.request import Request
from trabecula.core.seeds import generator
from trabecula.engine import memmap
from trabecula.engine.chunking import Box
from trabecula.engine.memory import Array, Stage
from trabecula.measure.dilate import dilate
from trabecula.measure.labelling import label_components
from trabecula.measure.runs import Runs, run_bytes, runs_of
from trabecula.synth.shared.content.fields import FULL, UNIT
from trabecula.synth.shared.content.kinds import Labels, free_voxels

_SETTLED = 3  # times that the bodies of all phases are counted and settled

_PART = 3
"""A body is small where this many fit side by side along every axis, of the exemplar and of the
result."""

_APART = 2  # voxels around a body in which there is none of its phase
_LESS = 0.05  # of its surroundings that may be another phase than in the exemplar
_CHANGE = 0.01  # of a phase: by how much more may be taken away than is placed
_TRIES = 100  # places that are tried for a body
_CORNERS, _FACES = 26, 6  # neighbours: what touches at a corner, or at a face


@dataclass(frozen=True)
class SmallBody:
    """A component inside an exemplar.

    Attributes
    ----------
    inside : (z, y, x) bool
        With `_APART` voxels around it.
    near : (z, y, x) bool
        The body and what is at most `_APART` steps from it.
    host : int
        The commonest label around it.
    hosted : float
        Share of the voxels around it that have that label.
    density : float
        Expected number of such bodies in a voxel of the material.
    """

    inside: np.ndarray
    near: np.ndarray
    host: int
    hosted: float
    density: float

    @property
    def voxels(self) -> int:
        """Return the volume."""
        return int(np.count_nonzero(self.inside))


@dataclass(frozen=True)
class SmallBodies:
    """The small bodies of a label in the exemplars.

    Attributes
    ----------
    placed : tuple of SmallBody
        By 26 neighbours: what touches at a corner stays together, so 6 or 26 may be counted.
    density : dict of int to float
        Expected number in a voxel, by size class, of those that 6 neighbours tell apart.
    """

    placed: tuple[SmallBody, ...]
    density: dict[int, float]


def learn_small_bodies(exemplars: Sequence[Image], label: int) -> SmallBodies:
    """List the small bodies of a label in the exemplars, (Z, Y, X), in raster order."""
    volume = sum(image.values.size for image in exemplars)
    density: dict[int, float] = {}
    for image in exemplars:
        found = _components_of(image.values, label, _FACES)
        for place, _, each in _small_ones(found, image.shape, volume):
            kind = _size_class(int(found.sizes[place - 1]))
            density[kind] = density.get(kind, 0.0) + each
    placed = (body for image in exemplars for body in _bodies_of(image.values, label, volume))
    return SmallBodies(tuple(placed), density)


def _bodies_of(values: np.ndarray, label: int, volume: int) -> Iterator[SmallBody]:
    found = _components_of(values, label, _CORNERS)
    padded = np.pad(values, _APART, mode="edge")
    for place, box, density in _small_ones(found, values.shape, volume):
        sides = _sides(box)
        inside = np.pad(found.labels(sides) == place, _APART)
        near = dilate(inside, _APART)
        around = padded[tuple(slice(a, b + 2 * _APART) for a, b in sides)]
        counts = np.bincount(around[near & ~inside])
        counts[label:][:1] = 0
        share = float(counts.max() / max(1, np.count_nonzero(near & ~inside)))
        yield SmallBody(inside, near, int(np.argmax(counts)), share, density)


def _components_of(values: np.ndarray, label: int, neighbours: int) -> Runs:
    return runs_of(np.ascontiguousarray(values), np.arange(256) == label, neighbours)


def _small_ones(
    found: Runs, shape: Sequence[int], volume: int
) -> Iterator[tuple[int, np.ndarray, float]]:
    """Yield number, box (6,) and density of every component that is small, inside and not hollow:
    what encloses another phase is no body of one.

    Of the places of a body as wide as it is, a share lets it lie inside the box: it counts as the
    reciprocal of that.
    """
    inside = ~found.at_faces()
    places, boxes = np.flatnonzero(inside) + 1, found.boxes(inside)
    sides = np.array(shape)
    extents = boxes[:, 3:] - boxes[:, :3]
    shares = np.prod(1 - (extents + 1) / sides, axis=1)
    small = np.all(extents * _PART <= sides.min(), axis=1)
    for place, box, share in zip(places[small], boxes[small], shares[small], strict=True):
        body = found.labels(_sides(box)) == place
        if len(label_components(~np.pad(body, 1))[1]) == 1:  # all that is around it is joined
            yield int(place), box, 1 / (float(share) * volume)


def _sides(box: np.ndarray) -> Box:
    """Return first voxels and ends (6,) as a box."""
    return tuple(zip(box[:3].tolist(), box[3:].tolist(), strict=True))


def _size_class(voxels: int) -> int:
    """Return the binary logarithm of a volume, rounded down."""
    return voxels.bit_length() - 1


def settle_small_bodies(
    votes: np.ndarray,
    values: np.ndarray,
    bodies: SmallBodies,
    label: int,
    present: Sequence[int],
    *,
    draw: np.random.Generator,
    periodic: Sequence[bool],
    mask: np.ndarray | None = None,
) -> dict[str, int]:
    """Bring the number of small bodies of a label, by size, to that of the exemplars.

    Parameters
    ----------
    votes : (C, Z, Y, X) int16
        Changed in place: far inside the phase that a voxel is given.
    values : (Z, Y, X) uint8
        The labels that the votes stand for, changed alike.
    bodies : SmallBodies
        Of the label.
    label : int
    present : sequence of int
        Labels of the channels of the votes: of two the second.
    draw : numpy.random.Generator
    periodic : three bools
        Axes along which a body may lie across the faces; along the others it is cut off there.
    mask : (Z, Y, X) bool, optional
        Only there bodies are counted, removed and placed.

    Returns
    -------
    dict
        `wanted`, `found`, `removed` and `added`: numbers of bodies, the first two as estimates.
    """
    canvas = _Canvas(votes, values, tuple(present), tuple(periodic), mask)
    volume = values.size if mask is None else int(np.count_nonzero(mask))
    fitting = [
        body
        for body in bodies.placed
        if (max(body.inside.shape) - 2 * _APART) * _PART <= min(values.shape)
    ]
    found = _by_size(_components_of(values, label, _CORNERS), mask)
    before = _components_of(values, label, _FACES)
    added = 0  # voxels
    report = {"wanted": 0.0, "found": 0.0, "removed": 0, "added": 0}
    for kind, sources in _grouped(fitting).items():
        odds = np.cumsum([body.density for body in sources])
        wanted, here = odds[-1] * volume, sum(weight for *_, weight in found.get(kind, []))
        report["wanted"] += wanted
        report["found"] += here
        for _ in range(max(0, int(np.floor(wanted - here + draw.random())))):
            pick = int(np.searchsorted(odds, draw.random() * odds[-1], side="right"))
            body = sources[min(pick, len(sources) - 1)]
            if canvas.place(body, label, draw):
                report["added"] += 1
                added += body.voxels
    excess: list[tuple[int, np.ndarray, float]] = []
    for kind, those in sorted(_by_size(before, mask).items()):
        share = bodies.density.get(kind, 0.0) * volume / sum(weight for *_, weight in those)
        fewer = int(np.floor(len(those) * max(0.0, 1 - share) + draw.random()))
        excess += [those[index] for index in draw.permutation(len(those))[:fewer]]
    most = added + _CHANGE * int(before.sizes.sum())
    for index in draw.permutation(len(excess)):
        place, box, _ = excess[index]
        if (most := most - int(before.sizes[place - 1])) >= 0:
            canvas.remove(before, place, box, label)
            report["removed"] += 1
    return {name: round(count) for name, count in report.items()}


def settle_phases(
    votes: np.ndarray,
    content: Labels,
    small: Mapping[int, SmallBodies],
    request: Request,
    *,
    name: str,
) -> dict[str, Any]:
    """Bring the small bodies of every label of `small` to their numbers, in votes (C, Z, Y, X)
    int16; return what was done by the names of phases.

    The bodies change the volume fractions, and what restores these may cut off others: so
    again. `name` is that of the method, of whose seed places are drawn.
    """
    report: dict[str, Any] = {}
    free = free_voxels(request)
    for number in range(_SETTLED):
        values = content.to_values(votes, request)
        for label, bodies in small.items():
            report[content.names[label]] = settle_small_bodies(
                votes,
                values,
                bodies,
                label,
                content.present,
                draw=generator(request.seed, f"{name}/bodies/{label}", number),
                periodic=request.periodic,
                mask=free,
            )
    return report


def body_stages(shape: Sequence[int], channels: int, *, known: bool) -> tuple[Stage, ...]:
    """Declare the arrays of the count: votes, labels, the runs of a phase, and beside known voxels
    the free ones.
    """
    arrays = {
        "votes": Array((channels, *shape), np.int16),
        "values": Array(shape, np.uint8),
        "free": Array(shape, bool) if known else None,
        "runs": Array(run_bytes(shape), np.uint8, at_most=True),
    }
    return (Stage("small bodies", arrays),)


def _by_size(
    found: Runs, mask: np.ndarray | None
) -> dict[int, list[tuple[int, np.ndarray, float]]]:
    """Return number, box and weight of the small components within a mask, by size class."""
    kinds: dict[int, list[tuple[int, np.ndarray, float]]] = {}
    for place, box, weight in _small_ones(found, found.shape, 1):
        sides = _sides(box)
        body = found.labels(sides) == place
        if mask is None or mask[tuple(slice(a, b) for a, b in sides)][body].all():
            kind = _size_class(int(found.sizes[place - 1]))
            kinds.setdefault(kind, []).append((place, box, weight))
    return kinds


def _grouped(bodies: Sequence[SmallBody]) -> dict[int, list[SmallBody]]:
    """Return bodies by size class, the largest first: there is room for them."""
    kinds: dict[int, list[SmallBody]] = {}
    for body in sorted(bodies, key=lambda body: -body.voxels):
        kinds.setdefault(_size_class(body.voxels), []).append(body)
    return kinds


@dataclass(frozen=True)
class _Canvas:
    """Votes and labels that are changed together."""

    votes: np.ndarray
    values: np.ndarray
    present: tuple[int, ...]
    periodic: tuple[bool, ...]
    mask: np.ndarray | None

    def remove(self, components: Runs, place: int, box: np.ndarray, label: int) -> None:
        """Give a component to the commonest label around it."""
        low = np.maximum(box[:3] - 1, 0)
        sides = _sides(np.append(low, np.minimum(box[3:] + 1, self.values.shape)))
        self._touch(sides[0][1] - sides[0][0])
        inside = components.labels(sides) == place
        window = tuple(slice(a, b) for a, b in sides)
        around = self.values[window][dilate(inside, 1) & ~inside]
        counts = np.bincount(around[around != label], minlength=1)
        if counts.any():
            self._write(np.argwhere(inside), low, int(np.argmax(counts)))

    def place(self, body: SmallBody, label: int, draw: np.random.Generator) -> bool:
        """Place a body where there is room for it; return whether there was."""
        inside, near = body.inside, body.near
        if draw.random() < 0.5:  # what depends on pairs of voxels stays as it is
            inside, near = inside[::-1, ::-1, ::-1], near[::-1, ::-1, ::-1]
        covered, middle = np.argwhere(near), np.array(near.shape) // 2
        shell = ~inside[near]
        for _ in range(_TRIES):
            self._touch(len(near))
            corner = draw.integers(0, self.values.shape) - middle
            at, kept = self._voxels(covered, corner)
            there = self.values[at]
            if (there == label).any() or (self.mask is not None and not self.mask[at].all()):
                continue
            around = there[shell[kept]]
            if np.count_nonzero(around == body.host) < (body.hosted - _LESS) * len(around):
                continue
            self._write(np.argwhere(inside), corner, label)
            return True
        return False

    def _touch(self, planes: int) -> None:
        """Count what a window of so many planes touches, of votes and of labels."""
        memmap.count_scattered((len(self.votes) + 1) * planes)

    def _voxels(
        self, covered: np.ndarray, corner: np.ndarray
    ) -> tuple[tuple[np.ndarray, ...], np.ndarray]:
        """Return the places (three arrays) of voxels (n, 3) of a window whose first is `corner`,
        and which of them are on the canvas.
        """
        at, sides = covered + corner, np.array(self.values.shape)
        at = np.where(self.periodic, at % sides, at)
        kept = np.all((at >= 0) & (at < sides), axis=1)
        return tuple(at[kept].T), kept

    def _write(self, voxels: np.ndarray, corner: np.ndarray, label: int) -> None:
        """Give voxels (n, 3) of a window to a label, far inside its phase."""
        at, _ = self._voxels(voxels, corner)
        self.values[at] = label
        deep = FULL * UNIT
        channels = self.present[1:] if len(self.votes) == 1 else self.present
        for own, votes in zip(channels, self.votes, strict=True):
            votes[at] = deep if label == own else -deep
