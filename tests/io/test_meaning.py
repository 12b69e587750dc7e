"""Kinds of image without an argument: colour, labels or grey; and the effect of arguments of
`read`.
"""

import numpy as np
import pytest
from PIL import Image as Picture

import trabecula as tb
from trabecula.core.errors import InputError, UnknownNameError
from trabecula.io import units


def save(tmp_path, array, name="x.npy"):
    np.save(tmp_path / name, array)
    return tmp_path / name


@pytest.mark.parametrize(
    ("array", "kind"),
    [
        (np.arange(8, dtype=np.int16).reshape(2, 4), "labels"),
        (np.arange(9, dtype=np.int16).reshape(3, 3), "grey"),
        (np.eye(3, dtype=bool), "labels"),
        (np.linspace(0, 1, 6).reshape(2, 3), "grey"),
        (np.zeros((4, 5, 3), np.uint8), "labels"),  # three voxels along x are no colour
    ],
)
def test_content_decides(array, kind, tmp_path):
    image = tb.read(save(tmp_path, array))
    assert image.kind == kind and image.shape == array.shape


def test_float_labels_ask(tmp_path):
    path = save(tmp_path, np.array([[0.0, 1.0], [2.0, 1.0]]))
    with pytest.raises(InputError, match="kind='labels' or kind='grey'"):
        tb.read(path)
    assert tb.read(path, kind="labels").values.tolist() == [[0, 1], [2, 1]]
    assert tb.read(path, kind="grey").values.dtype == np.float64
    assert tb.read(save(tmp_path, np.zeros((4, 5, 3), np.uint8), "c.npy"), kind="colour").shape == (
        4,
        5,
    )


@pytest.mark.parametrize(
    ("array", "options", "says"),
    [
        (np.arange(17).reshape(1, 17), {"kind": "labels"}, "more than 16 levels"),
        (np.array([[0.0, np.nan]]), {}, "1 NaN"),
        (np.array([[0.0, np.inf]]), {"kind": "labels"}, "1 NaN or infinite"),
        (np.array([[0.5, 1.0]]), {"kind": "labels"}, "whole numbers"),
        (np.zeros((2, 2, 2, 2), np.uint8), {}, "2 or 3 axes"),
        (np.zeros(4, np.uint8), {}, "2 or 3 axes"),
        (np.zeros((2, 2), complex), {}, "complex"),
        (np.zeros((2, 2), "S3"), {}, "real numbers"),
        (
            np.array([[0, 170]], np.uint8),
            {"phases": ["pore", "active", "binder"]},
            "holds 2 levels 0, 170",
        ),
        (np.array([[0, 9]], np.uint8), {"spacing": (1, 2, 3)}, "3 numbers"),
        (np.array([[0, 9]], np.uint8), {"spacing": -1}, "positive"),
    ],
)
def test_values_that_are_not_what_was_said(array, options, says, tmp_path):
    with pytest.raises(InputError, match=says):
        tb.read(save(tmp_path, array), **options)


def test_names_are_checked(tmp_path):
    path = save(tmp_path, np.eye(3, dtype=np.uint8))
    with pytest.raises(UnknownNameError, match="did you mean 'labels'"):
        tb.read(path, kind="label")
    with pytest.raises(UnknownNameError, match="unknown unit 'parsec'"):
        tb.read(path, unit="parsec")


def test_a_crop_without_a_phase_keeps_the_names_of_the_others(tmp_path):
    path = save(tmp_path, np.array([[0, 2]], np.uint8))
    assert tb.read(path).values.tolist() == [[0, 1]]
    assert tb.read(path, phases=("pore", "active", "binder")).values.tolist() == [[0, 2]]


