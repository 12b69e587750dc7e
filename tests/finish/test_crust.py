"""Crust: a closed wall of known thickness below the surface of a form, and nothing outside."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

import trabecula as tb
from trabecula.errors import InputError
from trabecula.finish import OPERATIONS, add_crust, connect, smooth, thicken
from trabecula.measure import components


def ball(side=40, radius=17):
    z, y, x = np.indices((side,) * 3) - (side - 1) / 2
    return z**2 + y**2 + x**2 < radius**2


def grains(shape, share=0.3, seed=0, sigma=2.0):
    """Return a random periodic structure."""
    noise = np.random.default_rng(seed).random(shape)
    field = ndimage.gaussian_filter(noise, sigma, mode="wrap")
    return field < np.quantile(field, share)


def report(image):
    return image.recipe.steps[-1]["report"]


def closed(void, outside):
    """Return whether no voxel of a void meets the outside, across faces or edges of voxels."""
    near = ndimage.binary_dilation(outside, ndimage.generate_binary_structure(void.ndim, 2))
    return not (void & near).any()


@pytest.mark.parametrize("thickness", [1, 2, 3.4, 5])
@pytest.mark.parametrize("spacing", [1.0, 0.04])
def test_the_wall_of_a_ball_is_closed_and_as_thick_as_asked_for(thickness, spacing):
    form = ball()
    filled = tb.Image((grains(form.shape) & form).astype(np.uint8), "labels", spacing=spacing)
    part = add_crust(filled, thickness=thickness * spacing, mask=form)
    solid = part.values == 1
    assert closed(form & ~solid, ~form)
    assert not solid[~form].any() and (solid | (filled.values == 0)).all()
    # Along rays from the centre, from the surface inwards to the first void of an empty form.
    seed = np.zeros(form.shape, np.uint8)
    seed[20, 20, 20] = 1
    centre = tb.Image(seed, "labels", spacing=spacing)
    empty = add_crust(centre, thickness=thickness * spacing, mask=form).values
    depth = ndimage.distance_transform_edt(form) - 0.5
    wall = (empty == 1) & (seed == 0)
    assert depth[wall].max() < thickness <= depth[form & (empty == 0)].min()
    for line in (empty[20, 20], empty[20, :, 20], empty[:, 20, 20]):
        count = np.argmin(line[np.argmax(line) :])
        assert abs(count - thickness) <= 0.5


def test_what_is_added_is_reported():
    form = ball()
    solid = grains(form.shape) & form
    part = add_crust(solid, thickness=2, mask=form)
    assert report(part)["added"] == np.count_nonzero(part.values) - np.count_nonzero(solid)
    assert report(part)["share"] == pytest.approx(report(part)["wall"] / form.sum(), abs=1e-6)


def test_loose_struts_become_one_component_on_the_crust():
    form = ball()
    solid = grains(form.shape, share=0.2) & form
    assert components(solid) > 3
    part = connect(add_crust(solid, thickness=2, mask=form), mask=form)
    assert components(part) == 1 and not part.values[~form].any()
    assert report(part)["left_parts"] == 0


def test_without_a_mask_the_faces_are_the_surface_but_for_periodic_ones():
    solid = grains((16, 18, 20))
    box = add_crust(solid, thickness=2).values
    inner = np.zeros(solid.shape, bool)
    inner[2:-2, 2:-2, 2:-2] = True
    assert np.array_equal(box == 1, solid | ~inner)
    plate = add_crust(solid, thickness=2, periodic=(False, True, True)).values
    assert np.array_equal(plate[2:-2], solid[2:-2]) and plate[[0, 1, -2, -1]].all()


def test_anisotropic_voxels_and_labels():
    values = np.zeros((9, 20, 20), np.uint8)
    values[:, 8:12, :10], values[:, 8:12, 10:] = 1, 2
    image = tb.Image(values, "labels", spacing=(3, 1, 1), phases=("void", "a", "b"))
    part = add_crust(image, thickness=3).values
    assert part[0].all() and part[-1].all() and (part[4, :3] > 0).all()
    assert not part[4, 3:8, 3:-3].any() and set(part[4, 0, :8]) == {1} and part[4, 0, 15] == 2
    named = add_crust(image, thickness=3, phase="a").values
    assert (named[named != values] == 1).all()


def test_smooth_and_thicken_leave_the_crust_at_the_surface():
    form = ball()
    part = add_crust(grains(form.shape) & form, thickness=3, mask=form)
    even = smooth(part, sigma=1, mask=form)
    assert closed(form & (even.values == 0), ~form) and not even.values[~form].any()
    assert not closed(form & (smooth(part, sigma=1).values == 0), ~form)
    thick = thicken(even, thickness=4, mask=form)
    assert not thick.values[~form].any() and thicken(even, thickness=4).values[~form].any()


@settings(max_examples=15)
@given(st.integers(0, 1000), st.floats(0.5, 2), st.floats(1, 4))
def test_nothing_changes_outside_a_form(seed, sigma, thickness):
    rng = np.random.default_rng(seed)
    solid, form = rng.random((10, 11, 12)) < 0.4, grains((10, 11, 12), share=0.6, seed=seed)
    if not (solid & form).any():
        return
    for part in (
        smooth(solid, sigma=sigma, mask=form),
        thicken(solid, thickness=thickness, mask=form),
        connect(solid, mask=form, min_size=1),
        tb.finish.prune(solid, mask=form),
    ):
        assert not ((part.values == 1) & ~solid & ~form).any()
    smoothed = smooth(solid, sigma=sigma, mask=form).values
    assert np.array_equal(smoothed[~form] == 1, solid[~form])


@pytest.mark.parametrize("labels", [1, 2])
def test_the_cavity_of_a_hollow_form_is_no_closed_pore(labels):
    form = ball(24, 11) & ~ball(24, 5)
    values = form.astype(np.uint8)
    values[4, 12, 12] = 0
    values[:8] *= labels
    phases = ("void", "a", "b")[: labels + 1]
    image = tb.Image(values, "labels", phases=phases)
    part = tb.finish.fill_trapped(image, mask=form)
    assert report(part) == {"filled_pores": 1, "filled": 1} and part.values[4, 12, 12] == labels
    assert not part.values[~form].any() and tb.finish.fill_trapped(image).values[12, 12, 12] > 0


def test_the_recipe_replays():
    form, solid = ball(20, 8), grains((20, 20, 20)) & ball(20, 8)
    for name, given_settings in (
        ("add_crust", {"thickness": 1.5}),
        ("smooth", {"sigma": 1}),
        ("thicken", {"thickness": 3}),
    ):
        part = OPERATIONS[name](solid, mask=form, **given_settings)
        step = part.recipe.steps[-1]
        assert "mask" in step and "mask" not in step["settings"]
        assert OPERATIONS[name](solid, mask=form, **step["settings"]).recipe.steps[-1] == step


@pytest.mark.parametrize(
    ("thickness", "more", "says"),
    [
        (0.9, {}, "thinner than a voxel"),
        (9, {}, "no voxel of the form is deeper"),
        (2, {"periodic": True}, "has no surface"),
        (2, {"mask": np.zeros((12, 12, 12), bool)}, "holds no voxel"),
        (float("nan"), {}, "thickness"),
        (2, {"mask": np.ones((3, 3, 3), bool)}, "the mask has shape"),
    ],
)
def test_refusals(thickness, more, says):
    with pytest.raises(InputError, match=says):
        add_crust(grains((12, 12, 12)), thickness=thickness, **more)


def test_a_form_without_void_or_solid_is_refused():
    for values, says in ((1, "holds no void"), (0, "nothing to make a crust of")):
        with pytest.raises(InputError, match=says):
            add_crust(np.full((8, 8, 8), values), thickness=2)


def test_a_filled_form_needs_its_mask():
    form = ball(24, 10)
    image = tb.Image((grains(form.shape) & form).astype(np.uint8), "labels")
    recipe = image.recipe.then(
        "generate", image.values, request={"mask": [{"verb": "array"}]}, method="texture"
    )
    with pytest.raises(InputError, match="fills a form: give it"):
        add_crust(tb.Image(image.values, "labels", recipe=recipe), thickness=2)
