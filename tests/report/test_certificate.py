"""The certificate: what must pass, what must fail, what cannot be compared, and the words scripts
rely on.
"""

import json
import re

import numpy as np
import pytest
from scipy import stats

import trabecula as tb
from trabecula.measure import covariance_form, describe, floating, two_point
from trabecula.measure.registry import AT_LEAST, AT_MOST
from trabecula.report import verify
from trabecula.report.band import (
    LEAST_PART,
    Sizes,
    distance_limit,
    excess_limit,
    expected_value,
    parts,
    value_band,
)
from trabecula.report.metrics import Metric
from trabecula.report.reference import _passes, search_parts
from trabecula.report.summary_text import sentences
from trabecula.report.verdict import Certificate

DISTANCES = ("porosity_error", "two_point_distance", "two_point_relative", "two_point_covariance")


def field(seed: int, shape=(64, 64, 64), share: float = 0.3) -> np.ndarray:
    """Return a thresholded smooth field: periodic, statistically the same for every seed."""
    noise = np.random.default_rng(seed).standard_normal(shape)
    for axis in range(len(shape)):
        for _ in range(3):
            noise = noise + np.roll(noise, 1, axis) + np.roll(noise, 2, axis)
    return (noise > np.quantile(noise, 1 - share)).astype(np.uint8)


@pytest.fixture(scope="module")
def exemplar() -> tb.Image:
    return tb.Image(field(0), "labels", spacing=10.0, unit="um")


def like(exemplar: tb.Image, values: np.ndarray) -> tb.Image:
    return tb.Image(
        values, "labels", spacing=exemplar.spacing, unit=exemplar.unit, phases=exemplar.phases
    )


@pytest.mark.whole
def test_the_exemplar_itself_has_no_distance_and_is_named_a_copy(exemplar):
    certificate = verify(exemplar, exemplar)
    distances = {
        name: metric.value for name, metric in certificate.metrics.items() if metric.exemplar == 0.0
    }
    assert set(distances) >= {
        *DISTANCES,
        "two_point_covariance_x",
        "lineal_path_distance",
        "component_distance",
    }
    assert all(
        distances[name] == 0 for name in (*DISTANCES, "lineal_path_distance", "component_distance")
    )
    assert certificate.failed == ("coherence",) and certificate.metrics["coherence"].value == 1.0
    assert any("COPIED" in text for text in sentences(certificate))
    assert "Error rates (trabecula bench zoo" in certificate.to_table()
    assert "Error rates (trabecula bench zoo" in certificate.to_html()
    quick = verify(exemplar, exemplar, level="quick")
    assert quick.failed == () and quick.verdict == "not decided", (
        "a copy passes every figure of that level"
    )
    assert any("quick" in reason for reason in quick.undecided)


@pytest.mark.slow
def test_another_sample_passes_what_shuffled_voxels_fail(exemplar):
    other = verify(exemplar, like(exemplar, field(1)))
    shuffled = verify(
        exemplar,
        like(
            exemplar,
            np.random.default_rng(2).permutation(exemplar.values.ravel()).reshape(64, 64, 64),
        ),
    )
    assert other.failed == () and shuffled.passed is False
    # Both volumes are thresholded Gaussian fields, and so is the baseline: no figure can tell them
    # apart.
    assert other.passed is None and any(
        "cannot tell this material from noise" in reason for reason in other.undecided
    )
    assert 'class="verdict pass"' not in other.to_html() and "NOT DECIDED" in other.to_html()
    assert shuffled.metrics["porosity_error"].passed and shuffled.metrics["porosity"].passed
    # Not among them two_point_relative: the parts differ in porosity, which makes its band wide.
    for name in (
        "two_point_covariance",
        "specific_surface",
        "thickness",
        "floating",
        "lineal_path_distance",
    ):
        assert shuffled.metrics[name].passed is False, name


@pytest.mark.whole
def test_distances_are_what_they_say(exemplar):
    image = like(exemplar, field(3, share=0.25))
    certificate = verify(exemplar, image, r_max=20)
    own, other = two_point(exemplar, r_max=20), two_point(image, r_max=20)
    metrics = certificate.metrics
    assert metrics["porosity_error"].value == pytest.approx(0.05 / 0.7, rel=1e-3)
    assert metrics["two_point_distance"].value == pytest.approx(np.linalg.norm((own - other)[1:]))
    assert metrics["two_point_relative"].value == pytest.approx(
        np.linalg.norm((own - other)[1:]) / np.linalg.norm(own[1:])
    )
    form, reference = covariance_form(other), covariance_form(own)
    assert metrics["two_point_covariance"].value == pytest.approx(
        np.linalg.norm(form - reference) / np.linalg.norm(reference)
    )
    numbers = describe(image, r_max=1)
    for name in ("porosity", "thickness", "euler", "components", "percolates", "specific_surface"):
        assert metrics[name].value == numbers[name]


