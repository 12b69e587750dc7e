"""Forms, tiles and measured parts as a user types them; and what a finished part is asked."""

import json
import shutil

import numpy as np
import pytest

import trabecula as tb
from commands import SMALL, refused, trabecula
from trabecula.finish import OPERATIONS
from trabecula.pipeline.inputs import load_mask
from trabecula.pipeline.replay import replay


def ball(side):
    grid = np.indices((side,) * 3) - (side - 1) / 2
    return (grid**2).sum(axis=0) < (side / 2) ** 2


@pytest.fixture(scope="module")
def scan_and_ball(tmp_path_factory, bone):
    """A scan of 28 voxels of 40 um, a ball as a surface of 16 voxels across in several units, and
    volumes.
    """
    folder = tmp_path_factory.mktemp("parts")
    scan = tb.crop(bone, 28)
    tb.write(tb.Image(scan.values, "labels", 40, "um"), folder / "scan.zarr")
    tb.write(tb.Image(np.roll(scan.values, 9, axis=2), "labels", 40, "um"), folder / "other.zarr")
    surface = tb.Image(ball(16), "labels", 40, "um")
    for name in ("ball.stl", "ball.ply"):  # in millimetres; in micrometres
        tb.export(surface, folder / name)
    tb.export(tb.Image(ball(16), "labels"), folder / "plain.obj")  # in no unit
    open_box = (folder / "plain.obj").read_text().splitlines()
    (folder / "open.obj").write_text("\n".join(open_box[:-3]), encoding="ascii")
    tb.write(np.pad(ball(18), ((0, 0), (0, 2), (1, 1))), folder / "form.tif")
    tb.write(np.ones((20, 20, 20), np.uint8), folder / "full.npy")
    tb.write(tb.Image(np.arange(8000.0).reshape(20, 20, 20), "grey"), folder / "grey.npy")
    tb.write(tb.Image(scan.values[5], "labels"), folder / "picture.png")
    known = np.zeros((28, 28, 28), np.uint8)
    known[:, :, :14] = 1
    tb.write(known, folder / "known.tif")
    return folder


@pytest.fixture
def place(scan_and_ball, tmp_path, monkeypatch):
    """Work in a copy."""
    shutil.copytree(scan_and_ball, tmp_path / "place")
    monkeypatch.chdir(tmp_path / "place")
    return tmp_path / "place"


def generate(*words, exemplars=("scan.zarr",), out="made.zarr"):
    output = trabecula("generate", *exemplars, *words, *SMALL, "--out", out)
    return tb.read(out), output


def request_of(image):
    return image.recipe.steps[0]["request"]


@pytest.mark.whole
@pytest.mark.parametrize("name", ["ball.stl", "ball.ply", "plain.obj"])
def test_a_surface_is_scaled_to_the_shape(place, name):
    image, output = generate("--mask", name, "--shape", 20, 20, 26)
    mask = load_mask(name, tb.read("scan.zarr"), shape=(20, 20, 26)).values == 1
    assert image.shape == mask.shape and not image.values[~mask].any() and image.values[mask].any()
    assert np.ptp(np.nonzero(mask), axis=1).tolist() == [19, 19, 19]
    assert mask.sum() == pytest.approx(np.pi / 6 * 20**3, rel=0.05)
    assert trabecula("rerun", "made.zarr").sha256 == output.sha256


@pytest.mark.whole
@pytest.mark.parametrize(
    ("name", "scale"), [("ball.stl", 1), ("ball.ply", 1), ("plain.obj", 40), ("ball.stl", 1.5)]
)
def test_a_surface_without_a_shape_keeps_its_size(place, name, scale):
    """Fill the same ball in millimetres, in micrometres, and in numbers that --mask-scale takes for
    the scan's unit.
    """
    image, _ = generate("--mask", name, *(("--mask-scale", scale) if scale != 1 else ()))
    assert image.shape == ((24,) * 3 if scale == 1.5 else (16,) * 3)
    assert image.spacing == (40.0,) * 3


@pytest.mark.whole
def test_a_surface_at_its_own_size_in_a_larger_shape(place):
    image, _ = generate("--mask", "ball.stl", "--mask-scale", 1, "--shape", 24)
    assert image.shape == (24, 24, 24) and not image.values[:4].any() and image.values[6:18].any()


