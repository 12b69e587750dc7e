"""Relative permeability of slits and tubes, where each fluid's flow is known."""

import numpy as np
import pytest

import trabecula as tb
from trabecula.errors import InputError
from trabecula.measure import drainage, permeability, relative_permeability


def slits(*widths, length=6):
    """Return slits along the first axis with walls of 2 voxels."""
    parts = [np.ones(1)]
    for width in widths:
        parts += [np.zeros(width), np.ones(2)]
    return np.tile(np.concatenate(parts)[:-1].astype(np.uint8), (length, 1))


def test_oil_in_the_widest_slits_and_water_in_the_others():
    image = slits(11, 3, 7)
    whole = permeability(image, axis=0, tolerance=1e-6).value

    def alone(*kept):
        found = [w if k in kept else 0 for k, w in enumerate((11, 3, 7))]
        values = slits(11, 3, 7)
        at = 1
        for width, own in zip((11, 3, 7), found, strict=True):
            values[:, at : at + width] = 0 if own else 1
            at += width + 2
        return permeability(values, axis=0, tolerance=1e-6).value / whole

    found = relative_permeability(image, axis=0, saturations=[0.5, 0.9, 1.0], tolerance=1e-6)
    assert found.saturation == pytest.approx([11 / 21, 18 / 21, 1])
    assert found.nonwetting == pytest.approx([alone(0), alone(0, 2), 1], rel=1e-4)
    assert found.wetting[:2] == pytest.approx((alone(1, 2), alone(1)), rel=1e-4)
    assert found.wetting[2] is None and all(found.converged)
    assert found.radii.tolist() == sorted(found.radii.tolist(), reverse=True)
    assert found.absolute.value == pytest.approx(whole)
    assert found.to_json()["wetting"][2] == "does not percolate"


def test_the_way_back_leaves_the_widest_slit_last():
    found = relative_permeability(slits(11, 3, 7), axis=0, saturations=[0.5], process="imbibition")
    forth = relative_permeability(slits(11, 3, 7), axis=0, saturations=[0.5])
    assert found.saturation == pytest.approx(forth.saturation)
    assert found.nonwetting == pytest.approx(forth.nonwetting)


def test_a_bottle_neck_holds_the_oil_back():
    values = np.ones((18, 12, 12), np.uint8)
    values[:, 1:5, 1:5] = 0  # a duct of 4
    values[:9, 6:11, 6:11] = values[12:, 6:11, 6:11] = 0  # one of 5 with a neck of 1
    values[:, 8, 8] = 0
    found = relative_permeability(values, axis=0, saturations=[0.3])
    # the oil is in the near half of the wide duct and leads nowhere; water flows
    assert found.nonwetting == (None,)
    assert found.wetting[0] == pytest.approx(1, abs=0.08)
    own = drainage(values)
    assert found.radii[0] > own.entry_radius


def test_units_and_axes():
    image = slits(9, 5)
    plain = relative_permeability(image, axis=0, saturations=[0.6])
    turned = tb.Image(np.ascontiguousarray(image.T), "labels", 2.0, "um")
    other = relative_permeability(turned, axis=1, saturations=[0.6])
    assert other.nonwetting == pytest.approx(plain.nonwetting)
    assert other.absolute.value == pytest.approx(4 * plain.absolute.value)
    assert other.radii == pytest.approx(2 * plain.radii)


def test_what_it_cannot_solve_is_refused():
    image = slits(9, 5)
    with pytest.raises(InputError, match="from 0 to 1"):
        relative_permeability(image, axis=0, saturations=[])
    with pytest.raises(InputError, match="outside 0"):
        relative_permeability(image, axis=0, saturations=[60])
    with pytest.raises(InputError, match="process"):
        relative_permeability(image, axis=0, process="suction")
    shut = slits(9, 5)
    shut[3] = 1
    with pytest.raises(InputError, match="does not percolate along axis 0"):
        relative_permeability(shut, axis=0)
