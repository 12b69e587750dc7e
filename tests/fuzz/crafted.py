"""Files made to harm: bombs, headers that lie, names that lead elsewhere, entities, circles."""

import gzip
import json
import struct
import zipfile
import zlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import nibabel
import numpy as np
from damage import LIES, deep
from specimens import FACES, LABELS, STL, TETRAHEDRON, Reader

import trabecula as tb
from trabecula.engine.checkpoint import step_in
from trabecula.fields.topology import cases

Rng = np.random.Generator
Make = Callable[[Rng, Path], None]


@cache
def zeros(mebibytes: int) -> bytes:
    """Return a zlib stream of so many MiB of zeros, a thousandth of their size."""
    packer = zlib.compressobj(9, wbits=-15)
    part = packer.compress(bytes(1 << 20)) + packer.flush(zlib.Z_FULL_FLUSH)
    adler = ((mebibytes << 20) % 65521) << 16 | 1
    return b"\x78\xda" + part * mebibytes + packer.flush() + struct.pack(">I", adler)


def lie(rng: Rng) -> int:
    """Return a size that no file has."""
    return LIES[int(rng.integers(len(LIES)))]


def sides(rng: Rng, count: int = 3) -> list[int]:
    """Return the sides of a volume, of which some lie."""
    return [lie(rng) if rng.random() < 0.6 else int(rng.integers(1, 9)) for _ in range(count)]


def npy(rng: Rng, path: Path) -> None:
    """Any type and shape in the header of .npy, which is an expression of Python."""
    kinds = ["<u2", ">f8", "|O", "|V8", "<U4", "<M8[ns]", "<c16", "|b1", "<f2", "<f16", "x", "<u0"]
    kinds += [[["a", "<u2"]], "|S0", "<i1", 7, None]
    shape: Any = tuple(sides(rng, int(rng.integers(0, 40))))
    shape = [shape, shape, shape, -1, None, "3", (2.5,), (True, 2, 2), ()][int(rng.integers(9))]
    kind = kinds[int(rng.integers(len(kinds)))]
    header = repr({"descr": kind, "fortran_order": bool(rng.integers(2)), "shape": shape})
    if rng.random() < 0.2:
        header = str(rng.choice([deep(rng), "-" * 5000 + "1", "9" * 9000, "()" * 3000, "'" * 9]))
    text = (header[:60_000] + "\n").encode()
    path.write_bytes(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + bytes(64))


def mhd(rng: Rng, path: Path) -> None:
    """A header whose voxels are elsewhere, or are other than it says."""
    places = [
        "../x.raw",
        "/etc/passwd",
        "/dev/zero",
        ".",
        "..",
        "x.mhd",
        "LIST",
        "%03d",
        "",
        "a\0b",
    ]
    places += ["LOCAL", "x.raw", "x" * 300, "~/.bashrc"]
    fields = {
        "NDims": int(rng.choice([3, 3, 2, 0, -1])),
        "DimSize": " ".join(map(str, sides(rng))),
        "ElementType": rng.choice(["MET_UCHAR", "MET_DOUBLE", "MET_UCHAR_ARRAY", "MET_NONE"]),
        "HeaderSize": lie(rng) * int(rng.choice([0, 1, -1])),
        "CompressedData": bool(rng.integers(2)),
        "ElementNumberOfChannels": rng.choice([1, 1, 3, 0, -1, 10**9]),
        "ElementSpacing": rng.choice(["1 1 1", "nan 1 1", "0 0 0", "1", "1e400 1 1"]),
        "ElementDataFile": str(rng.choice(places)),
    }
    (path.parent / "x.raw").write_bytes(bytes(120))
    text = "".join(f"{key} = {value}\n" for key, value in fields.items())
    path.write_bytes(text.encode() + zeros(64))


def mha_bomb(rng: Rng, path: Path) -> None:
    """A packed volume that is far larger than its header says."""
    side = int(rng.choice([1, 10, 400, 2000, 10**5]))
    text = f"NDims = 3\nDimSize = {side} {side} {side}\nElementType = MET_UCHAR\n"
    text += "CompressedData = True\nElementDataFile = LOCAL\n"
    path.write_bytes(text.encode() + zeros(int(rng.choice([1, 64, 300]))))


