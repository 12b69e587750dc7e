"""Evenness in the certificate: what is hollow, graded or of two halves fails, what is another
sample passes.
"""

import numpy as np
import pytest

import trabecula as tb
from trabecula.measure import signed_distance
from trabecula.measure.evenness import depth_of, window_means
from trabecula.measure.streaming.cells import cells_of
from trabecula.report.evenness import (
    choose_windows,
    evenness_bands,
    evenness_numbers,
    measure_evenness,
    phases_of,
)

SIDE = 96


def gaussian(seed: int, shape=(SIDE,) * 3, share=0.3) -> np.ndarray:
    """Cut a periodic smooth field at a fixed level: porosity scatters as that of samples does."""
    noise = np.random.default_rng(seed).standard_normal(shape)
    for axis in range(len(shape)):
        for _ in range(3):
            noise = noise + np.roll(noise, 1, axis) + np.roll(noise, 2, axis)
    weights = np.convolve(np.convolve([1, 1, 1], [1, 1, 1]), [1, 1, 1])
    scale = np.sqrt((weights**2).sum()) ** len(shape)
    return (noise / scale > 0.5244).astype(np.uint8)


def shift_density(image: tb.Image, profile: np.ndarray, amount: float) -> tb.Image:
    """Thicken the solid where the profile is high, thin it where it is low; keep the porosity."""
    field = signed_distance(image.values == image.values.max()) + amount * profile
    level = np.quantile(field, tb.measure.porosity(image))
    return tb.Image(
        (field > level).astype(np.uint8),
        "labels",
        spacing=image.spacing,
        unit=image.unit,
        phases=image.phases,
    )


def fakes(image: tb.Image, amount: float) -> dict[str, tb.Image]:
    """Make three uneven materials of about the same porosity; the profiles run from 0 to 1."""
    place = np.indices(image.shape)[0] / image.shape[0]
    profiles = {
        "hollow": -np.minimum(2 * depth_of(image.shape), 1),
        "graded": place,
        "halves": (place > 0.5).astype(float),
    }
    return {name: shift_density(image, profile, amount) for name, profile in profiles.items()}


def list_failures(exemplar: tb.Image, image: tb.Image) -> list[str]:
    """List the figures that fail, by the functions that the certificate calls."""
    windows = choose_windows(exemplar, [image])
    found = [
        measure_evenness(cells_of(each, cell=windows.cell), windows, phases_of(each))
        for each in (exemplar, image)
    ]
    wrong = []
    for suffix in found[0]:
        numbers = evenness_numbers(found[1][suffix], suffix)
        bands = evenness_bands(found[0][suffix], found[1][suffix], suffix)
        wrong += [name for name, (low, high) in bands.items() if not low <= numbers[name] <= high]
    return wrong


@pytest.mark.whole
def test_other_samples_of_a_material_seldom_fail():
    """Judge forty figures of ten pairs: one in a hundred may leave its band."""
    wrong = [
        list_failures(tb.Image(gaussian(n), "labels"), tb.Image(gaussian(n + 50), "labels"))
        for n in range(10)
    ]
    assert sum(map(len, wrong)) <= 4


@pytest.mark.whole
@pytest.mark.parametrize("name", ["hollow", "graded", "halves"])
def test_an_uneven_sample_fails(name):
    exemplar, other = tb.Image(gaussian(1), "labels"), tb.Image(gaussian(2), "labels")
    fake = fakes(other, 1.5)[name]
    assert tb.measure.porosity(fake) == pytest.approx(tb.measure.porosity(other), abs=0.03)
    assert any(figure.startswith("fraction") for figure in list_failures(exemplar, fake))


@pytest.mark.whole
@pytest.mark.parametrize("name", ["bone", "foam"])
def test_uneven_samples_of_the_package_fail(name):
    exemplar = tb.sample(name)
    for what, fake in fakes(exemplar, 1.5).items():
        assert any(figure.startswith("fraction") for figure in list_failures(exemplar, fake)), what
    assert list_failures(exemplar, exemplar) == []


@pytest.mark.slow
def test_uneven_scans_fail(data):
    for name in ("trabecular_bone_a", "trabecular_bone_b", "berea_sandstone_a", "nmc_electrode_a"):
        scan = tb.crop(tb.read(data / f"{name}.tif"), 120)
        for what, fake in fakes(scan, 3.0).items():
            assert any(figure.startswith("fraction") for figure in list_failures(scan, fake)), (
                name,
                what,
            )


@pytest.mark.whole
def test_the_certificate_says_it_at_every_level_and_for_every_kind():
    exemplar = tb.Image(gaussian(1), "labels")
    hollow = fakes(tb.Image(gaussian(2), "labels"), 1.5)["hollow"]
    found = tb.verify(exemplar, hollow, level="quick")
    assert found.groups["evenness"] is False and found.verdict == "fail"
    assert "Evenness in space: UNEVEN" in repr(found) and "Where it is dense" in found.to_html()
    assert set(found.local_fractions["image"]) == set("zyx")
    rng = np.random.default_rng(0)
    flat = tb.Image(rng.integers(100, 120, (128, 128)).astype(np.uint8), "grey")
    ramp = tb.Image((flat.values + np.linspace(-5, 5, 128)[:, None]).astype(np.uint8), "grey")
    found = tb.verify(flat, ramp)
    assert {"fraction_trend_y", "fraction_spread_large"} <= set(found.failed)


