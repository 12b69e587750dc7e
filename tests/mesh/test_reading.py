"""Reading surfaces: round trips, files of other programs, and damaged files."""

import json
import sys
import zipfile
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh

import trabecula as tb
from trabecula.errors import FileError, InputError, MissingExtraError, UnknownNameError
from trabecula.mesh.check import check
from trabecula.mesh.files import read_mesh, write_mesh
from trabecula.mesh.formats import FORMATS
from trabecula.mesh.threemf import _object_parts
from trabecula.mesh.weld import drop_degenerate
from trabecula.pipeline.inputs import load_mask

CUBE = trimesh.creation.box((1, 2, 3))


@pytest.fixture
def blob():
    noise = np.random.default_rng(0).random((7, 8, 9)) < 0.6
    return tb.mesh(tb.Image(noise, "labels", spacing=(20.0, 10.0, 10.0), unit="um"))


def corners(mesh):
    return np.asarray(mesh.vertices)[np.asarray(mesh.faces)]


@pytest.mark.parametrize("suffix", FORMATS)
def test_what_was_written_comes_back(blob, tmp_path, suffix):
    again = read_mesh(write_mesh(blob, tmp_path / f"part{suffix}"))
    factor, unit = (1e-3, "mm") if suffix == ".stl" else (1.0, "um")
    np.testing.assert_allclose(
        corners(again), corners(blob) * factor, rtol=1e-6, atol=1e-4 * factor
    )
    assert again.unit == unit and check(again).watertight
    assert len(again.vertices) == len(blob.vertices) and len(again.faces) == len(blob.faces)
    assert again.recipe.steps[0]["source"].endswith(suffix)


@pytest.mark.parametrize("suffix", FORMATS)
def test_plain_voxels_stay_voxels_and_a_given_unit_wins(tmp_path, suffix):
    path = write_mesh(tb.mesh(np.ones((2, 2, 2), np.uint8)), tmp_path / f"part{suffix}")
    assert read_mesh(path).unit == "voxel" and read_mesh(path, unit="micron").unit == "um"
    np.testing.assert_allclose(read_mesh(path).vertices.max(axis=0), 2)


@pytest.mark.parametrize(
    "written",
    [
        ("cube.stl", {"file_type": "stl"}),
        ("cube.stl", {"file_type": "stl_ascii"}),
        ("cube.ply", {"encoding": "ascii"}),
        ("cube.ply", {"encoding": "binary"}),
        ("cube.obj", {}),
    ],
    ids=str,
)
def test_files_of_another_program(tmp_path, written):
    name, options = written
    CUBE.export(tmp_path / name, **options)
    mesh = read_mesh(tmp_path / name)
    found = check(mesh)
    assert found.watertight and found.volume == pytest.approx(6) and found.area == pytest.approx(22)
    assert (len(mesh.vertices), len(mesh.faces)) == (8, 12)


def quads():
    """Return a cube of six quadrilaterals, outward."""
    points = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], float)
    faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
    return points, faces


def ply(points, faces, form, *, kind="float"):
    """Return a PLY with a colour per vertex, a flag per face, and an unknown element."""
    head = (
        f"ply\nformat {form} 1.0\nelement vertex {len(points)}\n"
        f"property {kind} x\nproperty {kind} y\nproperty {kind} z\n"
        "property uchar red\nelement camera 2\nproperty int id\nproperty list uchar short angles\n"
        f"element face {len(faces)}\nproperty list uchar uint vertex_index\n"
        "property uchar flag\nend_header\n"
    ).encode()
    order = ">" if "big" in form else "<"
    if form == "ascii":
        lines = [" ".join(map(str, [*point, 7])) for point in points] + ["4 2 90 -90", "5 0"]
        lines += [" ".join(map(str, [len(face), *face, 1])) for face in faces]
        return head + "\n".join(lines).encode() + b"\n"
    code = {"float": "f4", "double": "f8", "int": "i4"}[kind]
    body = b"".join(np.array(point, order + code).tobytes() + b"\x07" for point in points)
    body += (
        np.array(4, order + "i4").tobytes() + b"\x02" + np.array([90, -90], order + "i2").tobytes()
    )
    body += np.array(5, order + "i4").tobytes() + b"\x00"
    body += b"".join(
        bytes([len(face)]) + np.array(face, order + "u4").tobytes() + b"\x01" for face in faces
    )
    return head + body


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("kind", ["float", "double", "int"])
def test_ply_with_polygons_and_what_else_there_may_be(tmp_path, form, kind):
    points, faces = quads()
    mixed = [faces[0][:3], [faces[0][0], *faces[0][2:]], *faces[1:]]  # one side as two triangles
    for number, sides in enumerate((faces, mixed)):
        path = tmp_path / f"{number}.ply"
        path.write_bytes(
            ply(points.astype(int) if kind == "int" else points, sides, form, kind=kind)
        )
        found = check(read_mesh(path))
        assert found.watertight and found.volume == pytest.approx(1) and found.faces == 12


