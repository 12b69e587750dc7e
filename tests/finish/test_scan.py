"""Grey scans of labels: edges, noise, cupping and rings as asked; fitted ones like the real one."""

import numpy as np
import pytest

import trabecula as tb
from trabecula.core.errors import InputError, UnknownNameError
from trabecula.engine.parallel import threads
from trabecula.finish import ScanModel, fit_scan, scan
from trabecula.finish import scan as _function
from trabecula.finish.scan import coverage

module = __import__("sys").modules[_function.__module__]
CLEAN = {"levels": (20, 200), "noise": (0, 0)}


def ball(side=32, radius=10.3, centre=None):
    at = np.indices((side,) * 3) - ((side - 1) / 2 if centre is None else centre)
    return tb.Image((np.sqrt((at**2).sum(axis=0)) < radius).astype(np.uint8), "labels")


def blocks(side=48, seed=0):
    noise = np.random.default_rng(seed).normal(size=(side,) * 3)
    for axis in range(3):
        noise = sum(np.roll(noise, shift, axis) for shift in range(-3, 4))
    return tb.Image((noise > 0.4 * noise.std()).astype(np.uint8), "labels")


@pytest.mark.whole
def test_partial_volume_has_the_volume_and_the_place_of_the_true_surface():
    """Of a ball: the shares of its voxels sum to its volume, and fall with the distance."""
    centre = np.array([15.2, 15.5, 15.9])
    image = ball(radius=10.3, centre=centre.reshape(3, 1, 1, 1))
    share = coverage(image.values, (0, 0))[1]
    assert share.sum() == pytest.approx(4 / 3 * np.pi * 10.3**3, rel=0.02)
    at = np.indices(image.shape) - centre.reshape(3, 1, 1, 1)
    true = (0.5 + 10.3 - np.sqrt((at**2).sum(axis=0))).clip(0, 1)
    labels = image.values
    assert np.abs(share - true).mean() < 0.6 * np.abs(labels - true).mean()
    assert (share[labels == 1] >= 0.5).all() and (share[labels == 0] <= 0.5).all()


def test_shares_of_several_phases_sum_to_one():
    values = np.random.default_rng(3).integers(0, 4, (6, 7, 8)).astype(np.uint8)
    np.testing.assert_allclose(np.sum(coverage(values, (0, 0, 0, 0)), axis=0), 1, atol=1e-6)


def test_blur_widens_an_edge_as_a_gaussian_does():
    half = np.zeros((4, 4, 41), np.uint8)
    half[:, :, 20:] = 1
    for blur in (1.0, 2.0):
        grey = scan(half, blur=blur, dtype="float32", **CLEAN).values[2, 2]
        slope = np.diff(grey) / 180
        at = np.arange(40) + 0.5
        middle = (slope * at).sum()
        width = np.sqrt((slope * (at - middle) ** 2).sum())
        assert middle == pytest.approx(19.5, abs=0.01)
        assert width == pytest.approx(blur, rel=0.02)


def test_noise_has_its_standard_deviation_and_its_correlation():
    image = tb.Image(np.zeros((40, 40, 40), np.uint8), "labels", phases=("void", "solid"))
    grain = module.gaussian_grain(1.0)
    given = {"levels": (100, 200), "noise": (9, 3), "grain": (grain, grain), "dtype": "float32"}
    values = scan(image, seed=4, **given).values.astype(float) - 100
    assert values.std() == pytest.approx(9, rel=0.05) and abs(values.mean()) < 0.6
    for axis in range(3):
        lines = np.moveaxis(values, axis, 0)
        for lag in (1, 2, 3):
            found = (lines[lag:] * lines[:-lag]).mean() / values.var()
            assert found == pytest.approx(np.exp(-(lag**2) / 4), abs=0.04)


def test_cupping_and_rings_are_about_the_axis():
    solid = tb.Image(np.ones((8, 41, 41), np.uint8), "labels", phases=("void", "solid"))
    cup = scan(solid, cupping=0.2, dtype="float32", **CLEAN).values[4]
    assert cup[20, 20] == pytest.approx(160, abs=0.1) and cup[0, 0] == pytest.approx(200, abs=0.1)
    assert cup[20, 10] == pytest.approx(200 * (1 - 0.2 * (1 - (10 / 20.5) ** 2)), rel=1e-3)
    rings = scan(solid, rings=5, dtype="float32", **CLEAN).values - 200
    np.testing.assert_allclose(rings, rings[:, ::-1], atol=1e-3)
    np.testing.assert_allclose(rings, np.swapaxes(rings, 1, 2), atol=1e-3)
    assert np.abs(rings[0] - rings[1]).mean() > 1  # every slice has its own
    assert 3 < rings.std() < 6


