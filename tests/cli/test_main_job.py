"""The main job as a user types it: one scan in; material, figures, a part, surfaces, a still and
the same again out.
"""

import json
import zipfile
from types import SimpleNamespace

import numpy as np
import pytest
import zarr

import trabecula as tb
from commands import SMALL, refused, trabecula
from trabecula.core.recipe import digest
from trabecula.exemplar import samples
from trabecula.exemplar.segment import otsu

SHAPE = (32, 30, 34)


@pytest.fixture(scope="module")
def job(tmp_path_factory):
    """Run every command of the main job on the real sample, and keep what each printed."""
    folder = tmp_path_factory.mktemp("job")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        source = ("sample:bone", "--crop", 48)
        printed = SimpleNamespace(
            generate=trabecula(
                "generate", *source, "--shape", *SHAPE, "--seed", 7, "--out", "bone.zarr", *SMALL
            ),
            verify=trabecula("verify", "sample:bone", "bone.zarr", "--json", "--crop", 48),
            finish=trabecula("finish", "bone.zarr", "--connect", "--out", "part.zarr"),
            export={
                suffix: trabecula("export", "part.zarr", "--out", f"part{suffix}")
                for suffix in (".stl", ".3mf", ".ply", ".obj", ".mhd")
            },
            render=trabecula("render", "part.zarr", "--out", "part.png", "--size", 96, 64),
            rerun=trabecula("rerun", "bone.zarr"),
        )
    return SimpleNamespace(folder=folder, **vars(printed))


def test_generate_makes_what_was_asked_for(job):
    image = tb.read(job.folder / "bone.zarr")
    assert image.shape == SHAPE and image.phases == ("void", "solid")
    assert image.spacing == (40.0, 40.0, 40.0) and image.unit == "um"
    exemplar = tb.crop(tb.sample("bone"), 48)
    assert image.values.mean() == pytest.approx(exemplar.values.mean(), abs=2e-3)
    assert repr(image) in job.generate.out and job.generate.sha256 == digest(image.values)


def test_the_recipe_travels_in_every_file(job):
    made = tb.read(job.folder / "bone.zarr").recipe
    (step,) = made.steps
    assert step["verb"] == "generate" and step["method"] == "texture"
    assert step["settings"]["first_rounds"] == 2 and step["settings"]["rounds"] == [1]
    assert step["request"] == {"shape": list(SHAPE), "seed": 7, "periodic": [False] * 3}
    assert [inner["verb"] for inner in step["exemplars"][0]] == ["sample", "crop"]
    assert set(step["versions"]) == {"trabecula", "numpy", "python"}
    for name in ("part.zarr", "part.mhd"):
        assert [step["verb"] for step in tb.read(job.folder / name).recipe.steps] == [
            "generate",
            "finish",
        ]
    assert tb.read(job.folder / "part.zarr").recipe.steps[0] == step
    assert [step["verb"] for step in tb.read(job.folder / "part.png").recipe.steps] == [
        "generate",
        "finish",
        "render",
    ]


def test_verify_prints_the_certificate(job):
    certificate = json.loads(job.verify.out)
    metrics = certificate["metrics"]
    assert {
        *("porosity_error", "two_point_distance", "two_point_relative", "two_point_covariance"),
        *(
            "porosity",
            "specific_surface",
            "euler",
            "mean_curvature",
            "components",
            "floating",
            "largest_fraction",
        ),
        *("percolates", "chord_length", "pore_size", "thickness"),
    } <= set(metrics)
    for name, metric in metrics.items():
        assert set(metric) == {"value", "real_band", "pass"}, name
        if metric["real_band"] is not None:
            low, high = metric["real_band"]
            assert low <= high
        assert metric["pass"] in (True, False, None)
    material = tb.read(job.folder / "bone.zarr")
    exemplar = tb.crop(tb.sample("bone"), 48)
    assert metrics["porosity"]["value"] == pytest.approx((material.values == 0).mean())
    own = (exemplar.values == 0).mean()
    assert metrics["porosity_error"]["value"] == pytest.approx(
        abs((material.values == 0).mean() - own) / own
    )
    assert metrics["porosity"]["real_band"][0] <= own <= metrics["porosity"]["real_band"][1]
    assert set(metrics["percolates"]["value"]) == {"z", "y", "x"}


