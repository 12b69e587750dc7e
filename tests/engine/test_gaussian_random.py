"""Normal numbers by coordinate: their distribution, and that every coordinate has its own."""

import numpy as np
from scipy.stats import kstest, norm

from trabecula.core.seeds import key
from trabecula.engine.gaussian_random import ONE, normal_cells, normal_line, quantiles

KEY = key(3, "test")


def cells(corner, shape, periods=(0, 0, 0)):
    made = np.empty(shape, np.float32)
    normal_cells(made, KEY, np.array(corner), np.array(periods), quantiles())
    return made


def test_quantiles_are_the_normal_distributions():
    """Oracle: SciPy's inverse, at double precision; none so near to a half that a last bit could
    decide how it is rounded.
    """
    exact = norm.ppf((np.arange(65536) + 0.5) / 65536) * ONE
    table = quantiles()
    assert np.array_equal(table, np.rint(exact)) and np.array_equal(table, -table[::-1])
    assert np.abs(np.abs(exact - np.floor(exact)) - 0.5).min() > 1e-9
    assert np.array_equal(quantiles(256), np.rint(exact / ONE * 256))


def test_cells_are_standard_normal_and_independent():
    made = cells((0, 0, 0), (11, 20, 20, 20))
    assert kstest(made.ravel(), norm.cdf).pvalue > 0.01
    flat = made.reshape(11, -1)
    assert np.abs(np.corrcoef(flat) - np.eye(11)).max() < 0.05
    for axis in (1, 2, 3):
        ahead, behind = made.take(range(1, 20), axis).ravel(), made.take(range(19), axis).ravel()
        assert abs(np.corrcoef(ahead, behind)[0, 1]) < 0.02


def test_a_cell_is_its_coordinates_alone():
    whole = cells((-3, -2, -9), (9, 8, 7, 12))
    assert np.array_equal(cells((-1, 0, -4), (9, 3, 2, 5)), whole[:, 2:5, 2:4, 5:10])
    assert np.array_equal(cells((-1, 0, -4), (4, 3, 2, 5)), whole[:4, 2:5, 2:4, 5:10])


def test_a_period_repeats():
    made = cells((-4, 0, 2), (3, 9, 6, 10), periods=(4, 0, 5))
    assert np.array_equal(made[:, 4:], made[:, :-4]) and np.array_equal(
        made[..., 5:], made[..., :-5]
    )
    assert np.array_equal(made[:, 4:8], cells((0, 0, 2), (3, 4, 6, 10), periods=(0, 0, 5)))


def test_a_line_is_its_coordinates_alone():
    whole = np.empty(50)
    normal_line(whole, KEY, 2, -5, -20, 0, quantiles())
    part = np.empty(11)
    normal_line(part, KEY, 2, -5, -9, 0, quantiles())
    assert np.array_equal(part, whole[11:22])
    normal_line(part, KEY, 2, -5, 3, 7, quantiles())
    assert np.array_equal(part[7:], part[:4]) and np.array_equal(part[4:11], whole[20:27])