@pytest.mark.whole
def test_any_slab_and_any_number_of_threads_give_the_same(monkeypatch):
    image, given = blocks(), {"seed": 7, "cupping": 0.1, "rings": 2.0, "blur": 1.3}
    whole = scan(image, **given).values
    for depth in (7, 48, 100):
        monkeypatch.setattr(module, "_DEPTH", depth)
        assert np.array_equal(scan(image, **given).values, whole)
    with threads(1):
        assert np.array_equal(scan(image, **given).values, whole)
    other = scan(image, **{**given, "seed": 8}).values
    assert not np.array_equal(other, whole)


@pytest.fixture(scope="module")
def real():
    """Return labels, a scan of them by a model that is known, and the model."""
    grain = module.gaussian_grain(0.9)
    more = {"blur": 1.2, "inset": 0.3, "grain": (grain, grain), "cupping": 0.12, "rings": 4.0}
    model = ScanModel((50, 190), noise=(8, 12), **more)
    labels = blocks(72)
    return labels, scan(labels, model=model, seed=1), model


@pytest.mark.whole
def test_a_fit_finds_the_model_again(real):
    labels, grey, model = real
    found = fit_scan(grey, labels)
    assert found.levels == pytest.approx(model.levels, abs=6)
    assert found.blur == pytest.approx(model.blur, abs=0.3)
    assert found.inset == pytest.approx(0.3, abs=0.11)
    assert found.noise == pytest.approx(model.noise, rel=0.25)
    assert found.cupping == pytest.approx(0.12, abs=0.03)
    assert found.rings == pytest.approx(4.0, rel=0.3)
    other = blocks(72, seed=5)
    again = fit_scan(scan(other, model=found, seed=2), other)
    assert again.levels == pytest.approx(found.levels, abs=6)
    assert again.noise == pytest.approx(found.noise, rel=0.25)


@pytest.mark.whole
def test_a_scan_without_cupping_and_rings_is_fitted_without(real):
    labels, _, _ = real
    found = fit_scan(scan(labels, seed=3), labels)
    assert found.cupping == 0 and found.rings == 0


@pytest.mark.whole
def test_the_recipe_makes_the_scan_again_without_the_real_one(tmp_path, real, monkeypatch):
    labels, grey, _ = real
    tb.write(labels, tmp_path / "labels.zarr")
    made = scan(tb.read(tmp_path / "labels.zarr"), like=grey, seed=11)
    tb.write(made, tmp_path / "scan.zarr")
    again = tb.rerun(tmp_path / "scan.zarr")
    assert again.kind == "grey" and np.array_equal(again.values, made.values)
    # labels of another spacing and of void named second keep their own levels
    turned = tb.Image(1 - labels.values, "labels", phases=("solid", "void"))
    assert scan(turned, like=grey, seed=11).values.mean() == pytest.approx(
        made.values.mean(), rel=0.02
    )


def test_what_does_not_fit_is_refused():
    three = tb.Image(np.arange(3, dtype=np.uint8).repeat(9).reshape(3, 3, 3), "labels")
    grey = scan(blocks(16), seed=0)
    with pytest.raises(InputError, match="labels have 3 phases"):
        scan(three, like=grey)
    with pytest.raises(InputError, match="2 levels, the image 3 phases"):
        scan(three, model=ScanModel((20, 200)))
    with pytest.raises(InputError, match="give one of each for every phase"):
        scan(three, levels=(1, 2, 3), noise=(1, 2))
    with pytest.raises(UnknownNameError, match="unknown setting of a scan 'ring'"):
        scan(three, ring=3)
    with pytest.raises(InputError, match="levels 5: give one for every phase"):
        scan(three, levels=5)
    with pytest.raises(InputError, match="a scan is grey, got labels"):
        fit_scan(three)
    with pytest.raises(InputError, match="labels of the same voxels"):
        fit_scan(grey, three)
    with pytest.raises(InputError, match="has no inside"):
        fit_scan(tb.Image(np.random.default_rng(0).random((8, 8, 8)), "grey"))
    assert scan(three).values.dtype == np.uint8 and scan(three).kind == "grey"
    flat = scan(blocks(16).values[0])
    assert flat.shape == (16, 16)


def test_the_command_line_writes_a_scan(tmp_path):
    from commands import refused, trabecula

    part = tb.write(blocks(24), tmp_path / "part.zarr")
    out = tmp_path / "scan.tif"
    words = ("finish", part, "--floaters", "--scan", "--seed", "3", "--blur", "1", "--out", out)
    found = trabecula(*map(str, words)).out
    assert "grey" in found and "scan.levels" in found
    steps = tb.read(out).recipe.steps
    assert [step["operation"] for step in steps[-2:]] == ["remove_floaters", "scan"]
    assert steps[-1]["settings"]["seed"] == 3 and steps[-1]["settings"]["blur"] == 1
    line = refused("finish", str(part), "--floaters", "--rings", "2", "--out", str(out))
    assert "--rings is for --scan" in line
