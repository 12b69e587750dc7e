"""What is written is read back: voxels, spacing, unit, kind, phases and recipe."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from io_images import EDGES, GREYS, VOLUMES, grey_ramp, images, same

import trabecula as tb
from trabecula.core.recipe import Recipe
from trabecula.io.formats import suffixes

often = settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@pytest.mark.parametrize("suffix", VOLUMES)
def test_volumes_come_back(suffix, tmp_path):
    @often
    @given(images())
    def comes_back(image):
        path = tb.write(image, tmp_path / f"x{suffix}")
        same(tb.read(path), image)

    comes_back()


@pytest.mark.parametrize(("suffix", "greys"), [(".png", ("uint8", "uint16")), (".bmp", ("uint8",))])
def test_pictures_come_back(suffix, greys, tmp_path):
    @often
    @given(images(ndim=(2,), greys=greys))
    def comes_back(image):
        same(tb.read(tb.write(image, tmp_path / f"x{suffix}")), image)

    comes_back()


@settings(
    max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(image=images(ndim=(3,), greys=("uint8", "uint16")))
def test_slices_come_back(image, tmp_path):
    same(tb.read(tb.write(image, f"{tmp_path}/slices/")), image)


# which say it in our JSON; see test_store
@pytest.mark.parametrize("suffix", sorted({*VOLUMES} - {".npy", ".zarr"}))
@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
def test_without_our_json_the_formats_own_fields_say_the_spacing(
    suffix, dtype, tmp_path, monkeypatch
):
    # What other programs see: spacing and unit in the format's own words, axes in its own order.
    for room in ("tiff", "metaimage", "nrrd", "nifti", "vti"):
        monkeypatch.setattr(f"trabecula.io.{room}.encode", lambda image: '{"somebody": "else"}')
    image = grey_ramp(dtype)
    back = tb.read(tb.write(image, tmp_path / f"x{suffix}"))
    np.testing.assert_array_equal(back.values, image.values)
    assert back.spacing == pytest.approx(image.spacing, rel=1e-6)
    assert back.unit == ("voxel" if suffix == ".vti" else "um")  # a .vti has no word for units
    assert back.recipe.steps[0]["verb"] == "read"


@given(EDGES)
def test_tiff_resolution_keeps_nine_digits(edge):
    from trabecula.io.tiff import _per_unit

    voxels, units = _per_unit(edge)
    assert 0 < voxels < 2**32 and 0 < units < 2**32
    assert units / voxels == pytest.approx(edge, rel=1e-9)


def test_every_suffix_is_tried_here():
    tried = {*VOLUMES, ".png", ".bmp"}
    # spellings of those, and the lossy one
    assert set(suffixes()) - tried == {".tiff", ".raw", ".jpg", ".jpeg"}


def test_jpeg_is_near_and_starts_a_new_recipe(tmp_path):
    ramp = np.tile(np.arange(64, dtype=np.uint8) * 4, (64, 1))
    image = tb.Image(
        ramp, "grey", spacing=(2.0, 3.0), unit="mm", recipe=Recipe().then("made", ramp)
    )
    back = tb.read(tb.write(image, tmp_path / "x.jpg"))
    assert back.kind == "grey" and back.spacing == (2.0, 3.0) and back.unit == "mm"
    assert np.abs(back.values.astype(int) - ramp).max() <= 8
    # the recipe of the exact voxels would be a lie
    assert [step["verb"] for step in back.recipe.steps] == ["read"]
    with pytest.raises(tb.errors.InputError, match="blurs labels"):
        tb.write(np.eye(3, dtype=np.uint8), tmp_path / "y.jpg")


def test_a_raw_scan_starts_a_recipe_that_reads_it_again(tmp_path):
    path = tmp_path / "scan.npy"
    np.save(path, np.array([[0, 7, 7], [255, 0, 7]], np.uint8))
    options = {"spacing": [2.0, 0.5], "unit": "micron", "phases": ["pore", "clay", "grain"]}
    image = tb.read(str(path), **options)
    assert image.values.tolist() == [[0, 1, 1], [2, 0, 1]] and image.unit == "um"
    (step,) = image.recipe.steps
    assert (step["verb"], step["source"], step["levels"], step["options"]) == (
        "read",
        str(path),
        [0, 7, 255],
        options,
    )
    same(tb.read(step["source"], **step["options"]), image)


def test_reading_otherwise_than_the_file_says_is_a_step(tmp_path):
    image = tb.read(tb.write(np.eye(3, dtype=np.uint8), tmp_path / "x.tif"))
    path = tb.write(image, tmp_path / "y.tif")
    assert tb.read(path).recipe == image.recipe
    assert tb.read(path, spacing=1.0).recipe == image.recipe  # the file says the same
    other = tb.read(path, spacing=4.0, unit="nm").recipe
    assert other.steps[:-1] == image.recipe.steps
    assert other.steps[-1]["options"] == {"spacing": 4.0, "unit": "nm"}


@pytest.mark.parametrize("dtype", GREYS)
def test_formats_that_lack_a_type_say_so(dtype, tmp_path):
    image = tb.Image(np.zeros((2, 3)).astype(dtype), "grey")
    if dtype in ("uint8", "uint16"):
        assert tb.write(image, tmp_path / "x.png").exists()
        return
    with pytest.raises(tb.errors.InputError, match=f"PNG cannot hold {dtype}"):
        tb.write(image, tmp_path / "x.png")
    assert not list(tmp_path.iterdir())


@settings(max_examples=20)
@given(st.permutations(range(1, 12)))
def test_natural_order_of_slices(order):
    import tempfile
    from pathlib import Path

    from PIL import Image as Picture

    with tempfile.TemporaryDirectory() as name:
        for z in order:
            Picture.fromarray(np.full((2, 3), z, np.uint8)).save(Path(name) / f"s{z}.png")
        assert tb.read(name, kind="grey").values[:, 0, 0].tolist() == list(range(1, 12))


def test_a_spacing_that_is_given_wins_over_the_files(tmp_path):
    image = tb.Image(np.eye(8, dtype=np.uint8), "labels", 2.0, "um")
    for name in ("a.tif", "a.npy"):
        read = tb.read(tb.write(image, tmp_path / name), spacing=3.0, unit="mm")
        assert (read.spacing, read.unit) == ((3.0, 3.0), "mm")
