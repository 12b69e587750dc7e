"""The Gaussian field: its theory against known integrals, and its fields against the two-point
functions they were made for.
"""

import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import multivariate_normal, norm

import trabecula as tb
from trabecula.core.seeds import key
from trabecula.engine.gaussian_random import quantiles
from trabecula.engine.memory import check_releases
from trabecula.errors import InputError, RequestError
from trabecula.measure.correlation import two_point
from trabecula.synth.noise.config import NoiseConfig
from trabecula.synth.noise.covariance import (
    counts_by_offset,
    fit_filter,
    joint_probability,
)
from trabecula.synth.noise.fields import Phases
from trabecula.synth.shared.gaussian.field import integer_filter, white_plane
from trabecula.synth.shared.gaussian.filters import radial_mean


def exponential(shape, *, scale, seed, fraction=0.5, cover=40):
    """A cut Gaussian field with covariance exp(-r / scale), periodic, by the textbook's route: an
    oracle of its own.
    """
    far = [np.minimum(np.arange(side), side - np.arange(side)) for side in shape]
    r = np.sqrt(sum(part.astype(float) ** 2 for part in np.ix_(*far)))
    power = np.maximum(np.fft.fftn(np.exp(-r / scale)).real, 0)
    white = np.fft.fftn(np.random.default_rng(seed).normal(size=shape))
    field = np.fft.ifftn(white * np.sqrt(power)).real
    return (field > np.quantile(field, 1 - fraction)).astype(np.uint8)


def relative(made, wanted):
    return np.linalg.norm(made - wanted) / np.linalg.norm(wanted)


@given(fraction=st.floats(0.02, 0.98), covariance=st.floats(-0.95, 0.99))
def test_the_joint_probability_is_the_bivariate_normals(fraction, covariance):
    """Compare with SciPy's bivariate normal distribution."""
    angle, table = joint_probability(fraction)
    t = norm.isf(fraction)
    wanted = multivariate_normal.cdf([-t, -t], cov=[[1, covariance], [covariance, 1]])
    assert np.interp(np.arcsin(covariance), angle, table) == pytest.approx(wanted, abs=2e-6)
    assert table[-1] == pytest.approx(fraction, abs=1e-6)
    assert table[0] == pytest.approx(max(0, 2 * fraction - 1), abs=1e-6)
    assert np.all(np.diff(table) >= 0)


def test_half_and_half_is_the_arcsine():
    angle, table = joint_probability(0.5)
    assert np.allclose(table, 0.25 + angle / (2 * np.pi), atol=1e-9)


def test_pairs_are_counted_at_every_offset():
    inside = np.random.default_rng(0).random((7, 6, 9)) < 0.4
    counts = counts_by_offset(inside, (3, 2, 4))
    for dz, dy, dx in [(0, 0, 0), (3, -2, 4), (-1, 2, -3), (2, 0, 1)]:
        pairs = sum(
            inside[z, y, x] and inside[z + dz, y + dy, x + dx]
            for z, y, x in np.ndindex(inside.shape)
            if 0 <= z + dz < 7 and 0 <= y + dy < 6 and 0 <= x + dx < 9
        )
        assert counts[dz + 3, dy + 2, dx + 4] == pairs


def test_the_filter_has_the_covariance_it_was_made_for():
    """S2 of a field with a Gaussian covariance, which is realisable: nothing to clip, and the
    filter's autocorrelation is it.
    """
    r = np.arange(-20, 21.0)
    square = r[:, None, None] ** 2 + r[:, None] ** 2 + r**2
    covariance = np.exp(-square / (2 * 2.5**2))
    angle, table = joint_probability(0.3)
    two_points = np.interp(np.arcsin(np.minimum(covariance, 1)), angle, table)
    made = fit_filter(two_points, 0.3, corrections=20)
    assert made.clipped < 0.01
    found = np.fft.fftshift(np.fft.ifftn(np.abs(np.fft.fftn(made.values)) ** 2).real)
    assert np.abs(found - covariance).max() < 0.01


def white(shape, *, z=5, corner=(0, 0), periods=(0, 0), stage="noise/0"):
    plane = np.empty(shape)
    white_plane(plane, key(1, stage), z, np.array(corner), np.array(periods), quantiles(256))
    return plane