@pytest.mark.whole
def test_a_volume_is_a_mask_as_it_is(place):
    image, output = generate("--mask", "form.tif")
    mask = tb.read("form.tif").values == 1
    assert (
        image.shape == (18, 20, 20) and not image.values[~mask].any() and image.values[mask].any()
    )
    assert [step["verb"] for step in request_of(image)["mask"]] == ["read"]
    assert trabecula("rerun", "made.zarr").sha256 == output.sha256


def test_python_makes_what_the_command_makes(place):
    image, _ = generate("--mask", "plain.obj", "--mask-scale", 40, "--seed", 3)
    exemplar = tb.read("scan.zarr")
    surface = tb.voxelise(tb.read_mesh("ball.ply"), spacing=exemplar.spacing)
    model = tb.method("texture", neighbourhood=4, first_rounds=2, rounds=(1,)).fit(exemplar)
    np.testing.assert_array_equal(model.generate(None, mask=surface, seed=3).values, image.values)


@pytest.mark.whole
def test_a_mask_that_moved_or_changed_is_told(place):
    _, output = generate("--mask", "ball.ply", "--shape", 20)
    (place / "ball.ply").rename(place / "sphere.ply")
    assert "starts from ball.ply, which is not here: give its place with --mask" in refused(
        "rerun", "made.zarr"
    )
    assert trabecula("rerun", "made.zarr", "--mask", "sphere.ply").sha256 == output.sha256
    says = refused("rerun", "made.zarr", "--mask", "ball.stl")
    assert "step 'read_mesh' (ball.ply) gives other voxels than recorded" in says
    generate("--mask", "form.tif", out="form.zarr")
    values = tb.read("form.tif").values.copy()
    values[9, 9, 9] ^= 1
    tb.write(values, "form.tif")
    assert "step 'read' (form.tif) gives other voxels than recorded" in refused(
        "rerun", "form.zarr"
    )


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (lambda mask: mask.clear(), "the recipe is empty"),
        (lambda mask: mask[0].pop("mesh"), "the recipe is damaged: its step 'voxelise'"),
        (lambda mask: mask[0]["mesh"].clear(), "a surface that was in memory"),
        (lambda mask: mask[0]["mesh"][0].update(verb="write_mesh"), "a surface that was in memory"),
        (
            lambda mask: mask[0]["mesh"][1].update(verb="turn"),
            "unknown step of a surface's recipe 'turn'",
        ),
        (lambda mask: mask[0]["mesh"][1].update(factor="x"), "scale='x' should be a number"),
        (lambda mask: mask[0].update(origin=[0, 0]), "three finite numbers"),
        (
            lambda mask: mask[0].update(spacing=[39, 40, 40]),
            "step 'voxelise' .* gives other voxels|does not fit|needs",
        ),
        (lambda mask: mask[0].update(sha256="0"), "step 'voxelise' .* gives other voxels"),
    ],
)
def test_damaged_recipes_of_a_mask_are_told(scan_and_ball, monkeypatch, damage, says):
    monkeypatch.chdir(scan_and_ball)
    exemplar = tb.read("scan.zarr")
    mask = load_mask("ball.ply", exemplar)
    request = tb.Request(None, mask=mask)
    steps = [
        {
            "verb": "generate",
            "method": "texture",
            "settings": {},
            "sha256": "",
            "request": request.to_json(),
        }
    ]
    steps[0]["exemplars"] = [exemplar.recipe.to_json()]
    damage(steps[0]["request"]["mask"])
    with pytest.raises(tb.errors.TrabeculaError, match=says):
        replay(tb.Recipe.from_json(steps), folder=scan_and_ball)


@pytest.mark.whole
def test_a_scan_is_continued_from_its_corner(place):
    image, output = generate("--fixed", "scan.zarr", "--at", 0, 2, 4, "--shape", 28, 32, 40)
    np.testing.assert_array_equal(image.values[:, 2:30, 4:32], tb.read("scan.zarr").values)
    assert image.values[:, :, 33:].any()
    assert [step["verb"] for step in request_of(image)["known"]] == ["block"]
    assert request_of(image)["fixed"][-1]["corner"] == [0, 2, 4]
    assert trabecula("rerun", "made.zarr").sha256 == output.sha256


