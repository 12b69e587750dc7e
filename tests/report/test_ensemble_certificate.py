"""The certificate of an ensemble: real material passes, collapsed and shifted members fail, and
where too little is known nothing is claimed.
"""

import json
import re
from statistics import NormalDist

import numpy as np
import pytest
from scipy import ndimage

import trabecula as tb
from trabecula.core.errors import InputError
from trabecula.measure.copying import pair
from trabecula.report.band import parts
from trabecula.report.dependence import CorrelatedSample
from trabecula.report.ensemble_figures import EnsembleFigures
from trabecula.report.ensemble_tests import LARGE, MEAN, OPEN, PASS, SHAPE, SMALL, compare
from trabecula.report.real_parts import RealParts, expect

WIDTH = 1.2


def material(seed: int, side: int, share: float = 0.3) -> tb.Image:
    """Return a box of an endless thresholded Gaussian field, so that porosity varies."""
    noise = np.random.default_rng(seed).normal(size=(side + 12,) * 3)
    smooth = ndimage.gaussian_filter(noise, WIDTH)[6:-6, 6:-6, 6:-6]
    level = NormalDist().inv_cdf(1 - share) / (2 * np.sqrt(np.pi) * WIDTH) ** 1.5
    return tb.Image((smooth > level).astype(np.uint8), "labels", spacing=2.0, unit="um")


@pytest.fixture(scope="module")
def scan() -> tb.Image:
    return material(0, 72)


@pytest.fixture(scope="module")
def members() -> list[tb.Image]:
    return [material(700 + n, 24) for n in range(16)]


@pytest.fixture(scope="module")
def certificate(scan, members):
    return tb.verify_ensemble(scan, members, level="quick")


def samples(values) -> dict[str, CorrelatedSample]:
    return {name: CorrelatedSample.independent(each) for name, each in values.items()}


def test_other_samples_of_the_material_pass(certificate):
    assert certificate.verdict == "pass" and not certificate.failed
    assert certificate.real["parts"] == 27 and not certificate.real["extrapolated"]
    porosity = certificate.metrics["porosity"]
    low, high = porosity.ratio_interval
    assert low < 1 < high and porosity.mean == pytest.approx(0.7, abs=0.02)
    assert set(porosity.p) == {"mean", "spread", "kolmogorov_smirnov", "mann_whitney"}
    assert certificate.copying.closest > 0.8 and not certificate.copying.faults


@pytest.mark.slow
def test_members_cut_from_the_exemplar_are_called_copies():
    scan, far = material(0, 48), slice(24, 48)
    cut = [scan.values[:24, :24, :24], scan.values[far, far, far]]
    members = [tb.Image(each.copy(), "labels", 2.0, "um") for each in cut]
    members += [material(100 + n, 24) for n in range(4)]
    found = tb.verify_ensemble(scan, members)
    assert {"thickness", "pore_size"} <= set(found.metrics)
    assert found.copying.exemplar == 1.0 and found.passed is False
    assert "Copied from the exemplar" in found.copying.faults[0]
    assert found.copying.among <= found.copying.limit


@pytest.mark.whole
def test_figures_are_those_of_the_measures(scan, members):
    found = tb.verify_ensemble(scan, members, level="quick").metrics
    for name in ("porosity", "specific_surface", "chord_length", "euler_density"):
        values = [getattr(tb.measure, name)(member) for member in members]
        assert found[name].members == pytest.approx(values)
        assert found[name].mean == pytest.approx(np.mean(values))
        assert found[name].deviation == pytest.approx(np.std(values, ddof=1))
    parts = [scan.values[z : z + 24, :24, :24] for z in (0, 24, 48)]
    assert found["porosity"].real[::9] == pytest.approx([1 - part.mean() for part in parts])


@pytest.mark.whole
def test_a_member_repeated_is_a_collapsed_ensemble(scan, members):
    found = tb.verify_ensemble(scan, [members[0]] * 8, level="quick")
    assert found.passed is False and "repeat" in found.copying.faults[0]
    assert found.copying.closest == 0
    wide = [one for name, one in found.metrics.items() if name != "largest_fraction"]
    assert all(one.verdict == SMALL and one.ratio == 0 for one in wide)


