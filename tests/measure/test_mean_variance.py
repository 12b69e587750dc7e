"""Variances of means are those of known fields: noise, Gaussian fields, Boolean discs, crystals."""

import math

import numpy as np
import pytest

from trabecula.errors import InputError
from trabecula.measure import mean_variance
from trabecula.measure.mean_variance import SpatialCovariance, variance_of_means


def _spectrum(shape, length):
    waves = [np.fft.fftfreq(side) * 2 * np.pi for side in shape]
    return np.exp(-sum(wave**2 for wave in np.ix_(*waves)) * length**2 / 2)


def _gaussian(shape, length, seed):
    """Draw a periodic field of covariance exp(-r^2 / 2 length^2) but for a factor."""
    noise = np.random.default_rng(seed).standard_normal(shape)
    return np.fft.ifftn(np.fft.fftn(noise) * np.sqrt(_spectrum(shape, length))).real


def _true_variance(shape, length, box):
    """Return the variance of a box's mean, from the field's spectrum."""
    lines = []
    for side, edge in zip(shape, box, strict=True):
        window = np.zeros(side)
        window[:edge] = 1 / edge
        lines.append(np.abs(np.fft.fft(window)) ** 2)
    return float((_spectrum(shape, length) * math.prod(np.ix_(*lines))).mean())


