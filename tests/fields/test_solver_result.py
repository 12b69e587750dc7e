"""Results of solvers on voxels: formats, encodings, components, grids; damage and doubt."""

import base64
import zlib

import numpy as np
import pytest

import trabecula as tb
from trabecula.core.errors import FileError, InputError, UnknownNameError
from trabecula.fields import import_result

RNG = np.random.default_rng(4)
CUBE = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
PART = tb.Image(
    (RNG.random((3, 4, 5)) < 0.6).astype(np.uint8), "labels", spacing=(3.0, 2.0, 1.5), unit="um"
)
STRESS = RNG.normal(size=(int(PART.values.sum()), 6)).astype(np.float32)


def mesh(image):
    """Return corners (x, y, z) and bricks of the solid of an image, every brick with its own."""
    edges = np.array(image.spacing[::-1])
    at = np.argwhere(image.values == 1)[:, ::-1]
    points = ((at[:, None] + np.array(CUBE)) * edges).reshape(-1, 3)
    return points, np.arange(len(points)).reshape(-1, 8)


def packed(raw, order, width, size=64):
    """Return bytes as VTK packs them: counts, then blocks of zlib, each apart."""
    blocks = [raw[k : k + size] for k in range(0, len(raw), size)]
    squeezed = [zlib.compress(block) for block in blocks]
    last = len(raw) % size
    counts = [len(blocks), size, last, *map(len, squeezed)]
    return np.array(counts, f"{order}u{width}").tobytes(), b"".join(squeezed)


def write_vtu(
    path, points, cells, arrays, *, way="ascii", order="<", width=8, zipped=False, kind=12
):
    """Write a .vtu as other programs may: text, base64, appended raw or base64, packed or not."""
    tail = bytearray()

    def array(values, name):
        values = np.asarray(values)
        values = values.astype(values.dtype.newbyteorder(order))
        letter = {"f": "Float", "i": "Int", "u": "UInt"}[values.dtype.kind]
        more = f' NumberOfComponents="{values.shape[1]}"' if values.ndim == 2 else ""
        head = f'<DataArray type="{letter}{8 * values.itemsize}" Name="{name}"{more} '
        if way == "ascii":
            return f'{head}format="ascii">{" ".join(map(str, values.ravel().tolist()))}</DataArray>'
        raw = values.tobytes()
        parts = (
            packed(raw, order, width)
            if zipped
            else (b"", np.array([len(raw)], f"{order}u{width}").tobytes() + raw)
        )
        if way == "appended-raw":
            data, start = b"".join(parts), len(tail)
        else:
            data, start = b"".join(map(base64.b64encode, parts)), len(tail)
        if way == "binary":
            return f'{head}format="binary">\n{data.decode()}\n</DataArray>'
        tail.extend(data)
        return f'{head}format="appended" offset="{start}"/>'

    inside = "".join(
        f"<{place}>" + "".join(array(v, n) for n, v in named.items()) + f"</{place}>"
        for place, named in arrays.items()
    )
    count = len(cells)
    body = (
        f'<Piece NumberOfPoints="{len(points)}" NumberOfCells="{count}">'
        f"<Points>{array(points, 'Points')}</Points><Cells>{array(cells.ravel(), 'connectivity')}"
        f"{array(np.arange(1, count + 1) * cells.shape[1], 'offsets')}"
        f"{array(np.full(count, kind, np.uint8), 'types')}</Cells>{inside}</Piece>"
    )
    zipper = ' compressor="vtkZLibDataCompressor"' if zipped else ""
    end = {"<": "LittleEndian", ">": "BigEndian"}[order]
    text = (
        f'<?xml version="1.0"?><VTKFile type="UnstructuredGrid" version="1.0" byte_order="{end}" '
        f'header_type="UInt{8 * width}"{zipper}><UnstructuredGrid>{body}</UnstructuredGrid>'
    ).encode()
    if tail:
        code = "raw" if way == "appended-raw" else "base64"
        text += f'<AppendedData encoding="{code}">_'.encode() + bytes(tail) + b"</AppendedData>"
    path.write_bytes(text + b"</VTKFile>")
    return path


