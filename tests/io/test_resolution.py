"""Where a spacing comes from: flag, OME, ImageJ, resolution tags; and the tags that are habits of
programs.
"""

import numpy as np
import pytest
import tifffile
from PIL import Image as Picture

import trabecula as tb
from trabecula.core.progress import listen

GREY = np.arange(600, dtype=np.uint16).reshape(20, 30)


def read(path, **given):
    """Return the image, what was reported, and the step that read it."""
    said = []
    with listen(lambda line, fraction: said.append(line) if fraction < 0 else None):
        image = tb.read(path, **given)
    return image, said, image.recipe.steps[-1]


def tiff(path, resolution, unit, values=GREY, **more):
    tifffile.imwrite(
        path,
        values,
        resolution=resolution,
        resolutionunit=unit,
        metadata=None,
        photometric="minisblack",
        **more,
    )
    return path


@pytest.mark.parametrize(
    ("resolution", "unit", "spacing", "named", "stated"),
    [
        ((1000, 1000), "INCH", (0.0254, 0.0254), "mm", "1000 dpi"),
        ((2540, 5080), "INCH", (0.005, 0.01), "mm", "5080 x 2540 dpi (y, x)"),
        ((50000, 50000), "CENTIMETER", (2e-5, 2e-5), "cm", "50000 a cm"),
        ((50, 100), "CENTIMETER", (0.01, 0.02), "cm", "100 x 50 a cm (y, x)"),
    ],
)
def test_resolution_tags_are_read_and_named(tmp_path, resolution, unit, spacing, named, stated):
    image, said, step = read(tiff(tmp_path / "x.tif", resolution, unit))
    assert image.spacing == pytest.approx(spacing) and image.unit == named
    assert (
        step["spacing_from"] == f"the TIFF's resolution tags ({stated})" and "ignored" not in step
    )
    edges = " x ".join(f"{edge:.6g}" for edge in spacing)
    assert said == [
        f"{tmp_path / 'x.tif'}: spacing {edges} {named} from the TIFF's resolution tags ({stated})"
    ]


@pytest.mark.parametrize(
    ("resolution", "unit", "why"),
    [
        ((72, 72), "INCH", "say 72 dpi, the 72 dpi of prints and screens"),
        ((96.012, 96.012), "INCH", "the 96 dpi of prints"),
        ((300, 300), "INCH", "the 300 dpi of prints"),
        ((1200, 1200), "INCH", "the 1200 dpi of prints"),
        ((218, 218), "INCH", "a resolution of prints and screens"),
        ((1, 1), "INCH", "which programs write that know no size"),
        ((1, 1), "CENTIMETER", "which programs write that know no size"),
        ((28.35, 28.35), "CENTIMETER", "the 72 dpi of prints"),
        ((28, 28), "CENTIMETER", "the 72 dpi of prints"),
        ((118.11, 118.11), "CENTIMETER", "the 300 dpi of prints"),
        (
            (4_000_000_000, 4_000_000_000),
            "CENTIMETER",
            "voxels of 2.5e-12 m, hardly those of a material",
        ),
    ],
)
def test_habits_of_programs_are_no_voxel_size(tmp_path, resolution, unit, why):
    image, said, step = read(tiff(tmp_path / "x.tif", resolution, unit))
    assert (image.spacing, image.unit) == ((1.0, 1.0), "voxel") and "spacing_from" not in step
    assert why in step["ignored"] and "--spacing" in step["ignored"]
    assert said == [f"{tmp_path / 'x.tif'}: {step['ignored']}"]


def test_a_flag_comes_before_the_file(tmp_path):
    for resolution in ((1000, 1000), (72, 72)):
        image, said, step = read(tiff(tmp_path / "x.tif", resolution, "INCH"), spacing=2, unit="um")
        assert (image.spacing, image.unit, said) == ((2.0, 2.0), "um", [])
        assert step["spacing_from"] == "given" and "ignored" not in step


