"""`sliced`: known truth of its parts, and what it makes of pictures whose volume is known."""

import numpy as np
import pytest

import trabecula as tb
from trabecula import measure
from trabecula.core.request import Request
from trabecula.errors import InputError, RequestError
from trabecula.exemplar.views import views_of
from trabecula.synth.shared.content.histogram import Histogram
from trabecula.synth.shared.content.kinds import content_of
from trabecula.synth.shared.statistics.two_point import correlations_of, reweight_target
from trabecula.synth.sliced.aims import Pictures, make_isotropic, subsample
from trabecula.synth.sliced.method import remove_specks
from trabecula.synth.sliced.run import regions_around_known, torus_regions


def blobs(shape, seed=0, width=2.0, fraction=0.4):
    """A thresholded smooth random field, periodic: isotropic."""
    frequencies = np.meshgrid(*(np.fft.fftfreq(side) for side in shape), indexing="ij")
    square = sum(f * f for f in frequencies)
    noise = np.random.default_rng(seed).standard_normal(shape)
    smooth = np.fft.ifftn(np.fft.fftn(noise) * np.exp(-2 * (np.pi * width) ** 2 * square)).real
    return (smooth > np.quantile(smooth, 1 - fraction)).astype(np.uint8)


@pytest.fixture(scope="module")
def picture():
    return tb.Image(blobs((64, 64)), "labels")


@pytest.fixture(scope="module")
def model(picture):
    return tb.method("sliced", preset="fast").fit(picture)


def relative(found, truth):
    return np.linalg.norm(found - truth) / np.linalg.norm(truth)


def covariance(values, **keywords):
    return measure.covariance_form(measure.two_point(values, r_max=12, phase=1, **keywords))


@pytest.mark.whole
def test_slices_have_the_pictures_fraction_and_two_point_function(picture, model):
    made = model.generate(48, seed=3).values
    assert abs(made.mean() - picture.values.mean()) < 1e-4
    truth = covariance(picture.values)
    for axis in range(3):
        assert relative(covariance(made, axis=axis), truth) < 0.3
    noise = np.random.default_rng(0).permutation(made.ravel()).reshape(made.shape)
    assert relative(covariance(noise, axis=0), truth) > 0.6  # what the bound above is worth


@pytest.mark.whole
def test_no_axis_is_preferred(model):
    made = model.generate(48, seed=4).values
    lines = [covariance(made, axis=axis) for axis in range(3)]
    assert max(relative(a, b) for a in lines for b in lines) < 0.35


@pytest.mark.whole
def test_two_views_make_an_anisotropic_material():
    """Cylinders along x: stripes in the planes that hold x, discs across it."""
    rng = np.random.default_rng(2)
    across = blobs((60, 60), seed=5, fraction=0.35)
    along = np.repeat(across[rng.permutation(60)[:1]].T, 60, axis=1)
    along = np.ascontiguousarray(along)
    share = across.mean()
    assert abs(along.mean() - share) < 0.2
    model = tb.method("sliced", preset="fast").fit(
        [tb.Image(along, "labels"), tb.Image(across, "labels")]
    )
    made = model.generate(32, seed=1).values
    kept = [np.mean(np.diff(made, axis=axis) == 0) for axis in range(3)]
    assert kept[2] > max(kept[:2]) + 0.05


@pytest.mark.slow
def test_the_picture_itself_as_the_middle_slice(picture, model):
    values, known = np.zeros((24, 64, 64), np.uint8), np.zeros((24, 64, 64), bool)
    values[12], known[12] = picture.values, True
    made = model.generate(
        (24, 64, 64), seed=1, fixed=tb.Image(values, "labels"), known=known
    ).values
    assert np.array_equal(made[12], picture.values)
    beside = np.mean([np.mean(made[z] == made[12]) for z in (11, 13)])
    elsewhere = np.mean(made[3] == made[4])
    assert beside > 0.9 * elsewhere, "a seam beside the known slice"
    assert abs(made[:10].mean() - picture.values.mean()) < 0.15


@pytest.mark.whole
def test_a_target_porosity_is_met(model):
    for porosity in (0.45, 0.7):
        made = model.generate(24, seed=1, target={"porosity": porosity}).values
        assert abs(1 - made.mean() - porosity) < 1e-3


@pytest.mark.whole
def test_a_mask_is_filled_with_the_fraction_and_nothing_else(picture, model):
    grid = np.indices((30, 30, 30)) - 15
    ball = (grid**2).sum(axis=0) < 13**2
    made = model.generate((30, 30, 30), seed=1, mask=ball).values
    assert not made[~ball].any()
    assert abs(made[ball].mean() - picture.values.mean()) < 1e-3


@pytest.mark.whole
def test_periodic_axes_go_on_without_a_seam(model):
    made = model.generate((27, 32, 32), seed=2, periodic=(True, False, False)).values
    seam = np.mean(made[0] == made[-1])
    inside = np.mean(made[1:] == made[:-1])
    assert seam > inside - 0.05


@pytest.mark.whole
def test_too_thin_for_a_period_is_refused(model):
    with pytest.raises(RequestError, match="z is 5 voxels"):
        model.generate((5, 32, 32), seed=1, periodic=(True, False, False))
    assert model.generate((5, 20, 20), seed=1).shape == (5, 20, 20)


