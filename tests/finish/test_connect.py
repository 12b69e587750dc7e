"""Connect: components to join, components to remove, and voxels that never change."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

import trabecula as tb
from trabecula.core.progress import listen
from trabecula.finish import OPERATIONS, connect
from trabecula.measure import components, label_components
from trabecula.pipeline.inputs import load_mask


def blocks(gap: int) -> np.ndarray:
    solid = np.zeros((12, 12, 20 + gap), np.uint8)
    solid[3:9, 3:9, 2:10] = 1
    solid[4:8, 4:8, 10 + gap : 18 + gap] = 1
    return solid


def report(image, *names):
    found = image.recipe.steps[-1]["report"]
    return {name: found[name] for name in names} if names else found


FIGURES = ("joins", "added", "removed_parts", "removed", "left_parts", "left")


@pytest.mark.parametrize("gap", [1, 3, 5])
def test_a_near_block_is_joined_by_a_straight_bar(gap):
    part = connect(blocks(gap))
    assert components(part) == 1
    assert report(part, *FIGURES) == dict(zip(FIGURES, (1, 4 * gap, 0, 0, 0, 0), strict=True))
    assert report(part)["longest"] == gap and np.all(part.values >= blocks(gap))


@pytest.mark.parametrize(("gap", "reach"), [(9, 5), (6, 5), (3, 2), (3, 0)])
def test_what_is_farther_than_a_stated_reach_is_removed(gap, reach):
    part = connect(blocks(gap), reach=reach)
    assert report(part, *FIGURES) == dict(zip(FIGURES, (0, 0, 1, 128, 0, 0), strict=True))
    assert part.values.sum() == 6 * 6 * 8
    kept = connect(blocks(gap), reach=reach, unjoined="keep")
    assert np.array_equal(kept.values, blocks(gap)) and report(kept, "left_parts", "left") == {
        "left_parts": 1,
        "left": 128,
    }


def test_settings_of_0_1_give_what_they_gave():
    """Replay recipes with a reach and a size: near components are joined, far ones removed."""
    settings = {"phase": None, "reach": 5, "brush": 2, "min_size": 30, "connectivity": None}
    near, far = connect(blocks(5), **settings), connect(blocks(6), **settings)
    assert (
        report(near, "joins", "added") == {"joins": 1, "added": 20}
        and report(far)["removed"] == 128
    )


@pytest.mark.parametrize("gap", [6, 40])
def test_a_far_block_is_joined_where_no_reach_is_stated(gap):
    part = connect(blocks(gap))
    assert components(part) == 1 and report(part, *FIGURES) == dict(
        zip(FIGURES, (1, 4 * gap, 0, 0, 0, 0), strict=True)
    )


def test_joins_are_a_minimum_spanning_tree():
    """Compare with Kruskal's tree over the shortest paths between all pairs of components."""
    from scipy.ndimage import label
    from scipy.sparse.csgraph import minimum_spanning_tree

    for seed in range(6):
        rng = np.random.default_rng(seed)
        solid = np.zeros((18, 18, 18), np.uint8)
        for z, y, x in rng.integers(0, 16, (9, 3)):
            solid[z : z + 2, y : y + 2, x : x + 2] = 1
        numbers, count = label(solid)
        places = [np.argwhere(numbers == n + 1) for n in range(count)]
        costs = np.zeros((count, count))
        for a in range(count):
            for b in range(a):
                apart = np.abs(places[a][:, None] - places[b][None]).sum(axis=2).min() - 1
                costs[a, b] = apart
        part = connect(solid, brush=1, min_size=0)
        assert components(part) == 1 and report(part)["joins"] == count - 1
        assert report(part)["added"] == minimum_spanning_tree(costs).sum()


def test_a_join_goes_about_straight():
    solid = np.zeros((40, 40, 40), np.uint8)
    solid[:3, :3, :3] = solid[-3:, -3:, -3:] = 1
    way = np.argwhere(connect(solid, brush=1).values > solid)
    assert len(way) == 3 * 35 - 1 and np.abs(way - way.mean(axis=1, keepdims=True)).max() <= 2


