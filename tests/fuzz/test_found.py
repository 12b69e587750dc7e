"""Files that fuzzing found, and that hung, took all memory or came out as a traceback."""

import json
import os
import struct
import sys
import zipfile

import nibabel
import numpy as np
import pytest
from crafted import zeros
from specimens import FACES, FLOATS, LABELS, TETRAHEDRON

import trabecula as tb
from trabecula.engine.checkpoint import step_in
from trabecula.engine.files import UNREADABLE, read_npz, write_npz
from trabecula.errors import FileError, InputError, UnknownNameError

THREEMF = '<model xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02">{}</model>'


@pytest.mark.skipif(sys.platform == "win32", reason="has neither pipes nor these devices")
@pytest.mark.parametrize("place", ["x.npy", "x.npy.json", "x/slice_0000.png", "x.zarr/0/c/0/0/0"])
def test_a_pipe_is_not_waited_for(place, tmp_path):
    whole = place.split("/")[0].removesuffix(".json")
    tb.write(tb.Image(LABELS, "labels"), f"{tmp_path}/{whole}" + ("/" if whole == "x" else ""))
    (tmp_path / place).unlink()
    os.mkfifo(tmp_path / place)
    with pytest.raises(FileError, match="is a pipe or a device"):
        tb.read(tmp_path / whole)


def test_json_without_end_is_no_case(tmp_path):
    (tmp_path / "x.json").write_text("[" * 100_000)
    with pytest.raises(FileError, match="as a case: maximum recursion depth"):
        tb.fields.case(tmp_path / "x.json")


def test_rows_that_a_ply_cannot_hold(tmp_path):
    head = "ply\nformat ascii 1.0\nelement vertex 999999999999\nelement face 0\nend_header\n"
    (tmp_path / "x.ply").write_text(head)
    with pytest.raises(FileError, match="claims 999999999999 rows"):
        tb.read_mesh(tmp_path / "x.ply")


def test_components_of_3mf_that_multiply(tmp_path):
    corners = "".join('<vertex x="{}" y="{}" z="{}"/>'.format(*point) for point in TETRAHEDRON)
    triangles = "".join('<triangle v1="{}" v2="{}" v3="{}"/>'.format(*face) for face in FACES)
    objects = f"<mesh><vertices>{corners}</vertices><triangles>{triangles}</triangles></mesh>"
    objects = f'<object id="0">{objects}</object>'
    for number in range(1, 12):
        inner = f'<component objectid="{number - 1}"/>' * 10
        objects += f'<object id="{number}"><components>{inner}</components></object>'
    build = '<resources>{}</resources><build><item objectid="11"/></build>'
    with zipfile.ZipFile(tmp_path / "x.3mf", "w") as package:
        package.writestr("3D/3dmodel.model", THREEMF.format(build.format(objects)))
    with pytest.raises(FileError, match=r"components repeat .* entries, too much for memory"):
        tb.read_mesh(tmp_path / "x.3mf")


def test_an_extension_of_nifti_larger_than_its_file(tmp_path):
    header = nibabel.Nifti1Header()
    header.set_data_shape((2, 2, 2))
    header["magic"], header["vox_offset"] = b"n+1", 400
    extension = struct.pack("<4B2i", 1, 0, 0, 0, 2**31 - 1, 6)
    (tmp_path / "x.nii").write_bytes(header.binaryblock + extension + bytes(200))
    with pytest.raises(FileError, match="extension of its header claims 2147483647 bytes"):
        tb.read(tmp_path / "x.nii")


def test_chunks_of_a_store_without_end(tmp_path):
    path = tb.write(tb.Image(LABELS, "labels"), tmp_path / "x.zarr")
    text = json.loads((path / "0/zarr.json").read_text())
    text["shape"] = [10**9, 10**9, 10**9]
    (path / "0/zarr.json").write_text(json.dumps(text))
    with pytest.raises(FileError, match=r"claims \d+ chunks"):
        tb.open_slabs(path)


def test_a_level_of_a_store_that_is_a_group(tmp_path):
    path = tb.write(tb.Image(LABELS, "labels"), tmp_path / "x.zarr")
    text = json.loads((path / "zarr.json").read_text())
    text["attributes"]["ome"]["multiscales"][0]["datasets"][0]["path"] = ""
    (path / "zarr.json").write_text(json.dumps(text))
    for read in (tb.read, tb.open_slabs):
        with pytest.raises(FileError):
            read(path)


