"""Diffusivity and conductivity: layers, ducts, grains and checkerboards of known value, bounds, an
oracle, invariances.
"""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import sparse
from scipy.sparse.linalg import spsolve

import trabecula as tb
from trabecula.measure.transport import (
    aggregation,
    conduction,
    conduction_system,
    conductivity,
    diffusivity,
    finest_level,
    sweep_parts,
    tortuosity,
)
from trabecula.measure.transport.conduction_segments import ConductionSegments, multiply
from trabecula.measure.transport.conduction_system import ConductionSystem
from trabecula.measure.transport.section import percolating_voxels
from trabecula.measure.transport.segments import compact_numbers

volumes = arrays(np.uint8, (6, 6, 6), elements=st.integers(0, 1))


def medium(seed, shape=(12, 11, 10), solid=0.4):
    """Draw white noise: many dead ends and floating pores."""
    return (np.random.default_rng(seed).random(shape) < solid).astype(np.uint8)


def direct(values, sigma, edges):
    """Solve for the conductivity along the first axis by a sparse direct solve; every phase must
    conduct.
    """
    number = np.arange(values.size).reshape(values.shape)
    local = np.asarray(sigma, float)[values]
    rows, columns, couplings = [], [], []
    for d in range(values.ndim):
        low, high = [
            np.delete(np.arange(values.shape[d]), -1 if side == 0 else 0) for side in (0, 1)
        ]
        a, b = local.take(low, d), local.take(high, d)
        coupling = (2 * a * b / (a + b) * math.prod(edges) / edges[d] ** 2).ravel()
        i, j = number.take(low, d).ravel(), number.take(high, d).ravel()
        rows += [i, j, i, j]
        columns += [i, j, j, i]
        couplings += [coupling, coupling, -coupling, -coupling]
    ends = 2 * local[[0, -1]] * math.prod(edges) / edges[0] ** 2
    rows += [number[0].ravel(), number[-1].ravel()]
    columns += [number[0].ravel(), number[-1].ravel()]
    couplings += [ends[0].ravel(), ends[1].ravel()]
    matrix = sparse.csr_array(
        (np.concatenate(couplings), (np.concatenate(rows), np.concatenate(columns)))
    )
    right = np.zeros(values.size)
    right[number[0].ravel()] = ends[0].ravel()
    potential = spsolve(matrix, right).reshape(values.shape)
    flux = float((ends[0] * (1 - potential[0])).sum())
    return flux * (values.shape[0] * edges[0]) ** 2 / (values.size * math.prod(edges))


@pytest.mark.parametrize("shape", [(20, 5, 4), (20, 9)])
def test_layers_are_the_harmonic_mean_across_and_the_arithmetic_mean_along(shape):
    rng = np.random.default_rng(3)
    layer = rng.integers(0, 3, 20)
    values = np.broadcast_to(layer.reshape(-1, *[1] * (len(shape) - 1)), shape)
    image = tb.Image(
        values, "labels", spacing=(1.0, 3.0, 0.4)[: len(shape)], phases=("void", "a", "b")
    )
    sigma = {"void": 0.02, "a": 7.0, "b": 1.5}
    local = np.array(list(sigma.values()))[layer]
    across, along = [
        conductivity(image, conductivities=sigma, axis=axis, tolerance=1e-9) for axis in (0, 1)
    ]
    assert across.converged and across.value == pytest.approx(1 / np.mean(1 / local), rel=1e-6)
    assert along.converged and along.value == pytest.approx(np.mean(local), rel=1e-6)


def test_straight_duct_has_its_share_of_the_area():
    values = np.ones((9, 7, 8), np.uint8)
    values[:, 1:4, 2:6] = 0
    for axis in range(3):
        turned = np.moveaxis(values, 0, axis)
        assert diffusivity(turned, axis=axis, tolerance=1e-8).value == pytest.approx(
            12 / 56, rel=1e-7
        )
        assert tortuosity(turned, axis=axis, tolerance=1e-8).value == pytest.approx(1, rel=1e-7)


def test_tortuosity_is_the_fraction_over_the_diffusivity():
    values = medium(2)
    found, flow = tortuosity(values, axis=0), diffusivity(values, axis=0)
    assert found.value == pytest.approx((values == 0).mean() / flow.value) and found.value > 1.2


def test_checkerboard_in_2d_tends_to_the_geometric_mean():
    # Keller 1964, doi:10.1063/1.1704146. Corners make finite volumes converge slowly, from below.
    errors = []
    for side in (4, 8, 16, 32):
        board = np.kron(np.indices((4, 4)).sum(axis=0) % 2, np.ones((side, side))).astype(np.uint8)
        errors.append(
            1 - conductivity(board, conductivities={"void": 1, "solid": 4}, axis=0).value / 2
        )
    assert errors[0] < 0.05 and 0 < errors[-1] < 0.005
    assert all(fine < 0.65 * coarse for coarse, fine in pairwise(errors))


