"""Drainage and imbibition: tubes, bottles, dead ends, and every radius eroded, labelled and dilated
by itself.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

import trabecula as tb
from trabecula.errors import InputError
from trabecula.measure import drainage, entry_radius, imbibition, local_thickness, percolates


def pores(shape, seed, share=0.55, width=1.0):
    field = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=shape), width)
    return (field > np.quantile(field, share)).astype(np.uint8)


def ends(shape, axis, side):
    face = np.zeros(shape, bool)
    np.moveaxis(face, axis, 0)[side] = True
    return face


def joined(region, seeds, structure):
    """Return the components of a region that hold a seed."""
    labels, _ = ndimage.label(region, structure)
    return region & np.isin(labels, np.unique(labels[seeds & region]))


def dilated(centres, radius, spacing):
    """Return the voxels nearer to a centre than a radius."""
    if not centres.any():
        return centres
    return ndimage.distance_transform_edt(~centres, sampling=spacing) < radius * (1 - 1e-6)


def brute_drainage(inside, inlet, outlet, *, trapping, structure=None, spacing=1.0):
    """Drain radius by radius: a map of radii, the trapped voxels, the radius at breakthrough."""
    distance = ndimage.distance_transform_edt(inside, sampling=spacing).astype(np.float32)
    found, trapped = np.zeros(inside.shape, np.float32), np.zeros(inside.shape, bool)
    reached, entry = np.zeros(inside.shape, bool), 0.0
    for radius in np.unique(distance[inside])[::-1]:
        if trapping:  # what has lost its way before this radius
            trapped |= inside & (found == 0) & ~joined(inside & (found == 0), outlet, structure)
        centres = joined(inside & (distance >= radius), inlet, structure)
        balls = dilated(centres, radius, spacing)
        reached |= balls
        found[balls & (found == 0) & ~trapped] = radius
        if entry == 0 and (centres & outlet).any():
            entry = radius
    return found, trapped & reached, entry


def brute_imbibition(inside, inlet, *, structure=None):
    """Open radius by radius what is connected to the inlet; a map of radii, and what is trapped."""
    begin = joined(inside, inlet, structure)
    distance = ndimage.distance_transform_edt(begin).astype(np.float32)
    found, trapped = np.zeros(inside.shape, np.float32), np.zeros(inside.shape, bool)
    for radius in np.unique(distance[begin]):
        # Balls of voxels: a large one is not exactly the union of the smaller ones in it.
        larger = np.unique(distance[begin & (distance >= radius)])
        opened = np.any([dilated(distance >= one, one, None) for one in larger], axis=0)
        trapped |= opened & ~trapped & ~joined(opened, inlet, structure)
        found[opened & ~trapped] = radius
    return found, trapped


@pytest.mark.parametrize("trapping", [False, True])
@pytest.mark.parametrize("connectivity", [6, 26])
@pytest.mark.parametrize(("seed", "axis", "side"), [(1, 0, 0), (2, 2, -1), (3, 1, 0)])
def test_drainage_is_erosion_labelling_and_dilation(seed, axis, side, connectivity, trapping):
    values = pores((17, 14, 19), seed)
    structure = ndimage.generate_binary_structure(3, 1 if connectivity == 6 else 3)
    inlet, outlet = ends(values.shape, axis, side), ends(values.shape, axis, -1 - side)
    radii, trapped, entry = brute_drainage(
        values == 0, inlet, outlet, trapping=trapping, structure=structure
    )
    found = drainage(values, inlet=(axis, side), connectivity=connectivity, trapping=trapping)
    np.testing.assert_allclose(found.radius_map, radii, rtol=1e-6)
    np.testing.assert_array_equal(found.trapped_map, trapped)
    assert found.entry_radius == pytest.approx(entry)
    assert found.trapped == pytest.approx(trapped.sum() / (values == 0).sum())
    assert trapped.any() == trapping
    shares = [(radii >= radius).sum() / (values == 0).sum() for radius in np.unique(radii)[:0:-1]]
    assert found.saturation == pytest.approx(shares)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**31), st.floats(0.3, 0.7), st.booleans())
def test_drainage_of_random_volumes(seed, share, trapping):
    values = pores((9, 8, 7), seed, share, 0.6)
    values[0, 0, 0] = 0
    inlet, outlet = (ends(values.shape, 0, side) for side in (0, -1))
    radii, trapped, _ = brute_drainage(values == 0, inlet, outlet, trapping=trapping)
    found = drainage(values, trapping=trapping)
    np.testing.assert_allclose(found.radius_map, radii, rtol=1e-6)
    np.testing.assert_array_equal(found.trapped_map, trapped)


def test_voxels_that_are_no_cubes():
    values, spacing = pores((12, 14, 13), 5), (3.0, 2.0, 2.5)
    inlet, outlet = (ends(values.shape, 1, side) for side in (0, -1))
    radii, trapped, _ = brute_drainage(values == 0, inlet, outlet, trapping=True, spacing=spacing)
    image = tb.Image(values, "labels", spacing, "um")
    found = drainage(image, inlet=(1, 0), trapping=True)
    np.testing.assert_allclose(found.radius_map, radii, rtol=1e-5)
    np.testing.assert_array_equal(found.trapped_map, trapped)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_imbibition_is_opening_and_labelling(seed):
    values = pores((15, 16, 14), seed, 0.5)
    radii, trapped = brute_imbibition(values == 0, ends(values.shape, 0, 0))
    found = imbibition(values, trapping=True)
    assert trapped.any()
    np.testing.assert_array_equal(found.trapped_map, trapped)
    np.testing.assert_array_equal(np.isinf(found.radius_map), trapped)
    free = ~trapped
    np.testing.assert_allclose(found.radius_map[free], radii[free], rtol=1e-6)
    assert found.saturation[-1] == found.trapped == trapped.sum() / (values == 0).sum()


def test_planes_are_volumes_of_one_slice():
    values = pores((30, 26), 8, 0.5)
    for trapping in (False, True):
        flat = drainage(values, inlet=(1, -1), trapping=trapping)
        radii, trapped, _ = brute_drainage(
            values == 0, ends(values.shape, 1, -1), ends(values.shape, 1, 0), trapping=trapping
        )
        np.testing.assert_allclose(flat.radius_map, radii, rtol=1e-6)
        np.testing.assert_array_equal(flat.trapped_map, trapped)


def tube(radius, side=24, length=10):
    """Return a straight tube along z, 0 in it, whose centre is no voxel's."""
    y, x = np.indices((side, side)) - (side - 1) / 2 - np.array([0.21, 0.34])[:, None, None]
    return np.broadcast_to(y**2 + x**2 >= radius**2, (length, side, side)).astype(np.uint8)


