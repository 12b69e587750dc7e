"""What every measure does at the edge of its domain: arrays for images, thin images, wrong axes;
nothing is written to.
"""

from __future__ import annotations

import numpy as np
import pytest

import trabecula as tb
from trabecula.engine.parallel import threads
from trabecula.measure.effective_properties import physics_notes
from trabecula.numerics.transforms import fast_side, sums_by_offset

InputError = tb.errors.InputError


def test_describe_texture_wants_grey_levels_and_says_so():
    with pytest.raises(InputError, match="use describe"):
        tb.measure.describe_texture(np.ones((8, 8), bool))
    with pytest.raises(InputError, match="kind='grey'"):
        tb.measure.describe_texture(np.ones((8, 8)))


def test_describe_physics_takes_an_array_as_the_others_do():
    layers = np.zeros((6, 6, 6), np.uint8)
    layers[:, ::2] = 1
    found = tb.measure.describe_physics(layers)
    assert found["diffusivity"]["z"] == pytest.approx(0.5)
    assert found["tortuosity"]["y"] is None
    assert tb.measure.describe_physics(layers[0])["stiffness"] is None
    with pytest.raises(InputError, match="segment"):
        tb.measure.describe_physics(tb.Image(np.zeros((4, 4, 4)), "grey"))


def test_physics_is_told_in_the_order_of_the_axes_whichever_ends_first(monkeypatch):
    def backwards(work, length, **_):
        for at in reversed(range(length)):
            work(at, at + 1)

    monkeypatch.setattr("trabecula.measure.effective_properties.for_slabs", backwards)
    with threads(3):
        found = tb.measure.describe_physics(
            (np.random.default_rng(4).random((8, 8, 8)) < 0.3).astype(np.uint8)
        )
    for name in ("diffusivity", "tortuosity", "conductivity", "permeability"):
        assert list(found[name]) == ["z", "y", "x"]


def test_notes_tell_what_has_not_converged_even_without_a_flux():
    trust = {"converged": False, "imbalance": 0.25}
    notes = physics_notes(
        {
            "physics": {
                "permeability": {"z": {**trust, "imbalance": None}},
                "stiffness": {"all": trust},
            }
        }
    )
    assert notes == [
        "The permeability (z) has not converged: no steady flux was found.",
        "The stiffness (all) has not converged: its stress differs by 25.0% between sections.",
    ]


AXIS = {
    "two_point": lambda image, axis: tb.measure.two_point(image, r_max=1, axis=axis),
    "lineal_path": lambda image, axis: tb.measure.lineal_path(image, r_max=1, axis=axis),
    "correlation_length": lambda image, axis: tb.measure.correlation_length(image, axis=axis),
    "chord_length": lambda image, axis: tb.measure.chord_length(image, axis=axis),
    "percolating_fraction": lambda image, axis: tb.measure.percolating_fraction(image, axis=axis),
    "diffusivity": lambda image, axis: tb.measure.diffusivity(image, axis=axis),
}


@pytest.mark.parametrize("name", AXIS)
@pytest.mark.parametrize("axis", [3, -4, 1.5, True, "z"])
def test_an_axis_that_is_none_is_told_alike_by_all(name, axis):
    with pytest.raises(
        InputError,
        match=r"axis .* does not exist: the image has 3 axes, give 0 \(z\), 1 \(y\) or 2",
    ):
        AXIS[name](np.ones((4, 4, 4), np.uint8), axis)


@pytest.mark.parametrize("name", AXIS)
def test_a_negative_axis_counts_from_the_last(name):
    image = (np.random.default_rng(0).random((6, 7, 8)) < 0.6).astype(np.uint8)
    assert np.array_equal(
        np.array(AXIS[name](image, -3), object), np.array(AXIS[name](image, 0), object)
    )


def test_a_single_slice_is_told_to_be_given_as_2d():
    for measure in (
        tb.measure.minkowski,
        tb.measure.fabric,
        tb.measure.structure_tensor,
        tb.describe,
    ):
        with pytest.raises(InputError, match="2-D image"):
            measure(np.eye(8, dtype=np.uint8)[None])


def test_an_empty_mask_is_refused_by_all():
    image, mask = np.eye(8, dtype=np.uint8), np.zeros((8, 8), bool)
    for measure in (
        lambda: tb.measure.two_point(image, r_max=1, mask=mask),
        lambda: tb.measure.lineal_path(image, r_max=1, mask=mask),
        lambda: tb.measure.histogram(image, mask=mask),
        lambda: tb.measure.thickness(image, mask=mask),
        lambda: tb.measure.percolates(image, mask=mask),
    ):
        with pytest.raises(InputError, match="mark with True"):
            measure()