@pytest.mark.whole
def test_a_hole_is_repaired_where_nothing_is_known(place):
    image, output = generate("--fixed", "other.zarr", "--known", "known.tif")
    assert image.shape == (28, 28, 28)
    np.testing.assert_array_equal(image.values[:, :, :14], tb.read("other.zarr").values[:, :, :14])
    (place / "known.tif").rename(place / "seen.tif")
    assert "give its place with --known" in refused("rerun", "made.zarr")
    assert trabecula("rerun", "made.zarr", "--known", "seen.tif").sha256 == output.sha256


@pytest.mark.whole
def test_a_coarse_scan_and_a_picture_make_a_volume_that_is_made_again(place):
    rock = tb.Image(np.kron(ball(9), np.ones((1, 2, 2), bool)).astype(np.uint8), "labels", 8, "um")
    tb.write(rock, "coarse.tif")
    values = np.kron([[0, 1, 0], [1, 0, 1]], np.ones((9, 9))).astype(np.uint8)
    tb.write(tb.Image(np.roll(values, 3), "labels", 2, "um"), "fine.tif")
    words = ("--method", "kopf", "--set", "first_rounds=2", "--set", "rounds=[2]")
    output = trabecula("generate", "fine.tif", *words, "--coarse", "coarse.tif", "--out", "f.tif")
    made = tb.read("f.tif")
    assert made.shape == (36, 72, 72) and made.spacing == (2, 2, 2)
    share = made.values.reshape(9, 4, 18, 4, 18, 4).mean(axis=(1, 3, 5))
    np.testing.assert_array_equal(share > 0.5, rock.values > 0)
    (place / "coarse.tif").rename(place / "low.tif")
    assert "give its place with --coarse" in refused("rerun", "f.tif")
    assert trabecula("rerun", "f.tif", "--coarse", "low.tif").sha256 == output.sha256


@pytest.mark.whole
def test_a_relative_and_a_picture_make_a_volume_that_is_made_again(place):
    bone = tb.crop(tb.sample("bone"), 40)
    tb.write(tb.Image(bone.values, "labels", bone.spacing, bone.unit, bone.phases), "bone.tif")
    voxel = (bone.spacing[1:], bone.unit, bone.phases)
    tb.write(tb.Image(bone.values[20], "labels", *voxel), "slice.tif")
    words = ("--method", "kopf", "--shape", 24, "--like", "bone.tif", "--out", "made.tif")
    output = trabecula("generate", "slice.tif", *words)
    made = tb.read("made.tif")
    assert made.shape == (24, 24, 24) and made.spacing == bone.spacing
    assert made.recipe.steps[-1]["report"]["like"]["scale"][0] == pytest.approx(1, abs=0.3)
    (place / "bone.tif").rename(place / "other.tif")
    assert "give its place with --like" in refused("rerun", "made.tif")
    assert trabecula("rerun", "made.tif", "--like", "other.tif").sha256 == output.sha256


@pytest.mark.whole
def test_a_grey_scan_is_fixed_at_the_exemplars_threshold(place):
    rng = np.random.default_rng(0)
    solid = tb.read("scan.zarr").values
    grey = np.clip(60 + 110.0 * solid + rng.normal(0, 12, solid.shape), 0, 255).astype(np.uint8)
    np.save("raw.npy", grey)
    np.save("piece.npy", grey[:12, :12, :12])
    words = ("--fixed", "piece.npy", "--at", 4, 4, 4, "--shape", 24)
    image, output = generate(*words, "--threshold", 140, exemplars=("raw.npy",))
    np.testing.assert_array_equal(image.values[4:16, 4:16, 4:16], grey[:12, :12, :12] > 140)
    assert trabecula("rerun", "made.zarr").sha256 == output.sha256


