"""Layers as files: what they hold, how a run resumes, and what is refused."""

import json
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
from PIL import Image as Picture

import trabecula as tb
from trabecula.pipeline.layers import slabs_of_model


def block(side=12, unit="mm", edge=0.1, other=False):
    values = np.zeros((side, side, side), np.uint8)
    values[2:-2, 3:-3, 4:-4] = 1
    values[5:7, 5:7, 5:7] = 2
    values[0, 0, 0] = other
    return tb.Image(values, "labels", (edge,) * 3, unit=unit, phases=("void", "bone", "marrow"))


def test_each_material_has_its_colour(tmp_path):
    image = block()
    stack = tb.write_layers(image, tmp_path / "a", pitch=0.1, materials={"marrow": "soft"})
    files = sorted((tmp_path / "a").glob("*.png"))
    assert len(files) == stack.layers == 12
    about = json.loads((tmp_path / "a" / "layers.json").read_text())
    colours = {tuple(v): k for k, v in about["colours"].items()}
    names = {"background": 0, "bone": 1, "soft": 2}
    for z, file in enumerate(files):
        pixels = np.asarray(Picture.open(file).convert("RGB"))[::-1]
        found = [[names[colours[tuple(pixel)]] for pixel in row] for row in pixels.tolist()]
        assert (np.array(found) == image.values[z]).all()
    voxel = 0.1**3
    assert stack.materials["soft"] == pytest.approx(8 * voxel)
    assert stack.materials["bone"] == pytest.approx((image.values == 1).sum() * voxel)


def test_pixels_need_not_be_cubes_and_keep_their_pitch(tmp_path):
    stack = tb.write_layers(block(), tmp_path / "a", pitch=(0.05, 0.1, 0.2))
    assert (stack.layers, *stack.shape) == (24, 12, 6)
    dots = Picture.open(tmp_path / "a" / "layer_0003.png").info["dpi"]
    assert dots == pytest.approx((25.4 / 0.2, 25.4 / 0.1), rel=1e-3)


def test_masks_are_grey_at_edges_alone(tmp_path):
    y, x = np.indices((30, 30)) - 14.5
    disc = np.repeat((y**2 + x**2 < 100)[None], 3, axis=0).astype(np.uint8)
    image = tb.Image(disc, "labels", (0.1,) * 3, unit="mm")
    tb.write_layers(image, tmp_path / "a", form="dlp", pitch=0.1)
    grey = np.asarray(Picture.open(tmp_path / "a" / "layer_0001.png"))
    assert grey[15, 15] == 255 and grey[0, 0] == 0
    between = (grey > 0) & (grey < 255)
    assert between.any() and between.mean() < 0.15
    assert grey.mean() / 255 == pytest.approx(disc.mean(), rel=0.02)


def test_contours_hold_the_volume_in_both_forms(tmp_path):
    image = block()
    svg = tb.write_layers(image, tmp_path / "a", form="svg")
    cli = tb.write_layers(image, tmp_path / "a.cli", form="cli")
    assert svg.materials["solid"] == pytest.approx(cli.materials["solid"])
    # each of the block's four edges along z loses a corner of an eighth of a pixel
    assert cli.materials["solid"] == pytest.approx((8 * (6 * 4 - 0.5)) * 0.001)
    root = ElementTree.parse(tmp_path / "a" / "layer_0004.svg").getroot()
    assert root.get("width") == "1.2000mm"
    text = (tmp_path / "a.cli").read_text()
    assert text.count("$$LAYER/") == 12 and text.count("$$POLYLINE/1,1,") == 8
    x = [int(value) for value in text.split("$$POLYLINE/")[1].split("\n")[0].split(",")[3::2]]
    assert (min(x), max(x)) == (400, 800)  # micrometres


def test_a_mixture_keeps_its_shares(tmp_path):
    image = tb.Image(np.ones((4, 40, 40), np.uint8), "labels", (0.1,) * 3, unit="mm")
    ramp = np.broadcast_to(np.linspace(0, 1, 5, dtype=np.float32), (2, 3, 5))
    mixtures = {"solid": (ramp, "soft", "hard")}
    stack = tb.write_layers(image, tmp_path / "a", pitch=0.1, mixtures=mixtures)
    hard = stack.materials["hard"] / sum(stack.materials.values())
    assert hard == pytest.approx(0.5, abs=0.02)
    pixels = np.asarray(Picture.open(tmp_path / "a" / "layer_0001.png"))
    left, right = ((pixels[:, side] == 2).mean() for side in (slice(8), slice(-8, None)))
    assert left < 0.1 < 0.9 < right