def nrrd(rng: Rng, path: Path) -> None:
    """A header of NRRD with any sizes, encodings, skips and places."""
    fields = {
        "type": rng.choice(["uint8", "double", "block", "int", "x"]),
        "dimension": rng.choice([3, 3, 3, 0, -1, 16, 10**9]),
        "sizes": " ".join(map(str, sides(rng))),
        "encoding": str(rng.choice(["gzip", "raw", "bzip2", "ascii", "hex", "txt", "x"])),
        "endian": rng.choice(["little", "big", "middle"]),
    }
    extra = {
        "line skip": lie(rng),
        "byte skip": rng.choice([-1, -(10**9), lie(rng)]),
        "data file": rng.choice(
            ["../x", "/dev/zero", "LIST", "x%d.raw 1 10000000 1", "x.nrrd", ""]
        ),
        "kinds": rng.choice(["domain domain domain", "RGB-color domain domain", "x"]),
        "space directions": rng.choice(["none none none", "(1,0,0) (0,nan,0) (0,0,1)", "((("]),
        "spacings": rng.choice(["nan nan nan", "1 2", "0 -1 1e400"]),
        "units": rng.choice(['"mm" "mm" "mm"', '"mm"', '"']),
        "block size": lie(rng),
    }
    chosen = [name for name in extra if rng.random() < 0.2]
    fields |= {name: extra[name] for name in chosen}
    text = "".join(f"{key}: {value}\n" for key, value in fields.items())
    packed = gzip.compress(bytes(1 << 16)) if rng.random() < 0.5 else b"\x1f\x8b\x08\0" + bytes(6)
    path.write_bytes(b"NRRD0004\n" + text.encode() + b"\n" + packed + zeros(64))


def nifti(rng: Rng, path: Path) -> None:
    """A header of NIfTI with any sides, offsets, scales and extensions."""
    header = nibabel.Nifti1Header()
    header.set_data_shape((4, 5, 6))
    header["datatype"] = rng.choice([2, 4, 8, 16, 64, 32, 128, 2304, 1, 0, 1792, 777])
    header["bitpix"] = rng.choice([8, 16, 1, 0])
    count = int(rng.integers(0, 8))
    header["dim"] = [count, *(int(side) % 65536 - 32768 for side in sides(rng, 7))]
    if rng.random() < 0.5:
        header["dim"] = [3, *rng.choice([1, 5, 700, 32767], 3), 1, 1, 1, 1]
    header["magic"] = rng.choice([b"n+1", b"ni1", b""])
    header["vox_offset"] = rng.choice([352, 0, -1, 1e9, np.nan, 1e30])
    header["scl_slope"] = rng.choice([1, 0, np.nan, np.inf, 1e38])
    header["pixdim"] = rng.choice([1, 0, -1, np.nan, np.inf, 1e38], 8)
    extension = struct.pack("<4B2i", 1, 0, 0, 0, int(rng.choice([16, 0, -1, 2**31 - 1])), 6)
    path.write_bytes(header.binaryblock + extension + bytes(5000))


def nifti_bomb(rng: Rng, path: Path) -> None:
    """A packed NIfTI of gigabytes in its header or in its stream."""
    path.write_bytes(_packed_nifti(int(rng.choice([10, 300, 30000])), int(rng.choice([1, 300]))))


@cache
def _packed_nifti(side: int, mebibytes: int) -> bytes:
    header = nibabel.Nifti1Header()
    header.set_data_shape((side, side, side))
    header["magic"], header["vox_offset"] = b"n+1", 352
    packer = zlib.compressobj(1, wbits=31)
    data = packer.compress(header.binaryblock + bytes(4))
    data += b"".join(packer.compress(bytes(1 << 20)) for _ in range(mebibytes))
    return data + packer.flush()