def test_white_noise_is_standard_normal_and_by_coordinate():
    plane = white((300, 302))
    assert np.array_equal(plane, np.rint(plane))
    plane = plane / 256
    assert abs(plane.mean()) < 0.015 and abs(plane.std() - 1) < 0.01
    assert abs(np.mean(plane**4) - 3) < 0.15
    assert (
        abs(np.mean(plane[:, 1:] * plane[:, :-1])) < 0.015
        and abs(np.mean(plane[1:] * plane[:-1])) < 0.015
    )
    assert np.array_equal(white((40, 33), corner=(7, 13)), 256 * plane[7:47, 13:46])
    assert abs(np.corrcoef(white((40, 33), z=6).ravel(), plane[:40, :33].ravel())[0, 1]) < 0.1
    round_and_round = white((25, 41), corner=(-3, -50), periods=(10, 17))
    assert np.array_equal(round_and_round[10:], round_and_round[:-10])
    assert np.array_equal(round_and_round[3:13, 16:33], white((10, 17)))


def test_a_voxel_is_the_sum_over_the_filter_to_the_last_bit():
    """Compare with the convolution, in whole numbers, voxel by voxel."""
    model = tb.method("noise", reach=4).fit(
        exponential((24, 24, 24), scale=2, seed=9, fraction=0.4)
    )
    values = model.generate((9, 8, 10), seed=1).values
    weights = integer_filter(model.filters[0]).astype(np.int64)
    noise = np.stack([white((16, 18), z=z, corner=(-4, -4)) for z in range(-4, 13)]).astype(
        np.int64
    )
    field = np.array(
        [
            np.sum(weights[::-1, ::-1, ::-1] * noise[z : z + 9, y : y + 9, x : x + 9])
            for z, y, x in np.ndindex(9, 8, 10)
        ]
    ).reshape(9, 8, 10)
    fraction = model.phases.fractions[0]
    spread = np.sqrt(np.sum(weights**2.0)) * 256
    assert np.array_equal(
        values == 0,
        field > norm.isf(fraction) * spread * np.sqrt(np.mean((quantiles(256) / 256.0) ** 2)),
    )


@pytest.mark.parametrize("phases", [2, 3])
def test_how_a_volume_is_cut_does_not_matter(monkeypatch, phases):
    exemplar = np.random.default_rng(0).integers(0, phases, (16, 16, 16))
    model = tb.method("noise", reach=5).fit(exemplar)
    whole = {
        wraps: model.generate((30, 26, 21), seed=3, periodic=wraps).values
        for wraps in (False, True)
    }
    ranked = tb.method("noise", reach=5, exact=True).fit(exemplar)
    exact = ranked.generate((30, 26, 21), seed=3).values
    monkeypatch.setattr("trabecula.synth.shared.gaussian.field.PIECE", 11)
    for wraps, values in whole.items():
        assert np.array_equal(model.generate((30, 26, 21), seed=3, periodic=wraps).values, values)
    assert np.array_equal(ranked.generate((30, 26, 21), seed=3).values, exact)


@pytest.mark.whole
def test_the_fraction_is_exact_and_the_two_point_function_is_kept():
    """Known truth: an exponential covariance at phi = 1/2, along an axis S2 = 1/4 + arcsin(exp(-r /
    2)) / (2 pi).
    """
    exemplar = exponential((64, 64, 64), scale=2, seed=1)
    material = tb.method("noise", exact=True).fit(exemplar).generate(80, seed=3)
    assert np.count_nonzero(material.values) == 80**3 // 2
    wanted = 0.25 + np.arcsin(np.exp(-np.arange(16) / 2)) / (2 * np.pi)
    along = np.mean([two_point(material, r_max=15, axis=axis) for axis in range(3)], axis=0)
    assert relative(along, wanted) < 0.015
    assert relative(two_point(material, r_max=15), two_point(exemplar, r_max=15)) < 0.02


