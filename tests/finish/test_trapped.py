"""Floaters and closed pores: counting, removal and filling."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from scipy import ndimage

import trabecula as tb
from trabecula.errors import InputError
from trabecula.finish import OPERATIONS, fill_trapped, remove_floaters, trapped
from trabecula.measure import components


def report(image):
    return image.recipe.steps[-1]["report"]


def hollow():
    """Return a block with a closed pore of 3 x 3 x 3, one of a single voxel, and a channel."""
    block = np.ones((12, 12, 12), np.uint8)
    block[2:5, 2:5, 2:5] = 0
    block[9, 9, 9] = 0
    block[6, 6, :] = 0
    return block


def test_trapped_pores_are_counted_in_the_images_unit():
    found = trapped(tb.Image(hollow(), "labels", spacing=(2, 1, 0.5), unit="mm"))
    assert found == {"pores": 2, "voxels": 28, "volume": 28.0, "share": 28 / 40, "largest": 27}
    assert trapped(np.ones((3, 3, 3), int)) == {
        "pores": 0,
        "voxels": 0,
        "volume": 0.0,
        "share": 0.0,
        "largest": 0,
    }


def test_trapped_pores_are_filled_and_channels_stay_open():
    part = fill_trapped(hollow())
    assert report(part) == {"filled_pores": 2, "filled": 28}
    assert (part.values[6, 6] == 0).all() and part.values.sum() == 12**3 - 12
    assert trapped(part)["pores"] == 0


def test_a_way_out_over_an_edge_is_none_unless_it_is_asked_for():
    block = np.ones((5, 5), int)
    block[2, 2] = block[1, 1] = block[0, 0] = 0
    assert trapped(block)["pores"] == 2 and trapped(block, connectivity=8)["pores"] == 0


@given(arrays(bool, array_shapes(min_dims=2, max_dims=3, min_side=2, max_side=8)))
def test_filling_is_filling_holes(solid):
    """Compare with scipy, whose holes have face neighbours too."""
    part = fill_trapped(solid)
    assert np.array_equal(part.values, ndimage.binary_fill_holes(solid))
    assert (
        report(part)["filled"] == trapped(solid)["voxels"] == np.count_nonzero(part.values != solid)
    )


def test_what_is_filled_takes_the_nearest_label():
    values = np.ones((9, 9, 18), np.uint8)
    values[:, :, 9:] = 2
    values[4, 4, 2], values[4, 4, 15] = 0, 0
    image = tb.Image(values, "labels", phases=("void", "a", "b"))
    filled = fill_trapped(image).values
    assert filled[4, 4, 2] == 1 and filled[4, 4, 15] == 2
    # The void of a phase alone is the void, not the other phase.
    assert trapped(image, phase="a")["pores"] == 2


def specks():
    solid = np.zeros((10, 10, 10), np.uint8)
    solid[1:8, 1:8, 1:8] = 1
    solid[9, 9, 7:10] = 1
    solid[9, 0, 0] = 1
    return solid


def test_floaters_are_removed():
    part = remove_floaters(specks())
    assert (
        report(part) == {"removed_parts": 2, "removed": 4, "left": 1} and part.values.sum() == 343
    )
    some = remove_floaters(specks(), smaller_than=2)
    assert (
        report(some) == {"removed_parts": 1, "removed": 1, "left": 2} and some.values[9, 9, 9] == 1
    )
    assert report(remove_floaters(specks(), smaller_than=10**6))["left"] == 1, (
        "the largest stays, however small"
    )


@given(
    arrays(bool, array_shapes(min_dims=2, max_dims=3, min_side=2, max_side=8)),
    st.none() | st.integers(1, 9),
    st.booleans(),
)
def test_removing_always_leaves_the_rest_as_it_was(solid, smaller_than, wide):
    if not solid.any():
        return
    connectivity = {2: 8, 3: 26}[solid.ndim] if wide else None
    part = remove_floaters(solid, smaller_than=smaller_than, connectivity=connectivity)
    assert (
        np.all(part.values <= solid) and report(part)["removed"] == solid.sum() - part.values.sum()
    )
    labels, count = ndimage.label(solid, np.ones((3,) * solid.ndim) if wide else None)
    sizes = np.bincount(labels.ravel())[1:]
    kept = int((sizes >= smaller_than).sum()) if smaller_than and sizes.max() >= smaller_than else 1
    assert (
        components(part, connectivity=connectivity) == kept == count - report(part)["removed_parts"]
    )


def test_the_recipes_replay():
    for operation, volume in ((remove_floaters, specks()), (fill_trapped, hollow())):
        step = operation(volume).recipe.steps[-1]
        assert OPERATIONS[step["operation"]](volume, **step["settings"]).recipe.steps[-1] == step


def test_refusals():
    with pytest.raises(InputError, match="nothing floats in it"):
        remove_floaters(np.zeros((4, 4, 4), int))
    with pytest.raises(InputError, match="smaller_than=0 is outside"):
        remove_floaters(specks(), smaller_than=0)
    with pytest.raises(InputError, match="connectivity 4"):
        trapped(hollow(), connectivity=4)
    with pytest.raises(InputError, match="open what is solid"):
        trapped(tb.Image(hollow(), "labels", phases=("pore", "bone")))


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("end", [0, -1])
def test_a_pore_is_open_at_any_face(axis, end):
    block = np.ones((5, 5, 5), np.uint8)
    block[2, 2, 2] = 0
    assert trapped(block)["pores"] == 1
    way = [2, 2, 2]
    way[axis] = slice(3, 5) if end else slice(0, 2)
    block[tuple(way)] = 0
    assert trapped(block)["pores"] == 0


def test_what_is_open_over_an_edge_may_stay():
    block = np.ones((4, 4, 4), np.uint8)
    block[1, 1, 1] = block[0, 0, 1] = 0
    assert fill_trapped(block).values[1, 1, 1] == 1
    assert fill_trapped(block, connectivity=18).values[1, 1, 1] == 0


def test_components_of_just_the_size_stay():
    part = np.array([[1, 1, 1, 0, 1, 1, 0, 1]], np.uint8)
    assert remove_floaters(part, smaller_than=2).values.tolist() == [[1, 1, 1, 0, 1, 1, 0, 0]]
