"""Cells in the slices of a volume, beside the cells of its picture: sizes, neighbours, points where
three meet, and the length of the lines between them.

Only a picture of closed boundaries is judged by: they fill at most half of it, and hold most of the
lines between its cells. Bands are those of the parts of the picture, as of other figures.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.exemplar.views import take_slices
from trabecula.measure.plane_cells import PlaneCells, boundary_phase, plane_cells
from trabecula.report.band import LEAST_COUNT, parts, value_band
from trabecula.report.descriptors import Measurements
from trabecula.report.metrics import Metric
from trabecula.report.reference import Reference

CLOSED = 0.9
"""Share of the lines between cells that lie in the phase of the boundaries, at least."""

_LEAST = 12  # cells that the edge does not cut


def judge_cells(
    reference: Reference, planes: Sequence[str], image: Image, measured: Measurements
) -> dict[str, Metric]:
    """Judge the cells in slices of a volume; empty where the picture is not one of closed cells.

    Parameters
    ----------
    reference : Reference
        The picture.
    planes : sequence of str
        Of the volume that it stands for.
    image : Image, (Z, Y, X)
    measured : Measurements
        Mean of the volume's slices, for their size.
    """
    picture = reference.exemplar
    own = _cells_of(picture)
    if own is None or own.inside.sum() < _LEAST:
        return {}
    boundary = boundary_phase(picture)
    walls = picture.values == boundary
    if walls.mean() > 0.5 or _closed(own, walls) < CLOSED:
        return {}
    cuts = [each for plane in planes for each in take_slices(image, plane)]
    # in small windows cells at the edge count for more, so the parts are as small as the slices
    shape = [min(cut.shape[n] for cut in cuts) for n in range(2)]
    known = _figures(parts(picture, shape=shape), boundary)
    slices = _figures(cuts, boundary)
    found = {}
    for name, value in _numbers(own).items():
        spread = [numbers[name] for numbers in known]
        made = [numbers[name] for numbers in slices]
        mean = float(np.mean(made)) if made else None
        if len(spread) < LEAST_COUNT or mean is None:
            found[name] = Metric(mean, None, None if made else False, value)
            continue
        low, high = value_band(spread, value, reference.sizes_of(measured, name))
        found[name] = Metric(mean, (low, high), low <= mean <= high, value)
    return found


def _cells_of(picture: Image, boundary: int | None = None) -> PlaneCells | None:
    try:
        return plane_cells(picture, boundary=boundary)
    except InputError:
        return None


def _figures(pictures: Iterable[Image], boundary: int) -> list[dict[str, float]]:
    """Return the figures of the pictures that hold cells."""
    found = (_cells_of(picture, boundary) for picture in pictures)
    return [_numbers(cells) for cells in found if cells is not None]


def _numbers(cells: PlaneCells) -> dict[str, float]:
    return {
        "cell_area": cells.mean_area,
        "cell_area_variation": cells.spread(cells.area) / cells.mean_area,
        "cell_neighbours": cells.mean_neighbours,
        "cell_triple_points": cells.triple_points,
        "cell_boundary_length": cells.boundary_length,
    }


def _closed(cells: PlaneCells, boundary: np.ndarray) -> float:
    """Return the share of the lines between cells that lie in the boundary."""
    labels, lines, within = cells.labels, 0, 0
    for here, there in (
        ((slice(1, None), slice(None)), (slice(None, -1), slice(None))),
        ((slice(None), slice(1, None)), (slice(None), slice(None, -1))),
    ):
        apart = labels[here] != labels[there]
        lines += int(np.count_nonzero(apart))
        within += int(np.count_nonzero(apart & (boundary[here] | boundary[there])))
    return within / max(1, lines)
