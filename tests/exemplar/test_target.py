"""Targets beside what an exemplar holds."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

import trabecula as tb
from trabecula.errors import RequestError
from trabecula.exemplar.target import check_target_porosity, porosity_range


@given(
    arrays.arrays(
        np.uint8,
        st.one_of(arrays.array_shapes(min_dims=2, max_dims=3, max_side=9)),
        elements=st.integers(0, 1),
    )
)
def test_the_range_is_that_of_every_window(values):
    widths = [max(1, side // 4) for side in values.shape]
    windows = np.lib.stride_tricks.sliding_window_view(values == 0, widths)
    means = windows.mean(axis=tuple(range(values.ndim, 2 * values.ndim)))
    low, high = porosity_range(tb.Image(values, "labels"))
    assert low == pytest.approx(means.min()) and high == pytest.approx(means.max())


def halves(low: int, high: int) -> tb.Image:
    """Left: `low` of 8 rows are void; right: `high` of 8."""
    rows = np.arange(32) % 8
    picture = np.ones((32, 32), np.uint8)
    picture[rows < low, :16] = 0
    picture[rows < high, 16:] = 0
    return tb.Image(picture, "labels")


def test_a_target_is_inside_what_the_exemplar_holds_somewhere():
    exemplar = halves(2, 5)
    for porosity in (0.25, 0.5, 0.625, np.full((3, 3, 3), 0.4, np.float32)):
        check_target_porosity({"porosity": porosity}, [exemplar])
    for porosity in (0.2, 0.7, np.linspace(0.3, 0.7, 27).reshape(3, 3, 3)):
        with pytest.raises(RequestError, match=r"0\.25 \.\. 0\.625"):
            check_target_porosity({"porosity": porosity}, [exemplar])
    check_target_porosity({"porosity": 0.7}, [exemplar, halves(4, 6)])
    check_target_porosity({}, [exemplar])


def test_volume_fraction_is_the_complement_and_some_may_lie_beyond():
    exemplar = halves(2, 5)  # 0.25 .. 0.625 is void
    check_target_porosity({"volume_fraction": 0.75}, [exemplar])
    with pytest.raises(RequestError, match=r"target porosity 0\.2 is outside"):
        check_target_porosity({"volume_fraction": 0.8}, [exemplar])
    for porosity in (0.125, 0.8125):
        check_target_porosity({"porosity": porosity}, [exemplar], beyond=0.5)
    for porosity in (0.12, 0.82):
        with pytest.raises(RequestError, match=r"0\.125 \.\. 0\.8125 can be made of it"):
            check_target_porosity({"porosity": porosity}, [exemplar], beyond=0.5)


def test_a_field_counts_inside_the_mask():
    field = np.full((3, 3, 3), 0.4, np.float32)
    field[0] = 0.9
    mask = np.ones((3, 3, 3), bool)
    mask[0] = False
    check_target_porosity({"porosity": field}, [halves(2, 5)], mask=mask)
    with pytest.raises(RequestError):
        check_target_porosity({"porosity": field}, [halves(2, 5)])


def test_void_is_a_name():
    picture = halves(2, 5)
    turned = tb.Image(1 - picture.values, "labels", phases=("solid", "void"))
    assert porosity_range(turned) == porosity_range(picture)


def test_grey_has_no_porosity():
    with pytest.raises(RequestError, match="grey"):
        check_target_porosity({"porosity": 0.3}, [tb.Image(np.eye(9), "grey")])
