"""What the form of the material does to the flow: centres of slices, outlines, regions, shapes,
crust.
"""

import json
from dataclasses import asdict

import numpy as np
import pytest
from scipy import ndimage

import trabecula as tb
from trabecula.errors import FileError, InputError, UnknownNameError
from trabecula.synth.bubbles.flow import FlowConfig, flow_of
from trabecula.synth.bubbles.flow.slices import (
    along_outline,
    centre_of,
    component_centres,
    extent_of,
)


def disc(side, radius, at):
    v, u = np.ogrid[:side, :side]
    return np.hypot(v - at[0], u - at[1]) < radius


def ball(side, radius):
    return np.linalg.norm(np.indices((side,) * 3) - (side - 1) / 2, axis=0) < radius


def directions(config, mask, spacing=1.0, **more):
    flow = flow_of(config, mask.shape, spacing, mask, **more)
    return flow.directions(tuple((0, side) for side in mask.shape)) / 127


def test_centre_of_mass_and_extent_of_a_slice():
    plane = np.zeros((10, 12), bool)
    plane[2:4, 3:9] = True  # two rows of six: its middle lies at 3, 6
    assert centre_of(plane) == (3.0, 6.0)
    assert extent_of(plane) == (2, 6)
    plane[4:8, 3] = True
    rows, columns = np.nonzero(plane)
    assert centre_of(plane) == pytest.approx((rows.mean() + 0.5, columns.mean() + 0.5))
    assert extent_of(plane) == (6, 6)
    assert centre_of(plane & False) is None and extent_of(plane & False) == (0, 0)


def test_every_piece_has_its_own_centre():
    plane = disc(40, 6, (10, 10)) | disc(40, 8, (28, 27))
    rows, columns = component_centres(plane, (20.0, 20.0))
    assert (rows[10, 10], columns[10, 10]) == (10.5, 10.5)
    assert (rows[28, 27], columns[30, 24]) == (28.5, 27.5)
    assert (rows[0, 0], columns[0, 0]) == (20.0, 20.0)