def test_members_of_one_porosity_have_too_small_a_spread_of_it(scan, members):
    def even(member):
        """Trade voxels at random until 30 % are solid."""
        values, rng = member.values.copy().ravel(), np.random.default_rng(0)
        excess = int(values.sum()) - round(0.3 * values.size)
        if excess:
            where = np.flatnonzero(values == (excess > 0))
            values[rng.choice(where, abs(excess), replace=False)] ^= 1
        return tb.Image(values.reshape(member.shape), "labels", spacing=2.0, unit="um")

    found = tb.verify_ensemble(scan, [even(member) for member in members], level="quick")
    assert found.metrics["porosity"].verdict == SMALL and found.passed is False
    assert found.copying.closest > 0.8, "no member is another"


@pytest.mark.whole
def test_a_shifted_mean_fails(scan):
    denser = [material(200 + n, 24, share=0.33) for n in range(16)]
    found = tb.verify_ensemble(scan, denser, level="quick")
    porosity = found.metrics["porosity"]
    assert MEAN in porosity.faults and porosity.shift_interval[1] < 0 and found.passed is False
    assert "real standard deviations off" in porosity.reason


def test_shuffled_voxels_have_the_porosity_and_nothing_else(scan, members):
    rng = np.random.default_rng(1)
    shuffled = [
        tb.Image(rng.permuted(each.values.ravel()).reshape(each.shape), "labels", 2.0, "um")
        for each in members
    ]
    found = tb.verify_ensemble(scan, shuffled, level="quick").metrics
    assert MEAN not in found["porosity"].faults
    assert MEAN in found["specific_surface"].faults and MEAN in found["euler_density"].faults


@pytest.mark.whole
def test_members_as_large_as_the_exemplar_are_judged_by_extrapolation(members):
    own = material(1, 48)
    found = tb.verify_ensemble(own, [material(300 + n, 48) for n in range(12)], level="quick")
    assert found.real["extrapolated"] and not found.failed
    porosity = found.metrics["porosity"]
    assert set(porosity.p) == {"mean", "spread"} and porosity.real == ()
    assert porosity.real_mean == pytest.approx(1 - own.values.mean(), abs=0.005)
    low, high = porosity.ratio_interval
    assert low < 1 < high
    assert "largest_fraction" not in found.metrics
    notes = " ".join(found.notes)
    assert "rank tests (Kolmogorov-Smirnov, Mann-Whitney) are not possible" in notes
    assert "predicted from smaller real parts" in found.to_html()
    repeated = tb.verify_ensemble(own, [own] * 6, level="quick")
    assert repeated.metrics["porosity"].verdict == SMALL


@pytest.mark.slow
def test_the_extrapolated_spread_is_that_of_larger_boxes():
    """The deviation predicted from parts half as wide, against that of many boxes."""
    figures = EnsembleFigures("quick", {"one": 2.0})
    for side in (48, 72):
        truth = np.std([material(400 + n, side).values.mean() for n in range(40)], ddof=1)
        found = [RealParts([material(n, 48)], figures, (side,) * 3) for n in range(6)]
        assert all(each.extrapolated for each in found)
        predicted = np.mean([each.expected("porosity").deviation for each in found])
        assert predicted == pytest.approx(truth, rel=0.4)


@pytest.mark.whole
def test_exemplars_as_large_as_members_are_parts_themselves(members):
    found = tb.verify_ensemble(members[:8], members[8:], level="quick")
    assert found.real["parts"] == 8 == pytest.approx(found.real["independent"])
    assert not found.real["extrapolated"] and found.metrics["porosity"].real_deviation == (
        pytest.approx(np.std([member.values.mean() for member in members[:8]], ddof=1))
    )


