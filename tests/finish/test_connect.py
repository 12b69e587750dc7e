"""Connect: what must be joined, what must go, and what must never change."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

import trabecula as tb
from trabecula.finish import OPERATIONS, connect
from trabecula.measure import components, label_components


def blocks(gap: int) -> np.ndarray:
    solid = np.zeros((12, 12, 20 + gap), np.uint8)
    solid[3:9, 3:9, 2:10] = 1
    solid[4:8, 4:8, 10 + gap : 18 + gap] = 1
    return solid


def report(image):
    return image.recipe.steps[-1]["report"]


@pytest.mark.parametrize("gap", [1, 3, 5])
def test_a_near_block_is_joined_by_a_straight_bar(gap):
    part = connect(blocks(gap))
    assert components(part) == 1
    assert report(part) == {"joins": 1, "added": 4 * gap, "removed_parts": 0, "removed": 0}
    assert np.all(part.values >= blocks(gap))


@pytest.mark.parametrize(("gap", "reach"), [(9, 5), (6, 5), (3, 2), (3, 0)])
def test_a_far_block_is_removed(gap, reach):
    part = connect(blocks(gap), reach=reach)
    assert report(part) == {"joins": 0, "added": 0, "removed_parts": 1, "removed": 128}
    assert part.values.sum() == 6 * 6 * 8


def test_brush_sets_the_thickness_of_a_join():
    # The widest one starts at the block's edge and rounds it off by 5 voxels beside its 3 x 3 x 3.
    assert [report(connect(blocks(3), brush=brush))["added"] for brush in (1, 2, 3)] == [3, 12, 32]


def test_specks_are_dropped_even_where_they_are_near():
    solid = blocks(3)
    solid[10, 10, 5] = 1
    part = connect(solid)
    assert components(part) == 1 and part.values[10, 10, 5] == 0 and report(part)["removed"] == 1
    assert connect(solid, min_size=0).values[10, 10, 5] == 1


def test_a_part_comes_within_reach_through_another():
    chain = np.zeros((12, 12, 40), np.uint8)
    for start, size in ((1, 10), (14, 8), (25, 12)):  # the middle one is smallest: the first lies 13 from the largest
        chain[2 : size + 1, 3:7, start : start + 8] = 1
    part = connect(chain)
    assert components(part) == 1 and report(part)["joins"] == 2 and np.all(part.values >= chain)


def test_several_phases_keep_their_labels():
    solid = blocks(3)
    solid[:, :, 13:] *= 2
    solid[0, 0, 0] = 2
    image = tb.Image(solid, "labels", phases=("void", "active", "binder"), spacing=2.0, unit="um")
    part = connect(image)
    assert components(part) == 1 and part.values[0, 0, 0] == 0
    assert np.all(part.values[blocks(3) == 1] == solid[blocks(3) == 1])
    assert np.count_nonzero(part.values == 2) == 128 + 12  # the join takes the label of the part that is joined
    assert part.phases == image.phases and part.spacing == image.spacing and part.unit == "um"


def test_one_phase_of_several_does_not_run_through_another():
    values = np.where(blocks(3) == 1, np.uint8(1), np.uint8(0))
    values[:, :, 11] = 2
    image = tb.Image(values, "labels", phases=("void", "active", "binder"))
    part = connect(image, phase="active")
    assert components(part, phase="active") == 1 and report(part)["joins"] == 0
    assert np.array_equal(part.values == 2, values == 2)


def test_pores_can_be_connected():
    part = connect(1 - blocks(3), phase="void")
    assert components(part, phase="void") == 1 and np.all(part.values <= 1 - blocks(3))


def test_the_recipe_replays():
    part = connect(blocks(3), brush=1)
    step = part.recipe.steps[-1]
    assert step["verb"] == "finish" and set(step["settings"]) >= {"reach", "brush", "min_size", "phase"}
    again = OPERATIONS[step["operation"]](blocks(3), **step["settings"])
    assert again.recipe.steps[-1] == step


volumes = arrays(bool, array_shapes(min_dims=2, max_dims=3, min_side=3, max_side=9))


@given(volumes, st.integers(0, 4), st.integers(1, 3), st.sampled_from([0, 3]), st.booleans())
def test_any_volume_becomes_one_piece_and_stays_it(solid, reach, brush, min_size, wide):
    if not solid.any():
        return
    before = solid.copy()
    connectivity = (26 if solid.ndim == 3 else 8) if wide else None
    settings = {"reach": reach, "brush": brush, "min_size": min_size, "connectivity": connectivity}
    part = connect(solid, **settings)
    assert np.array_equal(solid, before)
    _, sizes = label_components(part.values == 1, connectivity=connectivity)
    assert len(sizes) == 1
    old, old_sizes = label_components(solid, connectivity=connectivity)
    assert np.all(part.values[old == np.argmax(old_sizes) + 1] == 1)
    changes = report(part)
    assert part.values.sum() == solid.sum() + changes["added"] - changes["removed"]
    again = connect(part, **settings)
    assert np.array_equal(again.values, part.values)
    assert report(again) == {"joins": 0, "added": 0, "removed_parts": 0, "removed": 0}


def test_refusals():
    with pytest.raises(tb.errors.InputError, match="nothing to connect"):
        connect(np.zeros((4, 4, 4), np.uint8))
    for settings in ({"reach": -1}, {"brush": 0}, {"reach": 2.5}, {"min_size": -3}, {"connectivity": 4}):
        with pytest.raises(tb.errors.InputError):
            connect(blocks(3), **settings)
    three = tb.Image(blocks(3), "labels", phases=("void", "a", "b"))
    with pytest.raises(tb.errors.InputError, match="open which phase"):
        connect(three, phase="void")


def test_real_bone(data):
    import tifffile

    bone = tifffile.imread(data / "trabecular_bone_a.tif")[40:140, 40:140, 40:140] > 0
    part = connect(bone)
    assert components(part) == 1 and report(part)["added"] < 0.01 * bone.sum()
    assert report(part)["joins"] > 0