def test_pictures(tmp_path):
    grey = np.arange(12, dtype=np.uint8).reshape(3, 4) * 20
    rgb = np.stack([grey, grey, grey], -1)
    Picture.fromarray(rgb).save(tmp_path / "same.png")
    assert tb.read(tmp_path / "same.png").kind == "colour"
    np.testing.assert_array_equal(tb.read(tmp_path / "same.png", kind="grey").values, grey)
    rgb[0, 0, 2] = 9
    Picture.fromarray(rgb).save(tmp_path / "real.png")
    with pytest.raises(InputError, match="is in colour"):
        tb.read(tmp_path / "real.png", kind="labels")
    alpha = np.dstack([rgb, np.full((3, 4), 255, np.uint8)])
    Picture.fromarray(alpha).save(tmp_path / "opaque.png")
    np.testing.assert_array_equal(tb.read(tmp_path / "opaque.png").values, rgb)
    alpha[1, 1, 3] = 254
    Picture.fromarray(alpha).save(tmp_path / "clear.png")
    with pytest.raises(InputError, match="1 of 12 pixels are transparent"):
        tb.read(tmp_path / "clear.png")


def test_palettes_and_bits_are_resolved(tmp_path):
    indices = np.array([[0, 1, 2], [2, 1, 0]], np.uint8)
    for name, palette in {
        "grey": [0, 0, 0, 90, 90, 90, 200, 200, 200],
        "colour": [0, 0, 0, 9, 0, 0, 0, 0, 9],
    }.items():
        picture = Picture.new("P", (3, 2))
        picture.putdata(indices.ravel().tolist())
        picture.putpalette(palette)
        picture.save(tmp_path / f"{name}.png")
        picture.save(tmp_path / f"{name}.tif")
    for suffix in (".png", ".tif"):
        image = tb.read(tmp_path / f"grey{suffix}")
        assert image.kind == "labels" and image.recipe.steps[0]["levels"] == [0, 90, 200]
        assert tb.read(tmp_path / f"colour{suffix}").values[0].tolist() == [
            [0, 0, 0],
            [9, 0, 0],
            [0, 0, 9],
        ]
    Picture.fromarray(indices > 0).save(tmp_path / "bits.png")
    assert tb.read(tmp_path / "bits.png").values.tolist() == [[0, 1, 1], [1, 1, 0]]


@pytest.mark.parametrize(
    "spelling", ["um", "µm", "μm", "micron", "Microns", "micrometer", "micrometre", " micrometers "]
)
def test_spellings_of_a_unit(spelling):
    assert units.canonical(spelling) == "um"
    assert units.to_metres(spelling) == 1e-6


def test_units_without_length():
    assert units.canonical("pixels") == "voxel" and units.canonical("furlong") == "furlong"
    assert units.to_metres("millimetre") == 1e-3 and units.to_metres("in") == 0.0254
    assert not units.has_length("pixel")
    for unit in ("voxel", "pixel", "furlong"):
        with pytest.raises(InputError, match="has no length"):
            units.to_metres(unit)


@pytest.mark.whole
def test_real_scans(data, tmp_path):
    bone = tb.read(
        data / "trabecular_bone_a.tif", spacing=0.05, unit="mm", phases=("marrow", "bone")
    )
    assert (bone.kind, bone.shape) == ("labels", (201, 201, 201))
    assert np.mean(bone.values == 0) == pytest.approx(0.8372, abs=5e-5)
    assert bone.recipe.steps[0]["levels"] == [0, 255]
    assert tb.read(data / "trabecular_bone_grey_lhdl.tif").kind == "grey"
    electrode = tb.read(data / "electrode_3phase_a.tif")
    assert len(electrode.phases) == 3 and np.mean(electrode.values == 0) == pytest.approx(
        0.4502, abs=5e-5
    )
    bread = tb.read(data / "bread_baguette2.png")
    assert (bread.kind, bread.shape) == ("colour", (380, 380))
    assert tb.read(data / "tex_gravel.png").kind == "grey"
    again = tb.read(tb.write(bone, tmp_path / "bone.zarr"))
    assert again.recipe == bone.recipe and again.phases == ("marrow", "bone")


@pytest.mark.whole
def test_metaimage_keeps_bars_wherever_its_lines_are_cut(tmp_path):
    """Cut the JSON into lines that stand in bars; a bar of the JSON itself at a cut must stay."""
    values = np.zeros((2, 2, 2), np.uint8)
    for length in range(400):
        recipe = tb.Recipe().then("made", values, note="x" * length + "|")
        tb.write(tb.Image(values, "labels", recipe=recipe), tmp_path / "a.mha")
        assert tb.read(tmp_path / "a.mha").recipe == recipe
