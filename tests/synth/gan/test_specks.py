"""Specks: what fits into a small box is taken away, and nothing else."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from trabecula.synth.gan.decode import remove_specks


def by_labelling(labels, edge):
    """The definition, piece by piece: every phase's components, their boxes, and what lies before
    their first voxel.
    """
    found = labels.copy()
    for label in np.unique(labels):
        numbers, _ = ndimage.label(labels == label)
        for number, box in enumerate(ndimage.find_objects(numbers), start=1):
            small = all(side.stop - side.start <= edge for side in box)
            inside = all(
                side.start > 0 and side.stop < n for side, n in zip(box, labels.shape, strict=True)
            )
            if small and inside:
                z, y, x = np.argwhere(numbers == number)[0]
                found[numbers == number] = labels[z, y, x - 1]
    return found


@pytest.mark.parametrize("edge", [0, 1, 2])
@pytest.mark.parametrize("phases", [2, 3])
@pytest.mark.parametrize("share", [0.05, 0.2, 0.5])
def test_it_is_what_labelling_finds(edge, phases, share):
    rng = np.random.default_rng(phases)
    noise = rng.random((14, 15, 16)) < share
    labels = (noise * rng.integers(1, phases, noise.shape)).astype(np.uint8)
    before = labels.copy()
    found = remove_specks(labels, edge)
    assert np.array_equal(found, by_labelling(labels, edge))
    assert np.array_equal(labels, before)
    assert edge == 0 or share == 0.5 or (found != labels).any()


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 2))
def test_phases_swap_and_axes_turn(seed, edge):
    labels = (np.random.default_rng(seed).random((7, 7, 7)) < 0.3).astype(np.uint8)
    found = remove_specks(labels, edge)
    assert np.array_equal(remove_specks(1 - labels, edge), 1 - found)
    turned = remove_specks(np.ascontiguousarray(labels.transpose(2, 0, 1)[:, ::-1]), edge)
    assert np.array_equal(turned, found.transpose(2, 0, 1)[:, ::-1])


def test_a_piece_of_eight_voxels_goes_and_one_of_three_in_a_row_stays():
    labels = np.zeros((8, 8, 12), np.uint8)
    labels[2:4, 2:4, 2:4] = 1
    labels[5, 5, 7:10] = 1
    found = remove_specks(labels, 2)
    assert found.sum() == 3 and found[5, 5, 7:10].all()
    labels[0, 0, 0] = labels[6, 0, 4] = 1  # at the border, nobody knows
    assert remove_specks(labels, 2).sum() == 5