def test_sums_by_offset_are_the_sums_over_all_pairs():
    values = np.random.default_rng(3).normal(size=(7, 5)).astype(np.float32)
    sums = sums_by_offset(values, (3, 4))
    for y in range(-3, 4):
        for x in range(-4, 5):
            here = values[max(0, -y) : 7 - max(0, y), max(0, -x) : 5 - max(0, x)]
            there = values[max(0, y) : 7 + min(0, y), max(0, x) : 5 + min(0, x)]
            assert sums[3 + y, 4 + x] == pytest.approx(float((here * there).sum()), abs=1e-5)


def test_fast_sides_are_the_next_2_3_5_smooth_numbers():
    smooth = sorted(2**a * 3**b * 5**c for a in range(9) for b in range(6) for c in range(4))
    assert [fast_side(side) for side in range(1, 250)] == [
        min(s for s in smooth if s >= side) for side in range(1, 250)
    ]


@pytest.mark.whole
@pytest.mark.parametrize("count", [1, 3])
def test_nothing_is_written_to_the_callers_array(count):
    image = (np.random.default_rng(5).random((10, 12, 14)) < 0.5).astype(np.uint8)
    image.flags.writeable = False
    mask = np.ones(image.shape, bool)
    mask.flags.writeable = False
    with threads(count):
        for view in (image, image[::-1, :, ::-1], np.asfortranarray(image), image.astype(bool)):
            view.flags.writeable = False  # writing raises from here on
            tb.describe(view, r_max=4)
            tb.measure.morphometry(view, mask=mask, periodic=True)
            tb.measure.two_point_cluster(view, r_max=3, mask=mask, periodic=True)
            tb.measure.stiffness(view, box=6)
            tb.measure.permeability(view, axis=1, box=6)
    assert not image.flags.writeable


@pytest.mark.parametrize("periodic", ["yes", None, (True, None, 2), 3])
def test_periodic_is_true_or_false(periodic):
    with pytest.raises(InputError, match="give True or False"):
        tb.measure.components(np.ones((4, 4, 4), np.uint8), periodic=periodic)


@pytest.mark.parametrize("s2", [[], [[0.5, 0.4], [0.4, 0.3]], [np.nan, 0.3], "curve"])
def test_a_covariance_is_of_one_curve_of_numbers(s2):
    with pytest.raises(InputError, match="one row of finite numbers"):
        tb.measure.covariance_form(s2)


@pytest.mark.parametrize("scale", [1e-30, 1e-18, 1e18, 1e30])
def test_texture_does_not_know_the_unit_of_grey_levels(scale):
    """Take levels whose squares do not fit into float32."""
    values = np.random.default_rng(8).random((12, 14)).astype(np.float32)
    plain, scaled = (
        tb.Image(values, "grey"),
        tb.Image(values * np.float32(scale), "grey", spacing=1e-9),
    )
    for measure in (
        lambda i: tb.measure.autocorrelation(i, lags=4),
        lambda i: tb.measure.orientation(i).shares,
    ):
        np.testing.assert_allclose(measure(scaled), measure(plain), rtol=0, atol=1e-5)


@pytest.mark.parametrize("lags", [0, 2.5, "a", True])
def test_lags_are_whole_numbers(lags):
    with pytest.raises(InputError, match="lags"):
        tb.measure.autocorrelation(np.eye(4, dtype=np.uint8), lags=lags)


@pytest.mark.parametrize("bins", ["auto", 2.5, True])
def test_bins_are_a_number_or_edges(bins):
    with pytest.raises(InputError, match="bins"):
        tb.measure.histogram(tb.Image(np.random.default_rng(0).random((5, 5)), "grey"), bins=bins)


def test_an_infinite_bin_is_no_histogram():
    with pytest.raises(InputError, match="finite"):
        tb.measure.kullback_leibler([1, np.inf], [1, 1])


def test_a_contrast_that_float64_cannot_resolve_is_refused():
    image = np.random.default_rng(0).integers(0, 2, (6, 6, 6)).astype(np.uint8)
    with pytest.raises(InputError, match="give 0 for phases that insulate"):
        tb.measure.conductivity(image, conductivities={"void": 1e-16, "solid": 6e7}, axis=0)
    with pytest.raises(InputError, match="give a mapping"):
        tb.measure.conductivity(image, conductivities=[1, 2], axis=0)


def test_coherence_takes_one_distance():
    image = (np.random.default_rng(1).random((14, 14, 14)) < 0.4).astype(np.uint8)
    assert tb.measure.coherence(image, image, k=2, size=3, samples=30) == {2: 1.0}