def test_interchange_of_phases_in_2d():
    # Dykhne: conductivity along y, times that of the inverse conductivities along x, is 1 in the
    # continuum.
    values = np.kron(medium(5, (12, 12), 0.5), np.ones((8, 8), np.uint8))
    product = 1.0
    for axis, power in ((0, 1), (1, -1)):
        product *= conductivity(
            values, conductivities={"void": 1.0, "solid": 3.0**power}, axis=axis
        ).value
    assert product == pytest.approx(1, abs=0.02)


def test_simple_cubic_insulating_spheres():
    # Rayleigh's series to the first term beyond Maxwell's (McPhedran and McKenzie 1978,
    # doi:10.1098/rspa.1978.0031).
    # Voxel grains are a little too large for the flux: the error falls with the first power of the
    # edge.
    errors = []
    for n in (24, 48):
        at = (np.arange(n) + 0.5) / n - 0.5
        ball = (
            at[:, None, None] ** 2 + at[:, None] ** 2 + at**2 < (0.15 / np.pi) ** (2 / 3)
        ).astype(np.uint8)
        f = ball.mean()
        exact = 1 - 3 * f / (2 + f - 1.569 * 0.75 * f ** (10 / 3))
        errors.append(1 - diffusivity(ball, axis=0).value / exact)
    assert 0 < errors[1] < 0.015 and errors[1] < 0.6 * errors[0]


@pytest.mark.parametrize("edges", [(1.0, 1.0, 1.0), (2.0, 0.7, 1.1)])
def test_equals_a_direct_solve(edges):
    values = np.random.default_rng(1).choice(3, (9, 8, 7)).astype(np.uint8)
    image = tb.Image(values, "labels", spacing=edges, phases=("void", "a", "b"))
    sigma = [0.01, 1.0, 30.0]
    found = conductivity(
        image, conductivities=dict(zip(image.phases, sigma, strict=True)), axis=0, tolerance=1e-8
    )
    assert found.converged and found.imbalance < 1e-8
    assert found.value == pytest.approx(direct(values, sigma, edges), rel=1e-6)


def test_levels_built_part_by_part_are_those_of_the_whole(monkeypatch):
    values = medium(3, (30, 22, 20))
    whole = diffusivity(values, axis=0)
    monkeypatch.setattr(finest_level, "PART", 1)
    monkeypatch.setattr(aggregation, "_RUN", 2)
    assert diffusivity(values, axis=0) == whole and whole.iterations < 15


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_equal_potentials_drive_no_flux_in_any_precision(kind):
    values = medium(4)
    labels = np.array([0.0, 0.3, 0.7])
    face = np.sqrt(labels[:, None] * labels)[:, :, None] * [1.0, 0.37, 1.9]
    active = np.ones(values.shape, bool)
    active[3:5, 2:4, 1:9] = False
    part = ConductionSegments.of(values, active, np.array([1, 2]), face, labels)
    potential, flux = np.zeros(part.length, kind), np.zeros(part.length, kind)
    number_of, nodes = compact_numbers(part.table, part.length)
    slots = np.flatnonzero(number_of >= 0)
    assert len(slots) == active.sum() == part.nodes == nodes
    assert (number_of[slots] == np.arange(nodes)).all()
    potential[slots] = 1 / 3
    through = np.full(len(values) + 1, np.nan)
    multiply(part.table, part.code, part.coupling, part.place, potential, flux, through)
    ends = np.zeros(values.shape)
    ends[[0, -1]] = labels[1 + values[[0, -1]]]
    np.testing.assert_array_equal(flux[slots], ends[active].astype(kind) * kind(1 / 3))
    assert (through[1:-1] == 0).all()
    assert through[[0, -1]] == pytest.approx([-ends[0].sum() / 3, ends[-1].sum() / 3])


def test_void_alone_is_the_limit_of_a_poorly_conducting_solid():
    values = medium(2)
    both = direct(values, [1.0, 1e-9], (1.0, 1.0, 1.0))
    assert diffusivity(values, axis=0, tolerance=1e-7).value == pytest.approx(both, rel=1e-5)


