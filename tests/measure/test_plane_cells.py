"""Cells of a picture: known walls, gaps, the edge, and Euler's relation."""

import numpy as np
import pytest

import trabecula as tb
from trabecula.core.errors import InputError
from trabecula.measure.plane_cells import boundary_phase, plane_cells


def _bricks(height=8, width=12, rows=9, columns=7):
    """Bricks whose rows are shifted by half: every cell has six neighbours."""
    values = np.zeros((rows * height + 1, columns * width + 1), np.uint8)
    values[::height] = 1
    for row in range(rows):
        shift = (row % 2) * width // 2
        values[row * height : (row + 1) * height, shift::width] = 1
    return values


def test_cells_of_a_wall_of_bricks():
    found = plane_cells(np.ascontiguousarray(_bricks()[4:-4, 6:-6]))
    inner = found.inside
    assert np.median(found.area[inner]) == 8 * 12
    assert (found.neighbours[inner] == 6).all()
    assert found.mean_area == pytest.approx(96)
    assert found.density == pytest.approx(1 / 96, rel=0.15)  # rows end at the edge
    # two triple points and 20 pixels of lines for each brick
    assert found.triple_points == pytest.approx(2 / 96, rel=0.1)
    # lines along the axes alone: crossings along rows and columns, and along diagonals
    expected = np.pi / 2 * (20 / 96 + 2 * (20 / 96) / np.sqrt(2)) / 4
    assert found.boundary_length == pytest.approx(expected, rel=0.08)
    assert found.mean(found.aspect) == pytest.approx(12 / 8, rel=0.03)


def test_gaps_are_bridged_and_wide_ones_are_not():
    values = _bricks(12, 18)
    values[12, 5:9] = 0
    assert len(plane_cells(values)) == len(plane_cells(_bricks(12, 18)))
    values[13:24, 45] = 0
    assert len(plane_cells(values)) == len(plane_cells(_bricks(12, 18))) - 1
    assert len(plane_cells(values, neck=0.05)) < len(plane_cells(values, neck=1.0))


@pytest.mark.whole
def test_weights_take_out_that_the_edge_cuts_large_cells_more_often():
    random = np.random.default_rng(1)
    seeds = random.random((220, 2)) * 160
    y, x = np.mgrid[:160, :160]
    owner = ((y[..., None] - seeds[:, 0]) ** 2 + (x[..., None] - seeds[:, 1]) ** 2).argmin(-1)
    walls = np.zeros((160, 160), np.uint8)
    walls[1:] |= owner[1:] != owner[:-1]
    walls[:, 1:] |= owner[:, 1:] != owner[:, :-1]
    whole = plane_cells(walls)
    places = [(a, b) for a in range(0, 160, 40) for b in range(0, 160, 40)]
    windows = [plane_cells(np.ascontiguousarray(walls[a : a + 40, b : b + 40])) for a, b in places]
    weighted = np.mean([c.density for c in windows])
    plain = np.mean([1 / c.area[c.inside].mean() for c in windows])
    known = whole.triple_points / 2
    assert abs(weighted - known) < abs(plain - known)
    assert whole.mean_neighbours == pytest.approx(6, abs=0.25)


def test_boundary_is_the_phase_whose_rest_falls_into_cells():
    values = _bricks()
    assert boundary_phase(tb.Image(values, "labels")) == 1
    assert boundary_phase(tb.Image(1 - values, "labels")) == 0


def test_lengths_are_in_the_pictures_unit():
    values = _bricks()
    image = tb.Image(values, "labels", (0.5, 0.5), "um", ("void", "solid"))
    fine, plain = plane_cells(image), plane_cells(values)
    assert fine.mean_area == pytest.approx(plain.mean_area / 4)
    assert fine.boundary_length == pytest.approx(plain.boundary_length * 2)
    assert fine.triple_points == pytest.approx(plain.triple_points * 4)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (np.zeros((20, 20), np.uint8), "one phase alone"),
        (np.eye(20, dtype=np.uint8), "no cells found|larger than a third"),
        (np.zeros((4, 20, 20), np.uint8), "take a slice"),
    ],
)
def test_what_holds_no_cells_is_refused(values, message):
    with pytest.raises(InputError, match=message):
        plane_cells(values)