def test_an_interrupted_run_resumes_and_another_is_refused(tmp_path):
    whole = tmp_path / "a"
    tb.write_layers(block(), whole, pitch=0.1)
    bytes_before = {file.name: file.read_bytes() for file in whole.iterdir()}
    for number in (3, 7):
        (whole / f"layer_{number:04d}.png").unlink()
    assert tb.write_layers(block(), whole, pitch=0.1).written == 2
    assert {file.name: file.read_bytes() for file in whole.iterdir()} == bytes_before
    with pytest.raises(tb.errors.FileError, match="other settings"):
        tb.write_layers(block(), whole, pitch=0.2)
    with pytest.raises(tb.errors.FileError, match="another volume"):
        tb.write_layers(block(other=True), whole, pitch=0.1)
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "mine.txt").write_text("kept")
    with pytest.raises(tb.errors.FileError, match="other files"):
        tb.write_layers(block(), tmp_path / "b")


@pytest.fixture(scope="module")
def model():
    values = tb.crop(tb.sample("bone"), 16).values
    return tb.method("noise", reach=4).fit(tb.Image(values, "labels", (0.027,) * 3, unit="mm"))


def test_other_mixtures_are_other_layers(tmp_path):
    shares = [np.full((2, 2, 2), share, np.float32) for share in (0.2, 0.8)]
    tb.write_layers(block(), tmp_path / "a", mixtures={"bone": (shares[0], "soft", "hard")})
    for mixture in ((shares[1], "soft", "hard"), (shares[0], "hard", "soft")):
        with pytest.raises(tb.errors.FileError, match="other settings"):
            tb.write_layers(block(), tmp_path / "a", mixtures={"bone": mixture})


def test_layers_of_a_model_are_those_of_its_volume(model, tmp_path):
    volume = model.generate((9, 8, 7), seed=5)
    slabs = slabs_of_model(model, (9, 8, 7), seed=5)
    tb.write_layers(volume, tmp_path / "a", pitch=0.027)
    tb.write_layers(slabs, tmp_path / "b", pitch=0.027, only=(4, 6))
    names = sorted(file.name for file in (tmp_path / "b").glob("*.png"))
    assert names == ["layer_0004.png", "layer_0005.png"]
    for name in names:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_the_first_and_the_last_layer_of_300_mm_are_made_alone(model, tmp_path):
    slabs = slabs_of_model(model, (11112, 24, 24), seed=1)
    assert tb.plan_layers(slabs_of_model(model, 11112, seed=1)).shape == (3544, 7088)
    for only in ((0, 1), (11111, 11112)):
        assert tb.write_layers(slabs, tmp_path / "a", only=only).written == 1
    names = sorted(file.name for file in (tmp_path / "a").glob("*.png"))
    assert names == ["layer_00000.png", "layer_11111.png"]


@pytest.mark.whole
def test_a_model_that_makes_no_boxes_is_refused():
    model = tb.method("texture", preset="fast").fit(tb.crop(tb.sample("bone"), 32))
    with pytest.raises(tb.errors.InputError, match="generate the volume"):
        slabs_of_model(model, 40, seed=1)


@pytest.mark.parametrize(
    ("change", "error", "says"),
    [
        ({"pitch": 0.0001}, tb.errors.InputError, "out of range"),
        ({"form": "gcode"}, tb.errors.UnknownNameError, "polyjet"),
        ({"phase": "bonne"}, tb.errors.UnknownNameError, "bone"),
        ({"only": (3, 99)}, tb.errors.InputError, "do not exist"),
        ({"form": "dlp", "materials": {"bone": "a"}}, tb.errors.InputError, "no materials"),
        ({"materials": {"muscle": "a"}}, tb.errors.UnknownNameError, "muscle"),
        ({"mixtures": {"bone": (np.ones((2, 2)), "a", "b")}}, tb.errors.InputError, "z, y, x"),
        ({"mixtures": {"bone": (np.full((2, 2, 2), 3), "a", "b")}}, tb.errors.InputError, "0 to 1"),
        ({"form": "cli"}, tb.errors.InputError, ".cli"),
    ],
)
def test_what_cannot_be_written_is_refused(tmp_path, change, error, says):
    with pytest.raises(error, match=says):
        tb.write_layers(block(), tmp_path / "a", **change)
    assert not (tmp_path / "a").exists()


def test_a_volume_without_a_length_is_refused(tmp_path):
    with pytest.raises(tb.errors.InputError, match="--unit"):
        tb.write_layers(np.ones((4, 4, 4), np.uint8), tmp_path / "a")