@pytest.mark.whole
@given(volumes, st.sampled_from([0.0, 0.05, 0.5]))
def test_bounds_are_never_violated(values, low):
    found = [
        conductivity(values, conductivities={"void": 1, "solid": low}, axis=axis).value
        for axis in range(3)
    ]
    f = 1 - values.mean()
    arithmetic = f + (1 - f) * low
    harmonic = 0.0 if low == 0 and f < 1 else 1 / (f + (1 - f) / low) if low else 1.0
    assert all(harmonic - 1e-5 <= value <= arithmetic + 1e-5 for value in found)
    assume(0 < f < 1)
    # Hashin and Shtrikman's upper bound for any anisotropy (Milton and Kohn 1988,
    # doi:10.1016/0022-5096(88)90001-4); with three equal values it is the well-known one.
    bound = 1 / (1 - harmonic) + 2 / (1 - arithmetic)
    assert sum(1 / (1 - value) for value in found) <= bound * (1 + 1e-4)


@pytest.mark.whole
@given(st.integers(0, 50), st.permutations(range(3)), st.booleans())
def test_turning_and_mirroring_the_image_turns_the_result(seed, order, mirror):
    values, edges = medium(seed, (7, 8, 6)), (1.0, 1.5, 0.8)
    turned = values.transpose(order)[:: -1 if mirror else 1]
    one = tb.Image(values, "labels", spacing=edges)
    other = tb.Image(turned, "labels", spacing=[edges[d] for d in order])
    for axis in range(3):
        expected = diffusivity(one, axis=order[axis], tolerance=1e-8).value
        assert diffusivity(other, axis=axis, tolerance=1e-8).value == pytest.approx(
            expected, rel=1e-6
        )


def test_spacing_scales_nothing_and_2d_is_one_slice():
    values = medium(4)
    plain = diffusivity(values, axis=1).value
    assert diffusivity(
        tb.Image(values, "labels", spacing=19.5, unit="um"), axis=-2
    ).value == pytest.approx(plain, rel=1e-9)
    flat = medium(8, (20, 15), 0.25)
    assert diffusivity(flat, axis=1).value == pytest.approx(
        diffusivity(flat[None], axis=2).value, rel=1e-9
    )


def test_what_does_not_percolate_is_exactly_zero():
    values = np.zeros((6, 5, 4), np.uint8)
    values[3] = 1
    wall = diffusivity(values, axis=0, halving=True)
    assert (wall.value, wall.converged, wall.iterations, wall.halving) == (0.0, True, 0, None)
    assert wall.fraction == pytest.approx(5 / 6) and tortuosity(values, axis=0).value == math.inf
    assert diffusivity(values, axis=1).value == pytest.approx(5 / 6, rel=1e-6)
    assert diffusivity(np.ones((4, 4), np.uint8), axis=0).value == 0.0
    diagonal = 1 - np.eye(5, dtype=np.uint8)  # voxels that share no more than a corner
    assert diffusivity(diagonal, axis=0).value == 0.0


def test_floating_pores_and_dead_ends_change_nothing():
    values = medium(11, (14, 13, 12))
    pruned = values.copy()
    while True:  # a voxel with one neighbour carries no flux, nor does one without
        void = np.pad(pruned == 0, 1)
        # the end faces hold on
        void[0, 1:-1, 1:-1], void[-1, 1:-1, 1:-1] = pruned[0] == 0, pruned[-1] == 0
        count = sum(np.roll(void, step, axis).astype(int) for axis in range(3) for step in (-1, 1))[
            1:-1, 1:-1, 1:-1
        ]
        dead = (pruned == 0) & (count <= 1)
        if not dead.any():
            break
        pruned[dead] = 1
    assert (pruned != values).sum() > 50
    full = diffusivity(values, axis=0, tolerance=1e-7)
    assert full.value > 0 and full.value == pytest.approx(
        diffusivity(pruned, axis=0, tolerance=1e-7).value, rel=1e-6
    )


def test_threads_change_no_bit():
    values = medium(7, (24, 24, 24), 0.3)
    with tb.threads(1):
        one = diffusivity(values, axis=0)
    with tb.threads(2):
        assert diffusivity(values, axis=0) == one


@pytest.fixture
def thin_parts(monkeypatch):
    """Let every two planes be swept by themselves, on every level."""
    monkeypatch.setattr(sweep_parts, "THIN", 2)
    monkeypatch.setattr(conduction_system, "PART_SLOTS", 1)
    monkeypatch.setattr(aggregation, "PART_NODES", 1)
    monkeypatch.setattr(aggregation, "_RUN", 2)
    monkeypatch.setattr(finest_level, "PART", 1)


def system_of(values):
    """Return the system of labels that conduct .3 and .7, with walls."""
    active = percolating_voxels(np.random.default_rng(8).random(values.shape) < 0.8)
    sigma = np.array([0.0, 0.3, 0.7])
    face = np.sqrt(sigma[:, None] * sigma)[:, :, None] * [1.0, 0.37, 1.9]
    part = ConductionSegments.of(values, active, np.array([1, 2]), face, sigma)
    return ConductionSystem(part, np.float32)


