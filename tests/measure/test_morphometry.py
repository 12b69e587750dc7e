"""Bone morphometry: layers, rods and lattices whose figures are known; masks, spacing, what does
not exist.
"""

import numpy as np
import pytest

import trabecula as tb
from trabecula import measure
from trabecula.measure.morphometry import MORPHOMETRY_POWERS, connectivity_density, morphometry


def layers(period, thick, count=4):
    solid = np.zeros((period * count, 10, 10), np.uint8)
    solid[np.arange(len(solid)) % period < thick] = 1
    return solid


def lattice(period=12, wide=4, count=3):
    """Return struts along the three axes: one node and three struts to a cell."""
    near = np.arange(period * count) % period < wide
    z, y, x = near[:, None, None], near[:, None], near
    return ((z & y) | (z & x) | (y & x)).astype(np.uint8)


@pytest.mark.parametrize(("period", "thick"), [(20, 6), (20, 5), (19, 6), (15, 4), (13, 3)])
def test_periodic_layers(period, thick):
    figures = morphometry(layers(period, thick), periodic=True)
    assert figures["BV/TV"] == pytest.approx(thick / period)
    assert figures["BS/BV"] == pytest.approx(2 / thick, rel=0.09)
    assert figures["Tb.Th"] == pytest.approx(thick, abs=0.51)
    assert figures["Tb.Sp"] == pytest.approx(period - thick, abs=0.51)
    assert 1 / figures["Tb.N"] == pytest.approx(period, abs=1.01)
    fast = morphometry(layers(period, thick), periodic=True, fast=True)
    assert 1 / fast["Tb.N"] == pytest.approx(period, abs=1.01)
    assert {**fast, "Tb.N": figures["Tb.N"]} == figures


def test_rods_are_as_far_apart_as_the_sphere_between_their_axes():
    y, x = np.ogrid[:32, :32]
    rods = np.broadcast_to((y % 16 - 8) ** 2 + (x % 16 - 8) ** 2 < 4.3**2, (6, 32, 32))
    figures = morphometry(rods, periodic=True)
    assert figures["Tb.Th"] == pytest.approx(8.6, abs=0.7)
    # The sphere that touches four axes at the corners of a square fills all but its corners'
    # slivers.
    assert 0.8 * 16 * 2**0.5 < 1 / figures["Tb.N"] < 16 * 2**0.5 + 1
    assert figures["Conn.D"] == pytest.approx(1 / rods.size)


@pytest.mark.parametrize("connectivity", [6, 18, 26])
def test_connectivity_of_a_lattice(connectivity):
    # A node and half of six struts to a cell: Euler number 1 - 3, wherever the cells begin.
    solid = lattice()
    volume, cells = solid.size, 27
    expected = (1 + 2 * cells) / volume
    assert connectivity_density(solid, connectivity=connectivity, periodic=True) == pytest.approx(
        expected
    )
    shifted = np.roll(solid, (5, 3, 7), axis=(0, 1, 2))
    assert connectivity_density(shifted, periodic=True) == pytest.approx(expected)
    # Parts of the lattice that the faces cut count by halves, quarters and eighths.
    cut = np.pad(solid, [(0, 1)] * 3, mode="wrap")
    assert connectivity_density(cut) == pytest.approx(1 / cut.size + 2 * cells / volume)


def test_bone_is_connected_by_corners():
    """A ring of four voxels that touch along edges only: one strut may be cut, by 26 neighbours."""
    ring = np.zeros((3, 5, 5), np.uint8)
    ring[1, [1, 2, 2, 3], [2, 1, 3, 2]] = 1
    assert connectivity_density(ring, periodic=True) * ring.size == pytest.approx(1)
    assert morphometry(ring, periodic=True)["Conn.D"] * ring.size == pytest.approx(1)


def test_lengths_carry_the_spacing():
    solid = lattice(count=2)
    plain = morphometry(solid)
    scaled = morphometry(tb.Image(solid, "labels", spacing=19.5, unit="um"))
    for name, power in MORPHOMETRY_POWERS.items():
        assert scaled[name] == pytest.approx(plain[name] * 19.5**power, rel=1e-5)
    stretched = tb.Image(layers(10, 4), "labels", spacing=(2.0, 1.0, 1.0))
    assert morphometry(stretched, periodic=True)["Tb.Sp"] == pytest.approx(12, abs=1.01)


def test_mask_of_a_box_is_a_crop_and_the_rim_is_no_surface():
    solid = lattice(count=2)
    mask = np.zeros(solid.shape, bool)
    mask[3:20, 2:21, 4:22] = True
    masked, crop = (
        morphometry(solid, mask=mask),
        morphometry(np.ascontiguousarray(solid[3:20, 2:21, 4:22])),
    )
    assert masked == pytest.approx(crop)
    z, y, x = np.ogrid[-20:21, -20:21, -20:21]
    cylinder = np.broadcast_to(y**2 + x**2 < 15**2, (41, 41, 41))
    plates = np.broadcast_to(z % 10 < 4, (41, 41, 41))
    filled = plates & cylinder  # beyond the cylinder nothing is known
    figures = morphometry(filled, mask=cylinder)
    assert figures["BV/TV"] == pytest.approx(17 / 41, abs=1e-9)
    assert figures["BS/BV"] == pytest.approx(2 / 4, rel=0.12) and figures["Tb.Th"] == pytest.approx(
        4, abs=0.51
    )


def test_what_does_not_exist_is_none():
    none = morphometry(np.zeros((4, 4, 4), np.uint8))
    assert none == {
        "BV/TV": 0,
        "BS/BV": None,
        "Tb.Th": None,
        "Tb.Sp": None,
        "Tb.N": None,
        "Conn.D": None,
    }
    full = morphometry(np.ones((4, 4, 4), np.uint8))
    assert full["BV/TV"] == 1 and full["BS/BV"] == 0 and full["Tb.Th"] is None
    for function in (morphometry, connectivity_density):
        with pytest.raises(tb.errors.InputError, match="2-D"):
            function(np.eye(4, dtype=np.uint8))


def test_real_bone_is_in_the_range_of_trabecular_bone(data):
    image = tb.read(data / "trabecular_bone_a.tif")
    crop = tb.Image(image.values[:70, :70, :70], "labels", spacing=image.spacing, unit=image.unit)
    figures = morphometry(crop)
    # The mid-axes lie a thickness further apart than the surfaces; spurs of the axes bring them
    # nearer again.
    assert 0.8 < figures["Tb.N"] * (figures["Tb.Th"] + figures["Tb.Sp"]) < 1.3
    assert figures["Conn.D"] > 0
    assert 0.05 < figures["BV/TV"] < 0.4 and figures["BV/TV"] == pytest.approx(
        1 - measure.porosity(crop)
    )