def png(rng: Rng, path: Path) -> None:
    """A PNG whose pixels, texts or profile are bombs, or whose head lies."""
    bomb = zeros(int(rng.choice([1, 64, 300])))
    head = [lie(rng) % 2**32, lie(rng) % 2**32] if rng.random() < 0.5 else [6, 5]
    depth, colour = rng.choice([1, 2, 4, 8, 16, 3]), rng.choice([0, 2, 3, 4, 6, 1])
    extra = {
        b"IDAT": bomb,
        b"zTXt": b"trabecula\0\0" + bomb,
        b"iTXt": b"trabecula\0\1\0\0\0" + bomb,
        b"iCCP": b"x\0\0" + bomb,
        b"tEXt": b"trabecula\0" + b'{"trabecula"' + deep(rng).encode(),
        b"tRNS": bytes(256),
        b"PLTE": bytes(int(rng.choice([0, 3, 768, 769]))),
        b"pHYs": struct.pack(">IIB", lie(rng) % 2**32, lie(rng) % 2**32, 1),
        b"acTL": struct.pack(">II", lie(rng) % 2**32, 0),
    }
    chosen = rng.choice(len(extra), 2)
    chunks = [b"IHDR" + struct.pack(">IIBBBBB", *head, depth, colour, 0, 0, rng.integers(2))]
    chunks += [name + extra[name] for name in (list(extra)[k] for k in chosen)]
    chunks += [b"IDAT" + zlib.compress(bytes(200)), b"IEND"]
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n"
        + b"".join(
            struct.pack(">I", len(chunk) - 4) + chunk + struct.pack(">I", zlib.crc32(chunk))
            for chunk in chunks
        )
    )


def tiff(rng: Rng, path: Path) -> None:
    """Directories of TIFF that lie, run in a circle, or unpack to gigabytes."""
    packed = zeros(int(rng.choice([1, 64, 300]))) if rng.random() < 0.3 else bytes(64)
    at = 8 + len(packed)
    width, height = (int(rng.choice([1, 6, 20000, lie(rng) % 2**32])) for _ in range(2))
    entries = [
        (254, 4, 1, 0),
        (256, 4, 1, width),
        (257, 4, 1, height),
        (258, 3, 1, int(rng.choice([8, 1, 16, 12, 64, 0, 65535]))),
        (259, 3, 1, int(rng.choice([1, 8, 5, 7, 32773, 34925, 50000, 0]))),
        (262, 3, 1, int(rng.choice([1, 0, 2, 3, 6, 99]))),
        (270, 2, int(rng.choice([20, lie(rng) % 2**32])), 8),
        (273, 4, int(rng.choice([1, 1, lie(rng) % 2**32])), int(rng.choice([8, lie(rng) % 2**32]))),
        (277, 3, 1, int(rng.choice([1, 3, 0, 5, 65535]))),
        (278, 4, 1, int(rng.choice([height, 1, 0]))),
        (
            279,
            4,
            int(rng.choice([1, 1, 1000])),
            int(rng.choice([len(packed), 0, lie(rng) % 2**32])),
        ),
        (284, 3, 1, int(rng.choice([1, 2, 3]))),
        (65000, 2, int(rng.choice([40, lie(rng) % 2**32])), int(rng.choice([8, 0]))),
    ]
    entries = [entry for entry in entries if rng.random() < 0.95]
    follow = int(rng.choice([0, at, 8, lie(rng) % 2**32]))
    path.write_bytes(
        b"II*\0"
        + struct.pack("<I", at)
        + packed
        + struct.pack("<H", len(entries))
        + b"".join(struct.pack("<HHII", *entry) for entry in entries)
        + struct.pack("<I", follow)
    )


def bmp(rng: Rng, path: Path) -> None:
    """A head of BMP with any sides, depths and runs of equal pixels."""
    width, height = (int(rng.choice([6, -5, lie(rng)])) for _ in range(2))
    info = struct.pack(
        "<IIIHHIIIIII",
        int(rng.choice([40, 12, 124, 0])),
        width % 2**32,
        height % 2**32,
        1,
        int(rng.choice([1, 4, 8, 24, 32, 16, 0])),
        int(rng.choice([0, 1, 2, 3, 9])),
        0,
        lie(rng) % 2**32,
        0,
        lie(rng) % 2**32,
        0,
    )
    path.write_bytes(b"BM" + struct.pack("<IHHI", 200, 0, 0, 54) + info + rng.bytes(500))


