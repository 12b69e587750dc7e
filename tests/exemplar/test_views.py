"""Views: how planes are named, which axis they are seen across, and what contradicts itself."""

import numpy as np
import pytest

import trabecula as tb
from trabecula.core.progress import listen
from trabecula.errors import InputError, UnknownNameError
from trabecula.exemplar.views import as_planes, is_isotropic, spacing_of, views_of


def blobs(seed=0, share=0.3, shape=(96, 96), spacing=(), sigma=(3, 3)):
    """A thresholded smooth field, longer along the axis of the larger sigma."""
    noise = np.random.default_rng(seed).standard_normal(shape)
    waves = np.exp(
        -0.5
        * sum(
            (s * 2 * np.pi * f) ** 2
            for s, f in zip(
                sigma, np.meshgrid(*map(np.fft.fftfreq, shape), indexing="ij"), strict=True
            )
        )
    )
    field = np.fft.ifft2(np.fft.fft2(noise) * waves).real
    return tb.Image(
        (field > np.quantile(field, 1 - share)).astype(np.uint8), "labels", spacing=spacing
    )


def planes(*args):
    return [(view.plane, view.picture) for view in views_of(*args)]


def test_one_picture_is_seen_in_all_planes_two_around_x_three_each():
    a, b, c = (blobs(seed) for seed in range(3))
    assert planes([a]) == [("yx", 0), ("zx", 0), ("zy", 0)]
    assert planes([a, b]) == [("yx", 0), ("zx", 0), ("zy", 1)]
    assert planes([a, b, c]) == [("yx", 0), ("zx", 1), ("zy", 2)]


def test_named_planes_take_their_pictures_in_order_and_are_sorted_by_axis():
    a, b = blobs(0), blobs(1)
    assert planes([a, b], ["zy", "yx"]) == [("yx", 1), ("zy", 0)]
    assert planes([a], ["zx", "yx"]) == [("yx", 0), ("zx", 0)]


@pytest.mark.parametrize("plane", ["yx", "zx", "zy", "xy", "xz", "yz"])
def test_a_plane_cut_from_a_volume_fits_at_its_place(plane):
    """A picture whose rows and columns are named is found again in the slice of the view."""
    volume = np.random.default_rng(1).integers(0, 2, (20, 21, 22), np.uint8)
    across = next(axis for axis, name in enumerate("zyx") if name not in plane)
    picture = volume.take(7, across)
    if plane in ("xy", "xz", "yz"):
        picture = picture.T
    other = "zx" if across != 1 else "yx"
    view = next(
        v for v in views_of([tb.Image(picture, "labels")], [plane, other]) if v.axis == across
    )
    assert np.array_equal(view.image.values, np.moveaxis(volume, across, 0)[7])


def test_spacings_are_those_of_the_axes():
    a, b = blobs(0, spacing=(2, 1)), blobs(1, spacing=(3, 2), sigma=(3, 3))
    assert spacing_of(views_of([a, b], ["yx", "zy"])) == (3, 2, 1)
    with pytest.raises(InputError, match="x has a spacing of 1 in one and 2 in another"):
        views_of([a, blobs(1, spacing=(3, 2))], ["yx", "zx"])


def test_a_turned_picture_brings_its_spacings_to_the_axes_it_names():
    wide, other = blobs(0, spacing=(2, 1)), blobs(1, spacing=(3, 2))
    assert spacing_of(views_of([wide, other], ["xy", "zx"])) == (3, 1, 2)


def test_pictures_of_other_amounts_contradict_each_other():
    with pytest.raises(
        InputError, match=r"the fraction of void is 0\.80 in one and 0\.50 in the other"
    ):
        views_of([blobs(0, share=0.2), blobs(1, share=0.5)])


def test_pictures_that_differ_along_the_axis_they_share_contradict_each_other():
    long, short = blobs(0, sigma=(10, 2)), blobs(1, sigma=(2, 2))
    with pytest.raises(
        InputError, match="yx and zy contradict each other: their covariances along y differ by"
    ):
        views_of([long, short])
    assert planes([long, short], ["xy", "zy"]) == [("yx", 0), ("zy", 1)], (
        "turned, they agree along y"
    )


def test_a_picture_that_contradicts_itself_is_told_of_and_taken():
    said = []
    with listen(lambda label, share: said.append(label)):
        views_of([blobs(0)])
        assert not said
        views_of([blobs(0, sigma=(12, 2))])
        assert len(said) == 1, "along y; zx and zy share z, which runs along rows in both"
        views_of([blobs(0, sigma=(12, 2))], ["yx", "zx"])
        assert len(said) == 1, "two planes share x alone, along which it agrees with itself"
    assert "two views may suit it better" in said[0]