def test_finish_leaves_one_piece(job):
    ndimage = pytest.importorskip("scipy.ndimage")
    before, after = (tb.read(job.folder / name) for name in ("bone.zarr", "part.zarr"))
    assert ndimage.label(after.values)[1] == 1
    pieces = ndimage.label(before.values)[0]
    body = pieces == 1 + np.bincount(pieces.ravel())[1:].argmax()
    assert (after.values[body] == 1).all()
    for word in ("joins", "added", "removed_parts", "removed"):
        assert word in job.finish.out


@pytest.mark.parametrize("suffix", [".stl", ".ply", ".obj"])
def test_surfaces_are_closed_and_in_their_unit(job, suffix):
    trimesh = pytest.importorskip("trimesh")
    surface = trimesh.load_mesh(job.folder / f"part{suffix}")
    surface.merge_vertices()
    part = tb.read(job.folder / "part.zarr")
    edge = 0.04 if suffix == ".stl" else 40.0  # STL is in millimetres
    assert surface.is_watertight
    assert surface.volume == pytest.approx(part.values.sum() * edge**3, rel=0.15)
    np.testing.assert_allclose(surface.bounds[1], np.array(SHAPE[::-1]) * edge, atol=edge)
    assert "watertight        True" in job.export[suffix].out


def test_the_print_file_declares_its_unit(job):
    with zipfile.ZipFile(job.folder / "part.3mf") as archive:
        model = next(archive.read(name) for name in archive.namelist() if name.endswith(".model"))
    assert b'unit="millimeter"' in model or b'unit="micron"' in model
    assert "watertight        True" in job.export[".3mf"].out


def test_voxels_are_exported_as_they_are(job):
    np.testing.assert_array_equal(
        tb.read(job.folder / "part.mhd").values, tb.read(job.folder / "part.zarr").values
    )


def test_the_still_shows_something(job):
    still = tb.read(job.folder / "part.png")
    assert still.kind == "colour" and still.shape == (64, 96)
    assert len(np.unique(still.values.reshape(-1, 3), axis=0)) > 100


def test_rerun_makes_the_same_voxels(job):
    assert job.rerun.sha256 == job.generate.sha256
    assert "bone.zarr: the same voxels" in job.rerun.out


def test_nothing_else_is_left_behind(job):
    assert {path.name for path in job.folder.iterdir()} == {
        *(
            "bone.zarr",
            "part.zarr",
            "part.stl",
            "part.3mf",
            "part.ply",
            "part.obj",
            "part.png",
            "part.mhd",
            "part.raw",
        )
    }