def test_what_no_way_leads_to_stays_unless_it_should_go():
    """Put another phase between the blocks, from wall to wall."""
    values = blocks(3)
    values[:, :, 11] = 2
    image = tb.Image(values, "labels", phases=("void", "active", "binder"))
    part = connect(image, phase="active")
    assert np.array_equal(part.values, values) and report(part, "joins", "left") == {
        "joins": 0,
        "left": 128,
    }
    gone = connect(image, phase="active", unjoined="remove")
    assert components(gone, phase="active") == 1 and report(gone)["removed"] == 128


def test_a_way_around_what_is_closed_is_found():
    values = blocks(3)
    values[1:, :, 11] = 2  # open along the first plane alone
    image = tb.Image(values, "labels", phases=("void", "active", "binder"))
    part = connect(image, phase="active", brush=1)
    assert components(part, phase="active") == 1 and np.array_equal(part.values == 2, values == 2)
    assert report(part)["added"] == 3 + 3 + 4


def test_joins_run_inside_of_the_form():
    """Join two limbs of a U: the path over the top is the shorter one."""
    solid, form = np.zeros((20, 12, 20), np.uint8), np.zeros((20, 12, 20), bool)
    form[:, 4:8, :6] = form[:, 4:8, 14:] = form[14:, 4:8] = True
    solid[:10, 4:8, 1:5] = solid[:10, 4:8, 15:19] = 1
    over, through = connect(solid), connect(solid, mask=form)
    assert components(over) == components(through) == 1
    assert np.any((over.values == 1) & ~form) and not np.any((through.values == 1) & ~form)
    assert report(over)["longest"] == 10 and report(through)["longest"] == 10 + 2 * 5
    near = connect(solid, mask=form, reach=20)
    assert report(near)["joins"] == 1 and not np.any((near.values == 1) & ~form)
    assert report(connect(solid, mask=form, reach=19))["removed"] == 160
    for wrong, says in (
        (form[1:], "has shape"),
        (form.astype(np.uint8), "uint8"),
        (form & False, "holds no voxel"),
    ):
        with pytest.raises(tb.errors.InputError, match=says):
            connect(solid, mask=wrong)


@pytest.mark.whole
def test_a_filled_form_keeps_its_limbs(bone, data):
    """Fill a cow with bone, 64 voxels long: two legs, a quarter of it, are loose."""
    mask = load_mask(data / "mesh_spot.ply", bone, shape=(64, 64, 64))
    model = tb.method("texture", preset="fast").fit(bone)
    made = next(
        made
        for made in (model.generate(None, mask=mask, seed=seed) for seed in range(1, 9))
        if report(connect(made, reach=5, min_size=30))["removed"] > 0.05 * made.values.sum()
    )
    part = connect(made, mask=mask)
    limbs, sizes = label_components(made.values == 1)
    kept = part.values == 1
    assert components(part) == 1 and not np.any(kept & (mask.values == 0))
    for number, size in enumerate(sizes, 1):
        assert kept[limbs == number].all() or size < report(part)["min_size"]
    assert report(part)["left"] == 0 and report(part)["min_size"] < 0.01 * sizes.sum()
    assert (
        report(part)["removed"] < 0.015 * sizes.sum() and report(part)["added"] < 0.03 * sizes.sum()
    )


def test_losses_are_said():
    said = []
    with listen(lambda line, fraction: said.append(line)):
        connect(blocks(9), reach=5)
        connect(blocks(9), reach=5, unjoined="keep")
        connect(blocks(9))
    assert len(said) == 2
    assert "1 components were removed, 30.77% of the phase" in said[0]
    assert "1 components of 2 voxels or more (30.77% of the phase) could not be joined" in said[1]


