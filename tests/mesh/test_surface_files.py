"""Files: a round trip gives the mesh, in the unit of the format."""

import json
import xml.etree.ElementTree as ET
import zipfile

import numpy as np
import pytest
import trimesh

import trabecula as tb
from trabecula.core.errors import FileError, InputError, UnknownNameError
from trabecula.mesh.base import Mesh
from trabecula.mesh.files import write_mesh
from trabecula.mesh.formats import FORMATS
from trabecula.mesh.text import recipe_digest

CORE = "{http://schemas.microsoft.com/3dmanufacturing/core/2015/02}"


@pytest.fixture
def blob():
    noise = np.random.default_rng(0).random((9, 10, 11)) < 0.6
    return tb.Image(noise, "labels", spacing=(20.0, 10.0, 10.0), unit="um")


def same_surface(read, mesh, factor=1.0):
    """Return whether a file holds the mesh; STL repeats vertices, so compare corners."""
    found, wanted = np.asarray(read.triangles), mesh.vertices[mesh.faces].astype(float) * factor
    np.testing.assert_allclose(found, wanted, rtol=1e-6, atol=1e-6 * np.abs(wanted).max())


@pytest.mark.parametrize(("suffix", "factor"), [("stl", 1e-3), ("ply", 1.0), ("obj", 1.0)])
def test_what_trimesh_reads_is_what_was_written(blob, tmp_path, suffix, factor):
    mesh = tb.mesh(blob)
    path = write_mesh(mesh, tmp_path / f"part.{suffix}")
    same_surface(trimesh.load(path, process=False, force="mesh"), mesh, factor)
    merged = trimesh.load(path, force="mesh")
    assert merged.is_watertight and merged.is_winding_consistent and merged.volume > 0


@pytest.mark.parametrize(
    ("unit", "factor"),
    [("mm", 1.0), ("um", 1e-3), ("nm", 1e-6), ("m", 1e3), ("voxel", 1.0), ("cm", 10.0)],
)
def test_stl_is_in_millimetres_and_says_so(tmp_path, unit, factor):
    mesh = tb.mesh(tb.Image(np.ones((2, 3, 4), bool), "labels", spacing=2.0, unit=unit), smooth=0)
    raw = write_mesh(mesh, tmp_path / "box.stl").read_bytes()
    assert raw[:5] != b"solid" and len(raw) == 84 + 50 * len(mesh.faces)
    assert (
        f"unit={'voxel' if unit == 'voxel' else 'mm'}, recipe={recipe_digest(mesh.recipe)}".encode()
        in raw[:80]
    )
    records = np.frombuffer(
        raw[84:], np.dtype([("n", "<f4", 3), ("c", "<f4", (3, 3)), ("a", "<u2")])
    )
    np.testing.assert_allclose(
        records["c"].max(axis=(0, 1)), np.array([8, 6, 4]) * factor, rtol=1e-6
    )
    np.testing.assert_allclose(np.linalg.norm(records["n"], axis=1), 1, rtol=1e-5)


def test_the_normals_of_an_stl_point_outwards(tmp_path):
    mesh = tb.mesh(tb.Image(np.ones((2, 3, 4), bool), "labels", spacing=2.0, unit="mm"), smooth=0)
    raw = write_mesh(mesh, tmp_path / "box.stl").read_bytes()[84:]
    records = np.frombuffer(raw, np.dtype([("n", "<f4", 3), ("c", "<f4", (3, 3)), ("a", "<u2")]))
    away = records["c"].mean(axis=1) - np.array([4, 3, 2])  # from the middle of the box
    assert np.all(np.einsum("ij,ij->i", records["n"], away) > 0)