def test_phases_are_judged_one_by_one():
    """Put binder on one side only, with all fractions right."""
    rng = np.random.default_rng(3)
    solid = rng.random((64, 64, 64)) < 0.5
    even = solid * np.where(rng.random(solid.shape) < 0.2, 2, 1)
    sided = solid * np.where(
        rng.random(solid.shape) < np.where(np.arange(64) < 32, 0.4, 0.0)[:, None, None], 2, 1
    )
    images = [
        tb.Image(each.astype(np.uint8), "labels", phases=("void", "active", "binder"))
        for each in (even, sided)
    ]
    wrong = list_failures(*images)
    assert {"fraction_trend_z_binder", "fraction_trend_z_active"} <= set(wrong)
    assert "fraction_trend_z_void" not in wrong


@pytest.mark.whole
def test_an_exemplar_with_a_trend_decides_nothing():
    graded = fakes(tb.Image(gaussian(1), "labels"), 1.5)["graded"]
    certificate = tb.verify(graded, graded, level="quick")
    assert certificate.failed == () and any(
        "not stationary" in reason and "along z" in reason for reason in certificate.undecided
    )


def spheres(seed: int, side: int = 96, radius: int = 5, count: int = 700) -> np.ndarray:
    """Return overlapping spheres at random places of a torus: a Boolean model, not Gaussian."""
    rng = np.random.default_rng(seed)
    reach = np.arange(-radius, radius + 1)
    ball = np.stack(np.meshgrid(reach, reach, reach, indexing="ij"), -1).reshape(-1, 3)
    ball = ball[(ball**2).sum(-1) <= radius**2]
    solid = np.zeros((side,) * 3, np.uint8)
    for centre in rng.integers(0, side, (rng.poisson(count), 3)):
        solid[tuple(((ball + centre) % side).T)] = 1
    return solid


@pytest.mark.slow
def test_another_sample_of_a_material_that_is_no_noise_passes():
    found = tb.verify(tb.Image(spheres(1), "labels"), tb.Image(spheres(2), "labels"))
    assert found.verdict == "pass" and found.undecided == () and all(found.groups.values())
    assert any(metric.passed is False for metric in found.baseline.values())
    text = repr(found)
    assert (
        "PASS" in text
        and len(text.splitlines()) <= 60
        and "2px solid #2b6b4f" in found._repr_html_()
    )
    html = found.to_html()
    assert 'class="verdict pass"' in html and "Not examined: transport and stiffness" in html


@pytest.mark.whole
def test_the_hellinger_distance_is_reported_and_literal():
    """It is that of histograms in the exemplar's tenths, 0 to itself, and gives no verdict."""
    exemplar, other = (tb.Image(gaussian(seed), "labels") for seed in (1, 2))
    halves = fakes(exemplar, 2.0)["halves"]
    found = tb.verify(exemplar, other, halves, exemplar, level="quick")
    apart = [one.metrics["fraction_hellinger_medium"].value for one in found]
    assert apart[2] < 0.01 and apart[0] < 0.25 < apart[1]
    assert all(one.metrics["fraction_hellinger_medium"].passed is None for one in found)
    windows = choose_windows(exemplar, [halves])
    edge = windows.edges[len(windows.edges) // 2]
    counts = 3 * (round(edge / windows.cell),)
    cells = [cells_of(image, cell=windows.cell) for image in (exemplar, halves)]
    own, theirs = (window_means(one.shares[1], counts).ravel() for one in cells)
    edges = np.quantile(own, np.linspace(0, 1, 11)[1:-1])
    p, q = (np.bincount(np.searchsorted(edges, v), minlength=10) / v.size for v in (own, theirs))
    assert apart[1] == pytest.approx(np.sqrt(1 - np.sqrt(p * q).sum()), abs=0.03)


def test_the_band_of_a_spread_is_never_narrower_than_real_materials_are_patchy():
    """White noise has so many independent windows that F alone would leave a few percents."""
    rng = np.random.default_rng(4)
    image = tb.Image((rng.random((64, 64, 64)) < 0.5).astype(np.uint8), "labels")
    windows = choose_windows(image, [image])
    found = measure_evenness(cells_of(image, cell=windows.cell), windows, phases_of(image))[""]
    low, high = evenness_bands(found, found)["fraction_spread_small"]
    assert high / found.fraction[0].deviation > 1.2 and low / found.fraction[0].deviation < 0.85


def test_octants_that_differ_widen_the_band_of_a_spread():
    rng = np.random.default_rng(5)
    coarse = rng.random((16, 16, 16)).repeat(4, 0).repeat(4, 1).repeat(4, 2)
    mixed = rng.random((64, 64, 64))
    mixed[:32, :32, :32] = coarse[:32, :32, :32]
    widths = []
    for values in (rng.random((64, 64, 64)), mixed):
        image = tb.Image((values < 0.5).astype(np.uint8), "labels")
        windows = choose_windows(image, [image])
        found = measure_evenness(cells_of(image, cell=windows.cell), windows, phases_of(image))[""]
        assert len(found.fraction[0].blocks) == 8
        low, high = evenness_bands(found, found)["fraction_spread_small"]
        widths.append(high / low)
    assert widths[1] > 1.5 * widths[0]
