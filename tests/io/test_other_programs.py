"""Files as other programs write and read them: the formats' own libraries, and files laid out by
hand.
"""

import base64
import struct
import zlib

import nibabel
import nrrd
import numpy as np
import pytest
import tifffile
from io_images import grey_ramp
from PIL import Image as Picture

import trabecula as tb
from trabecula.core.errors import FileError, InputError

RAMP = grey_ramp().values


def test_imagej_reads_ours(tmp_path):
    path = tb.write(grey_ramp(), tmp_path / "x.tif")
    with tifffile.TiffFile(path) as tiff:
        assert tiff.is_imagej and tiff.series[0].axes == "ZYX"
        assert tiff.imagej_metadata["spacing"] == 2.5 and tiff.imagej_metadata["unit"] == "um"
        page = tiff.pages[0]
        x, y = page.tags["XResolution"].value, page.tags["YResolution"].value
        assert x[1] / x[0] == pytest.approx(0.3) and y[1] / y[0] == pytest.approx(0.1)
        assert page.compression.name == "ADOBE_DEFLATE"
    labels = tb.write(np.eye(3, dtype=np.uint8), tmp_path / "l.tif")
    with tifffile.TiffFile(labels) as tiff:
        # else 1 shows as black
        assert (tiff.imagej_metadata["min"], tiff.imagej_metadata["max"]) == (0.0, 1.0)


def test_ome_reads_ours(tmp_path):
    path = tb.write(grey_ramp("int32"), tmp_path / "x.tif")
    with tifffile.TiffFile(path) as tiff:
        pixels = tifffile.xml2dict(tiff.ome_metadata)["OME"]["Image"]["Pixels"]
        assert [pixels[f"PhysicalSize{axis}"] for axis in "XYZ"] == [0.3, 0.1, 2.5]
        assert pixels["PhysicalSizeZUnit"] == "µm"
        np.testing.assert_array_equal(tiff.asarray(), RAMP)


def test_imagej_and_ome_files_are_read(tmp_path):
    stack = {"axes": "ZYX", "spacing": 4.0, "unit": "\\u00B5m"}
    tifffile.imwrite(tmp_path / "ij.tif", RAMP, imagej=True, resolution=(2.0, 5.0), metadata=stack)
    image = tb.read(tmp_path / "ij.tif")
    assert image.spacing == (4.0, 0.2, 0.5) and image.unit == "um" and image.kind == "grey"
    sizes = {
        "PhysicalSizeX": 500.0,
        "PhysicalSizeXUnit": "nm",
        "PhysicalSizeY": 0.25,
        "PhysicalSizeZ": 2.0,
    }
    tifffile.imwrite(tmp_path / "ome.tif", RAMP, ome=True, metadata={"axes": "ZYX", **sizes})
    image = tb.read(tmp_path / "ome.tif")
    assert image.spacing == pytest.approx((2000.0, 250.0, 500.0)) and image.unit == "nm"
    tifffile.imwrite(
        tmp_path / "cm.tif", RAMP[0], resolution=(50, 100), resolutionunit="CENTIMETER"
    )
    assert (
        tb.read(tmp_path / "cm.tif").spacing == (0.01, 0.02)
        and tb.read(tmp_path / "cm.tif").unit == "cm"
    )
    tifffile.imwrite(tmp_path / "dpi.tif", RAMP[0], resolution=(72, 72), resolutionunit="INCH")
    assert tb.read(tmp_path / "dpi.tif").unit == "voxel"  # a print size says nothing of a specimen


def test_tiff_of_many_makes(tmp_path):
    rgb = np.arange(3 * 4 * 5 * 3, dtype=np.uint8).reshape(3, 4, 5, 3)
    tifffile.imwrite(
        tmp_path / "planar.tif", np.moveaxis(rgb, -1, 1), photometric="rgb", planarconfig="separate"
    )
    image = tb.read(tmp_path / "planar.tif")
    assert image.kind == "colour"
    np.testing.assert_array_equal(image.values, rgb)
    tifffile.imwrite(
        tmp_path / "big.tif",
        RAMP.astype(">u2"),
        byteorder=">",
        bigtiff=True,
        tile=(16, 16),
        photometric="minisblack",
    )
    np.testing.assert_array_equal(tb.read(tmp_path / "big.tif").values, RAMP)
    tifffile.imwrite(tmp_path / "white.tif", RAMP[0].astype("u1"), photometric="miniswhite")
    np.testing.assert_array_equal(
        tb.read(tmp_path / "white.tif").values, 255 - RAMP[0].astype("u1")
    )
    pages = [Picture.fromarray(plane.astype("u1")) for plane in RAMP]
    pages[0].save(
        tmp_path / "lzw.tif", save_all=True, append_images=pages[1:], compression="tiff_lzw"
    )
    np.testing.assert_array_equal(tb.read(tmp_path / "lzw.tif").values, RAMP.astype("u1"))


