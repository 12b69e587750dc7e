"""After mending, a phase touches itself by faces alone: seen by its bricks and by its surface."""

import numpy as np
import pytest

import trabecula as tb
from trabecula.errors import InputError
from trabecula.mesh.bricks.contacts import ContactTally


def report(image):
    return image.recipe.steps[-1]["report"]


def contacts(values):
    """Count by the other counter, that of the bricks."""
    tally = ContactTally()
    for plane in np.asarray(values, bool):
        tally.add(plane)
    return tally.finish()


def random(shape, fraction=0.3):
    return (np.random.default_rng(1).random(shape) < fraction).astype(np.uint8)


def test_nothing_touches_by_an_edge_or_a_corner():
    values = random((20, 21, 22))
    assert min(contacts(values)) > 50
    mended = tb.finish.mend_contacts(values)
    assert contacts(mended.values) == (0, 0) == contacts(1 - mended.values)
    assert report(mended)["left"] == 0 and report(mended)["removed"] == 0
    assert report(mended)["added"] == np.count_nonzero(mended.values != values)
    assert (mended.values >= values).all()
    assert (tb.finish.mend_contacts(mended).values == mended.values).all()


@pytest.mark.parametrize(
    ("voxels", "added"),
    [([(1, 1, 1), (1, 2, 2)], 1), ([(1, 1, 1), (2, 2, 2)], 2), ([(1, 1, 1), (1, 1, 2)], 0)],
)
def test_two_voxels_are_joined_by_as_few_as_that_takes(voxels, added):
    values = np.zeros((4, 4, 4), np.uint8)
    values[tuple(np.transpose(voxels))] = 1
    assert report(tb.finish.mend_contacts(values))["added"] == added


def test_a_notch_is_filled_rather_than_a_wall_built():
    """Two walls of opposite corners: the voxel with the most neighbours is filled."""
    values = np.zeros((3, 6, 6), np.uint8)
    values[:, :3, :3] = values[:, 3:, 3:] = 1
    values[:, 3, 1] = 1  # leaves a pit at (3, 2), with three neighbours in its plane
    assert (tb.finish.mend_contacts(values).values[:, 3, 2] == 1).all()


def test_periodic_faces_touch():
    values = np.zeros((4, 6, 6), np.uint8)
    values[1, 0, 1] = values[1, 5, 2] = 1
    assert report(tb.finish.mend_contacts(values))["contacts"] == 0
    mended = tb.finish.mend_contacts(values, periodic=(False, True, False))
    assert (report(mended)["contacts"], report(mended)["added"]) == (1, 1)
    shifted = np.roll(random((9, 10, 11)), (3, 4, 5), (0, 1, 2))
    tiled = np.tile(tb.finish.mend_contacts(shifted, periodic=True).values, (2, 2, 2))
    assert contacts(tiled) == (0, 0)


def test_nothing_is_filled_outside_of_the_form():
    values = np.zeros((4, 4, 4), np.uint8)
    values[1, 1, 1] = values[1, 2, 2] = 1
    form = values > 0
    mended = tb.finish.mend_contacts(values, mask=form)
    assert report(mended)["removed"] == 1 and report(mended)["left"] == 0
    form[1, 1, 2] = True
    mended = tb.finish.mend_contacts(values, mask=form)
    assert mended.values[1, 1, 2] == 1 and report(mended)["removed"] == 0


def test_other_phases_stay():
    values = random((10, 10, 10)) + 1
    values[::3] = 0
    image = tb.Image(values, "labels", phases=("void", "binder", "grain"))
    mended = tb.finish.mend_contacts(image, phase="grain")
    assert (mended.values[values == 1] == 1).all()
    both = tb.finish.mend_contacts(image)  # binder and grain together
    assert contacts(both.values > 0) == (0, 0)
    assert (both.values[values > 0] == values[values > 0]).all()


def test_a_picture_has_corners():
    mended = tb.finish.mend_contacts(random((30, 30)))
    assert report(mended)["contacts"] > 20 and report(mended)["left"] == 0


def test_what_cannot_be_mended_is_refused():
    with pytest.raises(InputError, match="nothing to mend"):
        tb.finish.mend_contacts(np.zeros((4, 4, 4), np.uint8))