@pytest.mark.whole
def test_several_exemplars_are_one_distribution_unless_they_contradict_each_other(members):
    scans = [material(500 + n, 48) for n in range(2)]
    both = tb.verify_ensemble(scans, members, level="quick")
    assert both.real["parts"] == 54 and not both.failed
    assert not any("contradict" in note for note in both.notes)
    other = tb.verify_ensemble([scans[0], material(9, 48, share=0.4)], members, level="quick")
    said = next(note for note in other.notes if "contradict" in note)
    assert "porosity" in said
    assert other.real["sets_failed"] > 0, "real parts fail as well"


@pytest.mark.whole
def test_phases_are_figures_of_their_own(members, scan):
    def three(image):
        marked = image.values + (image.values & (np.indices(image.shape)[2] % 2 == 0))
        return tb.Image(marked, "labels", 2.0, "um", ("void", "a", "b"))

    found = tb.verify_ensemble(three(scan), [three(member) for member in members], level="quick")
    assert {"fraction_void", "fraction_a", "fraction_b"} <= set(found.metrics)
    assert found.metrics["fraction_b"].mean == pytest.approx(0.15, abs=0.02)


@pytest.mark.whole
def test_transport_is_judged_at_level_full():
    scan, members = material(3, 36), [material(600 + n, 12) for n in range(4)]
    found = tb.verify_ensemble(scan, members, level="full", box=10).metrics
    solved = [
        np.mean([tb.measure.diffusivity(each, axis=axis, box=10).value for axis in range(3)])
        for each in members
    ]
    assert found["diffusivity"].members == pytest.approx(solved)
    assert "permeability" in found


@pytest.mark.whole
def test_pictures_are_judged_as_volumes_are():
    rng = np.random.default_rng(0)
    scan = (ndimage.gaussian_filter(rng.normal(size=(200, 200)), 2) > 0).astype(np.uint8)
    members = [
        (ndimage.gaussian_filter(rng.normal(size=(60, 60)), 2)[5:-5, 5:-5] > 0).astype(np.uint8)
        for _ in range(12)
    ]
    found = tb.verify_ensemble(scan, members, level="quick")
    assert not found.failed and found.real["parts"] == 49


@pytest.mark.slow
def test_real_material_fails_about_once_in_twenty_ensembles():
    """Figures of normal values, the half of them kin to each other; the others heavy-tailed."""
    rng, failed = np.random.default_rng(6), 0
    for _ in range(200):
        made = {name: rng.normal(size=16) for name in "abc"} | {"e": rng.laplace(size=16)}
        real = {name: rng.normal(size=27) for name in "abc"} | {"e": rng.laplace(size=27)}
        for each in (made, real):
            each["d"] = each["a"] + 0.1 * rng.normal(size=len(each["a"]))
        names = dict(
            zip(
                "abcde",
                ("porosity", "chord_length", "euler_density", "thickness", "pore_size"),
                strict=True,
            )
        )
        found = compare(
            samples({names[k]: v for k, v in made.items()}),
            {
                name: expect(one)
                for name, one in samples({names[k]: v for k, v in real.items()}).items()
            },
        )
        failed += any(one.faults for one in found.values())
    assert 0.01 < failed / 200 < 0.1


@pytest.mark.whole
@pytest.mark.parametrize(
    "members, verdict",
    [
        (lambda rng: rng.normal(size=30), PASS),
        (lambda rng: 0.3 * rng.normal(size=30), SMALL),
        (lambda rng: 3 * rng.normal(size=30), LARGE),
        (lambda rng: rng.normal(size=30) + 1.5, MEAN),
        (lambda rng: rng.choice([-1, 1], 200) + 0.05 * rng.normal(size=200), SHAPE),
        (lambda rng: rng.normal(size=4), OPEN),
    ],
)
def test_verdicts_are_by_what_is_wrong(members, verdict):
    rng = np.random.default_rng(8)
    real = expect(CorrelatedSample.independent(rng.normal(size=120)))
    one = compare(samples({"chord_length": members(rng)}), {"chord_length": real})["chord_length"]
    assert one.verdict == verdict
    assert bool(one.reason) is (verdict != PASS)