@pytest.mark.parametrize("radius", [2.0, 3.5, 5.2, 8.7, 10.1])
def test_a_tube_is_entered_at_its_radius(radius):
    found = drainage(tube(radius))
    assert found.entry_radius == pytest.approx(radius, abs=0.6)
    assert found.entry_radius == found.radii[0] and found.saturation[0] > 0.6
    assert found.trapped == 0 and found.saturation[-1] == 1


def test_the_outlet_may_be_all_other_faces():
    values = pores((14, 15, 16), 6)
    inlet, rest = ends(values.shape, 1, 0), np.zeros(values.shape, bool)
    for axis in range(3):
        for side in (0, -1):
            rest |= ends(values.shape, axis, side)
    radii, trapped, entry = brute_drainage(values == 0, inlet, rest & ~inlet, trapping=True)
    found = drainage(values, inlet=(1, 0), outlet="all", trapping=True)
    np.testing.assert_allclose(found.radius_map, radii, rtol=1e-6)
    np.testing.assert_array_equal(found.trapped_map, trapped)
    assert found.entry_radius == pytest.approx(entry)
    assert found.trapped < drainage(values, inlet=(1, 0), trapping=True).trapped


def test_of_two_tubes_the_wide_one_drains_first():
    values = np.concatenate([tube(6.0), tube(3.0)], axis=2)
    found = drainage(values)
    wide = found.nonwetting(5.0)
    assert wide[:, :, :24].any() and not wide[:, :, 24:].any()
    assert found.nonwetting(2.5)[:, :, 24:].any()
    assert found.entry_radius == drainage(tube(6.0)).entry_radius