def test_obj_with_textures_polygons_and_numbers_from_behind(tmp_path):
    points, faces = quads()
    lines = [
        "mtllib cube.mtl",
        "o cube",
        *(f"v {x} {y} {z} 1.0" for x, y, z in points),
        "vt 0 0",
        "vn 0 0 1",
    ]
    lines += ["f " + " ".join(f"{k + 1}/1/1" for k in face) for face in faces[:3]]
    lines += ["f " + " ".join(f"{k - 8}//1" for k in face) for face in faces[3:]]
    (tmp_path / "cube.obj").write_text("\n".join(lines), encoding="ascii")
    found = check(read_mesh(tmp_path / "cube.obj"))
    assert found.watertight and found.volume == pytest.approx(1)


def test_a_binary_stl_that_begins_with_solid(tmp_path):
    CUBE.export(tmp_path / "cube.stl")
    raw = bytearray((tmp_path / "cube.stl").read_bytes())
    raw[:5] = b"solid"
    (tmp_path / "cube.stl").write_bytes(raw)
    assert check(read_mesh(tmp_path / "cube.stl")).volume == pytest.approx(6)


def model(unit, items, objects):
    return (
        f'<model unit="{unit}" '
        'xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02"><resources>'
        f"{objects}</resources><build>{items}</build></model>"
    )


def package(path, text):
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("3D/3dmodel.model", text)
    return path


def tetrahedron(number):
    points = "".join(
        f'<vertex x="{x}" y="{y}" z="{z}"/>'
        for x, y, z in ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1))
    )
    faces = "".join(
        f'<triangle v1="{a}" v2="{b}" v3="{c}"/>'
        for a, b, c in ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))
    )
    mesh = f"<vertices>{points}</vertices><triangles>{faces}</triangles>"
    return f'<object id="{number}"><mesh>{mesh}</mesh></object>'


def test_3mf_builds_its_components_at_their_places(tmp_path):
    objects = tetrahedron(1) + (
        '<object id="2"><components><component objectid="1" transform="2 0 0 0 2 0 0 0 2 10 0 0"/>'
        '<component objectid="1" transform="-1 0 0 0 1 0 0 0 1 0 0 0"/></components></object>'
    )
    items = '<item objectid="2" transform="1 0 0 0 1 0 0 0 1 0 0 5"/>'
    mesh = read_mesh(package(tmp_path / "two.3mf", model("centimeter", items, objects)))
    found = check(mesh)
    assert mesh.unit == "cm" and found.watertight and found.components == 2
    assert found.volume == pytest.approx((8 + 1) / 6)  # the mirrored one is turned right side out
    assert found.bounds == ((-1, 0, 5), (12, 2, 7))
    foot = read_mesh(
        package(tmp_path / "foot.3mf", model("foot", '<item objectid="1"/>', tetrahedron(1)))
    )
    assert foot.unit == "inch" and foot.vertices.max() == 12


def test_3mf_of_several_parts_as_slicers_write_it(tmp_path):
    path = 'p:path="/3D/Objects/one.model"'
    objects = (
        '<object id="1" xmlns:p="http://schemas.microsoft.com/3dmanufacturing/production/2015/06">'
        f'<components><component objectid="1" {path}/><component objectid="3" {path} '
        'transform="1 0 0 0 1 0 0 0 1 0 0 5"/></components></object>'
    )
    nested = '<object id="3"><components><component objectid="1"/></components></object>'
    main = model("millimeter", '<item objectid="1"/>', objects)
    whole = package(tmp_path / "parts.3mf", main)
    with zipfile.ZipFile(whole, "a") as archive:
        archive.writestr("3D/Objects/one.model", model("millimeter", "", tetrahedron(1) + nested))
    found = check(read_mesh(whole))
    assert found.watertight and found.components == 2 and found.bounds == ((0, 0, 0), (1, 1, 6))