@pytest.mark.whole
@pytest.mark.parametrize(
    ("words", "axes"), [(("--at", 12, 0, 2), "yx"), (("--at", 3, 12, 0, "--view", "xz"), "xz")]
)
def test_a_picture_is_a_slice(place, words, axes):
    """Crop a larger one at the shape's end, and report it."""
    picture = tb.read("scan.zarr").values[5]
    image, output = generate("--fixed", "picture.png", *words, "--shape", 24, 24, 26)
    slab = image.values[12, :, 2:] if axes == "yx" else image.values[3:, 12].T
    assert slab.shape == ((24, 24) if axes == "yx" else (26, 21))
    np.testing.assert_array_equal(slab, picture[: slab.shape[0], : slab.shape[1]])
    assert "pixels lie in the shape" in output.err
    assert image.values[:12].any() and trabecula("rerun", "made.zarr").sha256 == output.sha256


@pytest.mark.whole
@pytest.mark.parametrize(
    ("words", "axes"),
    [
        ((), [True] * 3),
        (("z",), [True, False, False]),
        (("y", "x"), [False, True, True]),
        (("XZ",), [True, False, True]),
    ],
)
def test_periodic_axes(place, words, axes):
    image, output = generate("--shape", 16, "--periodic", *words)
    assert request_of(image)["periodic"] == axes
    assert trabecula("rerun", "made.zarr").sha256 == output.sha256


@pytest.mark.whole
def test_several_exemplars(place):
    image, output = generate("--shape", 16, exemplars=("scan.zarr", "other.zarr"))
    assert [steps[0]["source"] for steps in image.recipe.steps[0]["exemplars"]] == [
        "scan.zarr",
        "other.zarr",
    ]
    assert output.sha256 != generate("--shape", 16, out="one.zarr")[1].sha256
    assert trabecula("rerun", "made.zarr").sha256 == output.sha256
    for name in ("scan.zarr", "other.zarr"):
        (place / name).rename(place / f"moved-{name}")
    moved = ("--exemplar", "moved-scan.zarr", "moved-other.zarr")
    assert trabecula("rerun", "made.zarr", *moved).sha256 == output.sha256


def test_plan_takes_the_same_words(place):
    words = ("--mask", "form.tif", "--fixed", "full.npy", "--at", 0, 0, 0, "--periodic", "x")
    assert "does not lie inside (18, 20, 20)" in refused("plan", "scan.zarr", *words, *SMALL)
    plan = json.loads(
        trabecula("plan", "scan.zarr", "other.zarr", "--mask", "form.tif", "--json", *SMALL).out
    )
    assert plan["peak"] > 18 * 20 * 20