def test_tiff_of_times_and_channels_is_refused(tmp_path):
    tifffile.imwrite(
        tmp_path / "t.tif", np.zeros((2, 3, 4, 5), np.uint8), imagej=True, metadata={"axes": "TZYX"}
    )
    with pytest.raises(InputError, match="T 2, Z 3, Y 4, X 5"):
        tb.read(tmp_path / "t.tif")


def test_nifti_both_ways(tmp_path):
    path = tb.write(grey_ramp(), tmp_path / "x.nii.gz")
    picture = nibabel.load(path)
    np.testing.assert_array_equal(np.asarray(picture.dataobj), RAMP.T)
    assert picture.header.get_zooms() == pytest.approx((0.3, 0.1, 2.5))
    assert picture.header.get_xyzt_units()[0] == "micron"
    np.testing.assert_allclose(np.diag(picture.affine), [0.3, 0.1, 2.5, 1], rtol=1e-6)
    other = nibabel.Nifti1Image(RAMP.T.astype(">i2")[..., None], np.diag([3, 2, 5, 1]))
    other.header.set_xyzt_units("mm")
    other.header.set_slope_inter(1, 0)
    nibabel.save(other, tmp_path / "y.nii")
    image = tb.read(tmp_path / "y.nii")
    np.testing.assert_array_equal(image.values, RAMP)
    assert (
        image.spacing == (5.0, 2.0, 3.0)
        and image.unit == "mm"
        and image.values.dtype == np.dtype("=i2")
    )
    # which the header has no word for
    nanometres = tb.Image(RAMP, "grey", spacing=500.0, unit="nm")
    assert nibabel.load(
        tb.write(nanometres, tmp_path / "n.nii")
    ).header.get_zooms() == pytest.approx((0.5,) * 3)


def test_nrrd_both_ways(tmp_path):
    values, header = nrrd.read(str(tb.write(grey_ramp(), tmp_path / "x.nrrd")))
    np.testing.assert_array_equal(values, RAMP.T)
    assert header["spacings"].tolist() == [0.3, 0.1, 2.5] and header["units"] == ["um"] * 3
    oblique = {
        "space": "left-posterior-superior",
        "space directions": np.array([[0, 3, 4], [2, 0, 0], [0, 0, 7.0]]),
    }
    nrrd.write(
        str(tmp_path / "y.nrrd"),
        RAMP.T,
        {**oblique, "space units": ["mm", "mm", "mm"], "encoding": "raw"},
    )
    image = tb.read(tmp_path / "y.nrrd")
    np.testing.assert_array_equal(image.values, RAMP)
    assert image.spacing == (7.0, 2.0, 5.0) and image.unit == "mm"


@pytest.mark.parametrize("local", [True, False])
@pytest.mark.parametrize("packed", [True, False])
@pytest.mark.parametrize(
    ("element", "dtype"), [("MET_SHORT", "i2"), ("MET_DOUBLE", "f8"), ("MET_UCHAR", "u1")]
)
@pytest.mark.parametrize("order", ["<", ">"])
def test_metaimage_by_hand(local, packed, element, dtype, order, tmp_path):
    raw = RAMP.astype(order + dtype).tobytes()
    raw = zlib.compress(raw) if packed else raw
    lines = [
        "ObjectType = Image",
        "NDims = 3",
        "DimSize = 5 4 3",
        "ElementSpacing = 0.3 0.1 2.5",
        "BinaryData = True",
    ]
    lines += [
        f"BinaryDataByteOrderMSB = {order == '>'}",
        f"CompressedData = {packed}",
        f"ElementType = {element}",
    ]
    lines += [f"ElementDataFile = {'LOCAL' if local else 'voxels.zraw'}", ""]
    path = tmp_path / ("x.mha" if local else "x.mhd")
    path.write_bytes("\n".join(lines).encode() + (raw if local else b""))
    (tmp_path / "voxels.zraw").write_bytes(b"" if local else raw)
    image = tb.read(path, kind="grey")
    np.testing.assert_array_equal(image.values, RAMP.astype(dtype))
    assert image.spacing == (2.5, 0.1, 0.3) and image.values.dtype == np.dtype(dtype)


def test_metaimage_header_as_itk_wants_it(tmp_path):
    image = tb.Image(
        RAMP,
        "grey",
        spacing=grey_ramp().spacing,
        unit="um",
        recipe=tb.Recipe().then("made", RAMP, note="n" * 3000),
    )
    path = tb.write(image, tmp_path / "x.raw")
    assert path.name == "x.mhd" and tb.read(tmp_path / "x.raw").recipe == image.recipe
    lines = path.read_text().splitlines()
    keys = dict(line.split(" = ", 1) for line in lines)
    assert (keys["DimSize"], keys["ElementSpacing"], keys["DistanceUnits"]) == (
        "5 4 3",
        "0.3 0.1 2.5",
        "um",
    )
    assert lines[-1] == "ElementDataFile = x.raw" and max(map(len, lines)) < 500
    np.testing.assert_array_equal(np.fromfile(tmp_path / "x.raw", "<u2").reshape(3, 4, 5), RAMP)