def test_fractions_are_right_in_the_mean_and_scatter_as_windows_do():
    exemplar = exponential((40, 40, 40), scale=2, seed=1, fraction=0.3)
    model = tb.method("noise", reach=10).fit(exemplar)
    shares = [
        model.window(400, [(40 * i, 40 * i + 40), (0, 40), (0, 40)], seed=2).mean()
        for i in range(12)
    ]
    error = np.std(shares) / np.sqrt(12)
    assert 0.004 < np.std(shares) < 0.03
    assert np.mean(shares) == pytest.approx(exemplar.mean(), abs=3 * error)


def test_exact_shares_have_no_windows():
    model = tb.method("noise", reach=4, exact=True).fit(
        np.random.default_rng(0).integers(0, 2, (12, 12, 12))
    )
    with pytest.raises(RequestError, match="leave exact out"):
        model.window(20, [(0, 4)] * 3)
    with pytest.raises(RequestError, match="leave exact out"):
        model.plan_block(tb.Request(20), 128)


@pytest.mark.whole
@pytest.mark.parametrize("exact", [False, True])
def test_the_forecast_holds_for_many_pieces(monkeypatch, exact):
    monkeypatch.setattr("trabecula.synth.shared.gaussian.field.PIECE", 40)
    exemplar = np.random.default_rng(0).integers(0, 2, (40, 40, 40))
    model = tb.method("noise", reach=15, corrections=2, exact=exact).fit(exemplar)
    request = tb.Request((100, 75, 80), seed=1)
    # what several hold at the same moment is up to chance, and the forecast counts all of it
    with tb.threads(1):
        plan = model.plan(request)
        tracemalloc.start()
        model.generate(request)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert (
        peak
        <= plan.peak - plan.memory["interpreter and kernels"] - plan.memory["exemplar"]
        <= 1.5 * peak
    )


@pytest.mark.parametrize("exact", [False, True])
def test_no_array_outlives_its_stage(exact):
    exemplar = np.random.default_rng(0).integers(0, 3, (20, 20, 20))
    model = tb.method("noise", reach=4, corrections=2, exact=exact).fit(exemplar)
    whole = model.generate(30, seed=1).values
    with check_releases():
        assert np.array_equal(model.generate(30, seed=1).values, whole)


@pytest.mark.whole
def test_anisotropy_is_kept():
    exemplar = np.repeat(exponential((24, 64, 64), scale=2.5, seed=2, fraction=0.3), 3, axis=0)[:64]
    material = tb.method("noise", exact=True).fit(exemplar).generate(72, seed=0)
    for axis in range(3):
        made, wanted = (two_point(image, r_max=15, axis=axis) for image in (material, exemplar))
        assert relative(made, wanted) < 0.04
    assert two_point(material, r_max=6, axis=0)[6] > 1.15 * two_point(material, r_max=6, axis=1)[6]


@pytest.mark.whole
def test_three_phases_keep_fractions_and_two_point_functions():
    first = exponential((60, 60, 60), scale=4, seed=4, fraction=0.5)
    second = exponential((60, 60, 60), scale=2, seed=5, fraction=0.4)
    exemplar = np.where(first == 1, 0, 1 + second).astype(np.uint8)
    material = tb.method("noise", exact=True).fit(exemplar).generate(72, seed=1)
    shares = np.bincount(exemplar.ravel()) / exemplar.size
    made = np.bincount(material.values.ravel())
    assert np.abs(made - shares * material.values.size).max() <= 1
    for phase in range(3):
        wanted = two_point(exemplar, r_max=12, phase=phase)
        assert relative(two_point(material, r_max=12, phase=phase), wanted) < 0.06


def test_periodic_faces_meet():
    exemplar = exponential((48, 48, 48), scale=5, seed=6)
    model = tb.method("noise").fit(exemplar)
    for axis in range(3):
        periodic = [i == axis for i in range(3)]
        values = model.generate((40, 45, 50), seed=2, periodic=periodic).values.astype(int)
        changes = [np.mean(np.abs(np.diff(values, axis=i))) for i in range(3)]
        seams = [np.mean(np.abs(values.take(0, i) - values.take(-1, i))) for i in range(3)]
        for i in range(3):
            if periodic[i]:
                assert abs(seams[i] - changes[i]) < 0.08
            else:
                assert seams[i] > 2 * changes[i]