def test_imagej_comes_before_the_tags_and_says_inches_by_habit(tmp_path):
    known = {"axes": "ZYX", "unit": "micron", "spacing": 3.0}
    stack = np.stack([GREY] * 4)
    tifffile.imwrite(tmp_path / "a.tif", stack, imagej=True, resolution=(72, 72), metadata=known)
    image, said, step = read(tmp_path / "a.tif")
    assert image.spacing == pytest.approx((3, 1 / 72, 1 / 72)) and image.unit == "um" and not said
    assert step["spacing_from"] == "ImageJ metadata"
    # ImageJ takes a print's 300 dpi over as a length.
    tifffile.imwrite(
        tmp_path / "b.tif", GREY, imagej=True, resolution=(300, 300), metadata={"unit": "inch"}
    )
    image, said, step = read(tmp_path / "b.tif")
    assert image.unit == "voxel" and "ImageJ metadata in inches say 300 dpi" in said[0]
    tifffile.imwrite(tmp_path / "c.tif", GREY, imagej=True, resolution=(1, 1))
    image, said, step = read(tmp_path / "c.tif")
    assert image.unit == "voxel" and not said and "spacing_from" not in step
    tifffile.imwrite(
        tmp_path / "d.tif", GREY, imagej=True, resolution=(2000, 2000), resolutionunit="CENTIMETER"
    )
    image, said, step = read(tmp_path / "d.tif")
    assert (
        image.spacing == pytest.approx((5e-4, 5e-4)) and "resolution tags" in step["spacing_from"]
    )


def test_ome_comes_first_and_is_not_completed(tmp_path):
    sizes = {"axes": "ZYX", "PhysicalSizeX": 0.5, "PhysicalSizeY": 0.25}
    stack = np.stack([GREY] * 4)
    tifffile.imwrite(
        tmp_path / "a.ome.tif", stack, ome=True, metadata={**sizes, "PhysicalSizeZ": 2.0}
    )
    image, said, step = read(tmp_path / "a.ome.tif")
    assert (
        image.spacing == (2.0, 0.25, 0.5)
        and image.unit == "um"
        and step["spacing_from"] == "OME metadata"
    )
    tifffile.imwrite(tmp_path / "b.ome.tif", stack, ome=True, metadata=sizes)
    image, said, step = read(tmp_path / "b.ome.tif")
    assert image.unit == "voxel" and "its OME metadata say nothing of Z" in said[0]


def test_tags_of_a_stack_say_nothing_of_z(tmp_path):
    image, said, step = read(tiff(tmp_path / "x.tif", (1000, 1000), "INCH", np.stack([GREY] * 4)))
    assert (
        image.unit == "voxel"
        and "say 1000 dpi and nothing of z" in said[0] == f"{tmp_path / 'x.tif'}: {step['ignored']}"
    )
    folder = tmp_path / "slices"
    folder.mkdir()
    for name in ("a.tif", "b.tif"):
        tiff(folder / name, (1000, 1000), "INCH")
    image, said, step = read(folder)
    assert image.shape == (2, 20, 30) and image.unit == "voxel"
    assert (
        len(said) == 1
        and "a.tif has a spacing (from the TIFF's resolution tags (1000 dpi)), which says nothing "
        "of z"
        in said[0]
    )


def test_pictures_of_other_formats(tmp_path):
    picture = Picture.fromarray((GREY // 3).astype(np.uint8))
    picture.save(tmp_path / "fine.png", dpi=(25400, 25400))
    image, said, step = read(tmp_path / "fine.png")
    assert image.spacing == pytest.approx((1.0, 1.0)) and image.unit == "um"
    assert "the PNG's pHYs chunk (1e+06 a metre)" in step["spacing_from"] and said
    for name in ("x.png", "x.jpg"):
        picture.save(tmp_path / name, dpi=(300, 300))
        image, said, step = read(tmp_path / name)
        assert image.unit == "voxel" and "the 300 dpi of prints and screens" in said[0]
        picture.save(tmp_path / name)
        image, said, step = read(tmp_path / name)
        assert image.unit == "voxel" and not said


def test_our_own_files_need_no_word(tmp_path):
    picture = tb.Image(GREY, "grey", 25.4, "um")
    for name in ("x.tif", "x.png"):
        image, said, step = read(tb.write(picture, tmp_path / name))
        assert image.spacing == (25.4, 25.4) and not said
    image, said, step = read(tmp_path / "x.tif", spacing=2)
    assert step["spacing_from"] == "given"
    tb.write(picture, tmp_path / "x.nrrd")
    import nrrd

    nrrd.write(str(tmp_path / "y.nrrd"), GREY.T, {"spacings": [0.5, 0.5], "units": ["mm", "mm"]})
    assert read(tmp_path / "y.nrrd")[2]["spacing_from"] == "the file's header"