@pytest.fixture
def place(tmp_path, monkeypatch, bone):
    """Make a working folder, and a sample that costs nothing."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("trabecula.exemplar.samples.sample", lambda name: bone)
    np.save("scan.npy", tb.crop(bone, 28).values)
    return tmp_path


def generate(exemplar, *words, out="made.zarr"):
    """Make a small volume; its image and what was printed."""
    words = words if "--shape" in words else (*words, "--shape", 16)
    output = trabecula("generate", exemplar, *words, *SMALL, "--out", out)
    return tb.read(out), output


def exemplar_steps(image):
    return {step["verb"]: step for step in image.recipe.steps[0]["exemplars"][0]}


@pytest.fixture
def grey(place, bone):
    """Make a noisy grey scan of the sample."""
    noise = np.random.default_rng(0).normal(0, 12, (28,) * 3)
    values = np.clip(np.rint(60 + 110.0 * tb.crop(bone, 28).values + noise), 0, 255).astype(
        np.uint8
    )
    np.save("grey.npy", values)
    return values


@pytest.mark.whole
def test_a_grey_scan_is_segmented_by_the_threshold_that_is_found(grey):
    image, output = generate("grey.npy")
    (found,) = otsu(grey)
    step = exemplar_steps(image)["segment"]
    assert 100 < found < 130
    assert step["threshold"] == found and step["found_by"] == "otsu"
    assert output.lines == [
        f"trabecula: grey.npy is grey: threshold {found} found (--threshold chooses another)"
    ]
    assert image.values.mean() == pytest.approx((grey > found).mean(), abs=5e-3)
    assert trabecula("rerun", "made.zarr").sha256 == output.sha256


@pytest.mark.whole
def test_a_threshold_that_is_given_is_used_and_recorded(grey):
    image, output = generate("grey.npy", "--threshold", 150, "--phases", "marrow", "bone")
    step = exemplar_steps(image)["segment"]
    assert step["threshold"] == 150 and step["found_by"] == "given" and output.lines == []
    assert image.phases == ("marrow", "bone")
    assert image.values.mean() == pytest.approx((grey > 150).mean(), abs=5e-3)
    pair, _ = generate("grey.npy", "--threshold", "90,150", out="pair.zarr")
    assert exemplar_steps(pair)["segment"]["threshold"] == [90, 150]


@pytest.mark.whole
def test_the_two_thresholds_are_found_and_recorded(grey):
    image, output = generate("grey.npy", "--threshold", "dual")
    step = exemplar_steps(image)["segment"]
    assert step["threshold"] == list(otsu(grey, classes=3)) and step["found_by"] == "dual"
    assert trabecula("rerun", "made.zarr").sha256 == output.sha256


@pytest.fixture
def electrode(place, bone):
    """Make three phases: solid, a coat on one side of it, pore."""
    solid = tb.crop(bone, 28).values == 1
    values = np.where(
        solid, 1, np.where(np.roll(solid, 2, axis=2) | np.roll(solid, 1, axis=2), 2, 0)
    ).astype(np.uint8)
    tb.write(
        tb.Image(values, "labels", (3, 2, 1), "um", ("void", "carbon", "binder")), "electrode.tif"
    )
    return values


@pytest.mark.whole
def test_three_phases_are_kept(electrode):
    image, output = generate("electrode.tif", "--shape", 28)
    assert image.phases == ("void", "carbon", "binder")
    share, expected = (
        np.bincount(values.ravel(), minlength=3) / values.size
        for values in (image.values, electrode)
    )
    np.testing.assert_allclose(share, expected, atol=0.04)
    assert trabecula("rerun", "made.zarr").sha256 == output.sha256
    volumes = {}
    for phase in ("carbon", "binder"):
        printed = trabecula("export", "made.zarr", "--phase", phase, "--out", f"{phase}.stl").out
        volumes[phase] = float(
            next(line.split()[1] for line in printed.splitlines() if line.startswith("volume"))
        )
    for label, phase in ((1, "carbon"), (2, "binder")):
        assert volumes[phase] == pytest.approx((image.values == label).sum() * 6, rel=0.25)


@pytest.mark.whole
def test_anisotropic_spacing_is_kept_in_every_output(electrode, place):
    generate("electrode.tif", "--shape", 16, 18, 20)
    for name in ("made.tif", "made.npy", "made.mhd", "made.nrrd", "made.nii.gz", "made.vti"):
        trabecula("export", "made.zarr", "--out", name)
        image = tb.read(name)
        np.testing.assert_allclose(image.spacing, (3, 2, 1), rtol=1e-6)
        assert (image.unit, image.phases) == ("um", ("void", "carbon", "binder")), name
    printed = trabecula("export", "made.zarr", "--out", "made.ply").out
    assert "((0.0, 0.0, 0.0), (20.0, 36.0, 48.0))" in printed  # x y z
    assert json.loads(trabecula("measure", "made.zarr", "--json").out)["spacing"] == [3, 2, 1]


@pytest.mark.whole
def test_spacing_can_be_given(place):
    image, output = generate("scan.npy", "--spacing", 3, 2, 1, "--unit", "micron")
    assert image.spacing == (3.0, 2.0, 1.0) and image.unit == "um"
    assert exemplar_steps(image)["read"]["options"] == {"spacing": [3, 2, 1], "unit": "micron"}
    assert trabecula("rerun", "made.zarr").sha256 == output.sha256


@pytest.mark.whole
@pytest.mark.parametrize("shape", [(16, 18, 40), (40, 16, 18), (16, 40, 18), (3, 5, 40)])
def test_an_exemplar_smaller_than_the_output_in_one_axis_only(place, shape):
    image, _ = generate("scan.npy", "--shape", *shape)
    assert image.shape == shape
    assert 0.02 < image.values.mean() < 0.6


@pytest.mark.whole
def test_seed_and_threads(place):
    first = json.loads(generate("scan.npy", "--seed", 3, "--threads", 1, "--json")[1].out)
    again = json.loads(
        generate("scan.npy", "--seed", 3, "--threads", 2, "--json", out="again.zarr")[1].out
    )
    other = json.loads(generate("scan.npy", "--seed", 4, "--json", out="other.zarr")[1].out)
    assert first["sha256"] == again["sha256"] != other["sha256"]
    assert first["shape"] == [16, 16, 16] and first["out"] == "made.zarr"
    assert (
        first["recipe"][0]["sha256"] == first["sha256"]
        and first["recipe"][0]["request"]["seed"] == 3
    )


def test_python_makes_what_the_command_makes(place):
    image, _ = generate("scan.npy", "--seed", 3)
    model = tb.method("texture", neighbourhood=4, first_rounds=2, rounds=(1,)).fit(
        tb.read("scan.npy")
    )
    np.testing.assert_array_equal(model.generate(16, seed=3).values, image.values)


@pytest.mark.whole
def test_plan_tells_and_makes_nothing(place):
    before = set(place.iterdir())
    words = ("plan", "scan.npy", "--shape", 100, "--memory", 1, *SMALL)
    plan = json.loads(trabecula(*words, "--json").out)
    assert set(plan) == {"memory", "disk", "scratch", "seconds", "peak", "learning", "available"}
    assert plan["peak"] == max(sum(plan["memory"].values()), plan["learning"]["peak"]) > 100**3
    assert plan["available"] > 0
    larger = json.loads(trabecula("plan", "scan.npy", "--shape", 200, *SMALL, "--json").out)
    assert 200**3 - 100**3 < larger["peak"] - plan["peak"] < 8 * plan["peak"]
    assert "peak memory" in trabecula(*words).out
    assert set(place.iterdir()) == before


@pytest.mark.slow
def test_plan_says_nothing_of_the_volumes_that_it_tries(place, monkeypatch):
    monkeypatch.setattr("trabecula.synth.shared.own_figures.off_line", lambda figures: "everything")
    words = ("sample:bone", "--method", "texture", "--shape", 40)
    assert "own spread: everything" in trabecula("generate", *words, "--out", "new.npy").err
    assert "own spread" not in trabecula("plan", *words).err


def test_methods_and_samples_are_listed():
    methods = json.loads(trabecula("methods", "--json").out)
    assert set(methods) == set(tb.methods()) and methods["texture"]["exemplar"] == "3d"
    assert (
        "2017" in methods["texture"]["paper"]
        and methods["texture"]["paper"] in trabecula("methods").out
    )
    listed = json.loads(trabecula("samples", "--json").out)
    assert listed == {
        "samples": tb.samples(),
        "data": tb.datasets(),
        "real_scans": dict(samples.REAL_SCANS),
    }
    text = trabecula("samples").out
    assert "sample:bone" in text and "stand-in" in text and "digitalporousmedia.org" in text


@pytest.mark.whole
def test_measure_prints_every_descriptor(place):
    found = json.loads(trabecula("measure", "sample:bone", "--crop", 28, "--json").out)
    values = np.load("scan.npy")
    assert {
        *(
            "porosity",
            "specific_surface",
            "euler",
            "mean_curvature",
            "components",
            "floating",
            "largest_fraction",
        ),
        *(
            "percolates",
            "two_point",
            "lineal_path",
            "chord_length",
            "pore_size",
            "thickness",
            "anisotropy",
        ),
        *("diffusivity", "permeability", "stiffness"),
    } <= set(found)
    assert found["porosity"] == pytest.approx((values == 0).mean())
    assert found["unit"] == "um" and found["spacing"] == [40, 40, 40]
    for curve in found["two_point"].values():
        assert curve[0] == pytest.approx(values.mean())
    table = trabecula("measure", "scan.npy").out
    assert "porosity" in table and "values (--json prints them)" in table


@pytest.mark.slow
def test_how_much_is_measured_is_chosen(place):
    quick, full = (
        json.loads(trabecula("measure", "sample:bone", "--crop", 28, "--json", *words).out)
        for words in (("--quick",), ("--full", "--box", 20))
    )
    assert set(quick) == set(full) and quick["level"] == "quick" and quick["thickness"] is None
    assert set(full["permeability"]) == {"z", "y", "x"} and np.shape(
        full["stiffness"]["matrix"]
    ) == (6, 6)
    assert (
        full["physics"]["permeability"]["z"]["converged"]
        and full["physics"]["stiffness"]["all"]["halving"] is not None
    )
    verdict = json.loads(trabecula("verify", "sample:bone", "sample:bone", "--quick", "--json").out)
    assert (
        verdict["verdict"] == "not decided"
        and verdict["level"] == "quick"
        and verdict["baseline"] is None
    )
    assert verdict["passed"] is None and "copy" in verdict["undecided"][0]
    assert "not allowed with" in refused("measure", "scan.npy", "--quick", "--full")


@pytest.mark.whole
def test_grey_values_are_compared_as_they_are_where_asked(place):
    noise = np.random.default_rng(0).integers(0, 200, (2, 64, 64)).astype(np.uint8)
    for name, values in zip(("one.png", "two.png"), noise, strict=True):
        tb.write(tb.Image(values, "grey"), name)
    tb.write(tb.Image(noise[0] // 2, "grey"), "dark.png")
    found = json.loads(trabecula("measure", "one.png", "--threshold", "none", "--json").out)
    assert found["level"] == "texture" and len(found["ten_bins"]) == 10
    verdicts = json.loads(
        trabecula(
            *("verify", "one.png", "two.png", "dark.png", "--threshold", "none"),
            *("--json", "--report", "page.html"),
        ).out
    )
    assert not any(metric["pass"] is False for metric in verdicts[0]["metrics"].values())
    assert verdicts[1]["metrics"]["histogram_divergence"]["pass"] is False
    assert "Autocorrelation along x" in (place / "page.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_several_files_are_judged_and_a_page_is_written(place):
    generate("scan.npy", "--seed", 1, out="one.zarr")
    generate("scan.npy", "--seed", 2, out="two.npy")
    printed = trabecula(
        "verify", "scan.npy", "one.zarr", "two.npy", "--json", "--report", "page.html", "--r-max", 5
    )
    first, second = json.loads(printed.out)
    assert set(first["metrics"]) == set(second["metrics"]) and first["metrics"] != second["metrics"]
    html = (place / "page.html").read_text(encoding="utf-8")
    assert "one.zarr" in html and "two.npy" in html and html.count("data:image/png;base64,") >= 3
    assert "porosity_error" in trabecula("verify", "scan.npy", "one.zarr").out


@pytest.mark.whole
def test_an_exemplar_that_moved_is_found_beside_the_file_or_by_its_name(place):
    (place / "scans").mkdir()
    (place / "scan.npy").rename(place / "scans" / "scan.npy")
    _, output = generate("scans/scan.npy", out="scans/made.zarr")
    (place / "scans").rename(place / "elsewhere")
    assert trabecula("rerun", "elsewhere/made.zarr").sha256 == output.sha256
    (place / "elsewhere" / "scan.npy").rename(place / "femur.npy")
    assert "scans/scan.npy, which is not here: give its place with --exemplar" in refused(
        "rerun", "elsewhere/made.zarr"
    )
    assert (
        trabecula("rerun", "elsewhere/made.zarr", "--exemplar", "femur.npy").sha256 == output.sha256
    )


@pytest.mark.whole
def test_another_exemplar_is_noticed(place):
    generate("scan.npy")
    values = np.load("scan.npy")
    values[0, 0, 0] ^= 1
    np.save("scan.npy", values)
    says = refused("rerun", "made.zarr")
    assert "step 'read' (scan.npy) gives other voxels than recorded: the file has changed" in says


@pytest.mark.whole
def test_changed_voxels_are_noticed(place):
    generate("scan.npy")
    array = zarr.open_group("made.zarr", mode="r+")["0"]
    array[0, 0, 0] = 1 - array[0, 0, 0]
    assert "its voxels were changed since" in refused("rerun", "made.zarr")


@pytest.mark.whole
def test_what_no_recipe_made_cannot_be_made_again(place):
    assert "holds no recipe" in refused("rerun", "scan.npy")
    tb.write(
        tb.method("texture", neighbourhood=4, first_rounds=2, rounds=1)
        .fit(np.load("scan.npy"))
        .generate(16),
        "array.zarr",
    )
    assert "starts from an array in memory" in refused("rerun", "array.zarr")
    trabecula("rerun", "array.zarr", "--exemplar", "scan.npy")


@pytest.mark.whole
def test_finish_and_still_can_be_made_again(place):
    generate("scan.npy", "--shape", 24)
    trabecula("finish", "made.zarr", "--connect", "--out", "part.tif")
    trabecula(
        "render",
        "part.tif",
        "--out",
        "part.png",
        "--size",
        64,
        48,
        "--look",
        "foam",
        "--cut",
        "none",
        "--camera",
        10,
        20,
    )
    for name in ("part.tif", "part.png"):
        assert trabecula("rerun", name).sha256 == digest(tb.read(name).values)


@pytest.mark.whole
def test_an_old_target_is_replaced(place):
    tb.write(tb.Image(np.zeros((3, 3, 3), int), "labels"), "made.zarr")
    image, _ = generate("scan.npy")
    assert image.shape == (16, 16, 16)
    assert {path.name for path in place.iterdir()} == {"scan.npy", "made.zarr"}