def test_a_box_smaller_than_the_filter_is_still_periodic():
    exemplar = exponential((48, 48, 48), scale=2, seed=6)
    values = (
        tb.method("noise")
        .fit(exemplar)
        .generate((20, 16, 18), seed=2, periodic=True)
        .values.astype(int)
    )
    change = np.mean(np.abs(np.diff(values, axis=0)))
    assert abs(np.mean(np.abs(values[0] - values[-1])) - change) < 0.12


def test_a_flat_image_makes_flat_images():
    flat = exponential((1, 128, 128), scale=4, seed=7, fraction=0.4)
    made = tb.method("noise").fit(flat).generate((1, 160, 160), seed=0)
    assert made.shape == (1, 160, 160)
    for axis in (1, 2):
        assert (
            relative(two_point(made, r_max=15, axis=axis), two_point(flat, r_max=15, axis=axis))
            < 0.1
        )


@pytest.mark.whole
def test_bone_has_the_fraction_and_the_two_point_function_and_is_broken(bone):
    exemplar = tb.crop(bone, 64)
    made = tb.method("noise", exact=True).fit(exemplar).generate(64, seed=1)
    assert relative(two_point(made, r_max=25), two_point(exemplar, r_max=25)) < 0.08
    assert tb.measure.components(made) > 5 * tb.measure.components(exemplar)


def test_settings_out_of_range_are_refused():
    for name, value in [("kind", "pink"), ("reach", 3), ("reach", 2.5), ("corrections", -1)]:
        with pytest.raises(InputError, match=name):
            NoiseConfig(**{name: value})


@pytest.mark.parametrize("shape", [(4, 30, 30), (30, 30, 7)])
def test_a_thin_exemplar_is_refused(shape):
    with pytest.raises(InputError, match="8 voxels"):
        tb.method("noise").fit(np.random.default_rng(0).integers(0, 2, shape))


def test_averaged_keeps_what_depends_on_length_alone_and_forgets_direction():
    z, y, x = (part.astype(float) for part in np.ogrid[-6:7, -6:7, -6:7])
    length = np.sqrt(z**2 + y**2 + x**2)
    found = radial_mean(0.5 - length * 0.01, np.ones(length.shape), (6, 6, 6))
    near = length < 10  # beyond the mean length of the last bin S2 stays as it is there
    np.testing.assert_allclose(found[near], (0.5 - length * 0.01)[near], atol=1e-9)
    plane = radial_mean((0.5 - length * 0.01)[6:7] * 3, np.full((1, 13, 13), 3.0), (4, 4, 4))
    assert plane.shape == (9, 9, 9) and plane[4, 4, 6] == pytest.approx(0.48) == pytest.approx(
        plane[6, 4, 4]
    )
    leaning = radial_mean(np.broadcast_to(x, (13, 13, 13)) ** 2, np.ones((13, 13, 13)), (6, 6, 6))
    np.testing.assert_allclose(leaning, leaning.transpose(2, 0, 1))


@pytest.mark.whole
def test_a_picture_gives_a_volume_where_all_directions_are_alike():
    picture = exponential((256, 256), scale=4, seed=3, fraction=0.4)
    volume = tb.method("noise", isotropic=True, exact=True).fit(picture[None]).generate(96, seed=1)
    own = two_point(picture, r_max=20)
    for axis in range(3):
        assert relative(two_point(volume, r_max=20, axis=axis), own) < 0.03
    layers = tb.method("noise").fit(picture[None]).generate(96, seed=1)
    assert relative(two_point(layers, r_max=20, axis=0), own) > 0.1
    with pytest.raises(InputError, match="isotropic"):
        tb.method("noise", isotropic=2)


def test_three_phases_are_cut_one_after_another():
    phases = Phases((2, 0, 1), (0.5, 0.3, 0.2))
    assert [phases.share(i) for i in range(3)] == pytest.approx([0.5, 0.6, 1.0])


def test_three_phases_come_out_to_the_voxel():
    values = np.random.default_rng(0).choice(3, (14, 14, 14), p=[0.5, 0.3, 0.2]).astype(np.uint8)
    model = tb.method("noise", reach=4, corrections=0, exact=True).fit(tb.Image(values, "labels"))
    found = np.bincount(model.generate(16, seed=1).values.ravel()) / 16**3
    assert found == pytest.approx(np.bincount(values.ravel()) / values.size, abs=2 / 16**3)
