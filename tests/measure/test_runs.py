"""Components as runs of voxels: what they paint, bound and write is what labels would."""

import tracemalloc

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

import trabecula as tb
from trabecula.engine.chunking import slices_of
from trabecula.measure import label_components
from trabecula.measure.runs import runs_of


@st.composite
def reference(draw):
    """Draw an array of labels, which of them are members, and its components both ways."""
    shape = draw(st.tuples(st.integers(1, 6), st.integers(1, 6), st.integers(1, 7)))
    values = (
        np.random.default_rng(draw(st.integers(0, 2**32))).integers(0, 3, shape).astype(np.uint8)
    )
    member = np.isin(np.arange(256), draw(st.sets(st.integers(0, 2))))
    neighbours = draw(st.sampled_from([6, 18, 26]))
    return (
        values,
        runs_of(values, member, neighbours),
        *label_components(member[values], connectivity=neighbours),
    )


@given(reference(), st.data())
def test_any_box_is_painted_as_it_lies_in_the_whole(case, data):
    _, runs, labels, sizes = case
    ends = [
        sorted(data.draw(st.tuples(st.integers(0, side), st.integers(0, side))))
        for side in labels.shape
    ]
    box = tuple((first, last) for first, last in ends)
    assert np.array_equal(runs.labels(box), labels[slices_of(box)])
    assert np.array_equal(runs.sizes, sizes)


@given(reference())
def test_boxes_hold_their_component_and_no_empty_layer(case):
    _, runs, labels, sizes = case
    boxes = runs.boxes()
    for number in range(1, len(sizes) + 1):
        places = np.argwhere(labels == number)
        assert boxes[number - 1].tolist() == [*places.min(axis=0), *(places.max(axis=0) + 1)]


@given(reference(), st.integers(0, 2**32))
def test_only_the_chosen_components_are_written(case, seed):
    values, runs, labels, sizes = case
    chosen = np.random.default_rng(seed).random(len(sizes)) < 0.5
    written = values.copy()
    runs.write(written, chosen, 9)
    assert np.array_equal(written, np.where(np.concatenate([[False], chosen])[labels], 9, values))


def test_joining_takes_the_image_the_result_and_runs_but_no_labels():
    noise = np.random.default_rng(1).random((48, 64, 160))
    for axis in range(3):
        for _ in range(2):
            noise = sum(np.roll(noise, step, axis) for step in range(-3, 4))
    image = tb.Image(noise > np.quantile(noise, 0.7), "labels")
    # A label for every voxel would be four bytes more; joins at any distance take the numbers and
    # steps of the way to them.
    for settings, most in (({"reach": 5}, 3), ({}, 7)):
        tb.finish.connect(image, **settings)  # kernels are loaded
        tracemalloc.start()
        tb.finish.connect(image, **settings)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < most * image.values.size
