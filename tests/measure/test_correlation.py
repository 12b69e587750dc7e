"""Two-point function and lineal path: pairs counted one by one, and structures whose curves are known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

import trabecula as tb
from trabecula.measure import covariance_form, lineal_path, two_point


def counted(inside, r_max, *, spacing=(1, 1, 1), mask=None, periodic=(False,) * 3):
    """S2 by visiting every pair of voxels."""
    points = np.argwhere(np.ones(inside.shape, bool) if mask is None else mask)
    value = inside[tuple(points.T)]
    steps = np.array(spacing[-inside.ndim :]) / min(spacing[-inside.ndim :])
    shape = np.array(inside.shape)
    hits, pairs = np.zeros(r_max + 1), np.zeros(r_max + 1)
    for point, here in zip(points, value, strict=True):
        offset = points - point
        wrapped = (offset + shape // 2) % shape - shape // 2
        offset = np.where(periodic[-inside.ndim :], wrapped, offset)
        r = np.floor(np.sqrt(((offset * steps) ** 2).sum(axis=1)) + 0.5).astype(int)
        near = r <= r_max
        np.add.at(pairs, r[near], 1)
        np.add.at(hits, r[near], here & value[near])
    return hits / pairs


@settings(max_examples=25)
@given(
    arrays(bool, array_shapes(min_dims=2, max_dims=3, min_side=6, max_side=9)),
    st.sampled_from([(1, 1, 1), (2, 1, 1), (1, 1.5, 0.5)]),
    st.tuples(*[st.booleans()] * 3),
    st.booleans(),
    st.integers(0, 2**32 - 1),
)
def test_equals_pairs_counted_one_by_one(inside, spacing, periodic, masked, seed):
    # An even wrapped side has an offset that is its own mirror image: counted once by hand, twice by symmetry, in
    # hits and pairs alike, so only radii that such an offset cannot reach are compared when wrapped.
    r_max = 2 if any(periodic) else 5
    mask = np.random.default_rng(seed).random(inside.shape) < 0.8 if masked else None
    image = tb.Image(inside, "labels", spacing=spacing[-inside.ndim :])
    periodic = periodic[-inside.ndim :]
    result = two_point(image, r_max=r_max, periodic=periodic, mask=mask)
    expected = counted(inside, r_max, spacing=spacing, mask=mask, periodic=(False,) * (3 - inside.ndim) + periodic)
    np.testing.assert_allclose(result, expected, atol=1e-12)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("periodic", [False, True])
def test_along_an_axis_equals_shifted_copies(axis, periodic):
    rng = np.random.default_rng(axis)
    inside, mask = rng.random((10, 11, 12)) < 0.4, rng.random((10, 11, 12)) < 0.8
    both, sides = np.moveaxis(inside & mask, axis, 0), np.moveaxis(mask, axis, 0)
    for r, value in enumerate(two_point(inside, r_max=4, axis=axis, periodic=periodic, mask=mask)):
        stop = len(both) if periodic else len(both) - r
        hits = np.sum(both[:stop] & np.roll(both, -r, axis=0)[:stop])
        pairs = np.sum(sides[:stop] & np.roll(sides, -r, axis=0)[:stop])
        assert value == pytest.approx(hits / pairs, abs=1e-15)


def test_layers_have_a_triangle_wave_across_and_a_constant_along():
    layers = np.zeros((40, 24, 24), np.uint8)
    layers[np.arange(40) % 10 < 5] = 1
    across = two_point(layers, r_max=10, axis=0, periodic=True)
    np.testing.assert_allclose(across, np.abs(np.arange(11) - 5) / 10, atol=1e-15)
    np.testing.assert_allclose(two_point(layers, r_max=10, axis=1), 0.5, atol=1e-15)
    # Not wrapped, every pair that fits still counts alike: the share differs from 0.5 only by where the window ends.
    assert two_point(layers, r_max=10, axis=0)[10] == 0.5


def test_checkerboard_alternates():
    board = np.indices((16, 16, 16)).sum(axis=0) % 2
    assert two_point(board, r_max=4, axis=2).tolist() == [0.5, 0, 0.5, 0, 0.5]


def test_independent_voxels_give_phi_squared():
    s2 = two_point(np.random.default_rng(1).random((64, 64, 64)) < 0.3, r_max=20)
    np.testing.assert_allclose(s2[1:], 0.09, atol=2e-3)
    np.testing.assert_allclose(covariance_form(s2)[1:], 0, atol=1e-2)
    assert covariance_form(s2)[0] == 1


def test_overlapping_spheres_follow_their_formula():
    # Torquato 2002: outside overlapping spheres of radius R and density n, S2 = exp(-n V(r)), V the union of two
    # spheres.
    rng, side, radius, count = np.random.default_rng(2), 100, 9.0, 190
    solid = np.zeros((side,) * 3, bool)
    grid = np.indices(solid.shape)
    for centre in rng.random((count, 3)) * side:
        offset = np.abs(grid - centre[:, None, None, None])
        offset = np.minimum(offset, side - offset)
        solid |= (offset**2).sum(axis=0) < radius**2
    r = np.arange(31)
    union = 4 / 3 * np.pi * radius**3 * np.where(r < 2 * radius, 1 + 0.75 * r / radius - (r / radius) ** 3 / 16, 2)
    theory = np.exp(-count / side**3 * union)
    s2 = two_point(solid, r_max=30, phase="void", periodic=True)
    assert abs(s2[0] - theory[0]) < 0.03
    np.testing.assert_allclose(covariance_form(s2), covariance_form(theory), atol=0.06)


def test_two_dimensions_and_phases():
    image = tb.Image(
        np.arange(3)[np.random.default_rng(3).integers(0, 3, (40, 50))], "labels", phases=("void", "a", "b")
    )
    union = two_point(image, r_max=5)
    assert union[0] == pytest.approx(two_point(image, r_max=5, phase="a")[0] + two_point(image, r_max=5, phase=2)[0])
    np.testing.assert_allclose(union, counted(image.values > 0, 5), atol=1e-12)


def test_covariance_of_an_empty_phase_is_finite():
    assert covariance_form(two_point(np.zeros((8, 8, 8), np.uint8), r_max=3)).tolist() == [1, 0, 0, 0]


def test_what_does_not_fit_is_refused():
    solid = np.ones((8, 8, 8), bool)
    mask = np.zeros_like(solid)
    mask[4, 4, 4] = True
    for options in [
        {"r_max": 8, "axis": 0},
        {"r_max": 5, "axis": 0, "periodic": True},
        {"r_max": -1},
        {"r_max": 2, "axis": 3},
        {"r_max": 2, "mask": mask},
        {"r_max": 2, "mask": mask[:4]},
        {"r_max": 2, "periodic": (True, False)},
    ]:
        with pytest.raises(tb.errors.InputError):
            two_point(solid, **options)
    with pytest.raises(tb.errors.InputError, match="labels"):
        two_point(tb.Image(np.zeros((8, 8)), "grey"), r_max=2)


def test_a_volume_of_0_and_255_is_refused_and_not_measured_wrongly():
    with pytest.raises(tb.errors.InputError, match="0/255"):
        two_point(np.full((8, 8, 8), 255, np.uint8), r_max=2)


@settings(max_examples=25)
@given(arrays(bool, array_shapes(min_dims=2, max_dims=3, min_side=4, max_side=8)))
def test_lineal_path_equals_segments_counted_one_by_one(inside):
    hits, fits = np.zeros(4), np.zeros(4)
    for axis in range(inside.ndim):
        for line in np.moveaxis(inside, axis, 0).reshape(inside.shape[axis], -1).T:
            for r in range(4):
                segments = [line[i : i + r + 1].all() for i in range(len(line) - r)]
                hits[r] += sum(segments)
                fits[r] += len(segments)
    path = lineal_path(inside, r_max=3)
    np.testing.assert_allclose(path, hits / fits, atol=1e-15)


def test_lineal_path_of_layers_falls_linearly():
    layers = np.zeros((44, 8, 8), np.uint8)
    layers[np.arange(44) % 11 < 6] = 1
    # A segment of r + 1 voxels fits 6 - r times into a layer of 6, once per period of 11; the window holds 4 whole
    # periods.
    assert lineal_path(layers, r_max=6, axis=0).tolist() == pytest.approx([4 * (6 - r) / (44 - r) for r in range(7)])
    assert lineal_path(layers, r_max=6, axis=1).tolist() == pytest.approx([24 / 44] * 7)
