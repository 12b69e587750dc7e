"""Whole files of everything that the package reads, small, and the readers that take them."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import nibabel
import nrrd
import numpy as np
import tifffile
import trimesh

import trabecula as tb
from trabecula.core.image import Image, describe_fields
from trabecula.core.recipe import Recipe
from trabecula.core.request import Request
from trabecula.engine import checkpoint, store
from trabecula.engine.files import write_npz
from trabecula.engine.lazy_volume import Slabs
from trabecula.fields.topology import cases
from trabecula.io.formats import FORMATS
from trabecula.mesh.base import Mesh
from trabecula.mesh.formats import READABLE as SURFACES
from trabecula.pipeline.generate import resume
from trabecula.synth.api.model import Model

RNG = np.random.default_rng(11)
LABELS = RNG.integers(0, 3, (4, 5, 6)).astype(np.uint8)
FLOATS = RNG.normal(0, 9, (4, 5, 6)).astype(np.float32)
COLOUR = RNG.integers(0, 256, (5, 6, 3)).astype(np.uint8)
HALF = (LABELS > 0).astype(np.uint8)


@dataclass(frozen=True)
class Reader:
    """A sort of file: how a whole one is written, and how it is read.

    Parameters
    ----------
    name : str
    write : callable
        Folder -> the path that is read; other files of it may be beside it.
    read : callable
        Path -> what comes of it; an error of ours, or something that `check` takes.
    """

    name: str
    write: Callable[[Path], Path]
    read: Callable[[Path], Any]


def check(found: Any) -> None:
    """Raise AssertionError where what a reader gave is not sound."""
    if isinstance(found, Slabs):
        found = found.planes(0, found.shape[0])
    if isinstance(found, Image):
        axes = found.values.ndim - (found.kind == "colour")
        assert axes in (2, 3) and len(found.spacing) == axes, f"{axes} axes, {found.spacing}"
        assert found.values.dtype.kind in "biuf" and found.values.size
        assert np.isfinite(found.values).all() and np.isfinite(found.spacing).all()
        assert min(found.spacing) > 0
        if found.kind == "labels":
            assert found.values.max() < len(found.phases), "a label without a phase"
    elif isinstance(found, Mesh):
        assert np.isfinite(found.vertices).all() and len(found.faces)
        assert 0 <= found.faces.min() <= found.faces.max() < len(found.vertices)
    elif isinstance(found, Model):
        assert repr(found)


def image(values: np.ndarray, kind: str) -> Image:
    """Return an image that says all that an image can say."""
    ndim = values.ndim - (kind == "colour")
    recipe = Recipe().then("made", values, seed=3, note="n" * 40)
    return Image(values, kind, (3.0, 2.0, 0.5)[-ndim:], "um", recipe=recipe)


def _ours(name: str, values: np.ndarray, kind: str) -> Callable[[Path], Path]:
    """Return a function that writes an image with `tb.write`."""
    return lambda folder: Path(str(tb.write(image(values, kind), f"{folder}/{name}")))


def _volumes() -> list[Reader]:
    """Return a reader for every suffix in the table of formats, with the kinds that it holds."""
    found = []
    for form in FORMATS:
        for suffix in form.suffixes:
            flat = form.ndim == (2,)
            found.append(Reader(suffix, _ours(f"x{suffix}", COLOUR, "colour"), tb.read))
            if not form.lossy:
                values = LABELS[0] if flat else LABELS
                found.append(Reader(suffix, _ours(f"x{suffix}", values, "labels"), tb.read))
            if not flat:
                found.append(Reader(suffix, _ours(f"x{suffix}", FLOATS, "grey"), tb.read))
    found.append(Reader("slices", _ours("x/", LABELS, "labels"), tb.read))
    return found


def _foreign(name: str, make: Callable[[str], Any]) -> Reader:
    """Return the reader of a file that another program's library writes."""

    def write(folder: Path) -> Path:
        make(f"{folder}/{name}")
        return folder / name

    return Reader(name[1:], write, tb.read)


def _plain_zarr(path: str) -> None:
    import zarr

    zarr.save_array(path, LABELS)


def _vti(path: str) -> None:
    sides = " ".join(f"0 {side}" for side in LABELS.shape[::-1])
    Path(path).write_text(
        '<VTKFile type="ImageData" version="1.0" byte_order="BigEndian">'
        f'<ImageData WholeExtent="{sides}" Spacing="1 2 3"><Piece Extent="{sides}">'
        '<CellData Scalars="a"><DataArray type="Int16" Name="a" format="ascii">'
        + " ".join(map(str, LABELS.ravel()))
        + "</DataArray></CellData></Piece></ImageData></VTKFile>",
        encoding="ascii",
    )


