"""Operations across periodic faces: the result of a rolled image is the rolled result."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

import trabecula as tb
from trabecula.finish import connect, offset, periodic, prune, remove_floaters, smooth, thicken
from trabecula.finish.struts import balls
from trabecula.measure import components, label_components
from trabecula.measure.labelling import joined_across
from trabecula.measure.runs import INSIDE, runs_of


def grains(shape, share=0.3, seed=0, sigma=2.0):
    """Return a random periodic structure."""
    noise = np.random.default_rng(seed).random(shape)
    field = ndimage.gaussian_filter(noise, sigma, mode="wrap")
    return field < np.quantile(field, share)


def report(image):
    return image.recipe.steps[-1]["report"]


OPERATIONS = {
    "smooth": lambda image, **more: smooth(image, sigma=1.3, **more),
    "thicken": lambda image, **more: thicken(image, thickness=5, **more),
    "offset": lambda image, **more: offset(
        image, fraction=0.3 if more["mask"] is None else 0.4, **more
    ),
    "connect": lambda image, **more: connect(image, min_size=2, **more),
    "connect near": lambda image, **more: connect(image, min_size=2, reach=4, **more),
    "prune": prune,
    "add_crust": lambda image, **more: tb.finish.add_crust(image, thickness=2, **more),
}


@pytest.mark.whole
@pytest.mark.parametrize("name", OPERATIONS)
@pytest.mark.parametrize("axes", [(True, True, True), (False, True, False)])
@pytest.mark.parametrize("masked", [False, True])
def test_a_rolled_image_gives_the_rolled_result(name, axes, masked):
    if name == "add_crust" and all(axes) and not masked:
        return  # no surface
    shape = (22, 24, 26)
    solid = grains(shape, share=0.08 if "connect" in name else 0.35)
    form = grains(shape, share=0.75, seed=1, sigma=4) if masked else None
    solid &= True if form is None else form
    part = OPERATIONS[name](solid, periodic=axes, mask=form)
    assert np.count_nonzero(part.values != solid), "nothing was done"
    assert form is None or not part.values[~form].any()
    for shift in ((11, 12, 13), (1, 23, 7)):
        step = tuple(by if wrap else 0 for by, wrap in zip(shift, axes, strict=True))
        rolled = None if form is None else np.roll(form, step, (0, 1, 2))
        again = OPERATIONS[name](np.roll(solid, step, (0, 1, 2)), periodic=axes, mask=rolled)
        assert np.array_equal(again.values, np.roll(part.values, step, (0, 1, 2)))
        assert report(again) == report(part)


@pytest.mark.whole
@settings(max_examples=60)
@given(st.integers(0, 10_000), st.integers(2, 3), st.sampled_from([0.1, 0.5, 0.9, 1.1]))
def test_small_and_full_images_roll_as_well(seed, ndim, share):
    rng = np.random.default_rng(seed)
    shape = tuple(rng.integers(2, 7, ndim))
    solid, axes = rng.random(shape) < share, tuple((rng.random(ndim) < 0.6).tolist())
    if not solid.any():
        return
    step = tuple(int(rng.integers(0, 9)) if wrap else 0 for wrap in axes)
    for work in (
        lambda image: smooth(image, sigma=1, periodic=axes),
        lambda image: thicken(image, thickness=2, periodic=axes),
        lambda image: connect(image, min_size=1, periodic=axes),
        lambda image: prune(image, periodic=axes),
    ):
        part, again = work(solid), work(np.roll(solid, step, range(ndim)))
        assert np.array_equal(again.values, np.roll(part.values, step, range(ndim)))


def test_components_that_meet_across_a_face_are_one():
    bar = np.zeros((12, 12, 30), np.uint8)
    bar[4:8, 4:8, :8] = bar[4:8, 4:8, 22:] = 1
    apart, whole = connect(bar), connect(bar, periodic=(False, False, True))
    assert report(apart)["joins"] == 1 and report(whole)["joins"] == 0
    assert np.array_equal(whole.values, bar)
    bar[4:8, 4:8, 22:] = 0
    bar[5, 5, 29] = 1
    assert report(remove_floaters(bar, periodic=True))["removed"] == 0
    assert report(remove_floaters(bar))["removed"] == 1


def test_the_shortest_join_runs_across_a_face():
    two = np.zeros((12, 12, 30), np.uint8)
    two[4:8, 4:8, 2:10] = two[4:8, 4:8, 20:27] = 1
    part = connect(two, periodic=True, min_size=1)
    assert report(part)["longest"] == 5 and components(part, periodic=True) == 1
    assert part.values[:, :, 27:].any() and not part.values[:, :, 11:19].any()
    assert report(connect(two, periodic=True, reach=4))["removed_parts"] == 1
    assert report(connect(two, periodic=True, reach=5))["joins"] == 1


@pytest.mark.whole
@settings(max_examples=30)
@given(
    st.integers(0, 10_000),
    st.tuples(st.booleans(), st.booleans(), st.booleans()),
    st.sampled_from([6, 18, 26]),
)
def test_runs_joined_across_faces_are_the_components(seed, axes, connectivity):
    solid = np.random.default_rng(seed).random((5, 6, 7)) < 0.3
    found = runs_of(solid.view(np.uint8), INSIDE, connectivity)
    runs = joined_across(found, connectivity, axes)
    labels, sizes = label_components(solid, connectivity=connectivity, periodic=axes)
    assert np.array_equal(runs.labels(), labels) and np.array_equal(runs.sizes, sizes)


@settings(max_examples=30)
@given(st.integers(0, 10_000), st.integers(0, 3))
def test_all_are_joined_and_nothing_is_lost(seed, brush):
    solid = np.random.default_rng(seed).random((6, 7, 8)) < 0.08
    if not solid.any():
        return
    part = connect(solid, periodic=(True, False, True), min_size=1, brush=max(brush, 1))
    assert components(part, periodic=(True, False, True)) == 1
    assert np.all(part.values >= solid)


def test_a_strut_is_thickened_as_far_from_a_face_as_at_it():
    wire = np.zeros((15, 15, 20), bool)
    wire[0, 14] = True
    thick = thicken(wire, thickness=5, periodic=True).values
    middle = thicken(np.roll(wire, (7, -7), (0, 1)), thickness=5, periodic=(False, False, True))
    assert np.array_equal(np.roll(thick, (7, -7), (0, 1)), middle.values)


@pytest.mark.parametrize("seed", range(20))
def test_balls_continue_at_the_opposite_face(seed):
    rng = np.random.default_rng(seed)
    places, radius = rng.integers(0, 6, (5, 3)), rng.random(5) * (2 + seed % 8)
    grid = np.indices((6, 9, 12)).reshape(3, -1).T
    expected = np.zeros(len(grid), bool)
    for place, reach in zip(places, radius, strict=True):
        apart = np.abs(grid - place)
        apart[:, 0] = np.minimum(apart[:, 0], 6 - apart[:, 0])
        apart[:, 2] = np.minimum(apart[:, 2], 12 - apart[:, 2])
        expected |= np.linalg.norm(apart, axis=1) <= reach
    found = balls(places, radius, (6, 9, 12), (1.0,) * 3, (True, False, True))
    assert np.array_equal(found.ravel(), expected)


def frame(stub):
    """Return a 2-D lattice with a strut of `stub` voxels that ends in the open."""
    lattice = np.zeros((60, 60), np.uint8)
    lattice[:3] = lattice[30:33] = lattice[:, :3] = lattice[:, 30:33] = 1
    lattice[3 : 3 + stub, 15:17] = 1
    return lattice


@pytest.mark.parametrize(("stub", "removed", "grown"), [(5, 1, 0), (22, 0, 1)])
def test_a_free_end_at_a_periodic_face_is_pruned_as_one_inside(stub, removed, grown):
    inside = np.roll(frame(stub), (12, 12), (0, 1))
    plain = prune(inside)
    assert (report(plain)["removed"], report(plain)["grown"]) == (removed, grown)
    for shift in ((0, 0), (-6, -16), (-18, 5)):
        found = prune(np.roll(frame(stub), shift, (0, 1)), periodic=True)
        assert (report(found)["removed"], report(found)["grown"]) == (removed, grown)
        assert report(found)["ends_before"] == 1 and report(found)["ends_after"] == 0


def test_the_origin_rolls_along():
    solid = grains((9, 10, 11)).astype(np.uint8)
    first = periodic.material_origin(solid, (True, False, True))
    moved = periodic.material_origin(np.roll(solid, (4, 7), (0, 2)), (True, False, True))
    assert moved == ((first[0] + 4) % 9, 0, (first[2] + 7) % 11)
