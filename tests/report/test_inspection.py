"""What `inspect` says of scans whose truth is known: fields, ramps, lattices, spheres, noise,
pictures.
"""

import json

import numpy as np
import pytest

import trabecula as tb
from trabecula.engine.lazy_volume import as_slabs
from trabecula.errors import InputError
from trabecula.report.inspection import inspect
from trabecula.report.recommend import recommend
from trabecula.report.stationarity import _inflation, find_trends
from trabecula.report.structure import has_bodies, has_round_grains, measure_structure

SIDE = 96
Z, Y, X = np.meshgrid(*[np.arange(SIDE)] * 3, indexing="ij", sparse=True)


def gaussian_field(seed=0, *, shape=SIDE, length=4.0, porosity=0.6, levels=None):
    made = tb.method("noise", covariance="gaussian", length=length, porosity=porosity).fit()
    return made.generate(shape, seed=seed)


def balls(seed=0, *, radius=6, count=140):
    """Separate balls of one size, labels."""
    rng = np.random.default_rng(seed)
    values, placed = np.zeros((SIDE,) * 3, np.uint8), []
    while len(placed) < count:
        centre = rng.uniform(0, SIDE, 3)
        if all(np.linalg.norm(centre - other) > 2 * radius + 2 for other in placed):
            placed.append(centre)
        else:
            count -= rng.random() < 0.01
    for z, y, x in placed:
        values[(Z - z) ** 2 + (Y - y) ** 2 + (X - x) ** 2 <= radius**2] = 1
    return tb.Image(values, "labels")


def lattice(period=16, width=5):
    struts = [(axis % period < width) for axis in (Z, Y, X)]
    return tb.Image(
        ((struts[0] & struts[1]) | (struts[1] & struts[2]) | (struts[0] & struts[2])).astype(
            np.uint8
        ),
        "labels",
    )


