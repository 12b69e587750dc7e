"""Apparent properties of windows, compared with the solvers of whole volumes."""

import numpy as np
import pytest

import trabecula as tb
from trabecula.engine import parallel
from trabecula.errors import InputError, UnknownNameError
from trabecula.fields import windowed

EDGES = (1.0, 0.5, 2.0)


def random_solid(shape, *, share=0.6, seed=1):
    return (np.random.default_rng(seed).random(shape) < share).astype(np.uint8)


def mirrored(values):
    for axis in range(values.ndim):
        values = np.concatenate([values, np.flip(values, axis)], axis)
    return values


def every_window(values, size):
    return np.lib.stride_tricks.sliding_window_view(values, (size,) * values.ndim)


@pytest.mark.parametrize("axis", range(3))
def test_conductivity_is_that_of_the_window_alone(axis):
    values = random_solid((6, 7, 8), share=0.38)
    name = f"apparent_conductivity:{'zyx'[axis]}"
    field = windowed(values, size=5, names=[name], spacing=EDGES)[name]
    conducts = {"void": 0.0, "solid": 1.0}
    for at in np.ndindex(*field.shape):
        window = tb.Image(every_window(values, 5)[at], "labels", spacing=EDGES)
        alone = tb.measure.conductivity(window, conductivities=conducts, axis=axis).value
        assert field[at] == pytest.approx(alone, rel=2e-3, abs=1e-7)
    assert (field == 0).any() and (field > 0).any()


@pytest.mark.parametrize("axis", range(3))
def test_stiffness_is_that_of_a_medium_of_mirrors(axis):
    values = random_solid((4, 5, 4), seed=2)
    name = f"apparent_stiffness:{'zyx'[axis]}"
    field = windowed(values, size=3, names=[name], spacing=EDGES)[name]
    for at in np.ndindex(*field.shape):
        medium = tb.Image(mirrored(every_window(values, 3)[at]), "labels", spacing=EDGES)
        found = tb.measure.stiffness(medium, tolerance=1e-6).moduli["zyx"[axis]]
        assert field[at] == pytest.approx(found, rel=2e-3, abs=1e-6)
    assert np.unique(field).size > 5


def test_voxels_are_those_of_the_image():
    values = random_solid((5, 5, 5), share=0.5)
    name = "apparent_conductivity:x"
    told = windowed(tb.Image(values, "labels", spacing=EDGES), size=5, names=[name])[name]
    given = windowed(values, size=5, names=[name], spacing=EDGES)[name]
    cubes = windowed(values, size=5, names=[name])[name]
    assert told.item() == given.item() != cubes.item()


def test_diffusivity_is_that_of_the_void():
    values = random_solid((7, 6, 6), share=0.4)
    field = windowed(values, size=6, names=["apparent_diffusivity:y"])["apparent_diffusivity:y"]
    for z, found in enumerate(field[:, 0, 0]):
        alone = tb.measure.diffusivity(values[z : z + 6], axis=1).value
        assert found == pytest.approx(alone, rel=2e-3)


def test_without_an_axis_it_is_the_mean():
    values = random_solid((6, 6, 6))
    for word in ("conductivity", "stiffness", "diffusivity"):
        name = f"apparent_{word}"
        found = windowed(values, size=5, names=[name, *(f"{name}:{axis}" for axis in "zyx")])
        axes = [found[f"{name}:{axis}"] for axis in "zyx"]
        assert np.allclose(found[name], np.mean(axes, axis=0), atol=1e-6)


def test_what_spans_nothing_carries_nothing():
    apart = np.zeros((8, 8, 8), np.uint8)
    apart[:4, 2:4, 2:4] = apart[5:, 2:4, 2:4] = 1  # a cut column
    apart[3:5, 5:7, 5:7] = 1  # an island
    across = np.zeros((8, 8, 8), np.uint8)
    across[2:4] = across[6] = 1  # plates that span the other axes alone
    for values in (apart, across):
        for word in ("conductivity", "stiffness"):
            name = f"apparent_{word}:z"
            assert windowed(values, size=8, names=[name])[name].item() == 0


def test_sides_are_free_to_move():
    block = np.ones((4, 4, 4), np.uint8)
    found = windowed(block, size=4, names=["apparent_stiffness"])["apparent_stiffness"]
    assert found.item() == pytest.approx(1, rel=1e-3)  # held sides would give 1.35


def test_between_solved_windows_columns_have_their_fraction():
    columns = np.zeros((20, 40, 40), np.uint8)
    columns[:, random_solid((40, 40), share=0.3, seed=3) > 0] = 1
    names = ["volume_fraction", "apparent_conductivity:z", "apparent_stiffness:z"]
    share, *others = windowed(columns, size=16, names=names).values()
    assert np.ptp(share) > 0.1
    assert np.allclose(others[0], share, rtol=2e-3)


def test_solved_windows_are_exact_and_those_between_are_near():
    bone = tb.crop(tb.sample("bone"), 42)
    name = "apparent_stiffness:z"
    found = windowed(bone, size=16, names=[name])[name]

    def off(corner):
        window = np.asarray(tb.crop(bone, 16, corner=corner).values)
        return found[corner] - windowed(window, size=16, names=[name])[name].item()

    for solved in ((8, 16, 24), (26, 26, 26)):
        assert off(solved) == pytest.approx(0, abs=1e-6)
    between = [(3, 5, 9), (4, 4, 4), (12, 3, 20), (20, 13, 11), (23, 1, 6), (9, 21, 13)]
    assert np.sqrt(np.mean([off(corner) ** 2 for corner in between])) < 0.1 * np.ptp(found)


def test_threads_change_no_bit():
    values = random_solid((9, 9, 9))
    names = ["apparent_conductivity:x", "apparent_stiffness:x"]
    with parallel.threads(1):
        one = windowed(values, size=5, names=names)
    with parallel.threads(3):
        three = windowed(values, size=5, names=names)
    assert all(np.array_equal(one[name], three[name]) for name in names)


@pytest.mark.parametrize(
    ("shape", "size", "name", "words"),
    [
        ((70, 70, 70), 65, "apparent_stiffness", "of windows of 64 voxels at most, asked for 65"),
        ((9, 9), 4, "apparent_stiffness", "unknown descriptor of 2-D windows"),
        ((9, 9, 9), 4, "apparent_stiffness:r", "unknown descriptor of 3-D windows"),
    ],
)
def test_what_has_no_apparent_property_is_refused(shape, size, name, words):
    with pytest.raises((InputError, UnknownNameError), match=words):
        windowed(random_solid(shape), size=size, names=[name])
