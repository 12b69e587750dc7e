"""What holds for every image: cropping, segmenting and numbering levels do not depend on scale,
order or axes.
"""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

import trabecula as tb

greys = arrays.arrays(
    np.float64,
    arrays.array_shapes(min_dims=2, max_dims=3, min_side=2, max_side=6),
    elements=st.integers(-50, 50).map(float),
).filter(lambda values: np.ptp(values) > 0)


def segmented(values, threshold="otsu"):
    return tb.segment(tb.Image(values, "grey"), threshold).values


@pytest.mark.whole
@given(
    greys,
    st.sampled_from([0.25, 2.0, 1024.0]),
    st.integers(-100, 100),
    st.sampled_from(["otsu", "dual"]),
)
def test_brightness_and_contrast_do_not_matter(values, contrast, brightness, way):
    """Otsu's optimum may be one of several equals, so only images with a clear one are compared."""
    levels = np.unique(values)
    assume(len(levels) > (2 if way == "dual" else 1))
    scores = _scores(values)
    assume(way == "dual" or len(scores) < 2 or scores[0] - scores[1] > 1e-6 * scores[0])
    if way == "dual":
        threshold = tb.segment(tb.Image(values, "grey"), way).recipe.steps[-1]["threshold"]
        moved = [level * contrast + brightness for level in threshold]
        np.testing.assert_array_equal(
            segmented(values * contrast + brightness, moved), segmented(values, threshold)
        )
    else:
        np.testing.assert_array_equal(segmented(values * contrast + brightness), segmented(values))


def _scores(values):
    """Between-class variances of all thresholds, best first."""
    levels = np.unique(values)
    found = []
    for level in levels[:-1]:
        share = (values <= level).mean()
        found.append(
            share
            * (1 - share)
            * (values[values <= level].mean() - values[values > level].mean()) ** 2
        )
    return sorted(found, reverse=True)


@pytest.mark.whole
@given(greys, st.data())
def test_axes_do_not_matter(values, data):
    axes = data.draw(st.permutations(range(values.ndim)))
    pair = sorted(data.draw(st.tuples(st.integers(-50, 49), st.integers(-50, 49))))
    assume(pair[0] < values.max() and (values > pair[1]).any() and not (values > pair[0]).all())
    np.testing.assert_array_equal(
        segmented(values.transpose(axes), pair), segmented(values, pair).transpose(axes)
    )


@pytest.mark.whole
@given(greys, st.data())
def test_a_crop_of_a_crop_is_a_crop(values, data):
    outer = [data.draw(st.integers(1, side)) for side in values.shape]
    first = [
        data.draw(st.integers(0, side - size))
        for side, size in zip(values.shape, outer, strict=True)
    ]
    inner = [data.draw(st.integers(1, size)) for size in outer]
    then = [data.draw(st.integers(0, size - part)) for size, part in zip(outer, inner, strict=True)]
    image = tb.Image(values, "grey", spacing=[2.0] * values.ndim)
    twice = tb.crop(tb.crop(image, outer, corner=first), inner, corner=then)
    once = tb.crop(image, inner, corner=np.add(first, then))
    np.testing.assert_array_equal(twice.values, once.values)
    assert [step["verb"] for step in twice.recipe.steps] == [
        "crop",
        "crop",
    ] and twice.spacing == image.spacing


@pytest.mark.whole
@given(greys)
def test_a_threshold_given_before_or_after_a_crop_is_the_same(values):
    size = [(side + 1) // 2 for side in values.shape]
    image = tb.Image(values, "grey")
    cropped = tb.crop(image, size)
    level = float(np.median(cropped.values))
    assume((cropped.values > level).any())
    np.testing.assert_array_equal(
        tb.segment(cropped, level).values, tb.crop(tb.segment(image, level), size).values
    )


@given(arrays.arrays(np.uint8, (3, 4, 5), elements=st.integers(0, 4)), st.permutations(range(5)))
def test_numbering_keeps_which_voxels_are_alike(values, order):
    """Levels are renamed by any rising map without effect, and by any map up to the names."""
    rising = np.array([3, 7, 20, 100, 255], np.uint8)
    np.testing.assert_array_equal(tb.labels(rising[values]).values, tb.labels(values).values)
    renamed = tb.labels(np.array(order, np.uint8)[values]).values
    pairs = set(
        zip(renamed.ravel().tolist(), tb.labels(values).values.ravel().tolist(), strict=True)
    )
    assert len(pairs) == len(np.unique(values))