def ramp(low=0.2, high=0.6, seed=0):
    noise = (
        np.random.default_rng(seed).random((SIDE // 3,) * 3).repeat(3, 0).repeat(3, 1).repeat(3, 2)
    )
    return tb.Image((noise < low + (high - low) * Z / (SIDE - 1)).astype(np.uint8), "labels")


@pytest.mark.whole
def test_a_stationary_field_has_no_trend_and_no_order():
    for seed in range(3):
        image = gaussian_field(seed)
        found = inspect(image)
        assert found.stationarity.stationary is True and found.structure.period is None
        assert found.recommendation.method == "texture" and found.recommendation.preset is None
        assert found.decidable.parts == 8 and found.decidable.limits == ()
        assert found.phases["solid"].fraction == pytest.approx(0.4, abs=0.05)


@pytest.mark.whole
def test_the_correlation_length_is_that_of_measure():
    image = gaussian_field(1)
    found = measure_structure(image).lengths
    for axis, length in enumerate(found):
        assert length == pytest.approx(tb.measure.correlation_length(image, axis=axis), rel=0.1)
    stretched = tb.Image(image.values[:32].repeat(3, axis=0), "labels")
    assert measure_structure(stretched).lengths[0] == pytest.approx(3 * found[0], rel=0.25)


@pytest.mark.whole
def test_a_ramp_is_found_along_its_axis_alone():
    trends = {
        trend.name: trend
        for trend in inspect(ramp()).stationarity.trends
        if trend.what == "fraction of solid"
    }
    assert [name for name, trend in trends.items() if trend.found] == ["z"]
    assert trends["z"].start == pytest.approx(0.2, abs=0.04) and trends["z"].end == pytest.approx(
        0.6, abs=0.04
    )
    assert "same all over   no: fraction of solid runs from 0." in str(inspect(ramp()))
    assert any("trend itself" in text for text in inspect(ramp()).decidable.limits)
    turned = tb.Image(ramp().values.transpose(1, 2, 0).copy(), "labels")
    assert {trend.name for trend in inspect(turned).stationarity.surest} == {"x"}


def test_a_hollow_is_found_from_centre_to_rim():
    noise = np.random.default_rng(0).random((SIDE // 3,) * 3).repeat(3, 0).repeat(3, 1).repeat(3, 2)
    rim = ((Z - 47.5) ** 2 + (Y - 47.5) ** 2 + (X - 47.5) ** 2) / 47.5**2
    image = tb.Image((noise < 0.2 + 0.1 * rim).astype(np.uint8), "labels")
    trends = {
        trend.name: trend
        for trend in find_trends(image, measure_structure(image).lengths).trends
        if trend.what == "fraction of solid"
    }
    assert [name for name, trend in trends.items() if trend.found] == ["centre to rim"]
    assert trends["centre to rim"].start < trends["centre to rim"].end


@pytest.mark.whole
def test_shading_of_a_grey_scan_is_in_its_own_values():
    values = np.random.default_rng(0).normal(1000, 50, (64, 64, 64)) + 3 * np.arange(64)
    (found,) = [
        trend for trend in inspect(tb.Image(values, "grey")).stationarity.trends if trend.found
    ]
    assert (
        found.name == "x"
        and found.start == pytest.approx(1000, abs=25)
        and found.end == pytest.approx(1190, abs=25)
    )


@pytest.mark.whole
def test_a_lattice_is_regular_and_gets_moved_pieces():
    found = inspect(lattice())
    assert found.structure.period is not None and all(
        step % 16 == 0 for step in found.structure.period
    )
    assert (found.recommendation.method, found.recommendation.preset) == ("texture", "best")
    assert "regular" in found.recommendation.reason
    # which is what the reason promises
    assert tb.method("texture", preset="best").config.novelty == 0


@pytest.mark.whole
def test_noise_in_a_lattice_hides_nothing():
    values = lattice().values * 100.0 + np.random.default_rng(0).normal(100, 40, (SIDE,) * 3)
    found = measure_structure(tb.Image(values, "grey"))
    assert found.period is not None
    assert inspect(tb.Image(values, "grey")).grey.noise == pytest.approx(40, rel=0.15)


@pytest.mark.whole
@pytest.mark.parametrize("name", ["bone", "foam"])
def test_samples_keep_the_default(name):
    found = inspect(tb.sample(name))
    assert found.recommendation.to_json() == {
        **found.recommendation.to_json(),
        "method": "texture",
        "preset": None,
    }
    assert found.recommendation.settings == {} and not found.margins
    assert set(found.origin.values()) == {"the sample"}


@pytest.mark.slow
def test_balls_that_are_cemented_are_round_grains_and_a_random_field_has_none():
    at = np.stack(np.indices((72, 72, 72)), -1)
    draw = np.random.default_rng(2)
    centres, inside = np.full((1, 3), 36.0), np.zeros((72, 72, 72), bool)
    for centre in draw.uniform(0, 72, (3000, 3)):
        if ((centres - centre) ** 2).sum(-1).min() > 10.5**2:
            centres = np.vstack([centres, centre])
            inside |= ((at - centre) ** 2).sum(-1) < 6.8**2
    image = tb.Image(inside.astype(np.uint8), "labels")
    assert has_bodies(image) is None
    assert has_round_grains(image)
    assert recommend(image).method == "packing"
    assert "round grains" in recommend(image).reason
    assert not has_round_grains(gaussian_field(0, porosity=0.5))
    assert not has_round_grains(tb.Image(1 - image.values, "labels"))
    assert not has_round_grains(tb.sample("foam"))


@pytest.mark.whole
def test_balls_are_bodies_and_pores_between_them_are_not():
    image = balls()
    assert has_bodies(image) == "solid"
    assert has_bodies(tb.Image(1 - image.values, "labels")) == "void"
    assert recommend(image).method == "packing"
    assert "solid consists of separate" in recommend(image).reason
    assert has_bodies(gaussian_field(0, porosity=0.9)) is None
    rods = np.zeros((SIDE,) * 3, np.uint8)
    for z in range(4, SIDE, 12):
        for y in range(4, SIDE, 12):
            for x in range(4, SIDE - 30, 32):
                rods[z : z + 4, y : y + 4, x : x + 26] = 1
    assert has_bodies(tb.Image(rods, "labels")) is None


@pytest.mark.whole
def test_three_phases_get_new_material():
    values = gaussian_field(0).values + 2 * (gaussian_field(9, porosity=0.85).values > 0)
    found = inspect(tb.labels(np.minimum(values, 2)))
    assert found.recommendation.preset is None and "3 phases" in found.recommendation.reason
    assert set(found.phases) == {"void", "solid", "phase2"}


def test_pictures():
    labels = tb.Image(gaussian_field(0).values[40], "labels")
    assert recommend(labels).method == "kopf"
    assert recommend(labels).settings == {"process": "auto"}
    assert "--method kopf --set process=auto: " in str(recommend(labels))
    assert not recommend(labels, alone=False).settings  # of several planes
    long = tb.Image(np.repeat(labels.values, 4, axis=1), "labels")
    three = tb.Image((np.kron(labels.values, [[1, 1], [1, 1]]) + 1).astype(np.uint8), "labels")
    three.values[:9, :9] = 0
    for other in (long, three):
        assert recommend(other).method == "kopf" and not recommend(other).settings
    stripes = tb.Image(np.broadcast_to(np.arange(64) // 1 % 2, (64, 64)).astype(np.uint8), "labels")
    assert recommend(stripes).method == "mrf"
    grey = tb.Image(np.random.default_rng(0).integers(0, 256, (64, 64)).astype(np.uint8), "grey")
    assert recommend(grey).method == "chen"
    assert recommend(tb.Image(np.repeat(grey.values[..., None], 3, -1), "colour")).method == "chen"
    found = inspect(labels)
    assert (
        any("no slice shows" in text for text in found.decidable.limits)
        and "in slices" in found.decidable.figures
    )
    assert "pixel" in str(found) and "voxel" not in str(found)


def test_what_is_recommended_can_learn_from_it():
    for image in (
        gaussian_field(0, shape=24),
        tb.Image(gaussian_field(0, shape=48).values[20], "labels"),
    ):
        found = recommend(image)
        tb.method(found.method, preset=found.preset, **found.settings).fit(image)


def test_a_target_field_has_a_method_of_its_own():
    random = gaussian_field(0, shape=32)
    assert recommend(random, graded=["porosity"]).method == "texture"
    assert recommend(random, graded=["porosity", "euler"]).method == "quilt"
    turned = recommend(random, graded=["orientation", "porosity"])
    assert turned.method == "quilt" and turned.settings == {"weights": {"orientation": 2.0}}
    assert "beads" in turned.reason
    assert "scaled" in recommend(random, graded=["size"]).reason
    regular = recommend(lattice(), graded=["volume_fraction"])
    assert regular.method == "quilt" and regular.settings == {"orientations": "all"}
    three = random.values.copy()
    three[:4] = 2
    several = tb.Image(three, "labels")
    assert recommend(several, graded=["porosity"]).method == "quilt"


def test_too_small():
    found = inspect(gaussian_field(0, shape=20, length=2.0))
    assert (
        not found.decidable.anything
        and "20 x 20 x 20 is too small for parts of 24" in found.decidable.limits[0]
    )
    assert "decidable       nothing" in str(found)
    assert recommend(gaussian_field(0, shape=10, length=2.0)).method == "noise"
    tiny = inspect(np.eye(5, dtype=np.uint8))
    assert tiny.recommendation.method is None and "12" in tiny.recommendation.reason
    assert inspect(np.zeros((3, 4, 5), np.uint8)).recommendation.method is None


@pytest.mark.whole
def test_fewer_than_six_correlation_lengths():
    found = inspect(gaussian_field(0, shape=64, length=24.0))
    assert any(text.startswith("what is typical along") for text in found.decidable.limits)
    assert found.stationarity.stationary is None or not found.stationarity.stationary


@pytest.mark.slow
def test_a_grey_scan_says_how_well_it_parts():
    solid = gaussian_field(0).values
    noise = np.random.default_rng(0).normal(0, 1, solid.shape)
    clear = tb.Image((60 + 100 * solid + 10 * noise).clip(0, 255).astype(np.uint8), "grey")
    found = inspect(clear)
    assert found.grey.threshold == pytest.approx(110, abs=8) and found.grey.separability > 0.9
    assert found.grey.bits == 8 and found.phases["solid"].fraction == pytest.approx(
        solid.mean(), abs=0.01
    )
    assert found.recommendation.reason.startswith("segmented at ")
    drowned = tb.Image((128 + 30 * noise).clip(0, 255).astype(np.uint8), "grey")
    # of a normal distribution
    assert inspect(drowned).grey.separability == pytest.approx(2 / np.pi, abs=0.02)
    assert "parts badly" in str(inspect(drowned))
    burnt = tb.Image(np.where(solid > 0, 255, clear.values).astype(np.uint8), "grey")
    assert inspect(burnt).grey.saturated == pytest.approx(solid.mean(), abs=0.02)
    assert "greys are lost there" in str(inspect(burnt))


@pytest.mark.whole
def test_margins_are_left_out_of_the_figures():
    inside = gaussian_field(0).values
    found = inspect(tb.Image(np.pad(inside, 3), "labels"))
    assert (
        found.margins.size == (SIDE,) * 3 and found.phases["void"].fraction == (inside == 0).mean()
    )
    assert found.fractions["void"] > found.phases["void"].fraction
    assert "--crop auto keeps 96 x 96 x 96" in str(found)


@pytest.mark.whole
def test_thin_parts_are_named():
    thin = np.zeros((48, 48, 48), np.uint8)
    thin[::8, ::8] = thin[:, ::8, ::8] = thin[::8, :, ::8] = 1
    assert "thin parts will break" in str(inspect(thin))
    assert "thin parts will break" not in str(inspect(lattice()))


@pytest.mark.parametrize("name", ["labels", "grey", "picture", "colour", "tiny"])
def test_the_table_is_short_and_the_json_plain(name):
    values = gaussian_field(0, shape=40).values
    image = {
        "labels": tb.Image(np.pad(values, 2), "labels", phases=("pore", "grain")),
        "grey": tb.Image(values * 1.5, "grey"),
        "picture": tb.Image(values[3], "labels", 0.5, "um"),
        "colour": tb.Image(np.repeat(values[3][..., None] * np.uint8(200), 3, -1), "colour"),
        "tiny": tb.Image(np.eye(3, dtype=np.uint8), "labels"),
    }[name]
    found = inspect(image)
    assert len(str(found).splitlines()) <= 40 and max(map(len, str(found).splitlines())) <= 110
    plain = found.to_json()
    assert json.loads(json.dumps(plain, allow_nan=False)) == plain
    assert plain["recommendation"]["reason"] and plain["decidable"]["parts"] >= 1


def test_one_value_alone():
    for image in (
        tb.Image(np.zeros((40, 40, 40), np.uint8), "labels"),
        tb.Image(np.full((40, 40), 3.0), "grey"),
    ):
        assert inspect(image).structure.period is None


@pytest.mark.whole
def test_where_each_field_comes_from(tmp_path):
    values = gaussian_field(0, shape=32).values
    image = tb.Image(values, "labels", 19.5, "um", ("marrow", "bone"))
    own = inspect(tb.read(tb.write(image, tmp_path / "own.tif"))).origin
    assert set(own.values()) == {"stated in the file", "metadata of this package"}
    import tifffile

    tifffile.imwrite(tmp_path / "bare.tif", values * np.uint8(255))
    bare = inspect(tb.read(tmp_path / "bare.tif")).origin
    assert bare == {
        "kind": "the file's levels 0, 255",
        "phases": "default names",
        "spacing": "default: nothing states it",
        "unit": "default: nothing states it",
    }
    given = inspect(
        tb.read(tmp_path / "bare.tif", spacing=5, unit="um", kind="labels", phases=("a", "b"))
    ).origin
    assert set(given.values()) == {"given"}
    tifffile.imwrite(
        tmp_path / "imagej.tif",
        values,
        imagej=True,
        resolution=(2.0, 2.0),
        metadata={"spacing": 0.5, "unit": "um", "axes": "ZYX"},
    )
    tags = inspect(tb.read(tmp_path / "imagej.tif")).origin
    assert (
        tags["spacing"] == tags["unit"] == "ImageJ metadata"
        and tags["kind"] != "stated in the file"
    )
    grey = tb.Image(values * 3.5, "grey", 2.0, "mm")
    assert inspect(tb.segment(grey)).origin["kind"].startswith("segmented at 1.75 (found: otsu)")
    assert inspect(grey).origin["spacing"] == "given with the array"


def test_slabs_are_inspected_in_their_middle(monkeypatch):
    from trabecula.report import inspection

    monkeypatch.setattr(inspection, "SLAB_BOX", 48)
    found = inspect(as_slabs(gaussian_field(0)))
    assert found.shape == (48,) * 3 and found.whole == (SIDE,) * 3 and not found.margins
    assert "the centre box of 96 x 96 x 96" in str(
        found
    ) and "margins         not looked at" in str(found)


def test_an_array_whose_meaning_is_open_is_refused():
    with pytest.raises(InputError, match="whose meaning is open"):
        inspect(np.zeros((30, 30)))


@pytest.mark.whole
@pytest.mark.parametrize(
    ("file", "method", "preset"),
    [
        ("trabecular_bone_a.tif", "texture", None),
        ("cement_air_voids.tif", "packing", None),
        ("electrode_3phase_a.tif", "texture", None),
        ("micrograph_ceramics.png", "kopf", None),
        ("micrograph_copolymer.png", "mrf", None),
        ("bread_baguette2.png", "chen", None),
    ],
)
def test_scans(data, file, method, preset):
    found = inspect(tb.read(data / file))
    assert (found.recommendation.method, found.recommendation.preset) == (method, preset)


@pytest.mark.slow
def test_the_cortex_is_a_trend_and_berea_is_even(data):
    cortex = inspect(tb.read(data / "trabecular_bone_cortex_a.tif")).stationarity
    found = [(trend.what, trend.name) for trend in cortex.trends if trend.found]
    assert [name for what, name in found if what == "fraction of solid"] == ["x"]
    assert ("direction", "x") in found  # towards the shell
    assert inspect(tb.read(data / "berea_sandstone_a.tif")).stationarity.stationary is True


def test_neighbours_that_are_alike_count_as_fewer():
    """Correlation rho of neighbouring windows: the variance of a mean grows by (1 + rho) / (1 -
    rho).
    """
    assert _inflation(np.tile([1.0, 1.0, -1.0, -1.0], 2)) == pytest.approx(
        (1 + 1 / 7) / (1 - 1 / 7)
    )
    assert _inflation(np.tile([1.0, -1.0], 4)) == 1
