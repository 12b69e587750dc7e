"""Two-point function: pairs count_pairs one by one, and what is refused."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

import trabecula as tb
from trabecula.engine.parallel import threads
from trabecula.measure.correlation import covariance_form, two_point


def count_pairs(inside, r_max, *, spacing=(1, 1, 1), mask=None, periodic=(False,) * 3):
    """Compute S2 by visiting every pair of voxels."""
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


@pytest.mark.whole
@settings(max_examples=25)
@given(
    arrays(bool, array_shapes(min_dims=2, max_dims=3, min_side=6, max_side=9)),
    st.sampled_from([(1, 1, 1), (2, 1, 1), (1, 1.5, 0.5)]),
    st.tuples(*[st.booleans()] * 3),
    st.booleans(),
    st.integers(0, 2**32 - 1),
)
def test_equals_pairs_counted_one_by_one(inside, spacing, periodic, masked, seed):
    r_max = 3 if any(periodic) else 5
    mask = np.random.default_rng(seed).random(inside.shape) < 0.8 if masked else None
    image = tb.Image(inside, "labels", spacing=spacing[-inside.ndim :])
    periodic = periodic[-inside.ndim :]
    result = two_point(image, r_max=r_max, periodic=periodic, mask=mask)
    expected = count_pairs(
        inside, r_max, spacing=spacing, mask=mask, periodic=(False,) * (3 - inside.ndim) + periodic
    )
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
    # Not wrapped, every pair that fits still counts alike: the share differs from 0.5 only by where
    # the window ends.
    assert two_point(layers, r_max=10, axis=0)[10] == 0.5


def test_checkerboard_alternates():
    board = np.indices((16, 16, 16)).sum(axis=0) % 2
    assert two_point(board, r_max=4, axis=2).tolist() == [0.5, 0, 0.5, 0, 0.5]


def test_independent_voxels_give_phi_squared():
    s2 = two_point(np.random.default_rng(1).random((64, 64, 64)) < 0.3, r_max=20)
    np.testing.assert_allclose(s2[1:], 0.09, atol=2e-3)
    np.testing.assert_allclose(covariance_form(s2)[1:], 0, atol=1e-2)
    assert covariance_form(s2)[0] == 1


def test_two_dimensions_and_phases():
    image = tb.Image(
        np.arange(3)[np.random.default_rng(3).integers(0, 3, (40, 50))],
        "labels",
        phases=("void", "a", "b"),
    )
    union = two_point(image, r_max=5)
    assert union[0] == pytest.approx(
        two_point(image, r_max=5, phase="a")[0] + two_point(image, r_max=5, phase=2)[0]
    )
    np.testing.assert_allclose(union, count_pairs(image.values > 0, 5), atol=1e-12)


def test_covariance_of_an_empty_phase_is_finite():
    assert covariance_form(two_point(np.zeros((8, 8, 8), np.uint8), r_max=3)).tolist() == [
        1,
        0,
        0,
        0,
    ]


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
        {"r_max": 2.5},
        {"r_max": 2, "axis": 0, "direction": (1, 0, 0)},
        {"r_max": 2, "direction": (1, 0)},
        {"r_max": 2, "direction": (0, 0, 0)},
        {"r_max": 2, "direction": (np.nan, 0, 1)},
        {"r_max": 2, "direction": "up"},
        {"r_max": 4, "direction": (0, 2, 1)},
        {"r_max": 3, "direction": (0, 2, 1), "periodic": True},
    ]:
        with pytest.raises(tb.errors.InputError):
            two_point(solid, **options)
    with pytest.raises(tb.errors.InputError, match="labels"):
        two_point(tb.Image(np.zeros((8, 8)), "grey"), r_max=2)


def test_a_volume_of_0_and_255_is_refused_and_not_measured_wrongly():
    with pytest.raises(tb.errors.InputError, match="0/255"):
        two_point(np.full((8, 8, 8), 255, np.uint8), r_max=2)


def lattice_count(inside, mask, offset, periodic):
    """Count the pairs in the phase and the pairs that fit, one `offset` apart."""
    hits = pairs = 0
    for here in np.argwhere(mask):
        there = here + offset
        if periodic:
            there %= inside.shape
        elif np.any(there < 0) or np.any(there >= inside.shape):
            continue
        if mask[tuple(there)]:
            pairs += 1
            hits += inside[tuple(here)] and inside[tuple(there)]
    return hits, pairs


@pytest.mark.parametrize("direction", [(1, 1, 0), (0, -1, 2), (2, 0, 0), (0, 0, -1), (-1, 1, 1)])
@pytest.mark.parametrize("periodic", [False, True])
def test_along_a_lattice_direction_only_its_own_offsets_count(direction, periodic):
    rng = np.random.default_rng(5)
    inside, mask = rng.random((9, 8, 10)) < 0.5, rng.random((9, 8, 10)) < 0.8
    s2 = two_point(inside, r_max=2, direction=direction, periodic=periodic, mask=mask)
    for r, value in enumerate(s2):
        hits, pairs = lattice_count(inside & mask, mask, r * np.array(direction), periodic)
        assert value == pytest.approx(hits / pairs, abs=1e-14)


@pytest.mark.parametrize("masked", [False, True])
def test_between_voxels_a_direction_interpolates_pairs(masked):
    rng = np.random.default_rng(6)
    inside = rng.random((9, 10)) < 0.5
    mask = rng.random((9, 10)) < 0.8 if masked else np.ones((9, 10), bool)
    # Sample 2 ends at (1.5, -0.5): a quarter each of the four voxels around it.
    corners = [
        lattice_count(inside & mask, mask, np.array(at), False)
        for at in ((1, 0), (1, -1), (2, 0), (2, -1))
    ]
    hits, pairs = np.sum(corners, axis=0)
    s2 = two_point(inside, r_max=2, direction=(0.75, -0.25), mask=mask if masked else None)
    assert s2[2] == pytest.approx(hits / pairs, abs=1e-14)


def test_a_tilted_wave_is_a_triangle_along_every_direction():
    # Half of a period lies in the phase; a step u along it advances it by wave . u of a period.
    wave = np.array([0.0, 1.0, 1.0]) / 16
    phase = np.tensordot(wave, np.indices((16, 48, 48)), 1) % 1
    solid = phase < 0.5
    for direction in [(0, 1, 1), (0, 1, -1), (0, 0.6, 0.8), (0.3, 0.9, -0.2)]:
        s2 = two_point(solid, r_max=12, direction=direction, periodic=(False, True, True))
        turn = np.arange(13) * np.dot(wave, direction) % 1
        theory = np.abs(turn - 0.5)
        np.testing.assert_allclose(
            s2, theory, atol=0.035 if np.any(np.array(direction) % 1) else 1e-12
        )


def test_a_direction_along_an_axis_is_that_axis():
    solid = np.random.default_rng(7).random((12, 13, 14)) < 0.4
    for axis in range(3):
        along = two_point(solid, r_max=8, axis=axis)
        unit = np.eye(3)[axis]
        assert two_point(solid, r_max=8, direction=unit).tolist() == along.tolist()
        assert two_point(solid, r_max=4, direction=-2 * unit).tolist() == along[::2].tolist()
        np.testing.assert_allclose(
            two_point(solid, r_max=16, direction=unit / 2)[::2], along, atol=1e-14
        )


def test_where_few_pairs_fit_they_are_still_counted_exactly():
    rng = np.random.default_rng(8)
    solid = rng.random((30, 31, 32)) < 0.9
    corners = np.zeros(solid.shape, bool)
    corners[:2, :2, :2] = corners[-2:, -2:, -2:] = corners[:2, -2:, :2] = True
    corners |= rng.random(solid.shape) < 0.02
    result = two_point(solid, r_max=31, mask=corners)
    np.testing.assert_allclose(result, count_pairs(solid & corners, 31, mask=corners), atol=1e-12)


def test_errors_of_float32_stay_below_a_millionth_wherever_pairs_are_few(monkeypatch):
    from trabecula.measure.correlation import pair_geometry

    def with_the_largest_error(first, second, *args, exact=False):
        counts = mirrored_counts(first, second, *args, exact=True)
        return counts if exact else counts + 5e-8 * np.count_nonzero(first)

    mirrored_counts = pair_geometry.count_mirror_pairs
    rng = np.random.default_rng(11)
    solid, sparse = rng.random((30, 31, 32)) < 0.7, rng.random((30, 31, 32)) < 0.03
    for options in [
        {"r_max": 31},
        {"r_max": 20, "mask": sparse},
        {"r_max": 10},
        {"r_max": 10, "mask": ~sparse},
    ]:
        truth = two_point(solid, **options)
        with monkeypatch.context() as patch:
            patch.setattr(pair_geometry, "count_mirror_pairs", with_the_largest_error)
            np.testing.assert_allclose(two_point(solid, **options), truth, rtol=0, atol=1.2e-6)
            assert two_point(solid | True, **options).max() <= 1


def test_a_distance_without_a_pair_is_told():
    mask = np.zeros((40, 8, 8), bool)
    mask[:3] = mask[-3:] = True
    with pytest.raises(tb.errors.InputError, match="lower r_max to 10"):
        two_point(np.ones(mask.shape, bool), r_max=20, mask=mask)
    with pytest.raises(tb.errors.InputError, match="mark with True"):
        two_point(np.ones(mask.shape, bool), r_max=20, mask=np.zeros_like(mask))


def test_float32_is_as_good_as_float64():
    from trabecula.measure.correlation.fourier import count_mirror_pairs

    # Nearly full: the largest counts beside which an error can hide.
    solid = np.random.default_rng(9).random((90, 100, 110)) < 0.97
    rough = count_mirror_pairs(solid, None, (20, 20, 20), (False, False, True))
    exact = count_mirror_pairs(solid, None, (20, 20, 20), (False, False, True), exact=True)
    np.testing.assert_allclose(rough, exact, rtol=0, atol=1e-7 * solid.sum())
    shifted = solid[:-3, 4:] & solid[3:, :-4]
    mirror = solid[:-3, :-4] & solid[3:, 4:]
    assert exact[3, 4, 0] == (shifted.sum() + mirror.sum()) / 2


def test_threads_change_nothing():
    solid = np.random.default_rng(10).random((40, 41, 42)) < 0.5
    curves = []
    for count in (1, 2, 5):
        with threads(count):
            curves.append(
                two_point(solid, r_max=15, mask=solid | (np.indices(solid.shape)[0] > 3)).tolist()
            )
    assert curves[0] == curves[1] == curves[2]


@pytest.mark.whole
@settings(max_examples=25)
@given(
    arrays(bool, array_shapes(min_dims=3, max_dims=3, min_side=5, max_side=9)),
    st.permutations(range(3)),
)
def test_turning_and_mirroring_change_nothing_radial(inside, order):
    s2 = two_point(inside, r_max=4)
    np.testing.assert_allclose(two_point(inside.transpose(order)[::-1], r_max=4), s2, atol=1e-14)
    phi, complement = s2[0], two_point(inside, r_max=2, phase="void", periodic=True)
    wrapped = two_point(inside, r_max=2, periodic=True)
    # Around a torus every voxel has as many partners: the void's curve is the solid's, moved.
    np.testing.assert_allclose(complement, wrapped + 1 - 2 * phi, atol=1e-12)


@pytest.mark.parametrize("direction", [(1, -1), (1, 2), (0, -1)])
def test_a_direction_that_runs_backwards_wraps_too(direction):
    values = np.random.default_rng(8).random((9, 11)) < 0.4
    found = two_point(values, r_max=2, direction=direction, periodic=True)
    shifted = [np.roll(values, [-r * d for d in direction], (0, 1)) for r in range(3)]
    assert found == pytest.approx([np.mean(values & there) for there in shifted])
