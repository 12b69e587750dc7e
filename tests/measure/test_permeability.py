"""Permeability: slits, ducts, grains of known drag, a direct solve of the whole saddle point,
invariances.
"""

import importlib
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse
from scipy.sparse.linalg import spsolve

import trabecula as tb
from trabecula.measure.centre_crop import centre
from trabecula.measure.transport import permeability


def medium(seed, shape=(10, 9, 8), solid=0.3):
    return (np.random.default_rng(seed).random(shape) < solid).astype(np.uint8)


def ball(sides, fraction):
    """Return one sphere in the middle of a unit cell of `sides` voxels, and its radius."""
    z, y, x = [((np.arange(n) + 0.5) / n - 0.5) ** 2 for n in sides]
    radius = (3 * fraction / (4 * np.pi)) ** (1 / 3)
    return (z[:, None, None] + y[:, None] + x < radius**2).astype(np.uint8), radius


def direct(values, edges):
    """Solve the same scheme, written down face by face, by a sparse direct solve of velocity and
    pressure at once.
    """
    void = {tuple(c) for c in np.argwhere(values == 0)}
    shape, volume = values.shape, math.prod(edges)

    def shift(c, d, step):
        return (*c[:d], c[d] + step, *c[d + 1 :])

    def is_face(d, c):  # the face below voxel c
        below = shift(c, d, -1)
        if d == 0 and c[0] in (0, shape[0]):
            return (c if c[0] == 0 else below) in void
        return c in void and below in void

    faces = [(d, c) for d in range(3) for c in np.ndindex(*np.add(shape, 1)) if is_face(d, c)]
    index = {face: i for i, face in enumerate(faces)}
    cell = {c: len(faces) + i for i, c in enumerate(sorted(void))}
    matrix = sparse.lil_array((len(faces) + len(cell),) * 2)
    right = np.zeros(matrix.shape[0])
    for (d, c), i in index.items():
        end = d == 0 and c[0] in (0, shape[0])
        below = shift(c, d, -1)
        for e in range(3):
            for step in (-1, 1):
                strength = volume / edges[e] ** 2 * (0.5 if end and e != 0 else 1)
                to = shift(c, e, step)
                beside = [v for v in (c, below) if 0 <= v[d] < shape[d]]
                outside = e != d and not 0 <= to[e] < shape[e]
                if (outside and e != 0) or (end and e == 0 and not 0 <= to[0] <= shape[0]):
                    continue
                if (d, to) in index:
                    matrix[i, index[d, to]] -= strength
                elif e != d and (outside or all(shift(v, e, step) not in void for v in beside)):
                    strength *= 2
                matrix[i, i] += strength
        area = volume / edges[d]
        for v, sign in ((below, -1), (c, 1)):
            if v in cell:
                matrix[i, cell[v]] = sign * area
                matrix[cell[v], i] = -sign * area
        if d == 0 and c[0] == 0:
            right[i] = area
    solution = spsolve(matrix.tocsr(), right)
    inflow = sum(
        solution[i] * volume / edges[0] for (d, c), i in index.items() if d == 0 and c[0] == 0
    )
    return inflow * (shape[0] * edges[0]) ** 2 / (values.size * volume)


@pytest.mark.parametrize("width", [1, 2, 5, 12])
def test_slit_is_the_parabola_of_its_voxels(width):
    slit = np.pad(np.zeros((5, width), np.uint8), ((0, 0), (1, 2)), constant_values=1)
    expected = width**2 / 12 * width / (width + 3) * (1 + 2 / width**2)
    assert permeability(slit, axis=0, tolerance=1e-8).value == pytest.approx(expected, rel=1e-6)
    # side faces are mirrors, so the third direction adds no drag
    thick = np.repeat(slit[:, None], 3, axis=1)
    image = tb.Image(thick, "labels", spacing=(3.0, 1.0, 0.5))
    assert permeability(image, axis=0, tolerance=1e-8).value == pytest.approx(
        expected / 4, rel=1e-6
    )


@pytest.mark.parametrize(
    ("sides", "error"), [((8, 8), 0.065), ((16, 16), 0.016), ((32, 32), 0.004), ((8, 16), 0.04)]
)
def test_square_duct(sides, error):
    # White 2006, "Viscous fluid flow", equation 3-48; non-cubic voxels fill the same square.
    series = sum(math.tanh(n * math.pi / 2) / n**5 for n in range(1, 99, 2))
    exact = (1 - 192 / math.pi**5 * series) / 12
    image = tb.Image(
        np.zeros((4, *sides), np.uint8), "labels", spacing=(0.1, 1 / sides[0], 1 / sides[1])
    )
    values = np.pad(image.values, ((0, 0), (1, 1), (1, 1)), constant_values=1)
    walled = tb.Image(values, "labels", spacing=image.spacing)
    area = (1 + 2 / sides[0]) * (1 + 2 / sides[1])
    assert permeability(walled, axis=0).value * area == pytest.approx(exact, rel=error)