def test_grey_pictures_are_compared_by_mean_and_autocorrelation():
    grey = [
        tb.Image(np.where(blobs(seed, sigma=(s, 2)).values > 0, 200, 40).astype(np.uint8), "grey")
        for seed, s in ((0, 2), (1, 2), (2, 12))
    ]
    views_of(grey[:2])
    with pytest.raises(InputError, match="covariances along y"):
        views_of([grey[2], grey[0]])


@pytest.mark.parametrize("named", [["yx"], ["yx", "xy"], ["yx", "zx", "zy", "xy"]])
def test_planes_are_two_or_three_across_different_axes(named):
    with pytest.raises(InputError, match="two or three planes"):
        as_planes(named)


def test_other_mistakes_are_named():
    a = blobs(0)
    with pytest.raises(UnknownNameError, match="xx"):
        as_planes("yx,xx")
    assert as_planes("yx, zy") == ("yx", "zy")
    with pytest.raises(InputError, match="2 exemplars for 3 views"):
        views_of([a, a], ["yx", "zx", "zy"])
    with pytest.raises(InputError, match="4 exemplars"):
        views_of([a] * 4)
    with pytest.raises(InputError, match="a view is a picture"):
        views_of([tb.Image(np.eye(8, dtype=np.uint8)[None].repeat(8, 0), "labels")])


@pytest.mark.parametrize(
    "values",
    [np.zeros((1, 1), int), np.zeros((9, 9), int), np.eye(2, dtype=int), np.eye(3, 30, dtype=int)],
)
def test_a_picture_with_little_in_it_contradicts_nobody(values):
    picture = tb.Image(values, "labels")
    assert len(views_of([picture])) == 3


def test_pictures_of_which_one_lacks_a_phase_are_compared_in_the_others():
    rng = np.random.default_rng(0)
    three = tb.Image(
        np.minimum(rng.integers(0, 40, (60, 60)), 2), "labels", phases=("void", "a", "b")
    )
    two = tb.Image(
        np.minimum(rng.integers(1, 40, (60, 60)), 2), "labels", phases=("void", "a", "b")
    )
    assert len(views_of([three, two])) == 3


def shades(picture, seed=0):
    """A picture of labels as grey values, with noise."""
    noise = np.random.default_rng(seed).integers(0, 30, picture.shape)
    return tb.Image(
        (picture.values * 150 + noise).astype(np.uint8), "grey", spacing=picture.spacing
    )


@pytest.mark.parametrize("kind", ["labels", "grey", "colour"])
@pytest.mark.parametrize("shape", [(96, 96), (60, 130)])
def test_a_sample_of_an_isotropic_field_is_isotropic_and_a_stretched_one_is_not(kind, shape):
    for seed in range(4):
        pictures = [blobs(seed, shape=shape, sigma=sigma) for sigma in ((3, 3), (10, 2), (2, 10))]
        if kind != "labels":
            pictures = [shades(picture) for picture in pictures]
        if kind == "colour":
            pictures = [
                tb.Image(np.stack([p.values, p.values // 2, p.values // 3], -1), "colour")
                for p in pictures
            ]
        assert [is_isotropic(picture) for picture in pictures] == [True, False, False]


def test_stripes_and_pixels_that_are_no_squares_are_not_isotropic():
    striped = np.repeat((np.arange(60) // 4 % 2).astype(np.uint8)[None], 60, axis=0)
    assert not is_isotropic(tb.Image(striped, "labels"))
    assert not is_isotropic(tb.Image(striped.T, "labels"))
    assert is_isotropic(tb.Image((striped + striped.T) % 2, "labels"))
    slanted = (np.indices((60, 60)).sum(axis=0) // 4 % 2).astype(np.uint8)
    assert not is_isotropic(tb.Image(slanted, "labels"))
    assert not is_isotropic(tb.Image(slanted[::-1] * np.uint8(200), "grey"))
    assert is_isotropic(blobs(0, spacing=(0.3, 0.3)))
    assert not is_isotropic(blobs(0, spacing=(0.3, 0.4)))


def test_isotropy_is_asked_of_every_phase():
    """Round grains in one half of the labels, rods in the other."""
    round_, rods = blobs(0, share=0.25).values, blobs(1, share=0.2, sigma=(12, 2)).values
    assert is_isotropic(tb.Image(np.where(round_, 1, 0), "labels", phases=("void", "a")))
    assert is_isotropic(tb.Image(np.where(round_, 1, 2 * blobs(2, share=0.2).values), "labels"))
    assert not is_isotropic(tb.Image(np.where(rods, 2, round_), "labels"))


@pytest.mark.parametrize("shape", [(1, 1), (1, 30), (30, 1)])
def test_a_line_of_pixels_and_one_value_are_no_sample_of_anything(shape):
    assert not is_isotropic(tb.Image(np.indices(shape).sum(0) % 2, "labels"))
    assert not is_isotropic(tb.Image((np.indices(shape).sum(0) % 2).astype(np.uint8), "grey"))
    assert not is_isotropic(tb.Image(np.ones((9, 9), int), "labels"))
