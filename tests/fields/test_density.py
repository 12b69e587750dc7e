"""The learned field of local density: its histogram, its covariance, and its independence of
chunks and threads.
"""

import numpy as np
import pytest

import trabecula as tb
from trabecula.cli.main import main
from trabecula.engine.parallel import threads
from trabecula.errors import InputError
from trabecula.measure.smooth import gaussian

WINDOW = 12


def uneven(seed, side=96, wave=8.0):
    """Fine Gaussian structure whose density follows a wave field much longer than itself."""
    rng, pad = np.random.default_rng(seed), 24

    def field(length):
        noise = rng.standard_normal((side + 2 * pad,) * 3).astype(np.float32)
        found = gaussian(noise, length)[pad:-pad, pad:-pad, pad:-pad]
        return found / found.std()

    return tb.Image((field(1.2) + 0.6 * field(wave) > 0.6).astype(np.uint8), "labels")


def correlation(values, lag):
    """The correlation of values a lag apart, mean over the axes."""
    away = values - values.mean()
    pairs = [np.moveaxis(away, axis, 0) for axis in range(values.ndim)]
    return np.mean([(p[lag:] * p[:-lag]).mean() for p in pairs]) / values.var()


@pytest.mark.whole
def test_windows_of_a_larger_volume_vary_and_reach_as_the_material_s():
    exemplar = uneven(0)
    have = tb.fields.windowed(exemplar, size=WINDOW)["volume_fraction"]
    fields = [tb.fields.density_like(exemplar, 120, window=WINDOW, seed=s).values for s in range(4)]
    assert np.mean([f.mean() for f in fields]) == pytest.approx(have.mean(), abs=0.03)
    assert np.mean([f.std() for f in fields]) == pytest.approx(have.std(), rel=0.1)
    for share in (0.02, 0.25, 0.75, 0.98):
        quantile = np.mean([np.quantile(f, share) for f in fields])
        assert quantile == pytest.approx(np.quantile(have, share), abs=0.05)
    # against other samples of the material, which the field has not seen
    others = [tb.fields.windowed(uneven(s), size=WINDOW)["volume_fraction"] for s in (1, 2)]
    for lag in (WINDOW // 2, WINDOW, 2 * WINDOW):
        true = np.mean([correlation(other, lag) for other in others])
        assert np.mean([correlation(f, lag) for f in fields]) == pytest.approx(true, abs=0.1), lag


@pytest.mark.whole
def test_longer_waves_reach_farther():
    reach = [
        correlation(tb.fields.density_like(uneven(0, wave=wave), 96, window=WINDOW).values, WINDOW)
        for wave in (1.2, 8.0)
    ]
    assert reach[0] < 0.15 and reach[1] > 0.3


def test_a_field_is_the_same_whatever_the_shape_and_the_threads():
    exemplar = uneven(0, side=64)
    large = tb.fields.density_like(exemplar, (70, 60, 50), window=WINDOW, seed=7)
    small = tb.fields.density_like(exemplar, (33, 41, 50), window=WINDOW, seed=7)
    assert np.array_equal(large.values[:33, :41], small.values)
    with threads(3):
        again = tb.fields.density_like(exemplar, (70, 60, 50), window=WINDOW, seed=7)
    assert np.array_equal(again.values, large.values)
    other = tb.fields.density_like(exemplar, (70, 60, 50), window=WINDOW, seed=8)
    assert np.corrcoef(other.values.ravel(), large.values.ravel())[0, 1] < 0.5


@pytest.mark.whole
def test_variance_is_the_same_between_the_points_of_the_lattice():
    exemplar = uneven(0, side=48, wave=1.2)
    drawn = [
        tb.fields.density_like(exemplar, (120, 4, 4), window=WINDOW, seed=seed).values
        for seed in range(60)
    ]
    spread = np.std(drawn, axis=0).reshape(-1, 3, 4, 4).mean(axis=(0, 2, 3))
    assert spread.max() < 1.06 * spread.min()


def test_a_picture_and_the_void():
    picture = tb.Image(uneven(0).values[40], "labels")
    solid = tb.fields.density_like(picture, (60, 80), window=WINDOW, seed=1)
    void = tb.fields.density_like(picture, (60, 80), window=WINDOW, phase="void", seed=1)
    assert solid.shape == void.shape == (60, 80)
    assert solid.values.mean() == pytest.approx(picture.values.mean(), abs=0.1)
    assert 1 - void.values.mean() == pytest.approx(picture.values.mean(), abs=0.1)
    plain = tb.fields.density_like(np.indices((48, 48)).sum(0) % 2, 20, window=8)
    assert (plain.values == 0.5).all()


@pytest.mark.whole
def test_too_short_an_exemplar_is_refused_with_what_would_do():
    exemplar = tb.crop(uneven(0), (30, 64, 64))
    with pytest.raises(InputError, match=r"2\.5 along z windows of 12 .* a window of 8 voxels"):
        tb.fields.density_like(exemplar, 64, window=12)
    tb.fields.density_like(exemplar, 16, window=8)
    with pytest.raises(InputError, match="dimension"):
        tb.fields.density_like(exemplar, (64, 64))


def test_the_command_writes_it_and_rerun_makes_it_again(tmp_path, capsys):
    tb.write(uneven(0, side=48), tmp_path / "scan.tif")
    words = ["field", "density", str(tmp_path / "scan.tif"), "--shape", "30", "--seed", "2"]
    assert main([*words, "--window", "12", "--out", str(tmp_path / "f.zarr")]) == 0
    field = tb.read(tmp_path / "f.zarr")
    expected = tb.fields.density_like(tb.read(tmp_path / "scan.tif"), 30, window=12, seed=2)
    assert np.array_equal(field.values, expected.values)
    assert main(["rerun", str(tmp_path / "f.zarr")]) == 0  # the same voxels, by their digest