def test_sweeps_by_parts_leave_the_residual_that_is_restricted(thin_parts):
    system = system_of(medium(5, (20, 15, 14)))
    finest, below = system.finest, system.finest.below[0]
    assert len(finest.parts) == 10 and len(below.parts) == 5
    rng = np.random.default_rng(0)
    nodes = compact_numbers(system.part.table, system.part.length)[0] >= 0
    right = np.where(nodes, rng.random(len(nodes)), 0).astype(np.float32)
    x = finest.presmooth(right, None).copy()
    left = right - system.apply(x)
    sums = np.bincount(finest.aggregate[nodes], left[nodes])
    np.testing.assert_allclose(finest.restrict(right, x), sums, atol=1e-5)
    right = rng.random(len(below.inverse)).astype(np.float32)
    x = below.presmooth(right, None)
    sums = np.bincount(below.aggregate, right - below.apply(x))
    np.testing.assert_allclose(below.restrict(right, x), sums, atol=1e-5)


def test_sweeps_by_parts_are_symmetric(thin_parts):
    system = system_of(medium(5, (20, 15, 14)))
    nodes = compact_numbers(system.part.table, system.part.length)[0] >= 0
    for level, inside in ((system.finest, nodes), (system.finest.below[0], None)):
        rng = np.random.default_rng(1)
        count = len(nodes) if inside is not None else len(level.inverse)
        some = np.ones(count, bool) if inside is None else inside
        u, v = (np.where(some, rng.random(count) - 0.5, 0).astype(np.float32) for _ in range(2))
        smoothed = [level.postsmooth(one, level.presmooth(one, None)).copy() for one in (u, v)]
        there, back = float(v @ smoothed[0]), float(u @ smoothed[1])
        assert there == pytest.approx(back, rel=1e-4, abs=1e-4) and abs(there) > 0.05


def test_parts_change_the_way_alone(thin_parts, monkeypatch):
    values = medium(7, (24, 24, 24), 0.3)
    found = []
    for count in (1, 2):
        with tb.threads(count):
            found.append(diffusivity(values, axis=1, tolerance=1e-7))
    assert found[0] == found[1] and found[0].converged
    monkeypatch.undo()
    whole = diffusivity(values, axis=1, tolerance=1e-7)
    assert found[0].value == pytest.approx(whole.value, rel=1e-6)
    assert found[0].imbalance != whole.imbalance


def test_box_is_the_centre_and_halving_compares_it_with_itself():
    values = medium(9, (20, 21, 22), 0.2)
    image = tb.Image(values, "labels", spacing=(1.0, 2.0, 1.0))
    inner = tb.Image(values[5:15, 5:15, 6:16], "labels", spacing=(1.0, 2.0, 1.0))
    assert diffusivity(image, axis=1, box=10) == diffusivity(inner, axis=1)
    split = values.repeat(2, 0).repeat(2, 1).repeat(2, 2)
    change = diffusivity(values, axis=0, halving=True).halving
    assert change == pytest.approx(
        diffusivity(split, axis=0).value / diffusivity(values, axis=0).value - 1, rel=1e-3
    )
    layers = np.repeat([[0, 0, 1, 0]], 6, axis=0)
    assert abs(diffusivity(layers, axis=0, halving=True).halving) < 1e-6


def test_a_solve_cut_short_says_so(monkeypatch):
    monkeypatch.setattr(conduction, "_MOST_STEPS", 3)
    found = diffusivity(medium(7, (24, 24, 24), 0.3), axis=0)
    assert not found.converged and found.iterations == 3 and found.imbalance > 1e-5


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"axis": 3}, "axis 3"),
        ({"axis": True}, "axis True"),
        ({"axis": 0, "tolerance": 0}, "tolerance"),
        ({"axis": 0, "box": 0}, "box"),
        ({"axis": 0, "phase": "bone"}, "phase"),
    ],
)
def test_bad_options_are_named(options, words):
    with pytest.raises(tb.errors.InputError, match=words):
        diffusivity(medium(1), **options)


@pytest.mark.parametrize(
    ("sigma", "words"),
    [
        ({"void": 1.0}, "solid"),
        ({"void": 1.0, "solid": -1.0}, "solid is -1.0"),
        ({"void": 1.0, "solid": math.nan}, "finite"),
        ({"void": 1.0, "bone": 1.0}, "bone"),
    ],
)
def test_bad_conductivities_are_named(sigma, words):
    with pytest.raises(tb.errors.InputError, match=words):
        conductivity(medium(1), conductivities=sigma, axis=0)