@pytest.mark.whole
def test_three_phases_keep_their_fractions():
    field = blobs((48, 48), seed=1).astype(np.uint8) + blobs((48, 48), seed=7)
    made = (
        tb.method("sliced", preset="fast")
        .fit(tb.Image(field, "labels"))
        .generate(24, seed=1)
        .values
    )
    for label in range(3):
        assert abs(np.mean(made == label) - np.mean(field == label)) < 0.02


def test_a_small_picture_is_refused():
    with pytest.raises(InputError, match="at least 11 pixels"):
        tb.method("sliced").fit(tb.Image(blobs((10, 30)), "labels"))


def test_thinned_parts_hold_every_pixel_once():
    field = np.arange(35, dtype=np.float32).reshape(1, 1, 5, 7)
    parts = subsample(field, 1, clip=127.0)
    assert sorted(int(v) for part in parts for v in part.ravel()) == list(range(35))
    assert parts[1].shape == (1, 1, 3, 3)


def test_alike_pools_the_directions_by_their_pairs():
    rng = np.random.default_rng(3)
    part = np.where(rng.random((1, 1, 12, 12)) < 0.5, 127, -127).astype(np.int8)
    along = correlations_of([part], softness=1.0, r_max=4)
    pooled = make_isotropic(along, [part.shape[1:]])
    curves = pooled.curves.reshape(3, -1)
    assert np.array_equal(curves[0], curves[1])
    assert np.array_equal(curves[0], curves[2])
    binary = part[0, 0] > 0
    pairs = np.concatenate(
        [(binary[1:] & binary[:-1]).ravel(), (binary[:, 1:] & binary[:, :-1]).ravel()]
    )
    diagonal = np.concatenate(
        [(binary[1:, 1:] & binary[:-1, :-1]).ravel(), (binary[1:, :-1] & binary[:-1, 1:]).ravel()]
    )
    # sqrt 2 rounds to 1
    assert curves[0, 1] == pytest.approx(np.concatenate([pairs, diagonal]).mean(), abs=1e-5)


def test_leaning_keeps_the_covariance_form():
    hard = np.where(blobs((40, 40)) > 0, 127, -127).astype(np.int8)
    target = correlations_of([hard[None, None]], softness=1.0, r_max=5)
    own = Histogram.of(hard)
    asked = Histogram.of(np.array([-127] * 7 + [127] * 3, np.int8))
    curve, phi = reweight_target(target, [own], [asked], softness=1.0).curves[0, 6:12], 0.3
    old, share = target.curves[0, 6:12], np.mean(hard > 0)
    # Bins of one direction: the picture lies across z, so those nearest to y are the second third.
    assert np.allclose(
        (curve - phi**2) / (phi - phi**2), (old - share**2) / (share - share**2), atol=1e-6
    )


def test_specks_go_and_pieces_stay():
    values = np.zeros((12, 12, 12), np.uint8)
    values[2:6, 2:6, 2:6] = 1  # a piece of 64
    values[9, 9, 9] = 1  # a speck
    values[4, 4, 4] = 0  # a hole
    votes = np.where(values > 0, 500, -500).astype(np.int16)[None]
    cleaned = remove_specks(votes, values, (0, 1), 12)[0] > 0
    assert cleaned[2:6, 2:6, 2:6].all()
    assert cleaned.sum() == 64
    assert votes[0, 9, 9, 9] == 500  # the caller's array is as it was


def test_a_torus_holds_whole_coarse_voxels():
    regions = torus_regions(Request((21, 30, 5), periodic=(False, True, False)), 2, 8)
    assert [region.shape for region in regions] == [(32, 30, 32), (16, 15, 16), (8, 8, 8)]


def test_a_known_slice_is_known_on_every_level(picture):
    content = content_of([picture])
    values, known = np.zeros((16, 64, 64), np.uint8), np.zeros((16, 64, 64), bool)
    values[6], known[6] = picture.values, True
    request = Request((16, 64, 64), fixed=tb.Image(values, "labels"), known=known)
    regions = regions_around_known(
        request, content.bounds(request), 2, lambda index: 3.0 * 2**index, exact=True
    )
    assert [np.unique(np.nonzero(~region.free)[0]).tolist() for region in regions] == [
        [6],
        [3],
        [1],
    ]
    coarse = regions[2].low[0, 1].astype(float)
    share = picture.values.reshape(16, 4, 16, 4).mean(axis=(1, 3))
    assert np.all(coarse[share == 1] > 0)
    assert np.all(coarse[share == 0] < 0)
    assert np.array_equal(regions[2].low[0, 1], regions[2].high[0, 1])


def test_views_of_one_picture_share_what_is_learnt(picture):
    views = views_of([picture])
    fields = {view.picture: content_of([picture]).fields(view.image) for view in views}
    level = Pictures(fields, views, "all").level(1, tb.method("sliced").config)
    assert len({id(candidates) for _, candidates in level.views}) == 1
    assert [axis for axis, _ in level.views] == [0, 1, 2]