def vti(rng: Rng, path: Path) -> None:
    """Extents that lie, blocks that are bombs, entities that multiply."""
    extent = " ".join(f"0 {side}" for side in sides(rng))
    if rng.random() < 0.3:
        entities = '<!DOCTYPE x [<!ENTITY a "lol">' + "".join(
            f'<!ENTITY {b} "{f"&{a};" * 10}">' for a, b in zip("abcdefgh", "bcdefghi", strict=True)
        )
        outside = '<!DOCTYPE x [<!ENTITY i SYSTEM "file:///etc/passwd">'
        path.write_text(f"{rng.choice([entities, outside])}]><VTKFile>&i;</VTKFile>")
        return
    bomb = zeros(int(rng.choice([1, 300])))
    counts = [int(rng.choice([1, 2, 10**6, lie(rng) % 2**64])), lie(rng) % 2**64, lie(rng) % 2**64]
    if rng.random() < 0.5:
        extent, counts = "0 10 0 10 0 10", [1, 1000, 0]
    head = struct.pack("<4Q", *counts, len(bomb))
    text = f"""<VTKFile type="ImageData" byte_order="LittleEndian" header_type="UInt64"
    compressor="vtkZLibDataCompressor"><ImageData WholeExtent="{extent}" Spacing="1 nan 1">
    <Piece Extent="{extent}"><CellData Scalars="a">
    <DataArray type="UInt8" Name="a" NumberOfComponents="{rng.choice([1, 3, 0, -1])}"
    format="appended" offset="{rng.choice([0, 0, -1, 10**9])}"/></CellData></Piece></ImageData>
    <AppendedData encoding="raw">_"""
    path.write_bytes(text.encode() + head + bomb + b"</AppendedData></VTKFile>")


def zarr(rng: Rng, path: Path) -> None:
    """A store whose description lies, leads out of it, or asks for codecs that are none."""
    tb.write(tb.Image(LABELS, "labels"), path)
    file = path / str(rng.choice(["zarr.json", "0/zarr.json"]))
    text = json.loads(file.read_text())
    if "shape" in text:
        way = int(rng.integers(6))
        grid = text["chunk_grid"]["configuration"]
        if way == 0:
            text["shape"] = sides(rng, int(rng.integers(0, 6)))
        elif way == 1:
            grid["chunk_shape"] = sides(rng)
        elif way == 2:
            text["data_type"] = str(rng.choice(["float64", "bool", "string", "r24", "complex64"]))
        elif way == 3:
            text["codecs"] = [
                {"name": str(rng.choice(["gzip", "x", "bytes"])), "configuration": {}}
            ]
        elif way == 4:
            text["fill_value"] = [None, "NaN", -1, 10**30, "x"][int(rng.integers(5))]
        else:
            text["shape"] = grid["chunk_shape"] = [5000, 5000, 5000]
    else:
        names = ["../../x", "/etc", "..", "1", "", "0/../0", "zarr.json", 7, None, "0" * 3000]
        for scale in text["attributes"]["ome"]["multiscales"]:
            for dataset in scale["datasets"]:
                dataset["path"] = names[int(rng.integers(len(names)))]
                if rng.random() < 0.3:
                    dataset["coordinateTransformations"] = [{"type": "scale", "scale": [0, "x"]}]
            if rng.random() < 0.3:
                scale["axes"] = [{"name": "t"}] * int(rng.integers(9))
    file.write_text(json.dumps(text))


def slices(rng: Rng, path: Path) -> None:
    """A folder of slices that are too many, in circles, or bombs."""
    path.mkdir()
    for number in range(int(rng.integers(1, 6))):
        name = path / f"slice_{'9' * int(rng.choice([1, 3, 200]))}{number}.png"
        if rng.random() < 0.3:
            name.symlink_to(str(rng.choice(["..", name.name, "/dev/zero", "/dev/null", "nowhere"])))
        elif rng.random() < 0.3:
            name.mkdir()
        else:
            png(rng, name)


def stl(rng: Rng, path: Path) -> None:
    """A count that lies, numbers that are none, or text that never ends."""
    ways = [
        bytes(80) + struct.pack("<I", lie(rng) % 2**32) + bytes(50),
        bytes(80) + struct.pack("<I", 2) + rng.bytes(100),
        bytes(80) + struct.pack("<I", 2) + struct.pack("<f", np.nan) * 25,
        bytes(80) + struct.pack("<I", 0),
        STL.encode() + b"endsolid",
        STL.replace("1", str(rng.choice(["nan", "1e999", "x", "9" * 9999]))).encode() + b"endsolid",
        b"solid" + b"facet vertex " * 20_000,
        b"facet " + b"vertex" * 20_000 + b" " * 50_000 + b"endsolid",
    ]
    path.write_bytes(ways[int(rng.integers(len(ways)))])