@pytest.mark.whole
def test_anisotropy_that_a_radial_mean_cannot_see_fails_along_an_axis():
    stretched = np.repeat(field(4, (32, 96, 96)), 3, axis=0)
    certificate = verify(stretched, np.moveaxis(stretched, 0, 2).copy(), r_max=15, level="quick")
    assert certificate.metrics["two_point_covariance"].value < 1e-6
    wrong = {
        "two_point_covariance",
        "lineal_path_distance",
        "lineal_path_distance_void",
        "chord_length",
    }
    assert {f"{name}_{axis}" for name in wrong for axis in "zx"} <= set(certificate.failed)
    assert certificate.metrics["two_point_covariance_y"].passed


@pytest.mark.slow
def test_a_gaussian_field_matches_the_two_point_function_of_bone_and_is_called_broken(bone):
    field = tb.method("noise", exact=True).fit(bone).generate(96, seed=1)
    certificate = verify(bone, field)
    assert certificate.groups["two-point"] is True and certificate.groups["amount"] is True
    assert certificate.groups["connectivity"] is False
    said = " ".join(sentences(certificate))
    assert "two-point function" in said.split(".")[0] and "BROKEN" in said
    assert certificate.metrics["coherence"].passed, "noise is no copy"


@pytest.mark.slow
def test_the_baseline_stands_beside_and_fails_where_noise_must(bone):
    certificate = verify(bone, tb.method("texture").fit(tb.crop(bone, 60)).generate(60, seed=0))
    baseline = certificate.baseline
    assert set(baseline) <= set(certificate.metrics)
    assert baseline["two_point_covariance"].passed and baseline["largest_fraction"].passed is False
    assert verify(bone, bone, level="quick").baseline is None


@pytest.mark.parametrize("side", [48, 96, 120, 240])
def test_another_sample_lies_in_the_band_ninety_nine_times_in_a_hundred(side):
    """Take white noise: parts of 48^3 in an exemplar of 96^3, and another sample of it."""
    rng = np.random.default_rng(side)
    sizes = Sizes(48.0**3, 96.0**3, float(side**3))
    inside = close = 0
    for _ in range(1000):
        known = rng.normal(10, 1, 8)
        own, further = known.mean(), rng.normal(10, np.sqrt(sizes.part / sizes.image))
        low, high = value_band(known, own, sizes)
        inside += low <= further <= high
        close += abs(further - own) <= distance_limit(abs(known - own), sizes)
    # The t distribution is exact for the first; distances of one number have heavier tails than
    # normal ones.
    assert 980 <= inside <= 999 and close >= 965
    assert value_band([-1e-12, 0.0, 0.3, 0.1], 0.1, sizes)[0] == 0.0


def test_long_waves_widen_the_band():
    """Draw means that fall as V to the power -0.5: parts share the exemplar's own deviation, and
    show less than their spread.
    """
    rng = np.random.default_rng(5)
    inside = {0.5: 0, 1.0: 0}
    for _ in range(1000):
        whole = rng.normal(0, 8**-0.25)
        deviations = rng.normal(0, 1, 8)
        known = whole + (deviations - deviations.mean()) * np.sqrt((1 - 8**-0.5) / (7 / 8))
        further = rng.normal(0, 8**-0.25)
        for exponent in inside:
            low, high = value_band(known, whole, Sizes(1.0, 8.0, 8.0, exponent=exponent))
            inside[exponent] += low <= further <= high
    assert inside[0.5] >= 965 and inside[1.0] < 930


@pytest.mark.parametrize("count", [4, 8])
def test_bands_are_the_intervals_of_one_more_draw(count):
    """Parts that tile the exemplar, and an image as large as a part: the textbook's interval, mean
    +- t s sqrt(1 + 1/n), with s over n - 1.
    """
    values = np.array([3.0, 5.0, 4.0, 8.0, 6.0, 4.5, 5.5, 7.0])[:count]
    mean, spread = values.mean(), values.std(ddof=1)
    reach = stats.t.ppf(0.995, count - 1) * spread * np.sqrt(1 + 1 / count)
    band = value_band(values, mean, Sizes(1.0, count, 1.0))
    assert band == pytest.approx((max(mean - reach, 0), mean + reach), rel=0.02)
    # Compared with an exemplar without end, of which the parts are independent samples.
    endless = Sizes(1.0, 1e30, 1.0)
    assert distance_limit(values, endless) == pytest.approx(mean + reach, rel=0.02)
    excess = np.abs(values - 2.0)
    wanted = 2 + excess.mean() + reach / spread * excess.std(ddof=1)
    assert excess_limit(values, 2.0, endless) == pytest.approx(wanted, rel=0.02)