def _crops(field, box):
    counts = [side // edge for side, edge in zip(field.shape, box, strict=True)]
    for place in np.ndindex(*counts):
        yield field[tuple(slice(i * e, (i + 1) * e) for i, e in zip(place, box, strict=True))]


@pytest.mark.parametrize("shape", [(48, 48, 48), (300, 200)])
def test_independent_voxels_vary_by_their_number(shape):
    inside = np.random.default_rng(3).random(shape) < 0.3
    found = variance_of_means([inside], (20,) * len(shape))[0, 0]
    assert found == pytest.approx(0.3 * 0.7 / 20 ** len(shape), rel=0.25)


@pytest.mark.whole
@pytest.mark.parametrize(
    ("shape", "length", "crop"),
    [((128, 128, 128), 2.0, (32, 32, 32)), ((768, 768), 3.0, (96, 96))],
)
def test_crops_know_the_variance_of_their_means(shape, length, crop):
    field = _gaussian(shape, length, 1)
    found = [variance_of_means([part], crop)[0, 0] for part in _crops(field, crop)]
    assert np.mean(found) == pytest.approx(_true_variance(shape, length, crop), rel=0.06)


def test_crops_know_the_variance_of_other_boxes():
    shape, crop, box = (128, 128, 128), (64, 40, 48), (24, 100, 60)
    field = _gaussian(shape, 2.0, 2)
    found = [variance_of_means([part], box)[0, 0] for part in _crops(field, crop)]
    assert np.mean(found) == pytest.approx(_true_variance(shape, 2.0, box), rel=0.06)


def test_boolean_discs():
    # C(h) = exp(-theta |K or K + h|) - p^2 of discs K at Poisson points (Lantuejoul 1991)
    radius, theta, side = 4, 0.012, 128
    y, x = np.ogrid[-radius : radius + 1, -radius : radius + 1]
    disc = np.zeros((64, 64))
    disc[: 2 * radius + 1, : 2 * radius + 1] = x**2 + y**2 <= radius**2
    common = np.fft.ifft2(np.abs(np.fft.fft2(disc)) ** 2).real
    covariance = np.exp(-theta * (2 * disc.sum() - common)) - math.exp(-2 * theta * disc.sum())
    weight = 1 - np.abs(np.fft.fftfreq(64) * 64) / side
    true = float((covariance * np.outer(weight, weight)).sum()) / side**2
    germs = np.random.default_rng(5).poisson(theta, (1024, 1024)) > 0
    germs_of_disc = np.fft.rfft2(np.pad(disc, (0, 960)))
    pores = np.fft.irfft2(np.fft.rfft2(germs) * germs_of_disc) > 0.5
    found = [variance_of_means([part], (side, side))[0, 0] for part in _crops(pores, (side, side))]
    assert np.mean(found) == pytest.approx(true, rel=0.08)


def test_literal_sum():
    field = _gaussian((20, 24), 1.0, 4)
    known = SpatialCovariance.of([field])
    rest, reach, cells = field - field.mean(), known.reach[0], field.size
    lags = [
        (dy, dx) for dy in range(-19, 20) for dx in range(-23, 24) if math.hypot(dy, dx) <= reach
    ]

    def mirrored(dy, dx):
        pairs = []
        for step in (dx, -dx):
            first = rest[: 20 - abs(dy)]
            second = rest[abs(dy) :]
            first, second = (first, second) if step >= 0 else (second, first)
            pairs.append((first[:, : 24 - abs(dx)] * second[:, abs(dx) :]).sum())
        return np.mean(pairs)

    fits = {lag: (20 - abs(lag[0])) * (24 - abs(lag[1])) for lag in lags}
    share = sum(fits.values()) / cells**2
    own = sum(mirrored(*lag) for lag in lags) / cells**2 / (1 - share)
    box = (10, 15)
    literal = sum(
        max(1 - abs(dy) / 10, 0) * max(1 - abs(dx) / 15, 0) / 150
        * (mirrored(dy, dx) / fits[dy, dx] + own)
        for dy, dx in lags
    )  # fmt: skip
    assert known.of_means(box)[0, 0] == pytest.approx(literal, rel=1e-9)
    assert known.freedom[0] == pytest.approx(1 / share - 1, rel=0.2)


def test_joint_means():
    first, second = _gaussian((256, 256), 3.0, 6), _gaussian((256, 256), 3.0, 7)
    found = variance_of_means([first, 2 * first, first + second, -first], (64, 64))
    scale = np.sqrt(np.diag(found))
    correlation = found / np.outer(scale, scale)
    assert scale[1] == pytest.approx(2 * scale[0])
    assert correlation[0, 1] == pytest.approx(1.0, abs=1e-6)
    assert correlation[0, 3] == pytest.approx(-1.0, abs=1e-6)
    assert correlation[0, 2] == pytest.approx(math.sqrt(0.5), abs=0.2)
    assert np.linalg.eigvalsh(found)[0] > -1e-9 * found.max()


def test_an_even_material_has_a_small_variance():
    # one sphere in every cell of a lattice, anywhere in it
    rng = np.random.default_rng(2)
    even, loose = np.zeros((2, 80, 80, 80), bool)
    ball = np.argwhere(((np.indices((7, 7, 7)) - 3) ** 2).sum(axis=0) <= 9)
    for cell in np.ndindex(8, 8, 8):
        even[tuple((10 * np.array(cell) + rng.integers(0, 10, 3) + ball).T % 80)] = True
        loose[tuple((rng.integers(0, 80, 3) + ball).T % 80)] = True
    found, common = variance_of_means([even, ~even], even.shape)[0]
    assert common == pytest.approx(-found)
    assert 0 < found < 0.5 * variance_of_means([loose], loose.shape)[0, 0]


def test_cells_keep_the_variance(monkeypatch):
    field = _gaussian((512, 512), 5.0, 8)
    whole = SpatialCovariance.of([field])
    monkeypatch.setattr(mean_variance, "MOST_CELLS", 20_000)
    coarse = SpatialCovariance.of([field])
    box = (200, 300)
    assert coarse.of_means(box)[0, 0] == pytest.approx(whole.of_means(box)[0, 0], rel=0.1)
    assert coarse.samples()[0] == pytest.approx(whole.samples()[0], rel=0.1)


def test_degrees_of_freedom_are_those_of_the_variance():
    shape, crop = (1024, 1024), (128, 128)
    parts = [SpatialCovariance.of([part]) for part in _crops(_gaussian(shape, 3.0, 9), crop)]
    found = np.array([part.of_means(crop)[0, 0] for part in parts])
    freedom = np.median([part.freedom[0] for part in parts])
    assert found.std() / found.mean() == pytest.approx(math.sqrt(2 / freedom), rel=0.3)


@pytest.mark.whole
def test_a_short_image_is_known_as_short():
    long = SpatialCovariance.of([_gaussian((96, 96, 96), 3.0, 10)])
    short = SpatialCovariance.of([_gaussian((96, 96, 96), 12.0, 10)])
    assert long.decayed[0]
    assert not short.decayed[0]
    assert long.samples()[0] > 10 * short.samples()[0]


def test_constant_fields_and_wrong_ones():
    flat = SpatialCovariance.of([np.ones((30, 30))])
    assert flat.of_means((9, 9))[0, 0] == 0
    assert np.isinf(flat.samples()[0])
    with pytest.raises(InputError, match="fields of one image"):
        variance_of_means([np.ones((3, 3)), np.ones((4, 3))], (3, 3))
    with pytest.raises(InputError, match="not finite"):
        variance_of_means([np.full((3, 3), np.nan)], (3, 3))