def mises(stress):
    xx, yy, zz, xy, yz, xz = stress.T.astype(float)
    shear = 6 * (xy**2 + yz**2 + xz**2)
    return np.sqrt(((xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2 + shear) / 2)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("width", [4, 8])
@pytest.mark.parametrize(
    ("way", "zipped"),
    [
        ("ascii", False),
        *((way, z) for way in ("binary", "appended-raw", "appended") for z in (0, 1)),
    ],
)
def test_every_encoding_of_a_vtu_gives_the_cells_back(tmp_path, way, zipped, order, width):
    points, cells = mesh(PART)
    arrays = {"CellData": {"stress": STRESS, "id": np.arange(len(cells))}}
    path = write_vtu(
        tmp_path / "x.vtu", points, cells, arrays, way=way, order=order, width=width, zipped=zipped
    )
    field = import_result(path, like=PART, array="stress", component="mises", fill=-1)
    solid = PART.values == 1
    np.testing.assert_allclose(field.values[solid], mises(STRESS), rtol=1e-5)
    assert (field.values[~solid] == -1).all()
    assert (field.spacing, field.unit) == (PART.spacing, "um")
    for at, name in enumerate(("xx", "yy", "zz", "xy", "yz", "xz")):
        one = import_result(path, like=PART, array="stress", component=name)
        np.testing.assert_array_equal(one.values[solid], STRESS[:, at])


def test_principal_values_and_the_mean_are_those_of_the_matrix(tmp_path):
    points, cells = mesh(PART)
    path = write_vtu(tmp_path / "x.vtu", points, cells, {"CellData": {"s": STRESS}})
    xx, yy, zz, xy, yz, xz = STRESS.T.astype(float)
    matrices = np.moveaxis(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]), 2, 0)
    values = np.linalg.eigvalsh(matrices)
    for name, want in (
        ("largest", values[:, 2]),
        ("smallest", values[:, 0]),
        ("mean", values.mean(1)),
    ):
        field = import_result(path, like=PART, component=name)
        np.testing.assert_allclose(field.values[PART.values == 1], want, rtol=1e-4, atol=1e-5)


