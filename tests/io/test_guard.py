"""A mistake in code is never called a damaged file: not in ours, and not in a library's."""

import numpy as np
import pytest
import tifffile
from io_images import same

import trabecula as tb
from trabecula.core.errors import FileError, InputError
from trabecula.core.recipe import Recipe
from trabecula.io.formats import SLICES, suffixes
from trabecula.io.guard import library_of, report_damage
from trabecula.pipeline.replay import replay

LABELS = np.random.default_rng(3).integers(0, 2, (4, 6, 7)).astype(np.uint8)
NAMES = {**{f"x{suffix}": form for suffix, form in suffixes().items()}, "x/": SLICES}


def write_file(name, folder):
    """Write a file of the format; return it and the module that reads it."""
    flat = NAMES[name].ndim == (2,)
    values = np.dstack([LABELS[0] * 200] * 3) if flat else LABELS
    tb.write(tb.Image(values, "colour" if flat else "labels"), f"{folder}/{name}")
    return f"{folder}/{name}", NAMES[name].load()


def mistake_in(package):
    """Make a function of a package that fails like code that calls a name that is gone."""
    scope = {"__name__": f"{package}.module"}
    exec("def fail(*arguments, **options):\n    return None.get_axes()", scope)
    return scope["fail"]


@pytest.mark.parametrize("name", NAMES)
def test_a_mistake_of_ours_comes_through(name, tmp_path, monkeypatch):
    path, module = write_file(name, tmp_path)
    monkeypatch.setattr(module, "check_claim", mistake_in("trabecula"))
    with pytest.raises(AttributeError, match="get_axes"):
        tb.read(path)


@pytest.mark.parametrize("name", NAMES)
def test_a_mistake_of_a_library_blames_no_file(name, tmp_path, monkeypatch):
    path, module = write_file(name, tmp_path)
    monkeypatch.setattr(module, "check_claim", mistake_in("tifffile"))
    with pytest.raises(FileError, match="fails on it") as raised:
        tb.read(path)
    text = str(raised.value)
    assert (
        f"tifffile {tifffile.__version__} fails on it (AttributeError: " in text
        and "get_axes" in text
    )
    assert (
        "try another version of tifffile" in text and "whole" not in text and "damaged" not in text
    )


@pytest.mark.parametrize(
    "error", [TypeError, NameError, ImportError, AssertionError, NotImplementedError]
)
def test_other_mistakes_of_ours_come_through(error, tmp_path):
    with pytest.raises(error), report_damage(tmp_path, "TIFF"):
        exec("raise error('mine')", {"__name__": "trabecula.io.tiff", "error": error})


def test_where_types_are_not_checked_both_readings_are_said(tmp_path):
    with (
        pytest.raises(FileError, match="changed by other hands, or trabecula has a defect"),
        report_damage(tmp_path, "a model", checked=False),
    ):
        exec("None.shape", {"__name__": "trabecula.synth.api.serialize"})


def test_frames_of_the_standard_library_are_their_callers():
    for package, found in (("trabecula.io", None), ("nibabel.load", "nibabel")):
        try:
            exec("import json; json.loads(5)", {"__name__": package})
        except TypeError as error:
            assert (library_of(error) or "").partition(" ")[0] == (found or "")


@pytest.mark.whole
def test_a_recipe_is_not_called_damaged_for_a_mistake_of_ours(tmp_path, monkeypatch):
    path = tb.write(tb.crop(tb.sample("bone"), 8), tmp_path / "x.npy")
    monkeypatch.setattr("trabecula.pipeline.replay._make_model", mistake_in("trabecula"))
    recipe = Recipe(({**tb.read(path).recipe.steps[0], "verb": "generate"},))
    with pytest.raises(InputError, match=r"damaged, or trabecula has a defect.*get_axes"):
        replay(recipe, folder=tmp_path)


OME = (
    '<?xml version="1.0"?><OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06" '
    'UUID="urn:uuid:{own}">'
    '<Image ID="Image:0"><Pixels ID="Pixels:0" DimensionOrder="XYZCT" Type="uint8" SizeX="7" '
    'SizeY="6" SizeZ="2" SizeC="1" '
    'SizeT="1">{parts}</Pixels></Image></OME>'
)
PART = (
    '<TiffData IFD="0" FirstZ="{z}" PlaneCount="1">'
    '<UUID FileName="{z}.ome.tif">urn:uuid:{z}</UUID></TiffData>'
)


def test_a_volume_in_several_files_is_refused(tmp_path):
    parts = "".join(PART.format(z=z) for z in range(2))
    for z in range(2):
        tifffile.imwrite(
            tmp_path / f"{z}.ome.tif",
            LABELS[z],
            description=OME.format(own=z, parts=parts),
            metadata=None,
        )
    with pytest.raises(InputError, match="one of several files"):
        tb.read(tmp_path / "0.ome.tif")


@pytest.mark.parametrize("shape", [(1, 6, 7), (4, 1, 7), (4, 6, 1), (1, 1, 1), (1, 7), (6, 1)])
# as ImageJ's, as OME, as plain pages
@pytest.mark.parametrize("dtype", ["uint8", "int16", "int64"])
def test_axes_of_one_voxel_stay(shape, dtype, tmp_path):
    """Keep them, though versions of tifffile differ in which of them they leave out."""
    values = np.arange(np.prod(shape)).reshape(shape).astype(dtype)
    image = tb.Image(values, "grey", recipe=Recipe().then("made", values))
    same(tb.read(tb.write(image, tmp_path / "x.tif")), image)
