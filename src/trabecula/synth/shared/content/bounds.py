"""Bounds that known voxels set to a field: the least and the most that it may be at each."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from trabecula.engine import memmap
from trabecula.measure.distance import distance_transform
from trabecula.synth.shared.slabs import complement, count_true, for_plane_groups, make_by_slabs

Bounds = tuple[np.ndarray, np.ndarray]
"""The least and the most, (C, Z, Y, X) float32, that the field may be."""

_ANY = 1e4  # farther than any distance
_OF_SLICES = 0.5  # of the farthest that an interface may be, and the nearest where slices are known


def distance_bounds(
    values: np.ndarray,
    known: np.ndarray,
    labels: Sequence[int],
    spacing: tuple[float, ...],
    *,
    thin: bool,
    least: float = 0.0,
) -> Bounds:
    """Bound the signed distances of some labels (one a channel) where `values` (Z, Y, X) are known.

    A known voxel is no farther from an interface than from the nearest known voxel of the other
    side, and no nearer than from that or from the nearest unknown one. Nothing ends just where
    knowledge does: so it is taken to be no nearer than `least` times as far either. With `thin`,
    where slices are known, it is no nearer than half as far, and nothing more.
    """
    unknown = None if thin else distance_transform(known, spacing=spacing)
    nearest = _OF_SLICES if thin else least
    low, high = _empty_bounds(len(labels), known)
    for label, lowest, highest in zip(labels, low, high, strict=True):
        inside = make_by_slabs(
            lambda a, b, label=label: values[a:b] == label,  # type: ignore[misc]
            known.shape,
            bool,
        )
        within, without = _depth(inside, known, spacing), _depth(complement(inside), known, spacing)

        def bounds(
            start: int,
            stop: int,
            inside: np.ndarray = inside,
            own: tuple[np.ndarray, ...] = (within, without),
        ) -> Bounds:
            there = unknown if unknown is None else unknown[start:stop]
            return _between(
                inside[start:stop], own[0][start:stop], own[1][start:stop], there, nearest
            )

        _fill(lowest, highest, known, bounds)
        del inside, within, without, bounds  # before the next are made
    return low, high


def sign_bounds(values: np.ndarray, known: np.ndarray, labels: Sequence[int]) -> Bounds:
    """Bound the sign of blurred indicators: the blur of a known voxel depends on its neighbours,
    its side of the middle does not.
    """
    low, high = _empty_bounds(len(labels), known)
    for label, least, most in zip(labels, low, high, strict=True):

        def bounds(start: int, stop: int, label: int = label) -> Bounds:
            inside = values[start:stop] == label
            return np.where(inside, 1.0, -_ANY), np.where(inside, _ANY, -1.0)

        _fill(least, most, known, bounds)
    return low, high


def value_bounds(
    fields: Callable[[np.ndarray], np.ndarray],
    values: np.ndarray,
    known: np.ndarray,
    *,
    features: int = 0,
) -> Bounds:
    """Bound fields that are the values themselves, stretched by `fields`; the `features` after them
    have no bounds: they follow the values.
    """
    plain = len(fields(values[:1]))
    low, high = _empty_bounds(plain + features, known)

    def work(start: int, stop: int) -> None:
        there, held = known[start:stop], fields(values[start:stop])
        low[:plain, start:stop] = np.where(there, held, -_ANY)
        high[:plain, start:stop] = np.where(there, held, _ANY)
        low[plain:, start:stop], high[plain:, start:stop] = -_ANY, _ANY

    for_plane_groups(work, known.shape)
    return low, high


def _empty_bounds(channels: int, known: np.ndarray) -> Bounds:
    shape = (channels, *known.shape)
    return memmap.empty(shape, np.float32), memmap.empty(shape, np.float32)


def _fill(
    low: np.ndarray, high: np.ndarray, known: np.ndarray, bounds: Callable[[int, int], Bounds]
) -> None:
    """Write the bounds of one channel: those of `bounds` where voxels are known, none elsewhere."""

    def work(start: int, stop: int) -> None:
        least, most = bounds(start, stop)
        low[start:stop] = np.where(known[start:stop], least, -_ANY)
        high[start:stop] = np.where(known[start:stop], most, _ANY)

    for_plane_groups(work, known.shape)


def _between(
    inside: np.ndarray,
    within: np.ndarray,
    without: np.ndarray,
    unknown: np.ndarray | None,
    least: float,
) -> Bounds:
    own = np.where(inside, within, without)
    far = np.maximum(own - 0.5, 0.1)
    near = np.maximum(least * far, 0.1)
    if unknown is not None:
        near = np.maximum(near, np.minimum(own, unknown) - 0.5)
    return np.where(inside, near, -far), np.where(inside, far, -near)


def _depth(inside: np.ndarray, known: np.ndarray, spacing: tuple[float, ...]) -> np.ndarray:
    """Measure the distance of every voxel of `inside` to the nearest known voxel outside."""
    may_be = make_by_slabs(lambda a, b: inside[a:b] | ~known[a:b], inside.shape, bool)
    if count_true(may_be) == may_be.size:
        return make_by_slabs(lambda a, b: _ANY, inside.shape, np.float32)
    return distance_transform(may_be, spacing=spacing)