def test_values_on_nodes_are_interpolated_to_the_middle_of_each_voxel(tmp_path):
    """A linear function is met exactly, by boxes, by skewed bricks and by tetrahedra."""
    points, cells = mesh(tb.Image(np.ones((3, 4, 5), np.uint8), "labels", PART.spacing, "um"))
    linear = points @ [2.0, -3.0, 0.5] + 7
    z, y, x = (
        (np.arange(n) + 0.5) * edge for n, edge in zip(PART.shape, PART.spacing, strict=True)
    )
    want = 2 * x - 3 * y[:, None] + 0.5 * z[:, None, None] + 7
    five = [(0, 1, 2, 5), (0, 2, 3, 7), (0, 5, 7, 4), (2, 7, 5, 6), (0, 2, 7, 5)]
    tetrahedra = np.concatenate([cells[:, four] for four in five])
    bent = points + 0.2 * np.sin(points @ [[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])
    bent_linear = bent @ [2.0, -3.0, 0.5] + 7
    for name, at, corners, values, kind in (
        ("boxes", points, cells, linear, 12),
        ("tetrahedra", points, tetrahedra, linear, 10),
        (
            "wedges",
            points,
            np.concatenate([cells[:, [0, 1, 2, 4, 5, 6]], cells[:, [0, 2, 3, 4, 6, 7]]]),
            linear,
            13,
        ),
        ("skewed", bent, cells, bent_linear, 12),
    ):
        path = write_vtu(
            tmp_path / f"{name}.vtu", at, corners, {"PointData": {"T": values}}, kind=kind
        )
        field = import_result(path, shape=PART.shape, spacing=PART.spacing, unit="um")
        inside = np.ones(PART.shape, bool)
        if name == "skewed":  # its outer faces are bent inwards here and there
            inside = field.values != 0
            assert inside.mean() > 0.9
        np.testing.assert_allclose(field.values[inside], want[inside], rtol=1e-5, err_msg=name)


def test_a_mesh_finer_or_coarser_than_the_voxels_covers_them(tmp_path):
    points, cells = mesh(PART)
    path = write_vtu(tmp_path / "x.vtu", points, cells, {"CellData": {"id": np.arange(len(cells))}})
    fine = import_result(path, shape=(6, 8, 10), spacing=(1.5, 1.0, 0.75), fill=-1)
    own = import_result(path, like=PART, fill=-1)
    np.testing.assert_array_equal(fine.values, own.values.repeat(2, 0).repeat(2, 1).repeat(2, 2))


def test_our_bricks_come_back_as_a_volume(tmp_path):
    three = tb.Image(
        RNG.integers(0, 3, (4, 5, 6)).astype(np.uint8),
        "labels",
        (2.0, 1.0, 0.5),
        "mm",
        phases=("void", "soft", "hard"),
    )
    path = tb.export(three, tmp_path / "x.vtu")
    back = tb.read(path)
    assert np.array_equal(back.values, three.values)
    assert (back.spacing, back.unit, back.phases) == (three.spacing, "mm", three.phases)
    one = tb.export(three, tmp_path / "hard.vtu", phase="hard")
    assert np.array_equal(tb.read(one).values, np.where(three.values == 2, 2, 0))
    assert np.array_equal(tb.read(path, dataset="material").values, three.values)
    grey = tb.read(path, dataset="material", kind="grey")
    assert np.array_equal(grey.values, np.where(three.values, three.values + 1, 0))


def test_bricks_of_other_programs_find_their_grid(tmp_path):
    points, cells = mesh(PART)
    arrays = {"CellData": {"density": STRESS[:, 0]}}
    path = write_vtu(tmp_path / "x.vtu", points + np.array([15.0, 8.0, -30.0]), cells, arrays)
    image = tb.read(path)
    low = np.argwhere(PART.values == 1).min(axis=0)
    want = np.zeros(PART.shape, np.float32)
    want[PART.values == 1] = STRESS[:, 0]
    cut = want[tuple(slice(start, None) for start in low)]
    sides = tuple(slice(0, side) for side in image.shape)
    np.testing.assert_allclose(image.spacing, PART.spacing)
    np.testing.assert_array_equal(image.values, cut[sides])
    skewed = write_vtu(tmp_path / "s.vtu", points * (1 + 0.02 * points), cells, arrays)
    with pytest.raises(InputError, match="several sizes"):
        tb.read(skewed)


def test_a_vti_of_several_arrays(tmp_path):
    path = tmp_path / "x.vti"
    a, u = RNG.random((2, 3, 4)), RNG.random((2, 3, 4, 3))
    nodes = RNG.random((3, 4, 5))

    def array(name, values, more=""):
        text = " ".join(map(repr, values.ravel().tolist()))
        return f'<DataArray type="Float64" Name="{name}"{more} format="ascii">{text}</DataArray>'

    path.write_text(
        '<VTKFile type="ImageData" byte_order="LittleEndian"><ImageData WholeExtent="0 4 0 3 0 2" '
        'Origin="0 0 0" Spacing="1 2 3"><Piece Extent="0 4 0 3 0 2"><CellData>'
        + array("a", a)
        + array("U", u, ' NumberOfComponents="3"')
        + f"</CellData><PointData>{array('n', nodes)}</PointData></Piece></ImageData></VTKFile>"
    )
    np.testing.assert_allclose(tb.read(path, dataset="a").values, a)
    with pytest.raises(InputError, match=r"several arrays .*--dataset"):
        tb.read(path)
    with pytest.raises(InputError, match="3 components: read one as a field"):
        tb.read(path, dataset="U")
    given = {"shape": (2, 3, 4), "spacing": (3, 2, 1)}
    field = import_result(path, **given, array="U", component="magnitude")
    np.testing.assert_allclose(field.values, np.linalg.norm(u, axis=-1), rtol=1e-6)
    middle = sum(
        nodes[i : i + 2, j : j + 3, k : k + 4] for i in (0, 1) for j in (0, 1) for k in (0, 1)
    )
    np.testing.assert_allclose(
        import_result(path, **given, array="n").values, middle / 8, rtol=1e-6
    )
    half = import_result(path, shape=(4, 6, 8), spacing=(1.5, 1, 0.5), array="a")
    np.testing.assert_allclose(half.values, a.repeat(2, 0).repeat(2, 1).repeat(2, 2), rtol=1e-6)


@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize("new", [False, True])
def test_legacy_vtk(tmp_path, binary, new):
    points, cells = mesh(PART)

    def numbers(values, kind):
        if binary:
            return np.asarray(values).astype(f">{kind}").tobytes() + b"\n"
        return (" ".join(map(str, np.asarray(values).ravel().tolist())) + "\n").encode()

    count = len(cells)
    old = np.column_stack([np.full(count, 8), cells])
    offsets = np.arange(count + 1) * 8
    raw = b"# vtk DataFile Version 5.1\ntitle\n" + (b"BINARY\n" if binary else b"ASCII\n")
    raw += b"DATASET UNSTRUCTURED_GRID\nFIELD FieldData 1\nTimeValue 1 1 float\n" + numbers(
        [2.5], "f4"
    )
    raw += f"POINTS {len(points)} double\n".encode() + numbers(points, "f8")
    if new:
        raw += f"CELLS {count + 1} {cells.size}\nOFFSETS vtktypeint64\n".encode()
        raw += numbers(offsets, "i8") + b"CONNECTIVITY vtktypeint64\n" + numbers(cells, "i8")
    else:
        raw += f"CELLS {count} {old.size}\n".encode() + numbers(old, "i4")
    raw += f"CELL_TYPES {count}\n".encode() + numbers(np.full(count, 12), "i4")
    raw += f"CELL_DATA {count}\nFIELD attributes 1\nU 3 {count} float\n".encode()
    raw += numbers(STRESS[:, :3], "f4")
    raw += f"POINT_DATA {len(points)}\nSCALARS T double\nLOOKUP_TABLE default\n".encode()
    raw += numbers(points[:, 2], "f8")
    path = tmp_path / "x.vtk"
    path.write_bytes(raw)
    field = import_result(path, like=PART, array="U", component="y")
    np.testing.assert_allclose(field.values[PART.values == 1], STRESS[:, 1], rtol=1e-6)
    height = import_result(path, like=PART, array="T")
    z = np.nonzero(PART.values)[0]
    np.testing.assert_allclose(height.values[PART.values == 1], (z + 0.5) * 3.0)
    path.write_bytes(raw[: int(0.7 * len(raw))])
    with pytest.raises((FileError, InputError)):
        import_result(path, like=PART, array="U", component="y")


def frd(points, cells, stress):
    """Return the text of an .frd as CalculiX writes it: fixed columns, numbers from 1."""
    lines = ["    1C", f"    2C{len(points):30d}{1:38d}"]
    for n, point in enumerate(points):
        lines.append(f" -1{n + 1:10d}" + "".join(f"{value:12.5E}" for value in point))
    lines += [" -3", f"    3C{len(cells):30d}{1:38d}"]
    for n, cell in enumerate(cells):
        lines.append(f" -1{n + 1:10d}    1    0    1")
        lines.append(" -2" + "".join(f"{node + 1:10d}" for node in cell))
    lines += [" -3"]
    for step in (0.5, 1.0):  # of two steps the last one counts
        lines += ["  100CL  101 1.000000000", " -4  DISP        4    1"]
        lines += [f" -5  D{k}          1    2    {k}    0" for k in (1, 2, 3)]
        lines += [" -5  ALL         1    2    0    0    1ALL"]
        for n, point in enumerate(points):
            row = step * point * [1, -2, 3]
            lines.append(f" -1{n + 1:10d}" + "".join(f"{value:12.5E}" for value in row))
        lines += [" -3"]
    lines += ["  100CL  101 1.000000000", " -4  STRESS      6    1"]
    lines += [
        f" -5  S{name}         1    4    1    1" for name in ("XX", "YY", "ZZ", "XY", "YZ", "ZX")
    ]
    for n, row in enumerate(np.repeat(stress, 8, axis=0)):
        lines.append(f" -1{n + 1:10d}" + "".join(f"{value:12.5E}" for value in row))
    return "\n".join([*lines, " -3", " 9999", ""])


def test_frd_of_calculix(tmp_path):
    points, cells = mesh(PART)
    path = tmp_path / "x.frd"
    text = frd(points, cells, -np.abs(STRESS))  # every number negative: they touch each other
    path.write_text(text)
    solid = PART.values == 1
    field = import_result(path, like=PART, array="STRESS", component="mises")
    np.testing.assert_allclose(field.values[solid], mises(-np.abs(STRESS)), rtol=2e-5)
    y = import_result(path, like=PART, array="DISP", component="y")
    np.testing.assert_allclose(y.values[solid], -2 * 2.0 * (np.nonzero(solid)[1] + 0.5), rtol=1e-5)
    path.write_text(text[: int(0.8 * len(text))])
    with pytest.raises(FileError, match="ends within a block"):
        import_result(path, like=PART, array="STRESS", component="mises")
    path.write_text(text.replace("E+0", "N+0", 3))
    with pytest.raises(FileError, match="CalculiX result"):
        import_result(path, like=PART, array="DISP", component="x")


def test_what_is_not_clear_is_refused(tmp_path):
    points, cells = mesh(PART)
    arrays = {"CellData": {"U": STRESS[:, :3], "p": STRESS[:, 3]}}
    path = write_vtu(tmp_path / "x.vtu", points, cells, arrays)
    with pytest.raises(InputError, match=r"several arrays: .*--array"):
        import_result(path, like=PART)
    with pytest.raises(InputError, match=r"x, y, z, magnitude .--component"):
        import_result(path, like=PART, array="U")
    with pytest.raises(UnknownNameError, match="unknown component of U 'mises'"):
        import_result(path, like=PART, array="U", component="mises")
    with pytest.raises(UnknownNameError, match="unknown array 'u'"):
        import_result(path, like=PART, array="u")
    with pytest.raises(InputError, match="needs a grid"):
        import_result(path)
    metres = write_vtu(tmp_path / "m.vtu", points * 1e-6, cells, arrays)
    with pytest.raises(InputError, match=r"no voxel lies in the mesh.*OpenFOAM's is m"):
        import_result(metres, like=PART, array="p")
    scaled = import_result(metres, like=PART, array="p", file_unit="m")
    np.testing.assert_array_equal(scaled.values, import_result(path, like=PART, array="p").values)
    holes = write_vtu(tmp_path / "n.vtu", points, cells, {"CellData": {"p": STRESS[:, 3] * np.nan}})
    with pytest.raises(InputError, match="NaN or infinite"):
        import_result(holes, like=PART)
    flat = write_vtu(tmp_path / "f.vtu", points, cells[:, :4], arrays, kind=9)
    with pytest.raises(InputError, match="take the volume, not its surface"):
        import_result(flat, like=PART, array="p")
    raw = path.read_bytes()
    for damaged in (
        raw[:-400],
        raw.replace(b'NumberOfCells="', b'NumberOfCells="9'),
        raw.replace(b'offsets"', b'offs"'),
    ):
        (tmp_path / "d.vtu").write_bytes(damaged)
        with pytest.raises(FileError):
            import_result(tmp_path / "d.vtu", like=PART, array="p")


def test_a_result_becomes_a_target_and_replays(tmp_path):
    """Extended outwards, spread over a range, written, and made again by its recipe."""
    points, cells = mesh(PART)
    path = write_vtu(tmp_path / "x.vtu", points, cells, {"CellData": {"p": STRESS[:, 3]}})
    field = import_result(path, like=PART, fill="extend")
    solid = PART.values == 1
    np.testing.assert_allclose(field.values[solid], STRESS[:, 3], rtol=1e-6)
    low, high = STRESS[:, 3].min(), STRESS[:, 3].max()
    assert (field.values >= low - 1e-6).all() and (field.values <= high + 1e-6).all()
    assert (field.values[~solid] != 0).all()
    target = tb.fields.rescale(field, low=0.2, high=0.4)
    tb.write(target, tmp_path / "target.zarr")
    again = tb.rerun(tmp_path / "target.zarr")
    assert np.array_equal(again.values, target.values)
    assert float(target.values.min()) == pytest.approx(0.2) and float(
        target.values.max()
    ) == pytest.approx(0.4)
