"""The page of a part under its loads."""

import re

import numpy as np
import pytest

import trabecula as tb
from trabecula import fields
from trabecula.core.errors import InputError
from trabecula.pipeline.design_page import asked_compliance
from trabecula.report.design_page import design_page, part_scale, weak_places

PULLED = {
    "shape": (4, 4, 12),
    "supports": [{"box": [(0, 1), (0, 1), (0, 0)], "axes": "x"}, {"box": [(0, 0), (0, 0), (0, 0)]}],
    "loads": [{"box": [(0, 1), (0, 1), (1, 1)], "force": (0, 0, 1)}],
}
PULLED["supports"].append({"box": [(1, 1), (0, 0), (0, 0)], "axes": "y"})


def notched():
    """A bar of 4 x 4 with a notch that leaves 2 x 4."""
    bar = np.ones((4, 4, 12), np.uint8)
    bar[2:, :, 5:7] = 0
    return tb.Image(bar, "labels", (0.1,) * 3, "mm", ("void", "solid"))


def test_the_weakest_place_is_the_notch_and_as_thick_as_what_it_leaves():
    image = notched()
    found = fields.part_stress(image, PULLED)
    worst = weak_places(image, found)[0]
    assert 4 <= worst.voxel[2] <= 7
    assert worst.thickness <= 0.25
    assert worst.stress == pytest.approx(found.values.max())


def test_the_strain_of_a_pulled_element_is_its_stress():
    found = fields.principal_stress(np.ones((3, 3, 9)), {**PULLED, "shape": (3, 3, 9)}, poisson=0.0)
    middle = found.strain[1, 1, 4], found.stress[1, 1, 4]
    assert middle[0] == pytest.approx(middle[1], rel=1e-2)


def test_the_page_says_what_was_asked_and_got():
    image = notched()
    found = fields.part_stress(image, PULLED)
    got = found.recipe.steps[-1]["report"]
    html = design_page(image, found, asked=[0.5], scale=part_scale(image, 1e9))
    ratio = got["compliance"][0] / got["solid_compliance"][0]
    cells = re.findall(r'<td class="n">([^<]*)</td>', html)
    assert cells[0] == "1" and float(cells[1]) == pytest.approx(ratio, rel=0.01)
    assert float(cells[3]) == pytest.approx(2 * ratio, rel=0.01)
    # a newton on a face of .1 mm is 100 MPa
    assert float(cells[5]) == pytest.approx(100 * got["largest"], rel=0.01)
    assert "<script" not in html and "MPa" in html


def test_a_design_of_solid_asks_for_the_compliance_of_solid():
    ones = tb.Image(np.ones((4, 4, 12), np.float32), "grey")
    assert asked_compliance(ones, PULLED) == pytest.approx([1.0])
    half = tb.Image(np.full((4, 4, 12), 0.5, np.float32), "grey")
    assert asked_compliance(half, PULLED) == pytest.approx([2.0], rel=1e-3)


def test_pascal_need_a_length():
    with pytest.raises(InputError, match="has no pascal"):
        part_scale(tb.Image(np.ones((2, 2, 2), np.uint8), "labels"), 1e9)