@pytest.fixture
def bottle():
    """Return a neck of radius 3 before a body of radius 8 before a neck of radius 2."""
    return np.concatenate([tube(3.0, length=8), tube(8.0, length=16), tube(2.0, length=8)])


def test_a_bottle_drains_at_its_neck(bottle):
    found = drainage(bottle)
    body = found.radius_map[8:24][bottle[8:24] == 0]
    neck, narrow = drainage(tube(3.0)).entry_radius, drainage(tube(2.0)).entry_radius
    assert body.max() <= neck < local_thickness(bottle, phase=0).max() / 2 - 3
    assert found.entry_radius == narrow
    # From the other side it is the other neck that counts.
    assert drainage(bottle, inlet=(0, -1)).radius_map[8:24].max() == narrow
    assert drainage(bottle, inlet=(0, -1)).entry_radius == narrow


def test_a_bottle_snaps_off_at_its_neck(bottle):
    back = imbibition(bottle, trapping=True)
    assert back.trapped_map[9:20].any() and not back.trapped_map[:4].any()
    assert 0.5 < back.trapped < 0.95
    free = imbibition(bottle)
    assert free.trapped == 0 and free.saturation[-1] == 0 and free.saturation[0] == 1
    assert np.all(np.diff(free.saturation) <= 0) and np.all(np.diff(free.radii) > 0)


def test_a_dead_end_keeps_its_fluid():
    values = tube(4.0, length=20)
    values[:, :, 20:22] = 1
    values[0:6, 10:14, 14:22] = 0  # a side pore on the inlet's face, open to the tube alone
    values[19] = 1
    closed = drainage(values, trapping=True)  # no way to the outlet
    assert closed.trapped == 1 and len(closed.radii) == 0 and closed.entry_radius == 0
    values[19] = tube(4.0)[0]
    found = drainage(values, trapping=True)
    assert 0 < found.trapped < 0.5 and found.trapped_map[:6, :, 18:].any()
    assert drainage(values).trapped == 0 and drainage(values).saturation[-1] == 1


def test_all_faces_let_as_much_in_as_the_local_thickness():
    values = pores((20, 20, 20), 4, 0.5)
    mercury = drainage(values, inlet="all")
    assert mercury.entry_radius is None
    thick = (local_thickness(values, phase=0) + 0.5) / 2
    assert np.all(mercury.radius_map <= thick + 1e-6)
    one = drainage(values)
    assert np.all(one.radius_map <= mercury.radius_map)
    whole = drainage(
        np.pad(values[:1] * 0, ((0, 0), (1, 1), (1, 1)), constant_values=1), inlet="all"
    )
    assert whole.saturation[-1] == 1


def test_balls_between_spheres_pass_the_published_throat():
    # Simple cubic spheres that touch: between four of them the throat has sqrt(2) - 1 radii.
    side = 31
    z, y, x = np.indices((side,) * 3) + 0.5
    corner = [np.minimum(one, side - one) for one in (z, y, x)]
    values = (sum(one**2 for one in corner) < (side / 2) ** 2).astype(np.uint8)
    values = np.concatenate([values, values])
    found = drainage(values, periodic=True)
    assert found.entry_radius == pytest.approx((np.sqrt(2) - 1) * side / 2, abs=0.75)
    body = (np.sqrt(3) - 1) * side / 2  # the largest ball between eight
    assert imbibition(values, periodic=True).radii[-2] == pytest.approx(body, abs=0.75)


def test_entry_is_percolation():
    through = set()
    for seed in range(12):
        values = pores((12, 12, 12), seed, 0.3, 0.7)
        through.add(percolates(values, phase=0)["z"])
        assert (drainage(values).entry_radius > 0) == percolates(values, phase=0)["z"]
    assert through == {True, False}


def test_periodic_sides_lead_through():
    values = np.ones((9, 24, 12), np.uint8)
    values[:5, 1:4, 4:7] = values[4:, 20:23, 4:7] = 0
    values[4:7, :4, 4:7] = values[4:7, 20:, 4:7] = 0
    assert drainage(values).entry_radius == 0
    assert drainage(values, periodic=True).entry_radius > 1
    assert drainage(values, periodic=(False, True, False)).entry_radius > 1


