"""Stiffness: exact cases, a direct solver, bounds, invariances."""

from itertools import product

import numpy as np
import pytest
import tifffile
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import sparse
from scipy.sparse.linalg import spsolve

import trabecula as tb
from trabecula.engine.parallel import threads
from trabecula.measure.mechanics import stiffness
from trabecula.measure.mechanics.elements import brick_stiffness, isotropic, mean_strain
from trabecula.measure.percolation import wrapping_voxels

SOFT, HARD = (1.0, 0.3), (10.0, 0.2)
BOTH = {"soft": SOFT, "hard": HARD}
small = arrays(np.uint8, st.tuples(*[st.integers(3, 6)] * 3), elements=st.integers(0, 1))


def two_phase(values, **fields):
    return tb.Image(values, "labels", phases=("soft", "hard"), **fields)


def blobs(shape, seed, share):
    """Draw a periodic random medium of some voxels' correlation length."""
    wave = np.fft.rfftn(np.random.default_rng(seed).normal(size=shape))
    k = sum(
        np.square(f)
        for f in np.meshgrid(
            *[np.fft.fftfreq(n) for n in shape[:2]], np.fft.rfftfreq(shape[2]), indexing="ij"
        )
    )
    field = np.fft.irfftn(wave * np.exp(-60 * k), shape, axes=(0, 1, 2))
    return (field < np.quantile(field, share)).astype(np.uint8)


def direct(values, materials, edges):
    """Solve the same bricks, put together entry by entry, by elimination; label -1 is void."""
    shape = np.array(values.shape)
    strain, volume = mean_strain(edges).reshape(6, 24), np.prod(edges)
    rows, columns, entries = [], [], []
    load, whole, used = (
        np.zeros((3 * values.size, 6)),
        np.zeros((6, 6)),
        np.zeros(3 * values.size, bool),
    )
    for at in np.argwhere(values >= 0):
        material = isotropic(*materials[values[tuple(at)]])
        nodes = [
            np.ravel_multi_index((at + corner) % shape, shape)
            for corner in product((0, 1), repeat=3)
        ]
        index = np.concatenate([3 * n + np.arange(3) for n in nodes])
        block = brick_stiffness(material, edges).transpose(0, 2, 1, 3).reshape(24, 24)
        rows.append(np.repeat(index, 24))
        columns.append(np.tile(index, 24))
        entries.append(block.ravel())
        np.add.at(load, index, -volume * strain.T @ material)
        whole += volume * material
        used[index] = True
    total = sparse.csr_matrix(
        (np.concatenate(entries), (np.concatenate(rows), np.concatenate(columns))),
        shape=(3 * values.size,) * 2,
    )
    # A little stiffness to the ground takes the null space away, and changes nothing that carries
    # load.
    free = np.flatnonzero(used)
    matrix = total[free][:, free] + 1e-9 * sparse.eye(len(free))
    relaxed = spsolve(matrix.tocsc(), load[free])
    return (whole - load[free].T @ relaxed) / (values.size * volume)


@pytest.mark.parametrize("spacing", [(1, 1, 1), (0.5, 1, 3)])
def test_homogeneous_solid_is_its_material(spacing):
    result = stiffness(
        tb.Image(np.ones((3, 5, 4), np.uint8), "labels", spacing=spacing), moduli=(7.0, 0.25)
    )
    assert np.allclose(result.matrix, isotropic(7.0, 0.25), atol=1e-12)
    assert result.moduli == pytest.approx(dict.fromkeys("zyx", 7.0), rel=1e-6)
    assert result.shear == pytest.approx(dict.fromkeys(("yz", "xz", "xy"), 2.8), rel=1e-6)
    assert result.converged and result.imbalance < 1e-12 and result.bearing == 1


@pytest.mark.parametrize("spacing", [(1, 1, 1), (2, 1, 0.7)])
def test_layers_have_backus_averages(spacing):
    values = np.zeros((6, 3, 4), np.uint8)
    values[2:] = 1
    result = stiffness(two_phase(values, spacing=spacing), moduli=BOTH, tolerance=1e-8)
    c, f = np.stack([isotropic(*SOFT), isotropic(*HARD)]), np.array([1 / 3, 2 / 3])
    expected = np.zeros((6, 6))
    stiff, ratio = 1 / (f @ (1 / c[:, 2, 2])), f @ (c[:, 0, 2] / c[:, 2, 2])
    inner = f @ (c[:, 0, 2] ** 2 / c[:, 2, 2])
    expected[2, 2] = stiff
    expected[0, 2] = expected[2, 0] = expected[1, 2] = expected[2, 1] = stiff * ratio
    expected[0, 0] = expected[1, 1] = f @ c[:, 0, 0] - inner + stiff * ratio**2
    expected[0, 1] = expected[1, 0] = f @ c[:, 0, 1] - inner + stiff * ratio**2
    expected[3, 3] = expected[4, 4] = 1 / (f @ (1 / c[:, 3, 3]))
    expected[5, 5] = f @ c[:, 5, 5]
    assert np.allclose(result.matrix, expected, atol=1e-6)