@pytest.mark.parametrize("width", [3, 4])
def test_extrapolation_takes_the_error_of_flat_walls_away(width):
    series = sum(math.tanh(n * math.pi / 2) / n**5 for n in range(1, 99, 2))
    exact = (1 - 192 / math.pi**5 * series) / 12 * width**4 / (width + 2) ** 2
    void = np.zeros((4, width, width), np.uint8)
    walled = np.pad(void, ((0, 0), (1, 1), (1, 1)), constant_values=1)
    found = permeability(walled, axis=0, halving=True)
    assert found.value > 1.2 * exact
    assert found.extrapolated == pytest.approx(exact, rel=0.02)
    assert permeability(walled, axis=0).extrapolated is None


@pytest.mark.parametrize("width", [8, 16])
def test_stairs_of_an_oblique_duct_err_as_flat_walls_do(width):
    # beside a square duct of as many voxels
    series = sum(math.tanh(n * math.pi / 2) / n**5 for n in range(1, 99, 2))
    at = np.arange(int(1.42 * width) + 6) + 0.5 - (int(1.42 * width) + 6) / 2
    duct = abs(at[:, None]) + abs(at) < width / math.sqrt(2)
    image = np.repeat((~duct).astype(np.uint8)[None], 3, axis=0)
    exact = (1 - 192 / math.pi**5 * series) / 12 * float(duct.sum()) ** 2 / duct.size
    assert permeability(image, axis=0).value == pytest.approx(exact * (1 + 3 / width**2), rel=0.02)


@pytest.mark.parametrize(
    ("sides", "fraction", "drag", "error"),
    [
        ((32, 32, 32), 0.125, 4.292, 0.02),
        ((32, 32, 32), 0.216, 7.442, 0.02),
        ((32, 32, 32), 0.343, 15.4, 0.03),
        ((24, 32, 20), 0.216, 7.442, 0.05),
    ],
)
def test_simple_cubic_spheres(sides, fraction, drag, error):
    # Zick and Homsy 1982, doi:10.1017/S0022112082000627, table 2: force = 6 pi viscosity radius
    # drag velocity.
    values, radius = ball(sides, fraction)
    found = permeability(tb.Image(values, "labels", spacing=[1 / n for n in sides]), axis=0)
    assert found.converged and 1 / (6 * np.pi * radius * found.value) == pytest.approx(
        drag, rel=error
    )


def test_square_array_of_cylinders_in_2d():
    # Sangani and Acrivos 1982, doi:10.1016/0301-9322(82)90029-5: force on a length, over viscosity
    # and velocity.
    at = ((np.arange(48) + 0.5) / 48 - 0.5) ** 2
    disc = (at[:, None] + at < 0.2 / np.pi).astype(np.uint8)
    for axis in (0, 1):
        found = permeability(tb.Image(disc, "labels", spacing=1 / 48), axis=axis)
        assert 1 / found.value == pytest.approx(51.53, rel=0.03)


@pytest.mark.parametrize("edges", [(1.0, 1.0, 1.0), (1.3, 0.6, 1.0)])
def test_equals_a_direct_solve(edges):
    values = medium(3, (6, 5, 7))
    cut = values * 0 + 1
    labels, _ = tb.measure.label_components(values == 0)
    cut[np.isin(labels, [n for n in np.intersect1d(labels[0], labels[-1]) if n])] = 0
    found = permeability(tb.Image(values, "labels", spacing=edges), axis=0, tolerance=1e-8)
    assert found.converged and found.iterations > 3
    assert found.value == pytest.approx(direct(cut, edges), rel=1e-6)


@settings(max_examples=15)
@given(st.integers(0, 50), st.permutations(range(3)), st.booleans())
def test_turning_and_mirroring_the_image_turns_the_result(seed, order, mirror):
    values, edges = medium(seed, (7, 8, 6)), (1.0, 1.5, 0.8)
    turned = values.transpose(order)[:: -1 if mirror else 1]
    one = tb.Image(values, "labels", spacing=edges)
    other = tb.Image(turned, "labels", spacing=[edges[d] for d in order])
    expected = permeability(one, axis=order[0], tolerance=1e-7).value
    assert permeability(other, axis=0, tolerance=1e-7).value == pytest.approx(expected, rel=1e-6)


@settings(max_examples=25)
@given(st.integers(0, 1000))
def test_carving_a_voxel_out_never_lowers_it(seed):
    values = medium(seed, (7, 6, 6), 0.35)
    more = values.copy()
    solid = np.argwhere(values)
    more[tuple(solid[seed % len(solid)])] = 0
    before, after = [permeability(v, axis=0, tolerance=1e-7).value for v in (values, more)]
    assert after >= before * (1 - 1e-6)


