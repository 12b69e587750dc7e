"""How many phases a scan tells, which voxel is of which, and levels on three of them."""

import numpy as np
import pytest
from scipy import ndimage

import trabecula as tb
from trabecula.synth.shared.content.fields import UNIT, values_by_phase
from trabecula.synth.shared.content.histogram import Histogram
from trabecula.synth.texture import grey_levels
from trabecula.synth.texture.config import TextureConfig
from trabecula.synth.texture.grey_levels import learn_levels
from trabecula.synth.texture.scan_phases import ScanPhases, find_phases

EVEN = (1.0, 1.0, 1.0)
LEVELS = np.array([-70.0, 0.0, 60.0], np.float32)


def smooth_noise(seed, sigma, side=40):
    noise = ndimage.gaussian_filter(
        np.random.default_rng(seed).standard_normal((side,) * 3), sigma, mode="wrap"
    )
    return (noise / noise.std()).astype(np.float32)


@pytest.fixture(scope="module")
def truth():
    """Pores, a matrix, and grains in it, (40, 40, 40)."""
    pores, grains = smooth_noise(1, 3.0) < -0.7, smooth_noise(2, 3.0) > 0.9
    return np.where(pores, 0, np.where(grains, 2, 1)).astype(np.uint8)


@pytest.fixture(scope="module")
def scan(truth):
    """Their levels, blurred by a voxel, with grain of a quarter of the steps between them."""
    grain = smooth_noise(3, 1.5) * 16
    return (ndimage.gaussian_filter(LEVELS[truth], 1.0) + grain)[None].astype(np.float32)


def test_gradients_tell_three_phases_that_overlap(scan, truth):
    found = find_phases([scan], EVEN)
    assert found.count == 3
    assert -60 < found.thresholds[0] < -10 < 10 < found.thresholds[1] < 55
    assert np.mean(found.structure_of(scan) == truth) > 0.85
    assert len(find_phases([scan], EVEN, way="two").thresholds) == 1


@pytest.mark.whole
@pytest.mark.parametrize("sigma", [1.0, 1.5, 3.0])
def test_noise_tells_no_phases(sigma):
    """Gradient and level of a Gaussian field are independent."""
    for seed in range(4):
        assert find_phases([40 * smooth_noise(seed, sigma, 48)[None]], EVEN) is None
    assert find_phases([np.zeros((1, 8, 8, 8), np.float32)], EVEN) is None


def test_two_phases_are_those_of_segment(truth):
    levels = ndimage.gaussian_filter(np.where(truth == 2, 180.0, 60.0), 1.0)
    image = tb.Image(np.rint(levels).astype(np.uint8), "grey")
    found = find_phases([image.values[None].astype(np.float32)], EVEN)
    assert (found.count, found.smooth) == (2, 0.0)
    assert np.array_equal(
        found.structure_of(image.values[None].astype(np.float32)), tb.segment(image).values
    )


def test_grain_between_two_phases_is_smoothed(truth):
    white = np.random.default_rng(5).standard_normal(truth.shape) * 45
    field = (np.where(truth == 2, 60.0, -60.0) + white)[None].astype(np.float32)
    found = find_phases([field], EVEN)
    assert (found.count, found.smooth) == (2, 1.0)
    assert np.mean(found.structure_of(field) == (truth == 2)) > 0.95


def test_from_dark_to_bright_there_is_no_middle_phase():
    levels = np.full((24, 24, 24), 200.0)
    levels[:, :12] = 40.0
    field = ndimage.gaussian_filter(levels, 1.0)[None].astype(np.float32)
    scan = ScanPhases((75.0, 165.0), 0.0)
    structure = scan.structure_of(field)
    assert np.all(structure[:, :12] == 0) and np.all(structure[:, 12:] == 2)
    low, high = scan.bounds(structure)
    assert np.all((field[0] >= low) & (field[0] <= high)), "they meet halfway"


def test_every_phase_gets_its_own_histogram():
    draw = np.random.default_rng(0)
    structure = draw.integers(0, 3, (12, 10, 16)).astype(np.uint8)
    votes = draw.integers(-100 * UNIT, 100 * UNIT, (3, *structure.shape)).astype(np.int16)
    ranges = [(0, 40), (100, 110), (200, 256)]
    targets = [
        [Histogram.of(np.arange(*ends, dtype=np.uint8)) for _ in range(3)] for ends in ranges
    ]
    values = values_by_phase(votes, structure, targets)
    assert values.shape == (*structure.shape, 3)
    for phase, (low, high) in enumerate(ranges):
        inside = values[structure == phase]
        assert inside.min() >= low and inside.max() < high
        assert abs(inside.mean() - (low + high - 1) / 2) < 0.03 * (high - low)
    half = values_by_phase(votes[:1], structure, [one[:1] for one in targets], votes[0] > 0)
    kept = (votes[0] > 0) & (structure == 1)
    assert abs(half[kept].mean() - 104.5) < 0.3, "only voxels inside are counted"


@pytest.mark.whole
def test_levels_of_three_phases_lie_between_their_thresholds(scan):
    """Painted on its own structure a scan keeps its phases, to the voxel where every phase has its
    own histogram, and its spectrum.
    """
    found = find_phases([scan], EVEN)
    structure = found.structure_of(scan)
    image = tb.Image(scan[0], "grey")
    targets = [[Histogram.of(scan[0][structure == phase])] for phase in range(3)]

    def match(votes, painted):
        return values_by_phase(votes, painted, targets)[None]

    levels = learn_levels([scan], [structure], found, EVEN, match)
    assert len(levels.filters) == 3
    votes = levels.paint(structure.copy(), tb.Request(structure.shape, seed=4))
    made = match(votes, structure)
    assert np.mean(found.structure_of(made) == structure) > 0.97
    slopes = [np.abs(np.diff(one[0], axis=2)).mean() for one in (made, scan)]
    assert 0.85 < slopes[0] / slopes[1] < 1.15
    assert not np.allclose(made, image.values, atol=10), "its grain is another"


def test_products_tell_thin_bodies_from_thick_ones(truth):
    """A body is the brighter the more of it there is around: no sum of Gaussians of the structure
    says so.
    """
    solid = (truth == 2).astype(np.uint8)
    around = ndimage.gaussian_filter(solid.astype(float), 1.4)
    field = (100 * solid * around**2)[None].astype(np.float32)

    def rest(products):
        weights = grey_levels._fit_weights([field], [solid], 2, EVEN, products=products)
        parts = grey_levels._gaussians(solid, 2, EVEN)
        return float((field[0] - grey_levels._expected(weights[0], parts)).std())

    assert rest(products=True) < 0.5 * rest(products=False)


def test_recipes_that_do_not_name_it_have_two_phases():
    assert TextureConfig.recorded({})["scan_phases"] == "two"
    assert TextureConfig.recorded({"scan_phases": "found"})["scan_phases"] == "found"