@pytest.mark.parametrize("spacing", [(1, 1, 1), (1, 2, 0.5)])
def test_strut_carries_along_itself_only(spacing):
    values = np.zeros((7, 8, 9), np.uint8)
    values[:, 2:5, 3:5] = 1
    result = stiffness(tb.Image(values, "labels", spacing=spacing), moduli=(5.0, 0.3))
    assert result.moduli["z"] == pytest.approx(5 * 6 / 72, rel=1e-5)
    assert result.moduli["y"] == result.moduli["x"] == 0
    assert np.allclose(np.delete(result.matrix.ravel(), 14), 0, atol=1e-6)


def test_islands_and_empty_boxes_carry_nothing():
    values = np.zeros((6, 6, 6), np.uint8)
    values[1:4, 1:4, 1:4] = 1
    for image in (values, np.zeros_like(values)):
        result = stiffness(image, halving=True)
        assert not result.matrix.any() and set(result.moduli.values()) == {0.0}
        assert result.converged and result.bearing == 0 and result.halving == 0


def test_islands_do_not_change_the_rest():
    values = np.zeros((8, 8, 8), np.uint8)
    values[:, :3, :3] = 1
    alone = stiffness(values)
    values[2:4, 5:7, 5:7] = 1
    with_island = stiffness(values)
    assert np.array_equal(alone.matrix, with_island.matrix)
    assert with_island.bearing == pytest.approx(72 / 80)


def test_what_bears_load_wraps_around():
    values = np.zeros((4, 6, 6), bool)
    # meets itself only where the two halves touch: they do not
    values[:2, 1, 1] = values[2:, 1, 2] = True
    assert not wrapping_voxels(values).any()
    values[1, 1, 2] = True  # joined inside, but not across the face
    assert not wrapping_voxels(values).any()
    values[0, 1, 2] = True
    assert wrapping_voxels(values).sum() == 6
    ring = np.zeros((1, 6, 6), bool)
    # four corners meet across the faces; a thin box wraps by itself
    ring[0, [0, 0, 5, 5], [0, 5, 0, 5]] = True
    assert np.array_equal(wrapping_voxels(ring), ring)
    assert not wrapping_voxels(np.concatenate([ring, np.zeros_like(ring)])).any()


@pytest.mark.whole
@settings(max_examples=15)
@given(small, st.sampled_from([(1.0, 1.0, 1.0), (1.0, 2.0, 0.6)]))
def test_equals_elimination_with_void(values, edges):
    bears = wrapping_voxels(values == 1)
    assume(bears.any())
    result = stiffness(tb.Image(values, "labels", spacing=edges), moduli=SOFT, tolerance=1e-7)
    expected = direct(np.where(bears, 0, -1), [SOFT], tuple(e / min(edges) for e in edges))
    assert np.allclose(result.matrix, expected, atol=2e-6)
    assert result.converged and result.imbalance < 1e-4


@pytest.mark.whole
@settings(max_examples=10)
@given(small)
def test_equals_elimination_with_two_solids(values):
    result = stiffness(two_phase(values), moduli=BOTH, tolerance=1e-7)
    assert np.allclose(
        result.matrix, direct(values.astype(int), [SOFT, HARD], (1.0, 1.0, 1.0)), atol=1e-5
    )


@pytest.mark.whole
@settings(max_examples=15)
@given(small, st.permutations([0, 1, 2]))
def test_matrix_turns_with_the_volume(values, order):
    # axes of the array that xx, yy, zz, yz, xz, xy are about
    pairs = [{2}, {1}, {0}, {0, 1}, {0, 2}, {1, 2}]
    row = [pairs.index({order[axis] for axis in pair}) for pair in pairs]
    matrix = stiffness(two_phase(values), moduli=BOTH, tolerance=1e-6).matrix
    turned = stiffness(two_phase(values.transpose(order)), moduli=BOTH, tolerance=1e-6).matrix
    assert np.allclose(turned, matrix[np.ix_(row, row)], atol=1e-4)