def test_scales_with_the_square_of_the_spacing():
    values = medium(5)
    plain = permeability(values, axis=2).value
    image = tb.Image(values, "labels", spacing=19.5, unit="um")
    assert permeability(image, axis=2).value == pytest.approx(19.5**2 * plain, rel=1e-9)


def test_what_does_not_percolate_is_exactly_zero_and_floating_pores_do_not_count():
    values = medium(6, (10, 9, 8), 0.4)
    labels, sizes = tb.measure.label_components(values == 0)
    filled = np.where(labels == 1 + np.argmax(sizes), 0, 1).astype(np.uint8)
    assert (filled != values).any()
    assert permeability(values, axis=0).value == permeability(filled, axis=0).value > 0
    filled[4] = 1
    wall = permeability(filled, axis=0, halving=True)
    assert (wall.value, wall.converged, wall.iterations, wall.halving) == (0.0, True, 0, None)


def test_an_image_without_walls_holds_no_fluid():
    values = np.zeros((6, 6, 6), np.uint8)
    assert permeability(values, axis=1, halving=True).value == math.inf
    values[2, 3, 3] = 1
    found = permeability(values, axis=1, halving=True)
    assert found.converged and 0 < found.value < math.inf and found.halving < 0


def test_threads_change_no_bit():
    values = medium(7, (16, 16, 16))
    with tb.threads(1):
        one = permeability(values, axis=0)
    with tb.threads(2):
        assert permeability(values, axis=0) == one


def test_box_is_the_centre_and_halving_compares_it_with_itself():
    values = np.pad(np.zeros((12, 9, 8), np.uint8), ((0, 0), (1, 1), (1, 1)), constant_values=1)
    image = tb.Image(values, "labels", spacing=(1.0, 2.0, 1.0))
    inner = tb.Image(values[3:9, 2:8, 2:8], "labels", spacing=(1.0, 2.0, 1.0))
    assert permeability(image, axis=0, box=6) == permeability(inner, axis=0)
    slit = np.pad(np.zeros((6, 4), np.uint8), ((0, 0), (1, 1)), constant_values=1)
    change = permeability(slit, axis=0, tolerance=1e-8, halving=True).halving
    assert change == pytest.approx((1 + 2 / 8**2) / (1 + 2 / 4**2) - 1, abs=1e-6)


@pytest.mark.whole
def test_a_real_sandstone_is_balanced(data):
    image = tb.read(data / "berea_sandstone_a.tif")
    found = permeability(image, axis=0, box=64)
    tight = permeability(image, axis=0, box=64, tolerance=1e-7)
    assert found.converged and found.imbalance <= 1e-4 and tight.imbalance <= 1e-7
    assert found.value == pytest.approx(tight.value, rel=1e-4)


@pytest.mark.parametrize("tolerance", [1e-2, 1e-4, 1e-8])
def test_noise_of_short_runs_is_solved_in_single_and_double_precision(tolerance):
    values = medium(11, (14, 13, 12), 0.4)
    found = permeability(values, axis=1, tolerance=tolerance)
    exact = permeability(values, axis=1, tolerance=1e-10)
    assert found.converged and found.value == pytest.approx(exact.value, rel=2 * tolerance)


def test_a_solve_cut_short_says_so(monkeypatch):
    module = importlib.import_module("trabecula.measure.transport.permeability")
    monkeypatch.setattr(module, "_MOST_STEPS", 2)
    found = permeability(medium(7, (16, 16, 16)), axis=0)
    assert not found.converged and found.iterations == 2 and found.imbalance > 1e-4


def test_the_imbalance_is_the_spread_of_the_flow_over_its_mean(monkeypatch):
    module = importlib.import_module("trabecula.measure.transport.permeability")
    monkeypatch.setattr(
        module, "_section_flows", lambda *_, **__: (np.array([1.0, 1.25, 0.75]), 7, False)
    )
    assert permeability(medium(7, (3, 8, 8)), axis=0).imbalance == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"axis": -4}, "axis -4"),
        ({"axis": 0, "tolerance": 1.0}, "tolerance"),
        ({"axis": 0, "phase": 7}, "phase 7"),
    ],
)
def test_bad_options_are_named(options, words):
    with pytest.raises(tb.errors.InputError, match=words):
        permeability(medium(1), **options)


def test_halving_compares_the_centre_box_with_itself(monkeypatch):
    monkeypatch.setattr("trabecula.measure.transport.section.HALVED", 6)
    values = medium(9, (10, 9, 8))
    split = np.kron(centre(values, (6, 6, 6)), np.ones((2, 2, 2), np.uint8))
    box = permeability(values, axis=0, box=6, tolerance=1e-7).value
    fine = permeability(tb.Image(split, "labels", 0.5), axis=0, tolerance=1e-7).value
    found = permeability(values, axis=0, tolerance=1e-7, halving=True)
    assert found.halving == pytest.approx(fine / box - 1, rel=1e-4)
    assert found.value != pytest.approx(box, rel=1e-3)