def test_checkpoints_whose_headers_lie(tmp_path):
    write_npz(tmp_path / "x.part", {"state.a": np.zeros(9), "about": np.zeros(9, np.uint8)})
    data = (tmp_path / "x.part").read_bytes()
    for old, new in ((b"'shape': (9,)", b"'shape': (9e8"), (b"'descr'", b"'''escr")):
        (tmp_path / "x.part").write_bytes(data.replace(old, new))
        assert step_in(tmp_path / "x.part") is None
        with pytest.raises(UNREADABLE):
            read_npz(tmp_path / "x.part")
    large = {"descr": "<f8", "fortran_order": False, "shape": (10**12,)}
    with zipfile.ZipFile(tmp_path / "y.part", "w") as file, file.open("state.a.npy", "w") as member:
        np.lib.format.write_array_header_1_0(member, large)
    with pytest.raises(ValueError, match="claims more than it holds"):
        read_npz(tmp_path / "y.part")


def test_a_bomb_unpacks_to_no_more_than_its_header_claims(tmp_path):
    text = "NDims = 3\nDimSize = 2 2 2\nElementType = MET_UCHAR\nCompressedData = True\n"
    text += "ElementDataFile = LOCAL\n"
    (tmp_path / "x.mha").write_bytes(text.encode() + zeros(64))
    with pytest.raises(FileError, match="claims 8 bytes of voxels"):
        tb.read(tmp_path / "x.mha")


@pytest.mark.parametrize("path", [3, b"x.npy", None, ["x"], "a\0b", object()])
def test_what_is_no_path_is_refused_by_every_reader(path):
    for read in (tb.read, tb.load, tb.load_model, tb.read_mesh, tb.open_slabs, tb.rerun):
        with pytest.raises(InputError, match="is no path: give a string or a Path"):
            read(path)


@pytest.mark.parametrize("phase", [1.5, True, (1,), np.zeros(2), {}, object()])
def test_what_is_no_phase_is_refused(phase):
    with pytest.raises(InputError, match="is neither a name nor a number") as refused:
        tb.measure.components(LABELS, phase=phase)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("name", [np.zeros(2), [], {}, None])
def test_what_is_no_name_of_a_method_is_refused(name):
    with pytest.raises(UnknownNameError, match="unknown method"):
        tb.method(name)


def test_a_spacing_of_other_axes_is_refused():
    with pytest.raises(InputError, match="spacing"):
        tb.measure.variance_of_means(np.zeros((1, 8, 8, 8)), (4, 4, 4), spacing=(1.0, 2.0))


INSIDE = np.ones((4, 4, 4), bool)
BLOCK = np.pad(np.ones((8, 8, 8), np.uint8), 4)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: tb.measure.signed_distance(INSIDE, clip=np.zeros(2)), "clip"),
        (lambda: tb.write_layers(LABELS, "x", form="dlp", materials=np.zeros(2)), "materials is"),
        (
            lambda: tb.write_layers(
                tb.Image(BLOCK, "labels", 0.1, "mm"), "x", form="svg", only=(1,)
            ),
            "no pair of layers",
        ),
        (lambda: tb.choose_settings(LABELS, LABELS, effort=2), "method is ndarray"),
        (lambda: tb.measure.coating(LABELS, side=np.zeros(2)), "is no face"),
        (lambda: tb.Request(8, mask=np.zeros((8, 8, 8), "M8[s]")), "are no voxels"),
        (lambda: tb.measure.evenness(BLOCK, windows=4.0), "is no list"),
        (lambda: tb.segment(3), "image is int"),
        (lambda: tb.verify_ensemble(LABELS, [LABELS, LABELS], names=3), "names is int"),
        (lambda: tb.verify(LABELS, LABELS, names=3), "names is int"),
        (lambda: tb.measure.describe_physics(LABELS, halving=np.zeros(2)), "halving is"),
        (lambda: tb.measure.confidence(LABELS, names=np.zeros(2)), "names is"),
        (lambda: tb.measure.describe_texture(tb.Image(FLOATS, "grey"), lags=np.zeros(2)), "lags"),
        (lambda: tb.measure.measure_property(LABELS, 3.0), "unknown property"),
        (lambda: tb.measure.variance_of_means(np.zeros((1, 1, 1)), (4, 4)), "one voxel"),
        (lambda: tb.inspect(LABELS, origin=0.5), "origin is float"),
        (lambda: tb.render(LABELS, ("x", "y")), "is no path"),
    ],
)
def test_arguments_of_another_type_are_refused(call, words):
    with pytest.raises(InputError, match=words) as refused:
        call()
    assert "\n" not in str(refused.value)