def ply(rng: Rng, path: Path) -> None:
    """Rows without end, lists of negative length, columns twice."""
    rows, faces = (int(rng.choice([4, 0, lie(rng)])) for _ in range(2))
    order = rng.choice(["ascii", "binary_little_endian", "binary_big_endian"])
    count = rng.choice(["uchar", "char", "int", "uint", "float", "double"])
    columns = "".join(
        f"property {rng.choice(['float', 'char', 'double'])} {axis}\n" for axis in "xyz"
    )
    columns = columns if rng.random() < 0.8 else ""
    lists = f"property list {count} int vertex_indices\n" if rng.random() < 0.8 else ""
    head = f"ply\nformat {order} 1.0\nelement vertex {rows}\n{columns}"
    head += f"element {rng.choice(['face', 'strange'])} {faces}\n{lists}end_header\n"
    if order == "ascii":
        numbers = [*np.ravel(TETRAHEDRON), *(n for face in FACES for n in (3, *face))]
        texts = [str(n) for n in numbers]
        texts[rng.integers(len(texts))] = str(rng.choice(["-1", "nan", "9" * 5000, "1e9", "x"]))
        body = " ".join(texts).encode()
    else:
        body = np.array(TETRAHEDRON, "<f4").tobytes() + rng.bytes(200)
        if rng.random() < 0.5:
            body += b"\xff" * 200
    path.write_bytes(head.encode() + body)


def obj(rng: Rng, path: Path) -> None:
    """Faces of vertices that are not there, numbers that are none, faces of a million corners."""
    text = "".join("v {} {} {}\n".format(*point) for point in TETRAHEDRON)
    faces = ["f 1 2 3", "f 1 2 9", "f -1 -2 -3", "f -9 1 2", "f 0 1 2", "f 1", "f", "f 1//2 2/1 3"]
    faces += ["f a b c", "f 1.5 2 3", f"f {'9' * 5000} 1 2", "f " + "1 2 3 " * 10_000, "v nan 0 0"]
    faces += ["v 1 2", "v", "v 1e999 0 0", "# unit \xff", "f 99999999999999999999 1 2"]
    text += "\n".join(faces[k] for k in rng.integers(len(faces), size=3)) + "\n"
    path.write_bytes(text.encode("latin-1"))


def threemf(rng: Rng, path: Path) -> None:
    """Components in circles or in powers of ten, transforms that are none, bombs, entities."""
    corners = "".join('<vertex x="{}" y="{}" z="{}"/>'.format(*p) for p in TETRAHEDRON)
    triangles = "".join('<triangle v1="{}" v2="{}" v3="{}"/>'.format(*face) for face in FACES)
    mesh = f"<mesh><vertices>{corners}</vertices><triangles>{triangles}</triangles></mesh>"
    move = str(rng.choice(["1 0 0 0 1 0 0 0 1 0 0 0", "nan " * 12, "0 " * 12, "1", "1e200 " * 12]))
    ten = "".join(f'<component objectid="{{}}" transform="{move}"/>' for _ in range(10))
    tree = "".join(
        f'<object id="{n}"><components>{ten.replace("{}", str(n - 1))}</components></object>'
        for n in range(2, int(rng.choice([3, 5, 12, 40])))
    )
    circle = '<object id="2"><components><component objectid="2"/></components></object>'
    inner = str(rng.choice([tree, circle, "<object/>", ""]))
    last = str(rng.choice(["1", "2", "4", "11", "39", "x", ""]))
    text = (
        '<model unit="{}" xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02">'
        f'<resources><object id="1">{mesh}</object>{inner}</resources>'
        f'<build><item objectid="{last}" transform="{move}"/></build></model>'
    ).replace("{}", str(rng.choice(["millimeter", "foot", "parsec", ""])))
    way = rng.random()
    if way < 0.15:
        text = ""
    elif way < 0.3:
        text = '<!DOCTYPE x [<!ENTITY a SYSTEM "/etc/passwd">]><model>&a;</model>'
    elif way < 0.4:
        text = "<a>" * 100_000
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as package:
        name = rng.choice(["3D/3dmodel.model", "../../x.model", "/x.model", "x.txt"])
        with package.open(str(name), "w") as part:
            part.write(text.encode())
            for _ in range(0 if text else 512):
                part.write(bytes(1 << 20))


