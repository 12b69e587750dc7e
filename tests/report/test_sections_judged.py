"""Volumes held against parallel sections, which decide on the Euler number."""

import numpy as np
import pytest

import trabecula as tb
from commands import refused, trabecula
from trabecula.errors import InputError
from trabecula.measure import disector_along, disector_euler_density, euler_density
from trabecula.report import verify
from trabecula.report.metrics import find_descriptor
from trabecula.report.sections import FIGURE, SectionJudge

GAP = 2


def field(seed: int, *sides: int) -> np.ndarray:
    """Return an isotropic Gaussian field, cut at its median: both phases are joined."""
    waves = np.meshgrid(*map(np.fft.fftfreq, sides), indexing="ij")
    damped = np.exp(-sum((np.pi * 3 * wave) ** 2 for wave in waves))
    noise = np.random.default_rng(seed).standard_normal(sides)
    values = np.fft.ifftn(np.fft.fftn(noise) * damped).real
    return (values > np.median(values)).astype(np.uint8)


@pytest.fixture(scope="module")
def sections() -> list[tb.Image]:
    return [tb.Image(each, "labels") for each in field(1, 24, 200, 200)[2 : 2 + 3 * GAP : GAP]]


@pytest.fixture(scope="module")
def volume() -> tb.Image:
    return tb.Image(field(2, 48, 48, 48), "labels")


@pytest.mark.whole
def test_another_part_of_the_material_has_its_euler_number(sections, volume):
    found = verify(sections, volume, gap=GAP, level="quick")
    metric = found.metrics[FIGURE]
    assert metric.passed and metric.exemplar == disector_euler_density(sections, gap=GAP)
    along = [disector_along(volume, gap=GAP, axis=axis) for axis in range(3)]
    assert metric.value == pytest.approx(np.mean(along))
    low, high = metric.real_band
    assert low < euler_density(volume) < high < 0
    assert find_descriptor(FIGURE).group == "shape", "it does not say that all is joined"
    assert any("3 sections that are 2 voxels" in note for note in found.notes)
    assert not any("Euler number" in text for text in found.beyond_picture)
    alone = verify(sections[0], volume, level="quick")
    assert FIGURE not in alone.metrics
    assert any("Euler number" in text for text in alone.beyond_picture)


@pytest.mark.whole
def test_a_structure_that_slices_do_not_tell_apart_fails(sections):
    """Layers of equal slices: no body begins, ends or branches from slice to slice."""
    walls = tb.Image(np.repeat(field(3, 8, 48, 48)[:1], 48, axis=0), "labels")
    assert verify(sections, walls, gap=GAP, level="quick").metrics[FIGURE].passed is False


def test_the_band_is_that_of_parts_of_the_layers_between_sections(sections, volume):
    low, high = SectionJudge(sections, GAP).judge(volume)[FIGURE].real_band
    own = disector_euler_density(sections, gap=GAP)
    parts = [
        disector_euler_density(
            [tb.crop(each, (66, 66), corner=(y, x)) for each in sections], gap=GAP
        )
        for y in (0, 67, 134)
        for x in (0, 67, 134)
    ]
    part, whole, image = (2 * GAP * 66**2, 2 * GAP * 200**2, 48**3)
    further = np.sqrt(part / image + part / whole)
    deviation = np.std(parts, ddof=1) / np.sqrt(9 / 8 * (1 - part / whole))
    # Student's t for 8 degrees of freedom, 99.5 %
    assert (high - low) / 2 == pytest.approx(3.355 * deviation * further, rel=0.01)
    assert (high + low) / 2 == pytest.approx(own), "it has no faces, and may be below 0"


@pytest.mark.whole
def test_sections_that_contradict_their_gap_decide_nothing(sections, volume):
    wrong = verify([sections[0], sections[2]], volume, gap=1, level="quick")
    assert any("correlate by" in reason for reason in wrong.undecided)
    assert wrong.metrics[FIGURE].passed is None and FIGURE not in wrong.failed
    assert any("The Euler number is not" in note for note in wrong.notes)
    right = verify(sections, volume, gap=GAP, level="quick")
    assert not any("correlate by" in reason for reason in right.undecided)


@pytest.mark.whole
def test_small_sections_report_and_grey_ones_are_textures(sections, volume):
    small = [tb.crop(each, 40) for each in sections]
    certificate = verify(small, volume, gap=GAP, level="quick")
    metric = certificate.metrics[FIGURE]
    assert metric.passed is None and metric.value is not None
    assert any("The Euler number is not" in note for note in certificate.notes)
    assert any("the Euler number" in text for text in certificate.beyond_picture)
    assert certificate.about["sections"] == {"count": 3, "gap": GAP}
    grey = [tb.Image(each.values * np.uint8(200), "grey") for each in sections]
    texture = verify(grey, tb.Image(volume.values * np.uint8(200), "grey"), gap=GAP)
    assert FIGURE not in texture.metrics


@pytest.mark.whole
def test_sections_have_no_views_and_fit_each_other(sections, volume):
    with pytest.raises(InputError, match="stand for all planes"):
        verify(sections, volume, gap=GAP, views=["yx", "zx"])
    with pytest.raises(InputError, match="two or more"):
        verify(sections[0], volume, gap=GAP)
    same = verify(sections, volume, gap=2.0, level="quick").metrics[FIGURE]
    assert same == verify(sections, volume, gap=2, level="quick").metrics[FIGURE]
    with pytest.raises(InputError, match="gap=-1"):
        verify(sections, volume, gap=-1)


@pytest.mark.whole
def test_the_command_line(sections, volume, tmp_path):
    for name, image in {"a": sections[0], "b": sections[1], "volume": volume}.items():
        tb.write(image, tmp_path / f"{name}.npy")
    files = [tmp_path / f"{name}.npy" for name in ("a", "volume", "b")]
    words = ("verify", *files[:2], "--pictures", files[2], "--quick")
    assert FIGURE in trabecula(*words, "--gap", GAP).out
    assert FIGURE not in trabecula(*words).out
    assert "leave out" in refused(*words, "--gap", GAP, "--ensemble")
