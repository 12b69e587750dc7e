"""Plates, rods and balls by their structure model index and their factor; the whole report."""

import numpy as np
import pytest

import trabecula as tb
from trabecula.errors import InputError
from trabecula.measure import bone_figures, morphometry, plates_and_rods, structure_model_index
from trabecula.measure.bone import BONE_POWERS


def places(side):
    return np.stack(np.indices((side,) * 3), axis=-1) - (side - 1) / 2


def rod(side, radius, way):
    at, along = places(side), np.array(way) / np.linalg.norm(way)
    return ((at**2).sum(-1) - (at @ along) ** 2 < radius**2).astype(np.uint8)


def plate(side, thick, way):
    return (abs(places(side) @ (np.array(way) / np.linalg.norm(way))) < thick / 2).astype(np.uint8)


WAYS = [(1, 0, 0), (1, 1, 0), (3, 1, 2)]


@pytest.mark.parametrize("way", WAYS)
def test_rods_and_plates_in_any_direction(way):
    thin, flat = rod(32, 4, way), plate(32, 6, way)
    inner = np.zeros(flat.shape, bool)
    inner[5:-5, 5:-5, 5:-5] = True  # a smoothed plate bends at the faces
    assert structure_model_index(thin) == pytest.approx(3, abs=0.45)
    assert structure_model_index(flat, mask=inner) == pytest.approx(0, abs=0.1)
    rods, plates = plates_and_rods(thin), plates_and_rods(flat)
    assert rods.rods == 1 and plates.plates == 1 and rods.plates + rods.rods == 1
    assert rods.factor > 0.35 and plates.factor < -0.35
    assert np.array_equal(plates.factor_map != 0, flat == 1)


def test_a_ball_has_four():
    ball = ((places(36) ** 2).sum(-1) < 12**2).astype(np.uint8)
    assert structure_model_index(ball) == pytest.approx(4, abs=0.4)
    # what is hollow is concave: a cavity's index has the other sign
    assert structure_model_index(1 - ball) < 0


def test_a_plate_with_a_rod_on_it_is_both():
    both = np.zeros((44, 44, 44), np.uint8)
    both[19:25] = 1
    at = np.arange(44) - 21.5
    both[:, at[:, None] ** 2 + at**2 < 9] = 1
    found = plates_and_rods(both)
    assert (found.factor_map[22, 8:12, 8:12] < -0.2).all()
    assert (found.factor_map[33:40, 21:23, 21:23] > 0.2).all()
    assert 0.05 < found.rods < 0.95


def test_lengths_scale_and_masks_count():
    solid = rod(30, 4, (1, 0, 0))
    plain, large = structure_model_index(solid), tb.Image(solid, "labels", 3.0, "um")
    assert structure_model_index(large) == pytest.approx(plain, rel=1e-6)
    assert plates_and_rods(large).factor == pytest.approx(plates_and_rods(solid).factor)
    mask = np.zeros(solid.shape, bool)
    mask[:, 4:26, 4:26] = True
    assert structure_model_index(solid, mask=mask) == pytest.approx(plain, rel=0.05)
    assert plates_and_rods(solid, mask=mask).rods == 1
    # a round rod of voxels 1 x 1 x 2
    at = (np.arange(40) - 19.5, 2 * (np.arange(20) - 9.5))
    flat = np.repeat((at[0][:, None] ** 2 + at[1] ** 2 < 49)[None], 30, axis=0)
    image = tb.Image(flat.astype(np.uint8), "labels", (1.0, 1.0, 2.0), "um")
    assert structure_model_index(image) == pytest.approx(3, abs=0.45)
    assert plates_and_rods(image).rods == 1


def test_the_report_is_whole_and_consistent():
    solid = tb.Image(plate(32, 6, (2, 0, 1)) | rod(32, 3, (1, 1, 0)), "labels", 0.05, "mm")
    found, short = bone_figures(solid), morphometry(solid)
    assert list(found) == list(BONE_POWERS) and None not in found.values()
    assert {name: found[name] for name in short} == short
    assert found["TV"] == pytest.approx(1.6**3)
    assert found["BV"] == pytest.approx(found["BV/TV"] * found["TV"])
    assert found["BS"] == pytest.approx(found["BS/BV"] * found["BV"])
    assert found["BS/TV"] == pytest.approx(found["BS"] / found["TV"])
    thickness = tb.measure.local_thickness(solid)
    own = thickness[solid.values == 1]
    assert found["Tb.Th.SD"] == pytest.approx(own.std(), rel=1e-4)
    directed = tb.measure.fabric(solid)
    assert found["MIL.ratio"] == pytest.approx(directed.lengths[0] / directed.lengths[2])
    assert found["DA"] == pytest.approx(1 - found["MIL.ratio"] ** -2)
    assert found["pBV/BV"] + found["rBV/BV"] == 1


def test_what_does_not_exist_is_none_or_refused():
    none = bone_figures(tb.Image(np.zeros((6, 6, 6), np.uint8), "labels", phases=("void", "solid")))
    assert none["BV/TV"] == 0 and none["SMI"] is None and none["pBV/BV"] is None
    full = bone_figures(tb.Image(np.ones((6, 6, 6), np.uint8), "labels", phases=("void", "solid")))
    assert full["BV/TV"] == 1 and full["Tb.Th"] is None and full["EF"] is None
    for measure in (structure_model_index, plates_and_rods):
        with pytest.raises(InputError, match="2-D"):
            measure(np.eye(6, dtype=np.uint8))
    with pytest.raises(InputError, match="fills the whole"):
        plates_and_rods(np.ones((6, 6, 6), np.uint8))
