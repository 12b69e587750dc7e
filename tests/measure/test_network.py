"""Pore networks of bodies whose pores, throats and permeability are known."""

import numpy as np
import pytest

import trabecula as tb
from trabecula.core.errors import InputError
from trabecula.measure import network


def lattice_of_ducts(width, pitch, times=1):
    """Return square ducts along z, y and x that cross in the middle of every cell."""
    cell = np.ones((pitch,) * 3, np.uint8)
    own = slice((pitch - width) // 2, (pitch + width) // 2)
    cell[own, own] = cell[own, :, own] = cell[:, own, own] = 0
    return np.tile(cell, (times,) * 3)


def spheres(pitch, radius, times, centres=((0.5, 0.5, 0.5),)):
    """Return balls of void on a lattice whose cell has `centres`, in a solid."""
    at = np.stack(np.indices((pitch * times,) * 3), axis=-1)
    void = np.zeros(at.shape[:3], bool)
    for centre in centres:
        off = (at - np.array(centre) * pitch + pitch / 2) % pitch - pitch / 2
        void |= (off**2).sum(axis=-1) < radius**2
    return (~void).astype(np.uint8)


def tube(width, side, length=12, *, round_=False):
    values = np.ones((length, side, side), np.uint8)
    at = np.arange(side) - (side - 1) / 2
    inside = np.maximum(abs(at[:, None]), abs(at)) < width / 2
    if round_:
        inside = at[:, None] ** 2 + at**2 < width**2 / 4
    values[:, inside] = 0
    return values


def test_two_rooms_and_a_door():
    values = np.ones((9, 9, 20), int)
    values[1:8, 1:8, 1:8] = values[1:8, 1:8, 11:18] = values[3:6, 3:6, 8:11] = 0
    found = network(tb.Image(values.astype(np.uint8), "labels", 2.0, "um"))
    assert found.centres.tolist() == [[8, 8, 8], [8, 8, 28]]
    assert found.throats.pores.tolist() == [[0, 1]] and len(found.openings) == 0
    assert found.throats.area.tolist() == [36.0]
    assert found.radius.tolist() == [7.5, 7.5] and found.throats.radius.tolist() == [3.5]
    assert found.volume.sum() == 8 * (values == 0).sum()
    assert found.throats.length[0] == pytest.approx(20)
    assert found.coordination.tolist() == [1, 1] and found.inside.all()
    assert np.array_equal(found.regions > 0, values == 0)


@pytest.mark.parametrize(
    ("centres", "radius", "coordination", "gap"),
    [
        (((0.5, 0.5, 0.5),), 11.0, 6, 20.0),
        (((0.25, 0.25, 0.25), (0.75, 0.75, 0.75)), 9.5, 8, 20 * 0.75**0.5),
    ],
    ids=["simple cubic", "body centred"],
)
def test_lattices_of_spheres_have_their_throats(centres, radius, coordination, gap):
    found = network(spheres(20, radius, 2, centres), periodic=True)
    pores = 8 * len(centres)
    assert len(found) == pores and (found.coordination == coordination).all()
    assert len(found.throats) == pores * coordination // 2
    throat = (radius**2 - gap**2 / 4) ** 0.5
    assert found.throats.length == pytest.approx(gap, rel=0.01)
    assert found.throats.radius == pytest.approx(throat, abs=0.75)
    assert found.throats.area.mean() == pytest.approx(np.pi * throat**2, rel=0.13)
    assert found.throats.shape_factor == pytest.approx(1 / (4 * np.pi), rel=0.15)
    assert found.radius == pytest.approx(radius, abs=0.6)


def test_faces_cut_pores_where_nothing_repeats():
    found = network(spheres(20, 11.0, 2))
    assert len(found) == 8 and (found.coordination == 3).all()
    assert len(found.openings) == 24 and (found.touches.sum(axis=1) == 3).all()
    assert np.bincount(found.openings.face).tolist() == [4] * 6
    low = found.openings.face == 0
    assert found.openings.centre[low, 0] == pytest.approx(-0.5)
    own = found.openings.pores[low, 0]
    assert (found.centres[own, 0] < 20).all() and found.touches[own, 0].all()


@pytest.mark.parametrize("width", [6, 9])
def test_straight_ducts_have_their_permeability(width):
    values, side = tube(width, 16 - width % 2), 16 - width % 2
    truth = 0.03514425 * width**4 / side**2
    assert network(values).permeability(0).value == pytest.approx(truth, rel=0.1)
    assert network(values, periodic=(True, False, False)).permeability(0).value == pytest.approx(
        truth, rel=0.1
    )
    assert network(values).diffusivity(0).value == pytest.approx(width**2 / side**2, rel=0.01)


def test_a_round_duct_has_its_permeability():
    values = tube(13, 17, round_=True)
    area = (values[0] == 0).sum()
    truth = area**2 / (8 * np.pi) / 17**2
    assert network(values).permeability(0).value == pytest.approx(truth, rel=0.1)


@pytest.mark.parametrize(("width", "pitch"), [(5, 15), (8, 24)])
def test_a_lattice_of_ducts_is_near_the_direct_solve(width, pitch):
    cell = lattice_of_ducts(width, pitch)
    found = network(lattice_of_ducts(width, pitch, 2))
    assert len(found) == 8 and (found.coordination == 3).all()
    assert (found.throats.area == width**2).all()
    flow, diffusion = found.permeability(1), found.diffusivity(1)
    assert flow.converged and flow.fraction == pytest.approx((cell == 0).mean())
    assert flow.value == pytest.approx(tb.measure.permeability(cell, axis=1).value, rel=0.12)
    assert diffusion.value == pytest.approx(tb.measure.diffusivity(cell, axis=1).value, rel=0.04)
    # junctions are wider than ducts, so it is more than ducts alone let through
    assert flow.value > 0.03514425 * width**4 / pitch**2


def test_one_cell_that_repeats_is_the_lattice():
    cell = network(lattice_of_ducts(6, 20), periodic=True)
    assert len(cell) == 1 and len(cell.throats) == 3
    assert cell.throats.pores.tolist() == [[0, 0]] * 3
    assert sorted(map(tuple, cell.throats.shift.tolist())) == [(0, 0, 1), (0, 1, 0), (1, 0, 0)]
    assert cell.throats.length == pytest.approx(20, rel=0.01)
    many = network(lattice_of_ducts(6, 20, 2))
    for solve in ("permeability", "diffusivity"):
        assert getattr(cell, solve)(2).value == pytest.approx(getattr(many, solve)(2).value)


def rock(shape, seed=4, width=2.2, share=0.4):
    """Return smooth random pores that repeat."""
    at = [np.fft.fftfreq(side)[(slice(None), *[None] * (2 - a))] for a, side in enumerate(shape)]
    smooth = np.exp(-2 * (np.pi * width) ** 2 * sum(one**2 for one in at))
    field = np.fft.ifftn(np.fft.fftn(np.random.default_rng(seed).normal(size=shape)) * smooth).real
    return (field > np.quantile(field, share)).astype(np.uint8)


ROCK = rock((34, 30, 32))


def test_a_turned_rock_has_the_same_pores_where_it_repeats():
    found = network(ROCK, periodic=True)
    turned = network(np.roll(ROCK, (11, -7, 16), (0, 1, 2)), periodic=True)
    assert len(found.openings) == len(turned.openings) == 0
    # ties between equal peaks may go the other way
    assert abs(len(found) - len(turned)) <= 0.02 * len(found)
    for axis in range(3):
        assert turned.permeability(axis).value == pytest.approx(
            found.permeability(axis).value, rel=0.1
        )
    assert found.volume.sum() == turned.volume.sum() == (ROCK == 0).sum()


def test_every_voxel_has_a_pore_and_every_component_one_at_least():
    specks = ROCK.copy()
    specks[:, :4] = 1
    specks[3, 1, 3] = specks[8:10, 1, 3] = specks[12:20, 2, 3] = 0
    found = network(specks)
    assert np.array_equal(found.regions > 0, specks == 0)
    labels, sizes = tb.measure.label_components(specks == 0)
    first = labels.ravel()[np.ravel_multi_index(tuple(found.centres.astype(int).T), specks.shape)]
    assert set(first) == set(range(1, len(sizes) + 1))
    for pore in range(1, len(found) + 1):
        assert len(tb.measure.label_components(found.regions == pore)[1]) == 1


def test_no_peak_lies_inside_the_ball_of_a_higher_one():
    found = network(ROCK)
    apart = np.linalg.norm(found.centres[:, None] - found.centres[None], axis=-1)
    ball = found.radius + 0.25  # the distance to the wall
    np.fill_diagonal(apart, np.inf)
    assert (apart >= np.maximum(ball[:, None], ball)).all()
    assert (np.diff(found.radius) <= 0).all()


@pytest.mark.parametrize(("apart", "pores"), [(7, 1), (20, 2)])
def test_balls_that_overlap_much_are_one_pore(apart, pores):
    z, y, x = np.ogrid[:30, :30, :52]
    near = np.minimum(abs(x - 15), abs(x - 15 - apart))
    values = ((z - 15) ** 2 + (y - 15) ** 2 + near**2 >= 12**2).astype(np.uint8)
    assert len(network(values)) == pores


def test_a_long_duct_between_rooms_is_a_throat():
    # its middle line is as high as itself, and touches the rooms, which are higher
    values = np.ones((13, 13, 48), np.uint8)
    values[1:12, 1:12, 1:12] = values[1:12, 1:12, 36:47] = values[5:8, 5:8, 12:36] = 0
    found = network(values)
    assert len(found) == 2 and found.throats.pores.tolist() == [[0, 1]]
    assert found.throats.centre[0] == pytest.approx([6, 6, 23.5], abs=0.6)


def test_a_saddle_is_no_pore():
    # an hourglass: the neck's middle is a ridge of the distance map, not a peak
    z, y, x = np.ogrid[:40, :25, :25]
    radius = 5 + 5 * np.cos((z - 8) / 12 * np.pi) ** 2
    values = ((y - 12) ** 2 + (x - 12) ** 2 >= radius**2).astype(np.uint8)
    found = network(values)
    assert len(found) == 4 - 1 and len(found.throats) == 2
    assert found.throats.radius == pytest.approx(5, abs=0.6)


def test_threads_change_nothing():
    with tb.threads(1):
        one = network(ROCK, periodic=(False, True, False))
    with tb.threads(3):
        three = network(ROCK, periodic=(False, True, False))
    assert np.array_equal(one.regions, three.regions)
    for part in ("throats", "openings"):
        for name, values in vars(getattr(one, part)).items():
            assert np.array_equal(values, getattr(getattr(three, part), name)), name
    assert one.permeability(1).value == three.permeability(1).value


def test_lengths_scale_and_edges_count():
    one, two = network(ROCK), network(tb.Image(ROCK, "labels", 3.0, "um"))
    assert two.permeability(0).value == pytest.approx(9 * one.permeability(0).value)
    assert two.throats.perimeter == pytest.approx(3 * one.throats.perimeter)
    assert two.surface == pytest.approx(9 * one.surface)
    # a duct 12 x 6 voxels of 1 x 2 is square
    values = np.ones((10, 24, 12), np.uint8)
    values[:, 6:18, 3:9] = 0
    flat = network(tb.Image(values, "labels", (1.0, 1.0, 2.0), "um"))
    assert flat.openings.area.tolist() == [144.0] * 2
    assert flat.permeability(0).value == pytest.approx(0.03514425 * 12**4 / 24**2, rel=0.1)


def test_what_does_not_lead_through_is_zero():
    values = np.ones((20, 12, 12), np.uint8)
    values[:8, 3:9, 3:9] = values[12:, 3:9, 3:9] = 0
    found = network(values)
    assert found.permeability(0).value == found.diffusivity(0).value == 0.0
    # across a face that repeats it is one pore, and leads nowhere either
    found = network(values, periodic=True)
    assert len(found) == 1 and found.permeability(0).value == 0.0
    assert found.volume.tolist() == [16 * 36]
    assert found.centroids[0, 0] % 20 == pytest.approx(19.5)


def test_what_it_cannot_cut_is_refused():
    for values, what in (
        (np.ones((5, 5), int), "2-D"),
        (np.zeros((5, 5, 5), int), "fills the whole image"),
        (np.ones((5, 5, 5), int), "is empty"),
    ):
        with pytest.raises(InputError, match=what):
            network(tb.Image(values.astype(np.uint8), "labels", phases=("void", "solid")))
    with pytest.raises(InputError, match="reach"):
        network(ROCK, reach=0)


@pytest.mark.parametrize("seed", range(6))
def test_noise_of_any_shape_is_sound(seed):
    rng = np.random.default_rng(seed)
    values = (rng.random(rng.integers(2, 11, 3)) < 0.45).astype(np.uint8)
    wraps = rng.integers(0, 2, 3).astype(bool).tolist() if seed % 2 else [False] * 3
    image = tb.Image(values, "labels", tuple(rng.uniform(0.5, 2, 3)), "um", ("void", "solid"))
    found = network(image, periodic=wraps)
    assert np.array_equal(found.regions > 0, values == 0)
    assert (found.throats.flow > 0).all() and np.isfinite(found.throats.flow).all()
    assert (found.throats.shape_factor <= 1 / (4 * np.pi) + 1e-12).all()
    through = tb.measure.percolates(image, phase="void")
    for axis, name in enumerate("zyx"):
        flow = found.permeability(axis)
        assert flow.converged and flow.imbalance < 1e-6
        if not any(wraps):
            assert (flow.value > 0) == through[name]


def test_a_cell_whose_pore_meets_itself_alone_converges():
    rng = np.random.default_rng(0)
    found = network((rng.random(rng.integers(2, 7, 3)) < 0.3).astype(np.uint8), periodic=True)
    assert len(found) == 1 and len(found.throats) > 3
    assert all(found.permeability(axis).converged for axis in range(3))


def test_diffusivity_stays_below_the_fraction():
    balls = spheres(16, 10.0, 2)  # hardly a neck: the void is one
    found = network(balls).diffusivity(0)
    assert found.value <= found.fraction == pytest.approx((balls == 0).mean())