def test_a_speck_is_a_cube_of_the_mean_chord():
    """Compare rods of 4 x 4 x 64 voxels: chords of 4, 4 and 64, of harmonic mean 5.8."""
    solid = np.zeros((64, 64, 64), np.uint8)
    for z in range(2, 64, 8):
        for y in range(2, 64, 8):
            solid[z : z + 4, y : y + 4] = 1
    assert report(connect(solid, reach=0, unjoined="keep"))["min_size"] == round(
        (3 / (1 / 4 + 1 / 4 + 1 / 64)) ** 3
    )
    assert report(connect(blocks(3)))["min_size"] == 2  # 0.5 % of the phase
    assert report(connect(blocks(3), min_size=129))["removed"] == 128


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
    # the middle one is smallest: the first lies 13 from the largest
    for start, size in ((1, 10), (14, 8), (25, 12)):
        chain[2 : size + 1, 3:7, start : start + 8] = 1
    for settings in ({}, {"reach": 5}):
        part = connect(chain, **settings)
        assert components(part) == 1 and report(part)["joins"] == 2 and np.all(part.values >= chain)


def test_several_phases_keep_their_labels():
    solid = blocks(3)
    solid[:, :, 13:] *= 2
    solid[0, 0, 0] = 2
    image = tb.Image(solid, "labels", phases=("void", "active", "binder"), spacing=2.0, unit="um")
    part = connect(image)
    assert components(part) == 1 and part.values[0, 0, 0] == 0
    assert np.all(part.values[blocks(3) == 1] == solid[blocks(3) == 1])
    # the join takes the label of the part that is joined
    assert np.count_nonzero(part.values == 2) == 128 + 12
    assert part.phases == image.phases and part.spacing == image.spacing and part.unit == "um"


def test_one_phase_of_several_does_not_run_through_another():
    values = np.where(blocks(3) == 1, np.uint8(1), np.uint8(0))
    values[:, :, 11] = 2
    image = tb.Image(values, "labels", phases=("void", "active", "binder"))
    part = connect(image, phase="active", reach=5)
    assert components(part, phase="active") == 1 and report(part)["joins"] == 0
    assert np.array_equal(part.values == 2, values == 2)


def test_pores_can_be_connected():
    part = connect(1 - blocks(3), phase="void")
    assert components(part, phase="void") == 1 and np.all(part.values <= 1 - blocks(3))


def test_the_recipe_replays():
    part = connect(blocks(3), brush=1)
    step = part.recipe.steps[-1]
    assert step["verb"] == "finish" and set(step["settings"]) >= {
        "reach",
        "brush",
        "min_size",
        "phase",
    }
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
    assert report(again, *FIGURES) == dict.fromkeys(FIGURES, 0)


@given(volumes, st.integers(1, 3), st.sampled_from([None, 0, 3]), st.booleans())
def test_nothing_but_specks_is_lost_where_no_reach_is_stated(solid, brush, min_size, wide):
    if not solid.any():
        return
    connectivity = (26 if solid.ndim == 3 else 8) if wide else None
    settings = {"brush": brush, "min_size": min_size, "connectivity": connectivity}
    part = connect(solid, **settings)
    changes = report(part)
    assert len(label_components(part.values == 1, connectivity=connectivity)[1]) == 1
    old, sizes = label_components(solid, connectivity=connectivity)
    for number, size in enumerate(sizes, 1):
        assert size < changes["min_size"] or np.all(part.values[old == number] == 1)
    assert (
        changes["left"] == 0
        and part.values.sum() == solid.sum() + changes["added"] - changes["removed"]
    )
    assert np.array_equal(connect(part, **settings).values, part.values)


def test_refusals():
    with pytest.raises(tb.errors.InputError, match="nothing to connect"):
        connect(np.zeros((4, 4, 4), np.uint8))
    for settings in (
        {"reach": -1},
        {"brush": 0},
        {"reach": 2.5},
        {"min_size": -3},
        {"connectivity": 4},
        {"unjoined": "drop"},
        {"brush": None},
    ):
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
