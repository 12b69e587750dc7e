"""Coatings of ridges, posts and beads, whose figures are known."""

import numpy as np
import pytest

import trabecula as tb
from trabecula.errors import InputError
from trabecula.measure import coating


def posts(height=20, base=6, pitch=10, wide=4, spacing=25.0, unit="um"):
    """Return square posts on a substrate, with air above."""
    values = np.zeros((base + height + 5, 4 * pitch, 3 * pitch), np.uint8)
    values[:base] = 1
    near = np.arange(4 * pitch) % pitch < wide
    values[base : base + height, near[:, None] & near[None, : 3 * pitch]] = 1
    return tb.Image(values, "labels", spacing, unit, phases=("void", "solid"))


def test_a_plain_layer_has_its_thickness():
    values = np.zeros((30, 12, 12), np.uint8)
    values[:18] = 1
    values[6:18:3] = values[6:18:3] * 0  # gaps: joined from no side
    values[17] = 1
    found = coating(tb.Image(values, "labels", 10.0, "um"))
    assert found.substrate == 6 and found.thickness == 120 and found.thickness_spread == 0
    assert found.void == pytest.approx(4 / 12)
    assert found.connected == 0 and found.window()["interconnecting"]["inside"] is False
    assert found.profile.tolist() == [1, 0, 0] * 4


def test_posts_on_a_substrate():
    image = posts()
    found = coating(image)
    share = 0.16
    assert found.substrate == 6
    assert found.thickness == pytest.approx(20 * 25 * share)
    assert found.thickness_spread == pytest.approx(20 * 25 * (share * (1 - share)) ** 0.5)
    # 84 % void; lines on 40 % of the places cross 7 walls in 39 steps, or 5 in 29
    assert found.void == pytest.approx(1 - share)
    crossed = 0.4 * (7 / 39 + 5 / 29) / 2
    assert found.intercept == pytest.approx(2 * 0.84 / crossed * 25)
    assert found.connected == 1
    assert found.profile.tolist() == pytest.approx([1 - share] * 20)
    sections = found.sections
    assert set(np.round(sections["void"], 3)) <= {0.6, 1.0} and len(sections["void"]) == 12
    assert sections["thickness"].max() == pytest.approx(20 * 25 * 0.4)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("side", [0, -1])
def test_any_axis_and_side(axis, side):
    image = posts()
    values = image.values[::-1] if side else image.values
    turned = tb.Image(np.ascontiguousarray(np.moveaxis(values, 0, axis)), "labels", 25.0, "um")
    own, other = coating(image), coating(turned, axis=axis, side=side)
    assert (other.substrate, other.thickness, other.void) == (
        own.substrate,
        own.thickness,
        own.void,
    )
    assert other.intercept == pytest.approx(own.intercept)
    assert other.pore_size == pytest.approx(own.pore_size)
    assert np.array_equal(other.profile, own.profile)


def test_the_window_is_the_rules():
    # walls 12 apart on 24 layers: half void
    values = np.ones((32, 48, 48), np.uint8)
    values[8:, np.arange(48) % 24 < 12] = 0
    values[31] = 0
    for edge, inside in ((25.0, True), (5.0, False), (100.0, False)):
        found = coating(tb.Image(values, "labels", edge, "um", phases=("void", "solid")))
        window = found.window()
        assert window["porosity"] == {"value": found.void, "range": [0.3, 0.7], "unit": "",
                                      "inside": True}  # fmt: skip
        assert window["thickness"]["value"] == pytest.approx(found.thickness)
        assert window["thickness"]["range"] == [500, 1500]
        assert window["thickness"]["inside"] is (500 <= found.thickness <= 1500)
        assert window["pore_size"]["inside"] is (100 <= found.intercept <= 1000)
        assert (window["pore_size"]["inside"] and window["thickness"]["inside"]) is False or inside
        assert window["interconnecting"]["inside"] is None
    bare = coating(tb.Image(values, "labels", phases=("void", "solid"))).window()
    assert bare["thickness"]["inside"] is None and bare["porosity"]["inside"] is True


def test_a_section_alone():
    image = posts()
    section = tb.Image(image.values[:, :, 0], "labels", 25.0, "um")
    found = coating(section)
    assert found.thickness == pytest.approx(20 * 25 * 0.4) and found.void == pytest.approx(0.6)
    assert found.pore_size is None and len(found.sections["void"]) == 1


def test_what_is_no_coating_is_refused():
    with pytest.raises(InputError, match="nothing stands above"):
        coating(np.ones((6, 8, 8), np.uint8))
    with pytest.raises(InputError, match="side 1"):
        coating(posts(), side=1)
    with pytest.raises(InputError, match="sections"):
        coating(posts(), sections=0)