def _mhd(path: str) -> None:
    FLOATS.astype(">f8").tofile(str(Path(path).with_suffix(".raw")))
    Path(path).write_text(
        "ObjectType = Image\nNDims = 3\nBinaryDataByteOrderMSB = True\nElementSpacing = 1 2 3\n"
        f"DimSize = {' '.join(map(str, FLOATS.shape[::-1]))}\nHeaderSize = -1\n"
        f"ElementType = MET_DOUBLE\nElementDataFile = {Path(path).stem}.raw\n",
        encoding="ascii",
    )


def _analyse(path: str) -> None:
    picture = nibabel.Nifti1Image(FLOATS.T.astype(">i2")[..., None], np.diag([3, 2, 5, 1]))
    picture.header.set_slope_inter(2, 1)
    nibabel.save(picture, path)


FOREIGN = [
    _foreign(
        "x.tif", lambda path: tifffile.imwrite(path, LABELS, imagej=True, metadata={"axes": "ZYX"})
    ),
    _foreign(
        "x.tif",
        lambda path: tifffile.imwrite(
            path, FLOATS.astype(">f4"), photometric="minisblack", byteorder=">", tile=(16, 16)
        ),
    ),
    _foreign(
        "x.tif",
        lambda path: tifffile.imwrite(
            path, FLOATS, ome=True, metadata={"axes": "ZYX", "PhysicalSizeX": 2.0}
        ),
    ),
    _foreign("x.npy", lambda path: np.save(path, np.asfortranarray(FLOATS.astype(">f8")))),
    _foreign("x.nii", _analyse),
    _foreign(
        "x.nrrd",
        lambda path: nrrd.write(path, FLOATS.T, {"encoding": "raw", "spacings": [1, 2, 3.0]}),
    ),
    _foreign("x.nrrd", lambda path: nrrd.write(path, LABELS.T, {"encoding": "ascii"})),
    _foreign("x.nrrd", lambda path: nrrd.write(path, LABELS.T, {"encoding": "bzip2"})),
    _foreign("x.vti", _vti),
    _foreign("x.mhd", _mhd),
    _foreign("x.zarr", _plain_zarr),
]


def _surface(name: str) -> Callable[[Path], Path]:
    """Return a function that writes a surface: this package, or trimesh what that alone reads."""
    if SURFACES[name].home != "by_trimesh":
        return lambda folder: Path(str(tb.export(image(HALF, "labels"), f"{folder}/x{name}")))

    def write(folder: Path) -> Path:
        body = trimesh.creation.box((1, 2, 3)).export(file_type=name[1:])
        for file, data in (body if isinstance(body, dict) else {f"x{name}": body}).items():
            place = folder / (f"x{name}" if file.endswith(name) else file)
            place.write_bytes(data.encode() if isinstance(data, str) else data)
        return folder / f"x{name}"

    return write


def _text(name: str, text: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        (folder / name).write_text(text, encoding="ascii")
        return folder / name

    return write


TETRAHEDRON = ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1))
FACES = ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))
STL = "solid x\n" + "".join(
    "facet normal 0 0 0\nouter loop\n"
    + "".join("vertex {} {} {}\n".format(*TETRAHEDRON[corner]) for corner in face)
    + "endloop\nendfacet\n"
    for face in FACES
)
PLY = (
    "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\n"
    "property float z\nelement face 4\nproperty list uchar int vertex_indices\nend_header\n"
    + "".join("{} {} {}\n".format(*point) for point in TETRAHEDRON)
    + "".join("3 {} {} {}\n".format(*face) for face in FACES)
)


def _mixed_ply(folder: Path) -> Path:
    """Write a binary PLY of triangles and a quadrangle, which is read row by row."""
    head = PLY[: PLY.index("end_header")].replace("ascii", "binary_big_endian")
    body = np.array(TETRAHEDRON, ">f4").tobytes()
    for face in (*FACES[:3], (1, 2, 3, 0)):
        body += bytes([len(face)]) + np.array(face, ">i4").tobytes()
    (folder / "x.ply").write_bytes(head.encode() + b"end_header\n" + body)
    return folder / "x.ply"


@cache
def _fitted(name: str) -> Model:
    if name == "lattice":
        return tb.method(name, cell_size=8.0).fit()
    voxels = np.tile(HALF, (3, 3, 3))
    if name == "noise":
        return tb.method(name, reach=4).fit(Image(voxels, "labels", 2.0, "um"))
    return tb.method(name).fit(Image(voxels[1], "labels", 2.0, "um"))


def _model(name: str) -> Callable[[Path], Path]:
    return lambda folder: Path(_fitted(name).save(folder / "x.model"))


