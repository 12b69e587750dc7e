"""Cross-phase two-point probability: pairs count_pairs one by one, and its sums over phases."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

import trabecula as tb
from trabecula.measure.correlation import cross_correlation, two_point

NAMES = ("void", "binder", "active")


def count_pairs(labels, i, j, r_max, mask, spacing, periodic):
    """Compute S_ij by visiting every ordered pair of voxels."""
    points = np.argwhere(mask)
    value = labels[tuple(points.T)]
    steps, shape = np.array(spacing) / min(spacing), np.array(labels.shape)
    hits, pairs = np.zeros(r_max + 1), np.zeros(r_max + 1)
    for point, here in zip(points, value, strict=True):
        offset = points - point
        offset = np.where(periodic, (offset + shape // 2) % shape - shape // 2, offset)
        r = np.floor(np.sqrt(((offset * steps) ** 2).sum(axis=1)) + 0.5).astype(int)
        near = r <= r_max
        np.add.at(pairs, r[near], 1)
        np.add.at(hits, r[near], (here == i) & (value[near] == j))
    return hits / pairs


@settings(max_examples=25)
@given(
    arrays(
        np.uint8,
        array_shapes(min_dims=2, max_dims=3, min_side=6, max_side=8),
        elements=st.integers(0, 2),
    ),
    st.booleans(),
    st.tuples(st.integers(0, 2), st.integers(0, 2)),
    st.integers(0, 2**32 - 1),
)
def test_equals_pairs_counted_one_by_one(labels, periodic, phases, seed):
    spacing = (1.5, 1.0, 0.75)[: labels.ndim]
    mask = np.random.default_rng(seed).random(labels.shape) < 0.85
    image = tb.Image(labels, "labels", spacing=spacing, phases=NAMES)
    i, j = phases
    result = cross_correlation(image, first=i, second=j, r_max=3, mask=mask, periodic=periodic)
    np.testing.assert_allclose(
        result, count_pairs(labels, i, j, 3, mask, spacing, periodic), atol=1e-12
    )


@pytest.mark.parametrize(
    "options", [{}, {"axis": 1}, {"direction": (1, 0, 1)}, {"direction": (0.5, 0.7, -0.1)}]
)
@pytest.mark.parametrize("periodic", [False, True])
def test_sums_over_phases(options, periodic):
    labels = np.random.default_rng(1).integers(0, 3, (12, 14, 16)) % 3
    labels[3:7] = 1
    mask = None if periodic else np.random.default_rng(2).random(labels.shape) < 0.8
    image = tb.Image(labels, "labels", phases=NAMES)
    options = {**options, "r_max": 6, "periodic": periodic, "mask": mask}
    table = np.array(
        [
            [cross_correlation(image, first=i, second=j, **options) for j in range(3)]
            for i in range(3)
        ]
    )
    np.testing.assert_allclose(table.sum(axis=(0, 1)), 1, atol=1e-12)
    np.testing.assert_array_equal(table, table.transpose(1, 0, 2))
    np.testing.assert_array_equal(table[..., 0] * (1 - np.eye(3)), 0)
    for i in range(3):
        np.testing.assert_allclose(table[i, i], two_point(image, phase=i, **options), atol=1e-12)
        if periodic:
            np.testing.assert_allclose(table[i].sum(axis=0), np.mean(labels == i), atol=1e-12)


def test_layers_of_three_phases_follow_each_other():
    labels = np.broadcast_to(np.repeat(np.arange(30) % 3, 4)[:, None, None], (120, 6, 6))
    image = tb.Image(labels, "labels", phases=NAMES)
    r = np.arange(13)
    # Phase 1 begins one layer (4 voxels) above phase 0: layers of period 12 overlap by 4 - |r - 4|
    # of 12, either way.
    up, down = (np.maximum(0, 4 - np.abs((r - shift + 6) % 12 - 6)) / 12 for shift in (4, -4))
    result = cross_correlation(
        image, first="void", second="binder", r_max=12, axis=0, periodic=True
    )
    np.testing.assert_allclose(result, (up + down) / 2, atol=1e-14)
    np.testing.assert_array_equal(cross_correlation(image, first=0, second=1, r_max=2, axis=1), 0)


def test_independent_phases_give_the_product_of_fractions():
    labels = np.random.default_rng(3).choice(3, (70, 70, 70), p=[0.5, 0.3, 0.2])
    s01 = cross_correlation(labels, first=0, second=1, r_max=12)
    np.testing.assert_allclose(s01[1:], 0.15, atol=2e-3)


def test_a_real_electrode_keeps_its_sums(data):
    electrode = tb.labels(tb.read(data / "electrode_3phase_a.tif").values[:48, :64, :56])
    table = [
        [cross_correlation(electrode, first=i, second=j, r_max=20) for j in range(3)]
        for i in range(3)
    ]
    np.testing.assert_allclose(np.sum(table, axis=(0, 1)), 1, atol=1e-12)
    # Ends in phase 0, by brute shifts along one axis.
    s01 = cross_correlation(electrode, first=0, second=1, r_max=5, axis=2)
    void, other = electrode.values == 0, electrode.values == 1
    for r in range(1, 6):
        both = np.mean(void[..., r:] & other[..., :-r]) + np.mean(void[..., :-r] & other[..., r:])
        assert s01[r] == pytest.approx(both / 2, abs=1e-14)


def test_phases_that_do_not_exist_are_refused():
    labels = np.zeros((8, 8, 8), np.uint8)
    with pytest.raises(tb.errors.InputError, match="binder"):
        cross_correlation(labels, first="void", second="binder", r_max=2)
    with pytest.raises(tb.errors.InputError, match="phase 5"):
        cross_correlation(labels, first=5, second=0, r_max=2)