def count_bytes(raw, *, packed, count, coded, block=64):
    """Lay bytes out as VTK does: a count and the bytes, or counts and packed blocks."""
    code = base64.b64encode if coded else bytes
    if not packed:
        return code(struct.pack(count, len(raw)) + raw)
    blocks = [zlib.compress(raw[start : start + block]) for start in range(0, len(raw), block)]
    counts = [len(blocks), block, len(raw) % block, *map(len, blocks)]
    return code(b"".join(struct.pack(count, value) for value in counts)) + code(b"".join(blocks))


@pytest.mark.parametrize("place", ["CellData", "PointData"])
@pytest.mark.parametrize("mode", ["ascii", "binary", "appended base64", "appended raw"])
@pytest.mark.parametrize("packed", [True, False])
@pytest.mark.parametrize("header", ["UInt32", "UInt64", None])
def test_vti_by_hand(place, mode, packed, header, tmp_path):
    count = "<Q" if header == "UInt64" else "<I"
    extent = "0 5 0 4 0 3" if place == "CellData" else "0 4 0 3 0 2"
    raw = count_bytes(RAMP.tobytes(), packed=packed, count=count, coded="raw" not in mode)
    other = count_bytes(b"\1" * 120, packed=packed, count=count, coded="raw" not in mode)
    text = {"ascii": " ".join(map(str, RAMP.ravel())).encode(), "binary": raw}.get(mode, b"")
    appended = mode.startswith("appended")
    tail = (
        f'<AppendedData encoding="{mode.split()[-1]}">_'.encode() + other + raw + b"</AppendedData>"
        if appended
        else b""
    )
    form = f'format="appended" offset="{len(other)}"' if appended else f'format="{mode}"'
    attributes = (f' header_type="{header}"' if header else "") + (
        ' compressor="vtkZLibDataCompressor"' if packed else ""
    )
    (tmp_path / "x.vti").write_bytes(
        f'<VTKFile type="ImageData" byte_order="LittleEndian"{attributes}>'
        f'<ImageData WholeExtent="{extent}" Origin="0 0 0" Spacing="0.3 0.1 2.5"><Piece '
        f'Extent="{extent}">'
        f'<{place} Scalars="b"><DataArray type="UInt8" Name="a" format="ascii">1</DataArray>'
        f'<DataArray type="UInt16" Name="b" {form}>'.encode()
        + text
        + f"</DataArray></{place}></Piece></ImageData>".encode()
        + tail
        + b"</VTKFile>"
    )
    image = tb.read(tmp_path / "x.vti")
    np.testing.assert_array_equal(image.values, RAMP)
    assert image.spacing == (2.5, 0.1, 0.3)


def test_our_vti_by_hand(tmp_path):
    raw = tb.write(grey_ramp(), tmp_path / "x.vti").read_bytes()
    assert (
        b'WholeExtent="0 5 0 4 0 3"' in raw
        and b'Spacing="0.3 0.1 2.5"' in raw
        and b'<CellData Scalars="grey">' in raw
    )
    data = raw[raw.index(b"_", raw.index(b"<AppendedData")) + 1 :]
    blocks, size, last, packed = struct.unpack_from("<4Q", data)
    assert (blocks, size, last) == (1, 1 << 20, RAMP.nbytes)
    assert zlib.decompress(data[32 : 32 + packed]) == RAMP.tobytes()


def test_slices_of_a_scanner(tmp_path):
    folder = tmp_path / "slices.d"  # a dot in a folder's name is no suffix
    folder.mkdir()
    for z, plane in enumerate(RAMP):
        tifffile.imwrite(folder / f"scan{z * 5}.tif", plane)  # scan0, scan5, scan10
    (folder / "notes.txt").write_text("not a slice")
    np.testing.assert_array_equal(tb.read(folder).values, RAMP)
    tifffile.imwrite(folder / "scan99.tif", RAMP[0, :2])
    with pytest.raises(FileError, match=r"scan99.tif is \(2, 5\)"):
        tb.read(folder)
    (folder / "scan99.tif").unlink()
    Picture.fromarray(RAMP[0]).save(folder / "preview.png")
    with pytest.raises(FileError, match="mixes"):
        tb.read(folder)


def test_nifti_in_a_unit_that_it_lacks_is_in_micrometres(tmp_path):
    image = tb.Image(np.zeros((3, 4, 5), np.uint8), "grey", (750.0, 500.0, 250.0), "nm")
    header = nibabel.load(tb.write(image, tmp_path / "a.nii")).header
    assert header.get_zooms() == pytest.approx((0.25, 0.5, 0.75))
    assert header.get_xyzt_units()[0] == "micron"