@cache
def _lattice_step() -> dict[str, Any]:
    """Return the recipe's step of a small lattice."""
    return dict(_lattice().recipe.to_json()[-1])


@cache
def _lattice() -> Image:
    return tb.method("lattice", cell_size=4.0).fit().generate((4, 5, 6), seed=1)


def _made(folder: Path) -> Path:
    """Write a result whose recipe makes, crops and cleans it."""
    made = tb.finish.remove_floaters(tb.crop(_lattice(), (4, 4, 5)))
    return Path(str(tb.write(made, folder / "made.npy")))


def _read_from(folder: Path) -> Path:
    """Write a result whose recipe reads and segments another file."""
    np.save(folder / "scan.npy", FLOATS)
    made = tb.segment(tb.read(folder / "scan.npy"), 0.0)
    return Path(str(tb.write(made, folder / "made.npy")))


def _checkpoint(folder: Path) -> Path:
    """Write the state of a run, as `offer` does."""
    about = {
        "identity": checkpoint.identity_of("walk", {}, Request(4), ()),
        "stage": "coarse",
        "number": 2,
        "step": _lattice_step(),
    }
    arrays = {
        "state.field": FLOATS,
        "state.count": np.asarray(3),
        "about": np.frombuffer(json.dumps(about).encode(), np.uint8),
    }
    write_npz(folder / "x.npy.part", arrays)
    return folder / "x.npy.part"


def _resume_loop(path: Path) -> Any:
    with checkpoint.kept_at(path), checkpoint.running("walk", {}, Request(4), ()):
        return checkpoint.resume("coarse")


def _growing(folder: Path) -> Path:
    """Write a store of an unfinished run, as a run that was killed leaves it."""
    fields = {**describe_fields(_lattice()), "recipe": [_lattice_step()]}
    store.create_unfinished(
        folder / "x.zarr.part",
        (4, 5, 6),
        np.dtype("u1"),
        scale=(1, 1, 1),
        unit=None,
        fields=fields,
        identity="x",
        name="x",
        chunk=16,
        block=16,
    )
    return folder / "x.zarr.part"


def _case(folder: Path) -> Path:
    (folder / "x.json").write_text(json.dumps(cases.to_json(cases.case("cantilever"))))
    return folder / "x.json"


def _certificate(folder: Path) -> Path:
    found = {"verdict": "pass", "rows": [{"name": "porosity", "value": 0.5, "band": [0.4, 0.6]}]}
    (folder / "x.json").write_text(json.dumps(found))
    np.save(folder / "scan.npy", HALF)
    return folder / "x.json"


def _view_certificate(path: Path) -> None:
    """Show a certificate beside a volume, by the command line."""
    _command("view", path.parent / "scan.npy", "--certificate", path, "--html", "page.html")


def _target(folder: Path) -> Path:
    np.save(folder / "field.npy", np.full((4, 4, 4), 0.4))
    return folder / "field.npy"


def _plan_target(path: Path) -> None:
    """Take a file for the field of a target, by the command line."""
    _command("plan", "--method", "lattice", "--shape", "4", "--target", f"porosity={path}")


def _command(*words: object) -> None:
    """Run the command line: status 0, or 2 with one line."""
    from commands import attempt

    output = attempt(*words)
    assert output.status in (0, 2), f"exit status {output.status}: {output.err}"
    assert output.status == 0 or len(output.lines) == 1, output.err


OTHERS = [
    Reader("open_slabs", _ours("x.zarr", LABELS, "labels"), tb.open_slabs),
    Reader("open_slabs", _foreign("x.zarr", _plain_zarr).write, tb.open_slabs),
    *(Reader(f"mesh {suffix}", _surface(suffix), tb.read_mesh) for suffix in SURFACES),
    Reader("mesh .stl", _text("x.stl", STL + "endsolid x\n"), tb.read_mesh),
    Reader("mesh .ply", _text("x.ply", PLY), tb.read_mesh),
    Reader("mesh .ply", _mixed_ply, tb.read_mesh),
    *(Reader("model", _model(name), tb.load_model) for name in ("noise", "lattice", "kopf")),
    Reader("recipe", _made, tb.rerun),
    Reader("recipe", _read_from, tb.rerun),
    Reader("checkpoint", _checkpoint, _resume_loop),
    Reader("unfinished", _checkpoint, resume),
    Reader("unfinished", _growing, resume),
    Reader("case", _case, cases.case),
    Reader("certificate", _certificate, _view_certificate),
    Reader("target", _target, _plan_target),
]

READERS = [*_volumes(), *FOREIGN, *OTHERS]