def npz(rng: Rng, path: Path) -> None:
    """A checkpoint whose members lie, lead elsewhere, or are bombs."""
    about = {"identity": "x", "stage": "coarse", "number": 1, "step": {"verb": "generate"}}
    text = json.dumps(about) if rng.random() < 0.5 else deep(rng)
    whole = repr({"descr": "|u1", "fortran_order": False, "shape": (len(text),)})
    shape = tuple(sides(rng, int(rng.integers(0, 4))))
    kinds = ["<u2", "|O", "<f8", "|b1", "<U2"]
    lying = {"descr": str(rng.choice(kinds)), "fortran_order": False, "shape": shape}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name, header, body in (
            ("about", whole, text.encode()),
            (str(rng.choice(["state.a", "../state.a", "/state.a"])), repr(lying), bytes(100)),
            ("about" if rng.random() < 0.2 else "b", repr(lying), bytes(1 << 20)),
        ):
            head = (header + "\n").encode()
            magic = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head))
            file.writestr(name + ".npy", magic + head + body)


def tensors(rng: Rng, path: Path) -> None:
    """A model whose header lies of its arrays, or is JSON without end."""
    about = {"format": 1, "method": "noise", "settings": {}, "exemplars": [], "history": {}}
    about["format"] = int(rng.choice([1, 1, 2, -1]))
    about["method"] = [["x"], "noise", "nothing", None, {}][int(rng.integers(5))]
    words = json.dumps(about) if rng.random() < 0.7 else deep(rng)
    entry = {
        "dtype": str(rng.choice(["F32", "U8", "BF16", "x", "F8_E4M3"])),
        "shape": sides(rng, int(rng.integers(0, 40))),
        "data_offsets": [0, int(rng.choice([64, lie(rng)]))],
    }
    header = json.dumps({"__metadata__": {"trabecula": words}, "learned.a": entry})
    if rng.random() < 0.3:
        header = deep(rng)
    length = int(rng.choice([len(header), len(header), lie(rng) % 2**63]))
    path.write_bytes(struct.pack("<Q", length) + header.encode() + bytes(64))


def case(rng: Rng, path: Path) -> None:
    """A case whose sides, boxes and forces are none."""
    whole = cases.to_json(cases.case("cantilever"))
    whole["shape"] = sides(rng, int(rng.choice([3, 3, 0, 5])))
    whole["volume_fraction"] = [0, 1, -1, 1e400, "x", None][int(rng.integers(6))]
    path.write_text(json.dumps(whole) if rng.random() < 0.7 else deep(rng))


def _crafted(name: str, file: str, make: Make, read: Callable[[Path], Any]) -> tuple[Reader, Make]:
    """Return the reader of a file that `make` writes from random numbers."""
    return Reader(name, lambda folder: folder / file, read), make


def _volume(file: str, make: Make) -> tuple[Reader, Make]:
    return _crafted(file.removeprefix("x"), file, make, tb.read)


def _surface(file: str, make: Make) -> tuple[Reader, Make]:
    return _crafted(file.replace("x.", "mesh ."), file, make, tb.read_mesh)


CRAFTED = [
    _volume("x.npy", npy),
    _volume("x.mhd", mhd),
    _volume("x.mha", mha_bomb),
    _volume("x.nrrd", nrrd),
    _volume("x.nii", nifti),
    _volume("x.nii.gz", nifti_bomb),
    _volume("x.png", png),
    _volume("x.tif", tiff),
    _volume("x.bmp", bmp),
    _volume("x.vti", vti),
    _volume("x.zarr", zarr),
    _crafted("open_slabs", "x.zarr", zarr, tb.open_slabs),
    _crafted("slices", "x", slices, tb.read),
    _surface("x.stl", stl),
    _surface("x.ply", ply),
    _surface("x.obj", obj),
    _surface("x.3mf", threemf),
    _crafted("model", "x.model", tensors, tb.load_model),
    _crafted("checkpoint", "x.part", npz, step_in),
    _crafted("case", "x.json", case, cases.case),
]
