"""Graded material of wide and of fine bodies: what is held at every place suits their size."""

import numpy as np
import pytest
from scipy import ndimage

import trabecula as tb
from trabecula.synth.shared.local_offset import NARROWEST, window_of
from trabecula.synth.shared.novel_schedule import structure_length


@pytest.mark.parametrize(
    ("length", "window"), [(1.4, 20), (3.1, 20), (4.66, 38), (6.6, 54), (50.0, 100), (np.inf, 100)]
)
def test_windows_are_as_wide_as_bodies_need(length, window):
    assert window_of(length) == window
    assert NARROWEST == 20


def changes(image):
    inside = np.asarray(image.values) > 0
    return np.mean([np.mean(np.diff(inside, axis=axis)) for axis in range(3)])


def at_its_own_porosity(exemplar, side):
    """The interface of what is graded to the exemplar's own porosity, over the exemplar's."""
    field = np.full((side,) * 3, np.mean(exemplar.values == 0), np.float32)
    made = (
        tb.method("texture").fit(exemplar).generate(field.shape, seed=1, target={"porosity": field})
    )
    return changes(made) / changes(exemplar)


@pytest.mark.slow
def test_bodies_wider_than_a_narrow_window_are_not_cut_up():
    """In windows of 20 voxels for all they had 1.5 times their interface."""
    bone = tb.crop(tb.sample("bone"), 40, corner=(0, 0, 0))
    wide = ndimage.zoom(bone.values.astype(float), 2, order=1)
    exemplar = tb.Image((ndimage.gaussian_filter(wide, 1) > 0.5).astype(np.uint8), "labels")
    assert structure_length([exemplar]) > 5
    assert at_its_own_porosity(exemplar, 64) < 1.25


@pytest.mark.slow
def test_fine_bodies_are_not_smoothed_away():
    """Smoothed they had three quarters of their interface."""
    bone = tb.sample("bone")
    fine = tb.Image(np.ascontiguousarray(bone.values[::2, ::2, ::2]), "labels")
    assert structure_length([fine]) < 2
    assert at_its_own_porosity(fine, 48) > 0.82
