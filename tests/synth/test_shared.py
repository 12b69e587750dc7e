"""What methods share: fields of labels, pyramids, neighbourhoods, histograms."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import trabecula as tb
from trabecula.synth.shared.content.fields import FULL, phase_fields, quantise
from trabecula.synth.shared.content.histogram import Histogram, match_histogram
from trabecula.synth.shared.content.phase_fractions import brightest_voxels, labels_of
from trabecula.synth.shared.matching.neighbourhoods import SCALE, grid_reach, grid_shape, project
from trabecula.synth.shared.matching.principal_components import principal_basis
from trabecula.synth.shared.pyramid import double, fit_to, halve


def noise(shape, seed, dtype=np.int8):
    return np.random.default_rng(seed).integers(-FULL, FULL + 1, shape).astype(dtype)


def test_the_field_of_a_half_space_is_the_distance_to_its_face():
    values = np.zeros((12, 5, 5), np.uint8)
    values[6:] = 1
    fields, present = phase_fields(tb.Image(values, "labels"))
    assert present == (0, 1)
    assert fields.shape == (1, 12, 5, 5)
    assert np.allclose(fields[0, :, 2, 2], np.arange(12) - 5.5)


def test_fields_follow_anisotropic_voxels():
    values = np.zeros((12, 12, 12), np.uint8)
    values[6:] = 1
    fields, _ = phase_fields(tb.Image(values, "labels", spacing=(2, 1, 1)))
    step = fields[0, 9, 0, 0] - fields[0, 8, 0, 0]
    assert step == pytest.approx(2 / 2 ** (1 / 3), rel=1e-5)


def test_more_phases_have_a_field_each():
    values = np.zeros((9, 4, 4), np.uint8)
    values[3:6], values[6:] = 1, 3
    fields, present = phase_fields(tb.Image(values, "labels", phases=("void", "a", "b", "c")))
    assert present == (0, 1, 3)
    assert np.array_equal(np.asarray(present)[fields.argmax(0)], values)


def test_quantise_saturates_at_the_clip():
    field = np.array([-9.0, -5.0, -2.5, 0.0, 0.5, 5.0, 50.0], np.float32)
    assert quantise(field, clip=5).tolist() == [-127, -127, -64, 0, 13, 127, 127]


@given(seed=st.integers(0, 99), share=st.floats(0, 1))
def test_two_phases_split_to_the_voxel_whatever_the_ties(seed, share):
    # five levels: nearly everything is tied
    field = (noise((1, 7, 6, 5), seed) // 60).astype(np.int16)
    fractions = np.array([1 - share, share])
    labels = labels_of(field, (0, 2), fractions)
    assert set(np.unique(labels)) <= {0, 2}
    assert np.count_nonzero(labels == 2) == round(field.size * share)


def test_more_phases_come_out_in_their_fractions():
    rng = np.random.default_rng(0)
    fields = (rng.normal(size=(3, 24, 24, 24)) * 4000).astype(np.int16)
    wanted = np.array([0.6, 0.3, 0.1])
    labels = labels_of(fields, (0, 1, 2), wanted)
    assert np.allclose(np.bincount(labels.ravel()) / labels.size, wanted, atol=2e-3)


@given(seed=st.integers(0, 99), count=st.integers(0, 4 * 5 * 6))
def test_the_brightest_are_no_darker_than_the_rest(seed, count):
    field = noise((4, 5, 6), seed, np.int16) * 200
    chosen = brightest_voxels(field, count)
    assert np.count_nonzero(chosen) == count
    if 0 < count < field.size:
        mixed = mixed_values(field)
        assert mixed[chosen].min() >= mixed[~chosen].max()


def mixed_values(field):
    padded = np.pad(field.astype(np.int32), 1, mode="edge")
    around = sum(
        np.roll(padded, shift, axis)[1:-1, 1:-1, 1:-1] for axis in range(3) for shift in (-1, 1)
    )
    return (24 * field.astype(np.int32) + around) // 30


def test_a_matched_histogram_is_the_targets():
    rng = np.random.default_rng(1)
    field = (rng.normal(size=(20, 20, 20)) * 8000).astype(np.int16)
    target = np.sort(rng.integers(-100, 100, 8000)).astype(np.int8)
    matched = match_histogram(field, Histogram.of(target))
    assert np.abs(np.sort(matched.ravel()).astype(int) - target).max() <= 1
    order = np.argsort(mixed_values(field).ravel(), kind="stable")
    assert np.all(np.diff(matched.ravel()[order].astype(int)) >= 0), "the order of values is kept"


def test_halving_is_the_mean_of_eight():
    field = np.arange(64, dtype=np.float32).reshape(1, 4, 4, 4)
    expected = field.reshape(1, 2, 2, 2, 2, 2, 2).mean(axis=(2, 4, 6))
    assert np.allclose(halve(field), expected)
    assert halve(field[:, :3, :3, :3]).shape == (1, 2, 2, 2)


def test_doubling_a_ramp_gives_a_ramp_half_as_steep():
    ramp = np.broadcast_to(np.arange(-40, 40, 8, dtype=np.int8)[:, None, None], (10, 3, 3))[None]
    fine = double(np.ascontiguousarray(ramp))
    assert fine.shape == (1, 20, 6, 6)
    # Cell centres: fine cell k lies at (k + 1/2) / 2 - 1/2 of the coarse ones.
    expected = np.rint(-40 + 8 * ((np.arange(20) + 0.5) / 2 - 0.5))[1:-1]
    assert np.abs(fine[0, 1:-1, 3, 3] - expected).max() <= 0.5


@given(st.integers(1, 40), st.integers(1, 40))
def test_fit_to_keeps_the_near_corner(have, want):
    field = noise((1, have, 3, 3), have)
    fitted = fit_to(field, (want, 3, 3))
    common = min(have, want)
    assert fitted.shape == (1, want, 3, 3)
    assert np.array_equal(fitted[:, :common], field[:, :common])


@given(side=st.integers(1, 50), width=st.integers(4, 10), step=st.integers(1, 5))
def test_a_grid_covers_its_shape_with_less_than_a_step_to_spare(side, width, step):
    cube = {"box": (width,) * 3, "steps": (step,) * 3}
    grid = grid_shape((side,) * 3, **cube)
    covered = grid_reach(grid, **cube)[0]
    assert covered >= side
    assert covered - max(side, width) < step


def test_projections_are_exact_sums():
    field = noise((2, 14, 13, 12), 3)
    basis = principal_basis(field, width=6, variance=0.9, most=24)
    features = project(field, basis, step=2)
    window = field[:, 4:10, 2:8, 6:12].reshape(-1).astype(np.int64)
    exact = window @ basis.vectors.astype(np.int64)
    assert np.abs(exact).max() < 2**24
    assert np.array_equal(
        features[2, 1, 3], np.rint(exact.astype(np.float32) * np.float32(SCALE / basis.scale))
    )


@pytest.mark.whole
def test_distances_of_features_are_those_of_neighbourhoods():
    field = quantise(phase_fields(tb.crop(tb.sample("foam"), 20))[0], clip=5)
    # every component: nothing is lost
    basis = principal_basis(field, width=4, variance=1.0, most=64)
    features = project(field, basis, step=1).astype(np.int64)
    a, b = features[1, 2, 3], features[9, 8, 7]
    windows = [
        field[0, z : z + 4, y : y + 4, x : x + 4].astype(np.int64)
        for z, y, x in ((1, 2, 3), (9, 8, 7))
    ]
    assert ((a - b) ** 2).sum() == pytest.approx(
        SCALE**2 * ((windows[0] - windows[1]) ** 2).sum(), rel=2e-3
    )


def test_the_basis_is_that_of_the_covariance():
    field = noise((1, 12, 12, 12), 4)
    basis = principal_basis(field, width=4, variance=0.5, most=64)
    rows = (
        np.lib.stride_tricks.sliding_window_view(field[0], (4, 4, 4)).reshape(-1, 64).astype(float)
    )
    values = np.linalg.eigvalsh(np.cov(rows.T))[::-1]
    count = basis.vectors.shape[1]
    assert np.cumsum(values)[count - 1] / values.sum() == pytest.approx(basis.explained, abs=1e-6)
    assert basis.explained >= 0.5 > np.cumsum(values)[count - 2] / values.sum()
    gram = basis.vectors.T @ basis.vectors / basis.scale**2
    assert np.allclose(gram, np.eye(count), atol=1e-3)


def test_ranks_of_another_size_take_the_values_of_their_share():
    histogram = Histogram.of(np.array([3, 3, 8, 8]))
    assert histogram.values_at(np.array([10, 60, 90]), 100).tolist() == [3, 8, 8]
