"""Coarser levels: the commonest label, the mean, and what a tie or an odd end does."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from trabecula.engine.chunking import below
from trabecula.engine.multiscale import halve_resolution, shapes_of


def cells(values):
    """Index of a coarse voxel, and the values that it stands for in their order."""
    shape = [(side + 1) // 2 for side in values.shape]
    for index in np.ndindex(*shape):
        yield index, values[tuple(slice(2 * i, 2 * i + 2) for i in index)].ravel()


@pytest.mark.whole
@given(
    arrays(np.uint8, array_shapes(min_dims=2, max_dims=3, max_side=37), elements=st.integers(0, 3))
)
def test_the_commonest_label(values):
    result = halve_resolution(values, labels=True)
    assert result.dtype == np.uint8
    for index, inside in cells(values):
        # Every voxel at an odd end stands for as many as any other there, so that counts need no
        # weights.
        counts = np.bincount(inside, minlength=4)
        winners = np.flatnonzero(counts == counts.max())
        assert result[index] == (inside[0] if inside[0] in winners else winners[0])


@pytest.mark.whole
@given(
    arrays(
        st.sampled_from([np.uint8, np.uint16, np.int16, np.float32]),
        array_shapes(min_dims=2, max_dims=3, max_side=19),
        elements=st.integers(0, 200),
    )
)
def test_the_mean(values):
    result = halve_resolution(values, labels=False)
    assert result.dtype == values.dtype
    for index, inside in cells(values):
        mean = inside.astype(np.float64).mean()
        expected = np.float32(mean) if values.dtype.kind == "f" else np.floor(mean + 0.5)
        assert result[index] == expected


def test_means_of_negative_and_of_very_large_numbers():
    assert halve_resolution(np.array([[-3, -2], [-2, -2]], np.int16), labels=False).tolist() == [
        [-2]
    ]
    assert (
        halve_resolution(np.full((4, 4), 65535, np.uint16), labels=False).tolist()
        == [[65535] * 2] * 2
    )


def test_no_phase_is_favoured():
    """Of independent voxels, half of each phase, a third of the cells are ties: the shares stay."""
    values = np.random.default_rng(0).integers(0, 2, (64, 64, 64)).astype(np.uint8)
    assert halve_resolution(values, labels=True).mean() == pytest.approx(0.5, abs=4 * 0.5 / 32**1.5)


def test_channels_are_halved_alone():
    values = np.random.default_rng(1).integers(0, 255, (3, 8, 6)).astype(np.uint8)
    expected = np.stack([halve_resolution(channel, labels=False) for channel in values])
    assert np.array_equal(halve_resolution(values, labels=False, axes=2), expected)


def test_shapes_and_boxes():
    assert shapes_of((256, 3, 256), 256) == [(256, 3, 256)]
    assert shapes_of((1025, 1), 256) == [(1025, 1), (513, 1), (257, 1), (129, 1)]
    assert below(((3, 5), (0, 4)), (10, 7)) == ((6, 10), (0, 7))