@pytest.mark.parametrize(
    ("unit", "name", "factor"),
    [
        ("um", "micron", 1),
        ("mm", "millimeter", 1),
        ("m", "meter", 1),
        ("nm", "micron", 1e-3),
        ("voxel", "millimeter", 1),
    ],
)
def test_3mf_declares_its_unit_and_holds_the_mesh(blob, tmp_path, unit, name, factor):
    mesh = tb.mesh(tb.Image(blob.values, "labels", spacing=blob.spacing, unit=unit))
    with zipfile.ZipFile(write_mesh(mesh, tmp_path / "part.3mf")) as package:
        assert package.testzip() is None
        assert {"[Content_Types].xml", "_rels/.rels"} < set(package.namelist())
        relation = ET.fromstring(package.read("_rels/.rels"))[0]
        model = ET.fromstring(package.read(relation.get("Target").lstrip("/")))
    assert model.get("unit") == name
    metadata = {entry.get("name"): entry.text for entry in model.iter(f"{CORE}metadata")}
    assert (
        json.loads(metadata["tb:recipe"]) == mesh.recipe.to_json() and metadata["tb:unit"] == unit
    )
    vertices = [[float(v.get(axis)) for axis in "xyz"] for v in model.iter(f"{CORE}vertex")]
    faces = [
        [int(t.get(corner)) for corner in ("v1", "v2", "v3")] for t in model.iter(f"{CORE}triangle")
    ]
    np.testing.assert_allclose(vertices, mesh.vertices * factor, rtol=1e-6)
    np.testing.assert_array_equal(faces, mesh.faces)


def test_ply_and_obj_carry_unit_and_recipe(blob, tmp_path):
    mesh = tb.mesh(blob)
    for suffix, unit, recipe in (
        ("ply", "comment unit ", "comment trabecula recipe "),
        ("obj", "# unit ", "# recipe "),
    ):
        lines = (
            write_mesh(mesh, tmp_path / f"part.{suffix}")
            .read_bytes()
            .decode("latin-1")
            .splitlines()
        )
        assert f"{unit}um" in lines
        assert (
            json.loads(next(line for line in lines if line.startswith(recipe))[len(recipe) :])
            == mesh.recipe.to_json()
        )


def test_double_precision_survives_ply(tmp_path):
    vertices = np.array([[0, 0, 0], [1 / 3, 0, 0], [0, 1 / 7, 0], [0, 0, 1 / 9]])
    mesh = Mesh(vertices, np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]))
    read = trimesh.load(write_mesh(mesh, tmp_path / "t.ply"), process=False)
    np.testing.assert_array_equal(read.vertices, vertices)


@pytest.mark.parametrize("suffix", FORMATS)
def test_the_same_mesh_gives_the_same_bytes(blob, tmp_path, suffix):
    first, second = (write_mesh(tb.mesh(blob), tmp_path / f"{k}{suffix.upper()}") for k in "ab")
    assert first.read_bytes() == second.read_bytes()


def test_many_rows_are_written_in_pieces(tmp_path, monkeypatch, blob):
    mesh = tb.mesh(blob)
    whole = [
        write_mesh(mesh, tmp_path / f"whole{suffix}").read_bytes() for suffix in (".obj", ".stl")
    ]
    monkeypatch.setattr("trabecula.mesh.text._ROWS", 7)
    monkeypatch.setattr("trabecula.mesh.stl._CHUNK", 7)
    assert [
        write_mesh(mesh, tmp_path / f"pieces{suffix}").read_bytes() for suffix in (".obj", ".stl")
    ] == whole


def test_an_unknown_suffix_suggests_the_nearest(blob, tmp_path):
    with pytest.raises(UnknownNameError, match=r"did you mean '.stl'"):
        write_mesh(tb.mesh(blob), tmp_path / "part.stla")


def test_a_mesh_without_faces_is_refused(tmp_path):
    with pytest.raises(InputError, match="no faces"):
        write_mesh(Mesh(np.zeros((0, 3)), np.zeros((0, 3), int)), tmp_path / "none.stl")


def test_nothing_is_left_of_a_file_that_failed(blob, tmp_path, monkeypatch):
    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("trabecula.mesh.ply.recipe_json", fail)
    with pytest.raises(FileError, match="No space left"):
        write_mesh(tb.mesh(blob), tmp_path / "part.ply")
    assert not list(tmp_path.iterdir())