@pytest.mark.whole
def test_curves_reach_no_farther_than_the_parts():
    """Parts of a picture are its thirds: what they cannot measure has no band."""
    picture = field(0, (96, 96))
    certificate = verify(picture, field(1, (96, 96)), r_max=50, level="quick")
    lengths = {len(certificate.curves[who]["two_point"]) for who in ("exemplar", "image")}
    assert lengths == {len(part["two_point"]) for part in certificate.curves["parts"]} == {32}


def test_an_axis_that_the_exemplar_leaves_open_is_no_fault():
    """Stripes go through along one axis; another sample of them is held to that one alone."""
    stripes = (np.arange(96) % 8 < 3)[:, None] & np.ones(96, bool)
    metrics = verify(stripes, np.roll(stripes, 3, axis=0), level="quick", r_max=8).metrics
    assert metrics["percolates"].value == {"y": False, "x": True} and metrics["percolates"].passed
    turned = verify(stripes, stripes.T.copy(), level="quick", r_max=8).metrics
    assert turned["percolates"].passed is False


def test_a_small_image_need_not_percolate_where_a_part_of_the_exemplar_does_not():
    rng = np.random.default_rng(1)
    scan = np.zeros((96, 96), np.uint8)
    scan[40:44] = 1  # the only way from side to side
    scan[rng.random(scan.shape) < 0.05] = 1
    other = (rng.random(scan.shape) < 0.1).astype(np.uint8)
    for image, passed in ((other[:64, :64], True), (other, False)):
        metrics = verify(scan, image, level="quick", r_max=8).metrics
        assert metrics["percolates"].exemplar == {"y": False, "x": True}
        assert metrics["percolates"].value == {"y": False, "x": False}
        assert metrics["percolates"].passed is passed


def test_parts_are_searched_in_other_parts():
    boxes = list(parts(tb.Image(field(0, (48, 24, 24)), "labels")))
    shares = [share for share, _ in search_parts(boxes)]
    assert len(shares) == len(boxes) == 2 and max(shares) < 0.5


def test_what_faces_bias_is_extrapolated_to_the_size_of_the_image():
    """Take a figure a + b / side: of parts of 20, an exemplar of 40 and images of any side."""
    for side in (20, 30, 40, 80, 1000):
        expected = expected_value(
            [5 + 3 / 20] * 8, 5 + 3 / 40, Sizes(20.0**3, 40.0**3, float(side**3))
        )
        assert expected == pytest.approx(5 + 3 / side)


@pytest.mark.whole
def test_bands_narrow_as_the_image_grows(exemplar):
    widths = []
    for n in (1, 2):
        image = like(exemplar, np.tile(exemplar.values, (n, n, n)))
        band = verify(exemplar, image, level="quick").metrics["specific_surface"].real_band
        widths.append(band[1] - band[0])
    # Parts are an eighth of the exemplar: sqrt(1/8 + 1/8) and sqrt(1/64 + 1/8) of their spread.
    assert widths[1] / widths[0] == pytest.approx(np.sqrt((1 / 64 + 1 / 8) / (2 / 8)), rel=0.25)


@pytest.mark.whole
def test_bands_hold_the_exemplar_and_know_its_parts(exemplar):
    pieces = list(parts(exemplar))
    assert len(pieces) == 8 and {piece.shape for piece in pieces} == {(32, 32, 32)}
    porosities = [tb.measure.porosity(piece) for piece in pieces]
    metrics = verify(exemplar, exemplar, level="quick").metrics
    low, high = metrics["porosity"].real_band
    width = 2 * 3.5 * np.std(porosities, ddof=1) * 0.5  # without long waves
    assert low < 0.7 < high and 0.98 * width < high - low < 2 * width


@pytest.mark.whole
def test_counts_are_scaled_to_the_volume(exemplar):
    double = like(exemplar, np.concatenate([exemplar.values, field(5)]))
    single, twice = (
        verify(exemplar, image, level="quick").metrics["floating"] for image in (exemplar, double)
    )
    assert single.exemplar == floating(exemplar) and twice.exemplar == pytest.approx(
        2 * floating(exemplar)
    )
    assert single.real_band[1] < twice.real_band[1] < 2 * single.real_band[1], (
        "a larger image scatters less"
    )


