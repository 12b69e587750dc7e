"""The table of descriptors declares the passes as they are, and a new entry shows everywhere."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

import trabecula as tb
from trabecula.engine.lazy_volume import as_slabs
from trabecula.measure import describe, describe_physics, describe_slabs, registry
from trabecula.measure.describe import SIZE_KEYS, describe_curves, describe_numbers
from trabecula.measure.each_phase import measure_numbers
from trabecula.measure.registry import DESCRIPTORS, Descriptor
from trabecula.measure.streaming.numbers import SOLID_NUMBERS
from trabecula.report import page, verify

CERTIFICATE_ONLY = ("trabecular_number",)
"""A number of `morphometry`, which the certificate judges by itself."""


@pytest.fixture(scope="module")
def foam() -> tb.Image:
    return tb.Image(smooth(0, (24, 24, 24)) > 0, "labels", spacing=2.0, unit="um")


def smooth(seed: int, shape: tuple[int, ...]) -> np.ndarray:
    noise = np.random.default_rng(seed).standard_normal(shape)
    for axis in range(len(shape)):
        noise = noise + np.roll(noise, 1, axis) + np.roll(noise, 2, axis)
    return noise - np.median(noise)


def names(source: str) -> set[str]:
    return {one.name for one in registry.select(source=source)} - {*CERTIFICATE_ONLY}


def test_passes_measure_what_the_table_declares(foam):
    numbers = describe_numbers(foam)
    assert {*SOLID_NUMBERS, "fractions"} == names(registry.PLANES) <= set(numbers)
    assert set(SIZE_KEYS) == names(registry.SIZES) <= set(numbers)
    assert names(registry.CURVES) == set(describe_curves(foam, r_max=4)) - {"r_max"}
    assert names(registry.PHYSICS) == set(describe_physics(foam, box=8))
    phases = measure_numbers(foam, level="quick", known={}).phases["void"]
    assert set(phases) == {one.name for one in registry.select(each="phase") if not one.curve}
    grey = describe(tb.Image(np.arange(256, dtype=np.uint8).reshape(16, 16), "grey"))
    assert names(registry.GREYS) <= set(grey)


def test_functions_agree_with_the_passes(foam):
    whole = describe(foam)
    for one in DESCRIPTORS.values():
        if (
            whole.get(one.name) is not None
            and one.group in ("amount", "shape", "connectivity")
            and not one.by_axis
        ):
            assert whole[one.name] == pytest.approx(one.measure(foam)), one.name


def test_levels_and_streams_are_as_declared(foam):
    for level in registry.LEVELS[:2]:
        found, slabs = describe(foam, level=level), describe_slabs(as_slabs(foam), level=level)
        for one in registry.select(kind="labels"):
            if one.name in found and one.source != registry.PHASES:
                assert (found[one.name] is not None) == one.is_measured(level), one.name
                assert (slabs[one.name] is not None) == (one.streams and one.is_measured(level))


def test_units_are_words():
    words = {one.unit for one in DESCRIPTORS.values()}
    assert words == {"", "length", "length^2", "1 / length", "1 / length^2", "1 / length^3"}


def height(image: tb.Image, *, phase: str = "solid") -> float:
    """Return the mean height of a phase: a toy."""
    inside = image.values == (image.phases.index(phase) if phase != "solid" else 1)
    return float(np.nonzero(inside)[0].mean() * image.spacing[0])


def reach(image: tb.Image) -> dict[str, float]:
    """Return the mean place of the solid along every axis: a toy."""
    places = np.nonzero(image.values == 1)
    return {axis: float(along.mean()) for axis, along in zip("zyx", places, strict=True)}


def decay(image: tb.Image, *, r_max: int) -> np.ndarray:
    """Return a toy curve."""
    return np.arange(r_max + 1) * height(image)


TOYS = (
    Descriptor(
        name="toy_height", title="Toy height", group="shape", measure=height, power=1,
        level="default", each=("phase",), meaning="Mean height of the solid.",
    ),
    Descriptor(
        name="toy_reach", title="Toy reach", group="shape", measure=reach, power=1, by_axis=True,
    ),
    Descriptor(name="toy_decay", title="Toy decay", measure=decay, curve=True),
    Descriptor(
        name="toy_distance", title="Toy decay, relative", group="two-point", source=registry.JUDGED,
        rule=registry.DISTANCE, compares="toy_decay", meaning="Relative l2 of the toy decay.",
    ),
    Descriptor(
        name="toy_contrast", title="Toy contrast", group="texture", kinds=registry.TEXTURE,
        measure=lambda image: float(np.ptp(image.values)),
    ),
)  # fmt: skip


@pytest.fixture
def toys(monkeypatch):
    for toy in TOYS:
        monkeypatch.setitem(DESCRIPTORS, toy.name, toy)


@pytest.mark.whole
def test_a_new_entry_is_described_and_judged_and_shown_and_documented(foam, toys):
    found = describe(foam)
    assert found["toy_height"] == found["phases"]["solid"]["toy_height"] == height(foam)
    assert found["phases"]["void"]["toy_height"] == height(foam, phase="void")
    assert found["toy_decay"] == decay(foam, r_max=found["r_max"]).tolist()
    assert describe(foam, level="quick")["toy_height"] is None
    slabs = describe_slabs(as_slabs(foam))
    assert set(slabs) == set(found) and slabs["toy_height"] is None
    assert any("toy_height, toy_reach, toy_decay" in note for note in slabs["notes"])

    exemplar, image = (tb.Image(smooth(n, (50, 50, 50)) > 0, "labels") for n in (1, 2))
    certificate = verify(exemplar, image, r_max=10)
    metrics = certificate.to_json()["metrics"]
    assert metrics["toy_height"]["value"] == height(image) and metrics["toy_height"]["real_band"]
    assert metrics["toy_height_void"]["pass"] in (True, False)
    assert metrics["toy_distance"]["value"] > 0 and metrics["toy_distance"]["real_band"][0] == 0
    assert json.loads(json.dumps(certificate.to_json(), allow_nan=False))
    assert metrics["toy_reach_x"]["value"] == reach(image)["x"]
    assert metrics["toy_reach"]["value"] == np.mean(list(reach(image).values()))
    assert "toy_height" not in verify(exemplar, image, level="quick").metrics
    html = page([certificate])
    assert "Toy height of void" in html and "<code>toy_distance</code>" in html
    assert "Toy decay</text>" in html and "toy_height" in certificate.to_table()


def test_a_new_entry_of_textures_is_described_and_judged(toys):
    exemplar, image = (
        tb.Image((128 + 10 * smooth(n, (60, 60))).astype(np.uint8), "grey") for n in (1, 2)
    )
    assert describe(image)["toy_contrast"] == np.ptp(image.values)
    assert verify(exemplar, image).metrics["toy_contrast"].real_band


def test_the_documentation_lists_every_descriptor(toys, monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).resolve().parents[2] / "docs"))
    from steps.pages import descriptors_table

    lines = descriptors_table().splitlines()
    for name, one in DESCRIPTORS.items():
        assert sum(f"`{name}`" in line.split("|")[1] for line in lines[2:]) == 1
        assert not one.group or one.meaning or name.startswith("toy"), name
    assert "Mean height of the solid." in "".join(lines)
    for module in [name for name in sys.modules if name.partition(".")[0] == "steps"]:
        monkeypatch.delitem(sys.modules, module)