BAD = [
    (("--mask", "missing.stl"), "there is no file missing.stl"),
    (("--mask", "open.obj"), "the mesh is not watertight, so it has no inside"),
    (("--mask", "grey.npy"), "the mask is grey: give labels"),
    (
        ("--mask", "form.tif", "--shape", 20),
        "the mask has shape (18, 20, 20), the request (20, 20, 20)",
    ),
    (("--mask", "form.tif", "--mask-scale", 2), "form.tif is a volume: a scale is for a surface"),
    (("--mask", "ball.stl", "--mask-scale", 0), "scale=0.0 is outside"),
    (("--mask", "ball.stl", "--mask-scale", "nan"), "scale=nan is outside"),
    (("--mask", "ball.stl", "--mask-scale", "big"), "--mask-scale big: give numbers"),
    (
        ("--mask", "ball.stl", "--mask-scale", 2, "--shape", 20),
        "needs 32 x 32 x 32 voxels, the shape is (20, 20, 20)",
    ),
    (("--mask", "ball.stl", "--mask-scale", 1e9), "2**48 voxels"),
    (("--mask", "part.stp", "--shape", 20), "part.stp"),
    (("--shape", 20, "--mask-scale", 2), "--mask-scale without --mask"),
    (("--shape", 40, "--known", "known.tif"), "--known, --at and --view say where --fixed lies"),
    (("--shape", 40, "--at", 0, 0, 0), "--known, --at and --view say where --fixed lies"),
    (("--shape", 40, "--fixed", "scan.zarr"), "needs the place where it is known"),
    (("--fixed", "scan.zarr", "--at", 0, 0, 0), "give --shape"),
    (("--shape", 20, "--fixed", "scan.zarr", "--at", 0, 0, 0), "does not lie inside (20, 20, 20)"),
    (
        ("--shape", 40, "--fixed", "scan.zarr", "--at", 0, 0, "x"),
        "--at 0 0 x: give one whole number or three",
    ),
    (("--shape", 40, "--view", "yx"), "--known, --at and --view say where --fixed lies"),
    (
        ("--shape", 40, "--fixed", "picture.png", "--at", 0, 0, 0, "--view", "yy"),
        "unknown view 'yy'",
    ),
    (
        ("--shape", 40, "--fixed", "picture.png", "--at", 40, 0, 0),
        "does not lie inside (40, 40, 40)",
    ),
    (("--shape", 40, "--target", "porosity"), "write --target porosity=0.25"),
    (
        ("--shape", 40, "--target", "porosty=0.2"),
        "unknown target 'porosty': did you mean 'porosity'",
    ),
    (("--shape", 40, "--target", "porosity=1.2"), "outside 0 .. 1"),
    (("--shape", 40, "--target", "porosity=0.2", "--target", "porosity=0.3"), "given twice"),
    (("--shape", 40, "--target", "porosity=field.npy"), "there is no file field.npy"),
    (
        ("--shape", 40, "--target", "porosity=grey.npy"),
        "has shape (20, 20, 20), the request (40, 40, 40)",
    ),
    (("--shape", 20, "--target", "porosity=grey.npy"), "runs from 0 to 7999"),
    (
        ("--shape", 40, "--target", "surface=0.2"),
        "cannot honour the target surface: it honours porosity",
    ),
    (
        ("--shape", 28, "--fixed", "scan.zarr", "--at", 0, 0, 0),
        "every voxel is known, nothing is left to make",
    ),
    (
        ("--fixed", "scan.zarr", "--known", "full.npy"),
        "known has shape (20, 20, 20), the request (28, 28, 28)",
    ),
    (
        ("--shape", 28, 28, 40, "--periodic", "--fixed", "scan.zarr", "--at", 0, 0, 0),
        "periodic with a fixed border: known voxels lie at both ends of z",
    ),
    (("--shape", 20, "--coarse", "known.tif"), "is no whole multiple of the coarse scan's"),
    (("--coarse", "known.tif"), "add --shape, a whole multiple of 28 28 28"),
    (("--shape", 56, "--coarse", "known.tif", "--periodic"), "coarse beside periodic"),
    (("--shape", 60, "--coarse", "full.npy"), "the coarse scan holds one value only"),
    (("--shape", 56, "--coarse", "known.tif"), "cannot honour coarse"),
    (("--shape", 56, "--like", "known.tif"), "cannot honour like"),
    (("--shape", 20, "--periodic", "w"), "--periodic w: name axes among z, y, x"),
    (("--shape", 20, "--periodic", "z", "other.zarr"), "a file comes before --periodic"),
    ((), "the size of the result is not given: add --shape N"),
]


@pytest.mark.parametrize(
    ("words", "says"), BAD, ids=[" ".join(map(str, words)) or "nothing" for words, _ in BAD]
)
def test_what_cannot_be_is_refused(scan_and_ball, monkeypatch, words, says):
    monkeypatch.chdir(scan_and_ball)
    for verb in (("plan",), ("generate", "--out", "new.zarr")):
        assert says in refused(verb[0], "scan.zarr", *words, *verb[1:], *SMALL)
    assert not (scan_and_ball / "new.zarr").exists()


def test_a_method_that_cannot_honour_a_part_says_so(scan_and_ball, monkeypatch):
    monkeypatch.chdir(scan_and_ball)
    for words, part in (
        (("--mask", "ball.stl"), "mask"),
        (("--fixed", "scan.zarr", "--at", 0, 0, 0, "--shape", 40), "fixed"),
    ):
        if part not in tb.methods()["noise"].honours:
            assert f"method 'noise' cannot honour {part}" in refused(
                "plan", "scan.zarr", *words, "--method", "noise"
            )


