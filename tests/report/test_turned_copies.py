"""Copies that were mirrored or turned, and the error rates, in the certificate."""

import json

import numpy as np
import pytest

import trabecula as tb
from trabecula.measure.copying import TurnedCopies
from trabecula.measure.copying.turned import ENOUGH
from trabecula.report import rates
from trabecula.report.descriptors import LabelDescriptors
from trabecula.report.metrics import Metric
from trabecula.report.rates import rates_note
from trabecula.report.reference import Reference, copies_limit, search_copies
from trabecula.report.summary_text import sentences
from trabecula.report.verdict import Certificate


def field(seed: int, side: int = 56) -> tb.Image:
    """Return independent material: a smooth field, cut."""
    noise = np.random.default_rng(seed).standard_normal((side,) * 3)
    for axis in range(3):
        for _ in range(4):
            noise = noise + np.roll(noise, 1, axis) + np.roll(noise, 2, axis)
    return tb.Image((noise > np.quantile(noise, 0.7)).astype(np.uint8), "labels")


def half(exemplar: tb.Image, other: tb.Image, turned: np.ndarray) -> tb.Image:
    middle = len(turned) // 2
    return tb.Image(np.concatenate([turned[:middle], other.values[middle:]]), "labels")


@pytest.fixture(scope="module")
def reference() -> Reference:
    return Reference(field(0), LabelDescriptors(r_max=8, level="quick"), copying=True)


@pytest.mark.whole
@pytest.mark.parametrize("share", ["whole", "half"])
def test_the_certificate_fails_what_was_mirrored_or_turned_and_says_how(reference, share):
    exemplar = reference.exemplar
    turned = np.ascontiguousarray(exemplar.values[:, ::-1].transpose(0, 2, 1))
    image = half(exemplar, field(1), turned) if share == "half" else tb.Image(turned, "labels")
    found = reference.judge(reference.measure(image), search_copies(reference.exemplar, image))
    metric = found["turned_copies"]
    assert metric.passed is False and metric.value > (0.15 if share == "half" else 0.95)
    assert metric.to_json()["symmetry"] == "turned by 90 degrees about z"
    certificate = Certificate({"turned_copies": metric})
    assert "COPIED from the exemplar, turned by 90 degrees about z" in sentences(certificate)[0]
    assert found["coherence"].passed, "which does not see it"


@pytest.mark.whole
def test_independent_material_has_no_turned_copies(reference):
    for seed in (2, 3):
        image = field(seed)
        found = reference.judge(reference.measure(image), search_copies(reference.exemplar, image))
        assert found["turned_copies"].passed and found["turned_copies"].value <= 0.05
        assert "symmetry" not in found["turned_copies"].to_json()


def test_the_limit_is_above_what_parts_have_and_never_below_a_tenth():
    assert copies_limit([0.0, 0.0, 0.0, 0.0], ENOUGH) == 0.1
    assert copies_limit([0.05, 0.2, 0.1, 0.05], ENOUGH) > 0.2
    assert copies_limit([0.9, 1.0], ENOUGH) == 1.0


@pytest.mark.slow
def test_a_member_turned_from_any_of_several_scans_is_found():
    """What another scan does not hold says nothing about it."""
    scans = [field(seed, 64) for seed in (0, 1)]
    members = [field(seed, 40) for seed in range(2, 6)]
    members[0] = tb.Image(scans[0].values[:40, 39::-1, :40].copy(), "labels")
    faults = tb.verify_ensemble(scans, members, r_max=8).copying.faults
    assert any("member 1" in text and "mirrored along y" in text for text in faults)


def test_a_plain_and_a_turned_copy_are_told_in_one_sentence():
    metrics = {
        "coherence": Metric(0.5, (0.0, 0.1), False),
        "turned_copies": Metric(0.4, (0.0, 0.1), False, symmetry="mirrored along z"),
    }
    (found,) = sentences(Certificate(metrics))
    assert "COPIED from the exemplar, partly mirrored along z: coherence" in found
    json.dumps(Certificate(metrics).to_json())
    assert TurnedCopies(0.3, ()).text == "mirrored or turned in several ways"


def test_error_rates_are_told_where_they_were_measured(monkeypatch):
    monkeypatch.setattr(
        rates,
        "MEASURED",
        rates.Rates("default", "bench", 3, (48, 96), (48, 64), 50, 2, 8, 40, 9, 38),
    )
    scan, image = (tb.Image(np.zeros((side,) * 3, np.uint8), "labels") for side in (64, 48))
    (text,) = rates_note(scan, image, "default")
    assert "50 real parts" in text and "80% passed, 4% failed and 16% were not decided" in text
    assert "40 fakes of 9 kinds 95% failed" in text
    large = tb.Image(np.zeros((48, 48, 65), np.uint8), "labels")
    flat = tb.Image(np.zeros((64, 64), np.uint8), "labels")
    for given in ((scan, image, "quick"), (scan, large, "default"), (flat, flat, "default")):
        assert not [*rates_note(*given)]


def test_the_rates_in_the_package_add_up():
    found = rates.MEASURED
    assert found.real >= 60 and found.real_failed + found.real_undecided <= found.real
    assert 0 < found.fakes_failed <= found.fakes