def test_a_larger_share_in_one_component_is_no_fault():
    rng = np.random.default_rng(0)
    real = expect(CorrelatedSample.independent(0.9 + 0.01 * rng.normal(size=40)))
    for shift, faults in ((0.05, False), (-0.05, True)):
        made = samples({"largest_fraction": 0.9 + shift + 0.001 * rng.normal(size=20)})
        found = compare(made, {"largest_fraction": real})["largest_fraction"]
        assert bool(found.faults) is faults


def test_one_value_in_members_and_parts_is_a_pass_and_parts_of_one_value_judge_no_spread():
    real = expect(CorrelatedSample.independent([1.0] * 10))
    for values, verdict in (([1.0] * 8, PASS), ([2.0] * 8, MEAN), ([2.0, 3, 4, 5] * 3, LARGE)):
        found = compare(samples({"thickness": values}), {"thickness": real})["thickness"]
        assert found.verdict == verdict and found.ratio is None


def test_json_is_plain_and_holds_every_figure(certificate):
    plain = json.loads(json.dumps(certificate.to_json(), allow_nan=False))["ensemble"]
    assert plain["members"] == 16 and plain["shape"] == [24, 24, 24]
    assert plain["verdict"] == "pass" and set(plain["metrics"]) == set(certificate.metrics)
    porosity = plain["metrics"]["porosity"]
    assert {"mean", "sd", "ratio", "ratio_interval", "p", "verdict", "reason"} <= set(porosity)
    assert len(porosity["values"]) == 16 and len(porosity["real_values"]) == 27
    assert plain["real"]["sets_judged"] == 3


def test_table_and_page_say_the_verdict_and_draw_every_figure(certificate, tmp_path):
    table = certificate.to_table()
    html = certificate.to_html(tmp_path / "page.html")
    assert table.startswith("16 members: PASS") and "PASS" in html.split("<h2>")[0]
    assert repr(certificate).startswith("16 members: PASS")
    assert html.count("<polyline") == 2 * len(certificate.metrics)
    for name in certificate.metrics:
        assert f"\n{name} " in table and f"<code>{name}</code>" in html
    assert not re.search(r"https?:|<script|<link|@import", html)
    assert "16 members: PASS" in certificate._repr_html_()


@pytest.mark.parametrize(
    "change, words",
    [
        (lambda scan, members: (scan, members[:3]), "ensemble of 3 members"),
        (lambda scan, members: (scan, [*members, material(1, 26)]), "26 x 26 x 26"),
        (
            lambda scan, members: (scan, [m.values.astype(float) * 100 for m in members]),
            "grey|whole|labels",
        ),
        (
            lambda scan, members: (
                scan,
                [tb.Image(m.values, "labels", 2.0, "um", ("void", "bone")) for m in members],
            ),
            "phases do not correspond",
        ),
        (
            lambda scan, members: (scan, [tb.Image(m.values, "labels") for m in members]),
            "voxels do not correspond",
        ),
        (lambda scan, members: (material(0, 26), members), "too few real parts.*48 x 48 x 48"),
        (lambda scan, members: ([], members), "needs a scan"),
        (
            lambda scan, members: (tb.Image(scan.values * 1.0, "grey", 2.0, "um"), members),
            "the exemplar is grey",
        ),
    ],
)
def test_what_cannot_be_judged_is_refused_with_advice(scan, members, change, words):
    given, images = change(scan, members)
    with pytest.raises(InputError, match=words):
        tb.verify_ensemble(given, images, level="quick")


@pytest.mark.slow
def test_the_exemplars_tree_is_grown_once_for_all_members(monkeypatch):
    grown, grow = [], pair.exemplar_tree
    monkeypatch.setattr(pair, "exemplar_tree", lambda one, **more: grown.append(1) or grow(one))
    exemplar = material(1, 64)
    members = [material(seed, 24) for seed in range(2, 14)]
    tb.verify_ensemble(exemplar, members, level="quick")
    assert not grown
    with tb.threads(3):
        tb.verify_ensemble(exemplar, members)
    searches = len([*parts(exemplar, share=2)]) // 2 + 4 * 3  # of parts, and among four members
    assert len(grown) == searches + 1
