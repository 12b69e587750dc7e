"""The feature channel beside grey values and colours of pictures."""

import numpy as np
import pytest

import trabecula as tb
from trabecula.measure.distance import signed_distance
from trabecula.measure.grey import autocorrelation
from trabecula.synth.api.registry import recorded_method
from trabecula.synth.shared.content.feature import Feature
from trabecula.synth.shared.content.kinds import content_of

MATRIX, STONES = (40, 38, 36), ((200, 170, 120), (90, 100, 140))
SIDE, RADIUS = 48, 5


def discs():
    """Return which pixels lie in discs, and the number of each disc."""
    y, x = np.mgrid[:SIDE, :SIDE]
    apart = np.hypot(y % 16 - 7.5, x % 16 - 7.5)
    return apart < RADIUS, (y // 16 + x // 16) % 2


def picture(kind):
    inside, number = discs()
    values = np.where(inside[..., None], np.array(STONES)[number], MATRIX).astype(np.uint8)
    values += np.random.default_rng(1).integers(0, 4, values.shape, dtype=np.uint8)
    return tb.Image(values if kind == "colour" else values[..., 1], kind)


@pytest.mark.parametrize("kind", ["grey", "colour"])
def test_the_mask_is_what_stands_out(kind):
    found = Feature.of([picture(kind)]).mask(picture(kind).values, kind)
    assert np.mean(found != discs()[0]) < 0.05


def test_the_last_channel_is_the_distance_from_the_rim():
    image = picture("colour")
    fields = content_of([image], rim=4.0).fields(image)
    inside = Feature.of([image]).mask(image.values, "colour")
    assert fields.shape == (4, 1, SIDE, SIDE)
    np.testing.assert_allclose(fields[3, 0], signed_distance(inside) * (127 / 4.0), rtol=1e-5)


def test_it_halves_with_the_resolution_and_colours_do_not():
    model = tb.method("kopf").fit(picture("colour"))
    field = np.full((4, 1, 2, 2), 40, np.float32)
    assert model.quantise_level(field, 1)[:, 0, 0, 0].tolist() == [40, 40, 40, 20]


def test_one_value_has_no_feature():
    flat = tb.Image(np.full((SIDE, SIDE), 7, np.uint8), "grey")
    assert Feature.of([flat]) is None


@pytest.mark.parametrize("name", ["kopf", "chen"])
def test_older_recipes_have_none(name):
    assert not recorded_method(name, {"clip": 3.0}).config.feature
    assert tb.method(name).config.feature


@pytest.mark.slow
def test_stones_keep_their_shapes_with_it(data):
    """Slices of gravel repeat the autocorrelation of the picture better than without."""
    image = tb.crop(tb.read(data / "tex_gravel.png"), 96)
    own, far = autocorrelation(image, lags=16), {}
    for feature in (False, True):
        made = tb.method("kopf", feature=feature).fit(image).generate(44, seed=3)
        slices = [tb.Image(made.values[z], "grey") for z in range(0, 44, 4)]
        mean = np.mean([autocorrelation(each, lags=16) for each in slices], axis=0)
        far[feature] = np.linalg.norm(mean - own)
    assert far[True] < 0.85 * far[False]
