"""The size of a written part, and the notices where its unit is unknown."""

import zipfile

import numpy as np
import pytest

import trabecula as tb
from trabecula.core.progress import listen
from trabecula.engine.lazy_volume import as_slabs
from trabecula.mesh.sizes import extent_of, size_notes, size_text

BLOCK = np.ones((4, 6, 8), np.uint8)


def export(image, path, **lengths):
    """Export; return the notices, the sides of the surface along z, y, x, and its unit."""
    said = []
    with listen(lambda line, fraction: said.append(line) if fraction < 0 else None):
        tb.export(image, path, **lengths)
    surface = tb.read_mesh(path)
    return [line for line in said if "compiling" not in line], extent_of(surface), surface.unit


@pytest.mark.parametrize("name", ["x.stl", "x.3mf", "x.ply", "x.obj"])
def test_a_unit_that_is_not_known_is_said(tmp_path, name):
    said, extent, _ = export(BLOCK, tmp_path / name)
    assert said == [
        "unit unknown: a length of 1 was written as 1 mm, the part is 4 x 6 x 8 mm (z, y, x); give "
        "its spacing and unit (--spacing, --unit)"
    ]
    assert extent == pytest.approx((4, 6, 8))
    said, extent, unit = export(
        BLOCK, tmp_path / name, spacing=(0.3, 0.2, 0.1), unit="mm", scale=10
    )
    assert not said and extent == pytest.approx((12, 12, 8), rel=1e-6) and unit == "mm"


def test_a_3mf_carries_the_word(tmp_path):
    def model(**lengths):
        tb.export(BLOCK, tmp_path / "x.3mf", **lengths)
        with zipfile.ZipFile(tmp_path / "x.3mf") as package:
            return package.read("3D/3dmodel.model").decode()

    note = '<metadata name="tb:note">unit unknown: a length of 1 was written as 1 mm</metadata>'
    assert note in model() and 'unit="millimeter"' in model()
    assert "unknown" not in model(unit="mm")


@pytest.mark.parametrize(
    ("spacing", "unit", "says"),
    [
        (25, "um", None),
        (0.5, "mm", None),
        (
            30,
            "nm",
            "the part is 0.00012 x 0.00018 x 0.00024 mm (z, y, x), less than 0.1 mm: is nm its "
            "unit?",
        ),
        (0.3, "m", "the part is 1200 x 1800 x 2400 mm (z, y, x), more than 2 m: is m its unit?"),
    ],
)
def test_sizes_that_are_hardly_meant_are_said(tmp_path, spacing, unit, says):
    said, _, _ = export(tb.Image(BLOCK, "labels", spacing, unit), tmp_path / "x.stl")
    assert (
        (not said)
        if says is None
        else (len(said) == 1 and says in said[0] and "--scale" in said[0])
    )


def test_slabs_have_lengths_too(tmp_path):
    image = tb.Image(BLOCK, "labels")
    whole = export(image, tmp_path / "a.stl", spacing=50, unit="um", scale=2)
    slabs = export(as_slabs(image), tmp_path / "b.stl", spacing=50, unit="um", scale=2)
    assert slabs == whole and whole[1] == pytest.approx((0.4, 0.6, 0.8))
    assert "unit unknown" in export(as_slabs(image), tmp_path / "b.stl")[0][0]


def test_volumes_take_lengths_and_their_recipe_tells(tmp_path):
    image = tb.read(tb.write(BLOCK, tmp_path / "in.npy"))
    tb.export(image, tmp_path / "out.nrrd", spacing=19.5, unit="micron", scale=2)
    found = tb.read(tmp_path / "out.nrrd")
    assert (found.spacing, found.unit) == ((39.0,) * 3, "um")
    step = found.recipe.steps[-1]
    assert step["verb"] == "declare" and step["fields"] == {"spacing": [39.0] * 3, "unit": "um"}
    assert tb.rerun(tmp_path / "out.nrrd").spacing == (39.0,) * 3
    tb.export(image, tmp_path / "same.nrrd", spacing=1, unit="voxel")
    assert tb.read(tmp_path / "same.nrrd").recipe.to_json() == image.recipe.to_json()


@pytest.mark.parametrize(
    ("lengths", "error", "says"),
    [
        ({"scale": 0}, tb.errors.InputError, "scale"),
        ({"scale": -2}, tb.errors.InputError, "scale"),
        ({"spacing": (1, 2)}, tb.errors.InputError, "2 numbers"),
        ({"spacing": 0}, tb.errors.InputError, "positive"),
        ({"unit": "furlong"}, tb.errors.UnknownNameError, "unknown unit"),
    ],
)
def test_lengths_that_are_none(tmp_path, lengths, error, says):
    for image in (tb.Image(BLOCK, "labels"), as_slabs(tb.Image(BLOCK, "labels"))):
        with pytest.raises(error, match=says):
            tb.export(image, tmp_path / "x.stl", **lengths)
    assert not list(tmp_path.iterdir())


def test_an_extent_is_that_of_the_faces():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3], [99, 99, 99]], float)
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32)
    from trabecula.mesh.base import Mesh

    assert extent_of(Mesh(vertices, faces)) == (3.0, 2.0, 1.0)
    assert extent_of(Mesh(vertices, faces[:0])) == (0.0, 0.0, 0.0)
    assert size_text((1, 2, 3), "inch") == "25.4 x 50.8 x 76.2 mm (z, y, x)" and not list(
        size_notes((1, 2, 3), "inch")
    )