@pytest.mark.whole
def test_fewer_loose_parts_are_no_fault_and_are_noted(exemplar):
    speckled = exemplar.values.copy()
    speckled[::4, ::4, ::4] = 1
    whole = tb.finish.connect(like(exemplar, speckled))
    certificate = verify(like(exemplar, speckled), whole, level="quick")
    assert certificate.metrics["floating"].value == 0 and certificate.metrics["floating"].passed
    assert certificate.metrics["largest_fraction"].passed
    assert any("floating parts" in note for note in certificate.notes)
    # One piece is far from many specks by the distance of sizes, and no fault: it is shown without
    # a verdict.
    far = certificate.metrics["component_distance"]
    assert far.value > far.real_band[1] and far.passed is None


@pytest.mark.whole
def test_a_small_exemplar_judges_nothing_and_says_so():
    small = field(6, (2 * LEAST_PART - 1,) * 3)
    certificate = verify(small, field(7, (40, 40, 40)))
    assert certificate.passed is None and all(
        metric.real_band is None for metric in certificate.metrics.values()
    )
    assert (
        any("too small" in reason for reason in certificate.undecided)
        and certificate.verdict == "not decided"
    )
    assert certificate.metrics["porosity_error"].value < 0.01
    long = verify(field(6, (64, 30, 30)), field(7, (40, 40, 40)))
    assert long.metrics["porosity"].real_band is None and any(
        "2 parts" in reason for reason in long.undecided
    )


@pytest.mark.whole
def test_a_bare_margin_is_noted(exemplar):
    margin = exemplar.values.copy()
    margin[0] = 0
    certificate = verify(like(exemplar, margin), exemplar)
    assert any("first plane along z" in note and "crop" in note for note in certificate.notes)


@pytest.mark.slow
def test_several_images_two_dimensions_and_three_phases():
    flat, other = field(8, (96, 96)), field(9, (96, 96))
    certificates = verify(flat, flat, other, names=["itself", "other"])
    assert [certificate.name for certificate in certificates] == ["itself", "other"]
    assert certificates[0].failed == ("coherence",) and set(
        certificates[0].metrics["percolates"].value
    ) == {"y", "x"}
    three = tb.Image(field(8) + field(9), "labels", phases=("void", "active", "binder"))
    metrics = verify(three, three).metrics
    assert (
        metrics["fraction_binder"].value == np.mean(three.values == 2)
        and metrics["fraction_binder"].passed
    )


@pytest.mark.whole
def test_an_image_of_one_phase_fails_and_stays_json(exemplar):
    for value in (0, 1):
        certificate = verify(exemplar, like(exemplar, np.full((40, 40, 40), value, np.uint8)))
        assert certificate.metrics["coherence"].passed is None
        assert certificate.passed is False
        json.dumps(certificate.to_json(), allow_nan=False)


@pytest.mark.whole
def test_the_words_of_the_json(exemplar):
    result = json.loads(json.dumps(verify(exemplar, exemplar).to_json(), allow_nan=False))
    assert set(result) == {
        "metrics",
        "verdict",
        "passed",
        "undecided",
        "groups",
        "baseline",
        "level",
        "notes",
    }
    assert all(
        set(metric) == {"value", "real_band", "pass"} for metric in result["metrics"].values()
    )
    assert set(result["metrics"]) >= {
        *DISTANCES,
        "porosity",
        "components",
        "floating",
        "thickness",
        "pore_size",
        "percolates",
    }


def test_what_does_not_correspond_is_refused(exemplar):
    cases = {
        "2-D": field(1, (64, 64)),
        "phases do not": tb.Image(
            field(1), "labels", spacing=10.0, unit="um", phases=("void", "bone")
        ),
        "voxels do not": tb.Image(field(1), "labels", spacing=10.0, unit="nm"),
        "spacing": tb.Image(field(1), "labels", spacing=(10.0, 10.0, 11.0), unit="um"),
        "segment the one": tb.Image(field(1), "grey", spacing=10.0, unit="um"),
    }
    for message, image in cases.items():
        with pytest.raises(tb.errors.InputError, match=message):
            verify(exemplar, image)
    with pytest.raises(tb.errors.InputError, match="needs an image"):
        verify(exemplar)
    with pytest.raises(tb.errors.InputError, match="nothing to compare"):
        verify(np.ones((50, 50, 50), np.uint8), exemplar)
    with pytest.raises(tb.errors.InputError, match="2 names"):
        verify(exemplar, exemplar, names=["a", "b"])
    with pytest.raises(tb.errors.InputError, match="r_max"):
        verify(exemplar, exemplar, r_max=0)
    with pytest.raises(tb.errors.UnknownNameError, match="full"):
        verify(exemplar, exemplar, level="ful")