@settings(max_examples=25)
@given(small, st.booleans())
def test_symmetric_and_between_reuss_and_voigt(values, with_void):
    image = two_phase(values)
    result = stiffness(image, moduli={"hard": HARD} if with_void else BOTH, tolerance=1e-6)
    phi = values.mean()
    voigt = phi * isotropic(*HARD) + (0 if with_void else (1 - phi) * isotropic(*SOFT))
    assert np.array_equal(result.matrix, result.matrix.T)
    assert np.linalg.eigvalsh(result.matrix)[0] > -1e-7
    assert np.linalg.eigvalsh(voigt - result.matrix)[0] > -1e-6
    if not with_void:
        reuss = np.linalg.inv(
            phi * np.linalg.inv(isotropic(*HARD)) + (1 - phi) * np.linalg.inv(isotropic(*SOFT))
        )
        assert np.linalg.eigvalsh(result.matrix - reuss)[0] > -1e-6


@pytest.mark.whole
@pytest.mark.parametrize("share", [0.35, 0.6])
def test_isotropic_media_stay_below_hashin_and_shtrikman(share):
    matrix = np.mean(
        [stiffness(blobs((20, 20, 20), seed, share), moduli=SOFT).matrix for seed in range(3)],
        axis=0,
    )
    bulk, shear = matrix[:3, :3].mean(), (np.trace(matrix[:3, :3]) - matrix[:3, :3].mean() * 3) / 4
    shear = (2 * shear + 3 * matrix[range(3, 6), range(3, 6)].mean()) / 5
    k, g = 1 / (3 * (1 - 2 * 0.3)), 1 / 2.6
    most_bulk = share * k * 4 * g / (4 * g + 3 * (1 - share) * k)
    zeta = g * (9 * k + 8 * g) / (6 * (k + 2 * g))
    most_shear = share * g * zeta / (zeta + (1 - share) * g)
    assert 0.1 * most_bulk < bulk < most_bulk and 0.1 * most_shear < shear < most_shear


@pytest.mark.whole
def test_scan_balances_whatever_the_threads(data):
    solid = (tifffile.imread(data / "trabecular_bone_a.tif") > 0).astype(np.uint8)
    with threads(1):
        alone = stiffness(solid, box=(33, 37, 26))
    with threads(3):
        together = stiffness(solid, box=(33, 37, 26))
    assert np.array_equal(alone.matrix, together.matrix) and alone.iterations == together.iterations
    assert alone.converged and alone.imbalance < 2e-3 and alone.bearing > 0.9
    strict = stiffness(solid, box=(33, 37, 26), tolerance=1e-6)
    assert strict.imbalance < 2e-6
    assert np.allclose(alone.matrix, strict.matrix, atol=2e-3 * strict.matrix.max())


def test_halving_thin_struts_softens_them():
    # a zigzag of struts one voxel thick bends, which one brick cannot show
    values = np.zeros((8, 8, 8), np.uint8)
    values[:4, 0, 0] = values[4:, 4, 0] = 1
    values[3, :5, 0] = values[7, :5, 0] = 1
    thin = stiffness(values, halving=True)
    thick = stiffness(values.repeat(2, axis=0).repeat(2, axis=1).repeat(2, axis=2))
    assert thin.halving < -0.2
    assert thin.halving == pytest.approx(
        np.trace(thick.matrix) / np.trace(thin.matrix) - 1, rel=1e-3
    )


def test_box_is_the_centre():
    values = blobs((12, 10, 11), 5, 0.6)
    whole = stiffness(values[3:9, 1:9, 1:10])
    assert np.array_equal(stiffness(values, box=(6, 8, 9)).matrix, whole.matrix)
    assert np.array_equal(stiffness(values, box=99).matrix, stiffness(values).matrix)


def test_phase_and_moduli_are_checked():
    volume = np.ones((4, 4, 4), np.uint8)
    for wrong in [(1.0, 0.5), (-1.0, 0.3), (1.0,), {"bone": SOFT}, {}]:
        with pytest.raises(tb.errors.InputError):
            stiffness(volume, moduli=wrong)
    with pytest.raises(tb.errors.InputError, match="2-D"):
        stiffness(volume[0])
    with pytest.raises(tb.errors.InputError, match="both"):
        stiffness(volume, phase="solid", moduli={"solid": SOFT})
    assert not stiffness(volume, phase="void").matrix.any()