@pytest.mark.parametrize("axis", "zyx")
def test_a_leaning_rod_is_followed_slice_by_slice(axis):
    """Its centre moves by one voxel from slice to slice, and the flow goes round it in each."""
    along = "zyx".index(axis)
    side = 32
    rod = np.stack([disc(side, 7, (10 + i // 3, 11 + i // 4)) for i in range(side)])
    mask = np.moveaxis(rod, 0, along)
    found = np.moveaxis(directions(FlowConfig(flow="concentric", flow_axis=axis), mask), along, 0)
    tall, wide = (n for n in range(3) if n != along)
    for i in range(0, side, 5):
        v, u = np.indices((side, side)) - np.array([10 + i // 3, 11 + i // 4])[:, None, None]
        far = rod[i] & (np.hypot(v, u) > 4)
        outward = (found[i, ..., tall] * v + found[i, ..., wide] * u) / np.maximum(
            np.hypot(v, u), 1
        )
        assert np.abs(outward[far]).max() < 0.13
    fixed = directions(FlowConfig(flow="concentric", flow_axis=axis, flow_centre="box"), mask)
    assert np.array_equal(
        fixed, directions(FlowConfig(flow="concentric", flow_axis=axis), np.ones_like(mask))
    )


def test_parts_that_do_not_touch_can_turn_about_their_own_centres():
    left, right = disc(60, 9, (14, 13)), disc(60, 11, (42, 44))
    mask = left | right
    config = FlowConfig(flow="concentric", flow_centre="piece")
    found = directions(config, mask)
    for part, at in ((left, (14, 13)), (right, (42, 44))):
        v, u = np.indices(mask.shape) - np.array(at)[:, None, None]
        far = part & (np.hypot(v, u) > 4)
        outward = (found[..., 0] * v + found[..., 1] * u) / np.maximum(np.hypot(v, u), 1)
        assert np.abs(outward[far]).max() < 0.13
    together = directions(FlowConfig(flow="concentric"), mask)
    assert np.abs(together - found)[mask].max() > 1, "about the common centre they do not"


@pytest.mark.parametrize("thickness", [5, 9, 20])
def test_the_outline_of_a_disc_is_followed_along_its_border_and_no_deeper(thickness):
    side, radius = 121, 50
    v, u = np.indices((side, side)) - 60
    depth = radius - np.hypot(v, u)
    mask = depth > 0
    found = directions(FlowConfig(silhouette=thickness), mask)
    moving = np.abs(found).sum(axis=-1) > 0
    border = mask & (depth < 0.6 * thickness)
    assert moving[border].all()
    assert not moving[depth > 1.06 * thickness + 1].any()
    radial = (found[..., 0] * v + found[..., 1] * u) / np.maximum(np.hypot(v, u), 1)
    # Of a fine zone the steps of the disc's border itself are seen.
    assert np.abs(radial[border]).mean() < (0.1 if thickness == 5 else 0.05)
    turning = found[..., 0] * u - found[..., 1] * v
    assert (turning[border] > 0).all(), "in the sense of x' = -y, y' = x"


def test_the_outline_comes_before_the_system_inside():
    mask = np.pad(np.ones((40, 60), bool), 10)
    found = directions(FlowConfig(flow="1, 1", silhouette=6), mask)
    assert np.allclose(found[30, 40], np.sqrt(0.5), atol=0.01), "the middle is the system's"
    assert np.array_equal(found[11, 40], (0, 1)) and np.array_equal(found[48, 40], (0, -1))
    assert np.array_equal(found[30, 11], (-1, 0)) and np.array_equal(found[30, 68], (1, 0))


def test_a_form_that_fills_its_box_has_its_border_at_the_faces():
    found = directions(FlowConfig(silhouette=4), np.ones((30, 30), bool))
    assert np.array_equal(np.abs(found[0, 15]), (0, 1)) and np.array_equal(
        np.abs(found[15, 29]), (1, 0)
    )
    assert not found[15, 15].any()


def test_the_gradient_is_that_of_the_blurred_slice():
    """Compare with SciPy: the mean over a disc and a central difference."""
    rng = np.random.default_rng(3)
    plane = ndimage.gaussian_filter(rng.normal(size=(50, 40)), 5) > 0
    rows, columns, every = along_outline(plane, 7)
    assert every == 1
    disc = np.hypot(*np.mgrid[-6:7, -6:7]) <= 6
    smooth = ndimage.convolve(
        np.pad(plane, 20).astype(np.int64), disc.astype(np.int64), mode="constant"
    )
    down, right = (2 * np.gradient(smooth, axis=axis)[20:-20, 20:-20] for axis in (0, 1))
    held = plane.any(axis=1)[:, None] & plane.any(axis=0)
    assert np.array_equal(columns[held], down[held]) and np.array_equal(rows[held], -right[held])


def test_thick_outlines_are_found_on_cells():
    mask = disc(200, 80, (99, 99))
    rows, columns, every = along_outline(mask, 32)
    assert every == 4 and rows.shape == columns.shape == (50, 50)
    cell = along_outline(mask[1::4, 1::4], 8)
    assert np.mean(np.abs(np.arctan2(rows, columns) - np.arctan2(*cell[:2])) < 0.1) > 0.9


def test_windows_of_a_form_agree_with_the_whole():
    rng = np.random.default_rng(4)
    mask = ndimage.gaussian_filter(rng.normal(size=(24, 28, 26)), 3) > 0
    config = FlowConfig(flow="spiral", silhouette=4, crust=1, flow_axis="y", flow_centre="piece")
    flow = flow_of(config, mask.shape, 1.0, mask)
    whole, room = (
        flow.directions(tuple((0, side) for side in mask.shape)),
        flow.room(((0, 24), (0, 28), (0, 26))),
    )
    box = ((3, 15), (0, 28), (11, 20))
    part = tuple(slice(*ends) for ends in box)
    assert np.array_equal(flow.directions(box), whole[part])
    assert np.array_equal(flow.directions(box, 3), whole[3:15:3, ::3, 11:20:3])
    assert np.array_equal(flow.room(box), room[part])
    beyond = ((-9, 15), (20, 40), (-4, 60))
    assert np.array_equal(flow.room(beyond)[9:, :8, 4:30], room[:15, 20:])
    assert not flow.room(beyond)[:9].any() and not flow.room(beyond)[:, 8:].any()
    assert flow.directions(beyond).shape == (24, 20, 64, 3)


def test_regions_take_the_first_that_holds():
    labels = np.zeros((10, 10), np.uint8)
    labels[:, 5:] = 2
    regions = [["y > 0.5", "none"], ["label == 2", "vertical"]]
    config = FlowConfig(flow="horizontal", flow_regions=regions, flow_labels=labels)
    found = flow_of(config, (20, 20), 1.0).directions(((0, 20), (0, 20))) / 127
    assert (found[:15, :10] == (0, 1)).all() and (found[:15, 10:] == (1, 0)).all()
    assert not found[15:].any()


def test_regions_are_parts_of_the_volume_whatever_the_axis():
    for axis in "zyx":
        config = FlowConfig(
            flow="0, 0, 1", flow_axis=axis, flow_regions=[["z > 0 and x > 0", "1, 0, 0"]]
        )
        found = flow_of(config, (8, 8, 8), 2.0).directions(((0, 8),) * 3) / 127
        inside = np.zeros((8, 8, 8), bool)
        inside[4:, :, 4:] = True
        assert (found[inside] == (0, 0, 1)).all() and (found[~inside] == (1, 0, 0)).all()


def test_wide_slices_flow_horizontally_and_tall_ones_vertically():
    mask = np.zeros((3, 40, 40), bool)
    mask[0, 15:25, 2:38] = True  # wide
    mask[1, 2:38, 15:25] = True  # tall
    mask[2, 10:30, 8:30] = True  # neither
    found = directions(FlowConfig(flow="1, 1", flow_aspect=1.5), mask)
    assert (found[0] == (0, 0, 1)).all() and (found[1] == (0, 1, 0)).all()
    assert np.allclose(found[2], (0, np.sqrt(0.5), np.sqrt(0.5)), atol=0.01)
    box = flow_of(FlowConfig(flow_aspect=2), (2, 10, 30), 1.0).directions(
        ((0, 2), (0, 10), (0, 30))
    )
    assert (box == (0, 0, 127)).all(), "without a mask it is the slice of the box"


def test_crumb_is_what_lies_deeper_than_the_crust():
    mask = ball(41, 17.3)
    mask[:, 20, :5] = False
    for spacing in (1.0, 0.5):
        room = flow_of(FlowConfig(crust=4 * spacing), mask.shape, spacing, mask).room(
            ((0, 41),) * 3
        )
        depth = ndimage.distance_transform_edt(np.pad(mask, 1))[1:-1, 1:-1, 1:-1] - 0.5
        assert np.array_equal(room, depth > 4)
    share = flow_of(FlowConfig(crust_share=0.5), mask.shape, 1.0, mask, distance=8.0).room(
        ((0, 41),) * 3
    )
    assert np.array_equal(share, depth > 4)
    assert flow_of(FlowConfig(flow="roll"), mask.shape, 1.0, mask).room(((0, 41),) * 3) is None


def test_the_faces_of_the_box_are_a_surface_of_the_form():
    room = flow_of(FlowConfig(crust=2), (9, 12), 1.0, np.ones((9, 12), bool)).room(
        ((0, 9), (0, 12))
    )
    assert np.array_equal(room, np.pad(np.ones((5, 8), bool), 2))


def test_a_mask_with_no_room_is_refused():
    with pytest.raises(InputError, match=r"the mask has no room: .* its crust of 9"):
        flow_of(FlowConfig(crust=9), (20, 20, 20), 1.0, ball(20, 8.0))
    thin = np.ones((40, 40, 3), bool)
    thin[33:36, 10:13] = True
    with pytest.raises(InputError, match="no room"):
        flow_of(FlowConfig(crust=2), thin.shape, 1.0, thin)
    # The slice that holds most has none, another has.
    sheet = np.zeros((40, 40, 40), bool)
    sheet[2] = True
    sheet[20:32, 10:22, 10:22] = True
    assert flow_of(FlowConfig(crust=4), sheet.shape, 1.0, sheet).room(((0, 40),) * 3).any()


@pytest.mark.parametrize(
    ("settings", "error", "words"),
    [
        ({"flow_axis": "w"}, UnknownNameError, "flow_axis"),
        ({"flow_centre": "middle"}, UnknownNameError, "flow_centre"),
        ({"flow_extent": -1}, InputError, "flow_extent"),
        ({"flow_aspect": 0.5}, InputError, "flow_aspect"),
        ({"crust": -1}, InputError, "crust"),
        ({"silhouette_share": 1e3}, InputError, "silhouette_share"),
        ({"flow_regions": "x > 0"}, InputError, "pairs of a condition and a flow"),
        ({"flow_regions": [["x > q", "roll"]]}, UnknownNameError, "'q'"),
        ({"flow_regions": [["x > 0", "rol"]]}, UnknownNameError, "did you mean 'roll'"),
        ({"flow_labels": "nowhere.tif"}, FileError, "nowhere.tif"),
        ({"flow_labels": np.zeros((3, 3))}, InputError, "whole numbers"),
        ({"flow_labels": "word"}, InputError, "a file of labels"),
    ],
)
def test_settings_out_of_range_are_refused(settings, error, words):
    with pytest.raises(error, match=words):
        FlowConfig(**settings)


def test_labels_of_a_picture_are_not_those_of_a_volume():
    config = FlowConfig(flow_regions=[["label", "roll"]], flow_labels=np.ones((4, 4), np.uint8))
    with pytest.raises(InputError, match="as many axes as the request"):
        flow_of(config, (4, 4, 4), 1.0)


def test_labels_from_a_file_are_kept_by_name_and_digest(tmp_path):
    labels = np.zeros((6, 8), np.uint8)
    labels[:, 4:] = 1
    tb.write(tb.Image(labels, "labels"), tmp_path / "zones.tif")
    config = FlowConfig(flow_regions=[["label", "radial"]], flow_labels=str(tmp_path / "zones.tif"))
    again = FlowConfig(**json.loads(json.dumps(asdict(config))))
    assert again == config and again.flow_labels.startswith(f"{tmp_path / 'zones.tif'}#sha256=")
    found = flow_of(again, (12, 16), 1.0).directions(((0, 12), (0, 16)))
    assert found[:, 8:].any(axis=-1).all() and not found[:, :8].any()
    tb.write(tb.Image(1 - labels, "labels"), tmp_path / "zones.tif")
    with pytest.raises(FileError, match=r"flow_labels=.* holds other numbers"):
        FlowConfig(**asdict(config) | {"flow_labels": str(config.flow_labels)})