@pytest.mark.slow
def test_the_full_level_adds_physics_with_its_own_bands():
    solid = field(12, (48, 48, 48), share=0.4)
    certificate = verify(solid, field(13, (48, 48, 48), share=0.4), level="full", box=16)
    names = {
        "diffusivity",
        "diffusivity_z",
        "conductivity",
        "permeability",
        "permeability_x",
        "stiffness",
    }
    assert names <= set(certificate.metrics)
    assert all(certificate.metrics[name].real_band is not None for name in names)
    assert 0 < certificate.metrics["diffusivity"].value < 0.6
    assert certificate.groups["physics"] is True
    assert all(
        certificate.metrics[name].real_band[1] <= 1
        for name in ("diffusivity", "conductivity", "stiffness")
    )
    assert any("boxes" in note for note in certificate.notes)
    json.dumps(certificate.to_json(), allow_nan=False)
    assert "converged" in certificate.to_html()


@pytest.mark.whole
def test_an_exemplar_smaller_than_its_correlation_is_warned_of():
    wide = np.kron(field(5, (8, 8, 8), share=0.4), np.ones((8, 8, 8), np.uint8))
    assert any("correlated" in reason for reason in verify(wide, wide, level="quick").undecided)
    fine = (np.random.default_rng(0).random((64, 64, 64)) < 0.3).astype(np.uint8)
    assert not any("correlated" in reason for reason in verify(fine, fine, level="quick").undecided)


@pytest.mark.slow
def test_realisations_are_compared_with_each_other(exemplar):
    twins = [like(exemplar, field(3))] * 2
    others = [like(exemplar, field(3)), like(exemplar, field(4))]
    (said, _), (other, _) = ([c.notes for c in verify(exemplar, *pair)] for pair in (twins, others))
    assert any("differ in 0%" in note and "at most 100%" in note for note in said)
    assert any(
        re.search(r"differ in (9\d|10\d)%", note) and re.search(r"at most \d%", note)
        for note in other
    )


@pytest.mark.parametrize("kind", ["grey", "colour"])
def test_textures_are_compared_without_a_threshold(kind):
    rng = np.random.default_rng(1)

    def smooth(axis: int, bright: float) -> tb.Image:
        noise = rng.standard_normal((96, 96))
        for _ in range(12):
            noise = noise + np.roll(noise, 1, axis)
        values = np.clip(128 + bright + 40 * noise / noise.std(), 0, 255).astype(np.uint8)
        return tb.Image(values if kind == "grey" else np.stack([values] * 3, -1), kind)

    exemplar = smooth(0, 0)
    other = verify(exemplar, smooth(0, 0))
    assert other.failed == () and any("segment" in reason for reason in other.undecided)
    assert "histogram_divergence" in verify(exemplar, smooth(0, 60)).failed
    turned = verify(exemplar, smooth(1, 0))
    assert {"orientation_divergence", "autocorrelation_distance"} <= set(turned.failed)
    assert turned.metrics["histogram_divergence"].passed
    json.dumps(turned.to_json(), allow_nan=False)
    assert "Local orientations" in turned.to_html()


def test_one_figure_that_fails_fails_and_open_questions_leave_it_open():
    good, bad, shown = Metric(1.0, (0, 2), True), Metric(3.0, (0, 2), False), Metric(1.0)
    assert Certificate({"porosity": good, "thickness": bad}).passed is False
    assert Certificate({"porosity": good, "thickness": shown}).passed is True
    assert Certificate({"porosity": good}, undecided=("too small",)).passed is None
    assert Certificate({"porosity": bad}, undecided=("too small",)).passed is False
    assert Certificate({"porosity": shown}).passed is None


def test_a_band_has_two_ends_but_for_the_rules_of_one():
    band = (1.0, 2.0)
    inside = {
        rule: [_passes(v, band, rule) for v in (0.5, 1.5, 2.5)] for rule in (AT_LEAST, AT_MOST, "")
    }
    assert inside == {
        AT_LEAST: [False, True, True], AT_MOST: [True, True, False], "": [False, True, False]
    }  # fmt: skip