def test_imbibition_starts_where_drainage_ended(bottle):
    ended = drainage(bottle).nonwetting(2.5)
    found = imbibition(bottle, start=ended, trapping=True)
    assert found.saturation[0] == ended.sum() / (bottle == 0).sum() < 1
    assert not (found.radius_map[~ended] > 0).any()
    with pytest.raises(InputError, match="beyond the phase"):
        imbibition(bottle, start=np.ones(bottle.shape, bool))
    with pytest.raises(InputError, match="boolean array of shape"):
        imbibition(bottle, start=ended[1:])


def test_pressure_is_laplaces():
    image = tb.Image(tube(5.0), "labels", spacing=2.0, unit="um", phases=("void", "solid"))
    found = drainage(image, surface_tension=0.48, contact_angle=140)
    expected = 2 * 0.48 * np.cos(np.radians(40)) / (found.radii * 1e-6)
    np.testing.assert_allclose(found.pressure, expected)
    assert found.radii[0] == pytest.approx(2 * drainage(tube(5.0)).radii[0])
    assert drainage(image).pressure is None
    back = imbibition(image, surface_tension=0.48)
    assert back.pressure[-1] == 0 and np.all(np.diff(back.pressure) < 0)
    slit = tb.Image(image.values[:, 12], "labels", 2.0, "um", phases=("void", "solid"))
    plane = drainage(slit, surface_tension=0.48)
    np.testing.assert_allclose(plane.pressure, 0.48 / (plane.radii * 1e-6))


def test_what_cannot_be_drained_is_refused(bottle):
    with pytest.raises(InputError, match="void is empty"):
        drainage(tb.Image(np.ones((5, 5, 5), int), "labels", phases=("void", "solid")))
    with pytest.raises(InputError, match="fills the whole image"):
        drainage(tb.Image(np.zeros((5, 5, 5), int), "labels", phases=("void", "solid")))
    with pytest.raises(InputError, match="does not reach the inlet"):
        drainage(bottle, inlet=(1, 0))
    with pytest.raises(InputError, match="is no face"):
        drainage(bottle, inlet=(0, 1))
    with pytest.raises(InputError, match="axis 3 does not exist"):
        drainage(bottle, inlet=(3, 0))
    with pytest.raises(InputError, match="inlet and outlet are both"):
        drainage(bottle, inlet=(0, 0), outlet=(0, 0))
    with pytest.raises(InputError, match="all faces are the inlet"):
        drainage(bottle, inlet="all", outlet=(0, 0))
    with pytest.raises(InputError, match="trapping needs an outlet"):
        drainage(bottle, inlet="all", trapping=True)
    with pytest.raises(InputError, match="every axis is periodic"):
        drainage(bottle, inlet="all", periodic=True)
    with pytest.raises(InputError, match="surface_tension"):
        drainage(bottle, surface_tension=-0.07)
    with pytest.raises(InputError, match="no length"):
        drainage(bottle, surface_tension=0.07)
    with pytest.raises(InputError, match="contact_angle=90"):
        drainage(bottle, surface_tension=0.07, contact_angle=90)
    with pytest.raises(InputError, match="must be positive"):
        drainage(bottle).nonwetting(0)


@pytest.mark.parametrize("spacing", [(1.0, 1.0, 1.0), (2.0, 1.5, 1.0)])
def test_the_entry_radius_is_that_of_drainage(spacing):
    image = tb.Image(pores((18, 20, 22), 3, share=0.4), "labels", spacing, "um")
    found = entry_radius(image)
    for axis, name in enumerate("zyx"):
        expected = drainage(image, inlet=(axis, 0)).entry_radius
        assert found[name] == pytest.approx(expected, rel=1e-6)
    slab = np.ones((6, 8), np.uint8)
    slab[2:4] = 0
    assert entry_radius(slab) == {"y": 0.0, "x": 1.0}
    with pytest.raises(InputError, match="fills the whole"):
        entry_radius(np.zeros((4, 4, 4), np.uint8))