def test_3mf_that_holds_itself_is_told(tmp_path):
    objects = '<object id="1"><components><component objectid="1"/></components></object>'
    with pytest.raises(FileError, match="nested too deep"):
        read_mesh(package(tmp_path / "loop.3mf", model("meter", '<item objectid="1"/>', objects)))


@pytest.mark.parametrize("suffix", FORMATS)
def test_damage_is_told_in_one_line(blob, tmp_path, suffix):
    path = write_mesh(blob, tmp_path / f"part{suffix}")
    whole = path.read_bytes()
    for name, content in (
        ("empty", b""),
        ("noise", bytes(range(256)) * 8),
        ("short", whole[: len(whole) * 2 // 3 - 5]),
    ):
        (tmp_path / f"{name}{suffix}").write_bytes(content)
        # the format has no count that could be missed: it has holes
        if (name, suffix) == ("short", ".obj"):
            assert check(read_mesh(tmp_path / "short.obj")).open_edges > 0
            continue
        with pytest.raises(
            (FileError, InputError), match=r"cannot read|no triangles|faces name vertices"
        ):
            read_mesh(tmp_path / f"{name}{suffix}")
    with pytest.raises(FileError, match="there is no file"):
        read_mesh(tmp_path / f"missing{suffix}")


def test_text_stl_cut_short_is_told(tmp_path):
    CUBE.export(tmp_path / "cube.stl", file_type="stl_ascii")
    text = (tmp_path / "cube.stl").read_bytes()
    (tmp_path / "short.stl").write_bytes(text[: len(text) // 2])
    with pytest.raises(FileError, match=r"cannot read .*short\.stl as STL"):
        read_mesh(tmp_path / "short.stl")


def test_what_is_no_surface_is_refused(tmp_path):
    (tmp_path / "points.obj").write_text("v 0 0 0\nv 1 0 0\n", encoding="ascii")
    with pytest.raises(FileError, match="holds no triangles"):
        read_mesh(tmp_path / "points.obj")
    (tmp_path / "far.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", encoding="ascii")
    with pytest.raises(InputError, match=r"faces name vertices 0\.\.8, the mesh has 0\.\.2"):
        read_mesh(tmp_path / "far.obj")
    (tmp_path / "nan.obj").write_text("v 0 nan 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", encoding="ascii")
    with pytest.raises(InputError, match="NaN or infinite"):
        read_mesh(tmp_path / "nan.obj")
    with pytest.raises(UnknownNameError, match=r"did you mean '\.stl'"):
        read_mesh(tmp_path / "part.stp")
    with pytest.raises(UnknownNameError, match="unknown unit"):
        read_mesh(write_mesh(tb.mesh(np.ones((2, 2, 2), int)), tmp_path / "a.stl"), unit="parsec")


def scene():
    """Return two boxes at their places, of volumes 6 and 1, and points, which are no surface."""
    moved = trimesh.transformations.translation_matrix((5, 0, 0))
    found = trimesh.Scene([CUBE, trimesh.PointCloud(np.zeros((3, 3)))])
    found.add_geometry(trimesh.creation.box((1, 1, 1)), transform=moved)
    return found


@pytest.mark.parametrize("suffix", ["glb", "gltf"])
def test_gltf_joins_the_bodies_of_its_scene_in_metres(tmp_path, suffix):
    if suffix == "glb":
        scene().export(tmp_path / "model.glb")
    else:
        for name, content in trimesh.exchange.gltf.export_gltf(scene()).items():
            (tmp_path / name).write_bytes(content)
    mesh = read_mesh(tmp_path / f"model.{suffix}")
    found = check(mesh)
    assert mesh.unit == "m" and found.watertight and found.components == 2
    assert found.volume == pytest.approx(7) and found.bounds[1] == pytest.approx((5.5, 1, 1.5))


@pytest.mark.whole
def test_off_is_a_form_to_fill_and_an_open_one_is_refused(tmp_path):
    trimesh.creation.icosphere(radius=6).export(tmp_path / "ball.off")
    bone = tb.crop(tb.sample("bone"), 16)
    form = load_mask(tmp_path / "ball.off", bone, scale=40)
    assert form.shape == (12, 12, 12) and 0.4 < form.values.mean() < 0.6
    assert read_mesh(tmp_path / "ball.off").unit == "voxel"
    text = (tmp_path / "ball.off").read_text(encoding="ascii").splitlines()
    count = len(text) - 1
    text[1] = text[1].replace(" 1280 ", " 1279 ")
    (tmp_path / "open.off").write_text("\n".join(text[:count]), encoding="ascii")
    with pytest.raises(InputError, match="not watertight"):
        load_mask(tmp_path / "open.off", bone, scale=40)


def test_damage_that_trimesh_finds_is_told_in_one_line(tmp_path):
    CUBE.export(tmp_path / "cube.off")
    CUBE.export(tmp_path / "cube.glb")
    for suffix in ("off", "glb"):
        whole = (tmp_path / f"cube.{suffix}").read_bytes()
        for content in (b"", bytes(range(256)) * 8, whole[: len(whole) * 2 // 3 - 5]):
            (tmp_path / f"bad.{suffix}").write_bytes(content)
            with pytest.raises(FileError, match="cannot read"):
                read_mesh(tmp_path / f"bad.{suffix}")
    (tmp_path / "none.gltf").write_text('{"asset": {"version": "2.0"}}', encoding="ascii")
    with pytest.raises(FileError, match=r"holds no triangles|cannot read"):
        read_mesh(tmp_path / "none.gltf")


def test_a_compressed_body_is_refused_and_not_read_as_zeros(tmp_path):
    draco = "KHR_draco_mesh_compression"
    body = {"attributes": {"POSITION": 1}, "indices": 0, "mode": 4}
    packed = {"bufferView": 0, "attributes": {"POSITION": 0}}
    content = {
        "asset": {"version": "2.0"},
        "extensionsUsed": [draco],
        "extensionsRequired": [draco],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{**body, "extensions": {draco: packed}}]}],
        "accessors": [
            {"componentType": 5125, "type": "SCALAR", "count": 36},
            {"componentType": 5126, "type": "VEC3", "count": 8},
        ],
        "buffers": [{"byteLength": 6, "uri": "data:;base64,RFJBQ08x"}],
        "bufferViews": [{"buffer": 0, "byteOffset": 0, "byteLength": 6}],
    }
    (tmp_path / "small.gltf").write_text(json.dumps(content), encoding="ascii")
    with pytest.raises(FileError, match="without compression"):
        read_mesh(tmp_path / "small.gltf")


def test_a_format_of_the_extra_names_it_where_it_is_missing(tmp_path, monkeypatch):
    CUBE.export(tmp_path / "cube.off")
    monkeypatch.setitem(sys.modules, "trimesh", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'trabecula\[mesh\]'"):
        read_mesh(tmp_path / "cube.off")


def test_faces_with_a_corner_twice_are_dropped():
    faces = np.array([[0, 1, 0], [0, 1, 2], [1, 1, 2], [0, 2, 2]])
    assert drop_degenerate(faces).tolist() == [[0, 1, 2]]


def test_a_component_of_a_3mf_is_moved_and_then_turned_with_its_part():
    core = "{http://schemas.microsoft.com/3dmanufacturing/core/2015/02}"
    part, whole = ElementTree.Element("object"), ElementTree.Element("object")
    vertices = ElementTree.SubElement(ElementTree.SubElement(part, f"{core}mesh"), "vertices")
    ElementTree.SubElement(vertices, f"{core}vertex", x="0", y="0", z="0")
    place = {"objectid": "1", "transform": "1 0 0 0 1 0 0 0 1 5 0 0"}
    ElementTree.SubElement(whole, f"{core}component", place)
    turn = np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1], [0, 0, 7]], float)  # x becomes y
    objects = {("/a.model", "1"): part, ("/a.model", "2"): whole}
    ((points, _),) = _object_parts(objects, ("/a.model", "2"), turn)
    assert points.tolist() == [[0, 5, 7]]