def test_finish_does_its_operations_in_one_order(place):
    words = (
        "--fill",
        "--manifold",
        "--floaters",
        "--offset",
        0.25,
        "--thicken",
        90,
        "--smooth",
        45,
        "--connect",
        "--prune",
        "--like",
        "other.zarr",
    )
    printed = trabecula("finish", "scan.zarr", *words, "--out", "part.zarr").out
    part = tb.read("part.zarr")
    done = [step for step in part.recipe.steps if step["verb"] == "finish"]
    # A crust closes what --fill fills: both are refused together. --drain leaves it nothing.
    assert [step["operation"] for step in done] == [
        name for name in OPERATIONS if name not in ("add_crust", "drain")
    ]
    assert [done[2]["settings"]["sigma"], done[3]["settings"]["thickness"]] == [45, 90]
    image = tb.read("scan.zarr")
    other = tb.read("other.zarr")
    for name, settings in (
        ("prune", {"exemplar": other}),
        ("connect", {}),
        ("smooth", {"sigma": 45}),
        ("thicken", {"thickness": 90}),
        ("offset", {"fraction": 0.25}),
        ("remove_floaters", {}),
        ("mend_contacts", {}),
        ("fill_trapped", {}),
    ):
        image = OPERATIONS[name](image, **settings)
    np.testing.assert_array_equal(part.values, image.values)
    for line in (
        "connect.joins",
        "smooth.level",
        "thicken.thin_after",
        "offset.layers",
        "remove_floaters.left",
        "mend_contacts.contacts",
        "fill_trapped.filled ",
    ):
        assert line in printed
    trabecula("rerun", "part.zarr")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--like", "other.zarr", "--connect"), "--like is the exemplar for --prune"),
        (("--smooth", "much"), "--smooth much: give numbers"),
        (("--smooth", 0), "sigma 0 smooths nothing"),
        (("--thicken", -3), "thickness=-3.0 is outside"),
        (("--thicken", "nan"), "thickness=nan is outside"),
        (("--crust", 10), "a crust of 10 is thinner than a voxel of 40 um"),
        (("--crust", 80, "--fill"), "--fill would fill the whole form"),
        (("--prune", "--like", "missing.zarr"), "there is no file missing.zarr"),
    ],
)
def test_finish_refuses(scan_and_ball, monkeypatch, words, says):
    monkeypatch.chdir(scan_and_ball)
    assert says in refused("finish", "scan.zarr", *words, "--out", "new.zarr")
    assert not (scan_and_ball / "new.zarr").exists()


def test_check_prints_a_table_or_json(scan_and_ball, monkeypatch):
    monkeypatch.chdir(scan_and_ball)
    found = tb.print_check(tb.read("scan.zarr"), printer="fdm")
    assert trabecula("check", "scan.zarr", "--printer", "fdm").out == found.to_table() + "\n"
    plain = json.loads(trabecula("check", "scan.zarr", "--printer", "fdm", "--json").out)
    assert plain == found.to_json() and plain["verdict"] == "refuse"
    large = ("--spacing", 1, "--unit", "cm", "--set", "box=[500,500,500]", "--set", "wall=5")
    plain = json.loads(trabecula("check", "scan.zarr", *large, "--json").out)
    assert plain["printer"]["box"] == [500, 500, 500] and plain["checks"]["size"]["extent"] == [
        280,
        280,
        280,
    ]
    assert plain["checks"]["walls"]["verdict"] == "pass"


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("full.npy",), "unit is 'voxel', which is no length"),
        (("scan.zarr", "--printer", "fmd"), "unknown printer 'fmd': did you mean 'fdm'"),
        (("scan.zarr", "--set", "wal=1"), "did you mean 'wall'"),
        (("scan.zarr", "--set", "wall=thin"), "wall='thin' should be a number"),
        (("scan.zarr", "--phase", "bone"), "unknown phase 'bone'"),
        (("missing.zarr",), "there is no file missing.zarr"),
    ],
)
def test_check_refuses(scan_and_ball, monkeypatch, words, says):
    monkeypatch.chdir(scan_and_ball)
    assert says in refused("check", *words)


@pytest.mark.whole
def test_what_a_fixed_scan_takes_from_the_exemplar_is_in_the_recipe(place):
    np.save("plain.npy", tb.read("scan.zarr").values[:10])
    image, output = generate("--fixed", "plain.npy", "--at", 0, 0, 0, "--shape", 24, 28, 28)
    assert image.spacing == (40.0,) * 3
    assert trabecula("rerun", "made.zarr").sha256 == output.sha256
