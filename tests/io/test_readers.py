"""Files that are read alone: Scanco, Nikon, scanners' logs, DICOM and HDF5 (`make test-readers`),
readers of other distributions.
"""

import struct
import sys
from importlib.metadata import EntryPoint

import numpy as np
import pytest

import trabecula as tb
from trabecula.core.errors import FileError, InputError, MissingExtraError, UnknownNameError
from trabecula.core.progress import listen
from trabecula.io import readers
from trabecula.io.metadata import FileContent

RNG = np.random.default_rng(9)
VOLUME = RNG.integers(-900, 3000, (5, 6, 7)).astype(np.int16)


def isq(values, edge=20.0, *, offset=1, kind=3, mu=4096):
    """Return an ISQ file's bytes by the layout of its header."""
    head = bytearray(512 * (offset + 1))
    head[:16] = b"CTDATA-HEADER_V1"
    z, y, x = values.shape
    struct.pack_into("<i", head, 16, kind)
    struct.pack_into("<3i", head, 44, x, y, z)
    struct.pack_into("<3i", head, 56, round(x * edge), round(y * edge), round(z * edge))
    struct.pack_into("<i", head, 88, mu)
    struct.pack_into("<i", head, 508, offset)
    return bytes(head) + values.astype("<i2").tobytes()


@pytest.mark.parametrize("name", ["C0001234.ISQ;1", "c.isq"])
def test_isq_has_its_values_and_spacing(tmp_path, name):
    (tmp_path / name).write_bytes(isq(VOLUME, 36.0, offset=4))
    notes = []
    with listen(lambda label, fraction: notes.append(label)):
        image = tb.read(tmp_path / name)
    assert np.array_equal(image.values, VOLUME) and image.kind == "grey"
    assert (image.spacing, image.unit) == ((36.0,) * 3, "um")


def test_isq_that_is_damaged_is_refused(tmp_path):
    path, raw = tmp_path / "x.isq", isq(VOLUME)
    for damaged, words in (
        (raw[:-1], "whole"),
        (raw[:300], "ends within its header"),
        (b"AIMDATA_V030    " + raw[16:], "does not begin with CTDATA-HEADER_V1"),
        (isq(VOLUME, 0.0), "lengths are not positive"),
        (raw[:44] + struct.pack("<i", -3) + raw[48:], "claims"),
    ):
        path.write_bytes(damaged)
        with pytest.raises(FileError, match=words):
            tb.read(path)
    path.write_bytes(isq(VOLUME, kind=5))
    with pytest.raises(InputError, match="type 5, 16-bit ones"):
        tb.read(path)


def test_nikon_reads_the_voxels_beside_its_header(tmp_path):
    text = (
        "{volume1}\n[representation]\nsize = 7 6 5\ndatatype = float\nbitsperelement = 32\n"
        "[file1]\nName = scan.vol\nSkipHeader = 8\n[geometry]\nresolution = 0.02 0.03 0.04\n"
        "unit = mm\n"
    )
    (tmp_path / "scan.vgi").write_text(text)
    with pytest.raises(FileError, match=r"copy scan\.vol there"):
        tb.read(tmp_path / "scan.vgi")
    (tmp_path / "scan.vol").write_bytes(bytes(8) + (VOLUME / 7).astype("<f4").tobytes())
    image = tb.read(tmp_path / "scan.vgi")
    assert np.array_equal(image.values, (VOLUME / 7).astype(np.float32))
    assert (image.spacing, image.unit) == ((0.04, 0.03, 0.02), "mm")
    (tmp_path / "scan.vol").write_bytes(bytes(100))
    with pytest.raises(FileError, match="whole"):
        tb.read(tmp_path / "scan.vgi")


BRUKER = "[System]\nScanner=SkyScan1272\n[Acquisition]\nImage Pixel Size (um)=10.0\n"
RECON = "[Reconstruction]\nReconstruction Program=NRecon\nPixel Size (um)=9.92\n"


def stack(folder):
    folder.mkdir()
    for z in range(3):
        tb.write(tb.Image((VOLUME[z] + 900).astype(np.uint16), "grey"), folder / f"s_{z:04d}.tif")
        (folder / f"s_{z:04d}.tif.json").unlink(missing_ok=True)
    return folder


@pytest.mark.parametrize(
    ("name", "text", "spacing", "unit"),
    [
        ("s_rec.log", BRUKER + RECON, (9.92,) * 3, "um"),
        ("s.log", BRUKER, (10.0,) * 3, "um"),
        (
            "s.xtekct",
            "[XTekCT]\nVoxelSizeX=0.05\nVoxelSizeY=0.05\nVoxelSizeZ=0\n",
            (0.05,) * 3,
            "mm",
        ),
        ("other.log", "nothing of a scan\n", (1.0,) * 3, "voxel"),
    ],
)
def test_slices_take_their_spacing_from_the_scanners_log(tmp_path, name, text, spacing, unit):
    folder = stack(tmp_path / "scan")
    (folder / name).write_text(text)
    image = tb.read(folder)
    assert (image.spacing, image.unit) == (spacing, unit)
    assert np.array_equal(image.values, VOLUME[:3] + 900)
    given = tb.read(folder, spacing=3.0, unit="um")
    assert (given.spacing, given.unit) == ((3.0,) * 3, "um")


def test_logs_that_differ_or_are_damaged_are_refused(tmp_path):
    folder = stack(tmp_path / "scan")
    (folder / "a.log").write_text(BRUKER)
    (folder / "b.log").write_text(BRUKER + RECON)
    with pytest.raises(FileError, match="different voxels"):
        tb.read(folder)
    (folder / "a.log").unlink()
    (folder / "b.log").write_text(BRUKER + RECON.replace("9.92", "-1"))
    with pytest.raises(FileError, match="scanner's log"):
        tb.read(folder)


class _Points(list):
    def __call__(self, *, group):
        return [point for point in self if point.group == group]


@pytest.fixture
def fresh(monkeypatch):
    readers.readers.cache_clear()
    yield lambda *points: monkeypatch.setattr(readers, "entry_points", _Points(points))
    monkeypatch.undo()
    readers.readers.cache_clear()


FOREIGN = readers.Reader("Foreign", (".foreign",), __name__, "of a test", datasets=True)
TAKEN = readers.Reader("Taken", (".isq",), __name__, "of a test")


def read(path, dataset=None):
    """Read a file of another distribution's reader."""
    return FileContent(np.full((2, 3, 4), 7 if dataset else 5, np.uint16), spacing=(1, 2, 3))


def test_a_reader_of_another_distribution(tmp_path, fresh, monkeypatch):
    monkeypatch.setitem(sys.modules, "foreign_readers", sys.modules[__name__])
    given = [("a", "foreign_readers:FOREIGN"), ("b", "foreign_readers:TAKEN"), ("c", "gone:X")]
    fresh(*(EntryPoint(name, value, readers.GROUP) for name, value in given))
    notes = []
    with listen(lambda label, fraction: notes.append(label)):
        found = readers.readers()
    assert [one.name for one in found] == [*(one.name for one in readers.READERS), "Foreign"]
    (tmp_path / "x.foreign").write_bytes(b"1")
    image = tb.read(tmp_path / "x.foreign", kind="grey")
    assert image.spacing == (1, 2, 3) and (image.values == 5).all()
    chosen = tb.read(tmp_path / "x.foreign", kind="grey", dataset="seven")
    assert (chosen.values == 7).all()
    assert chosen.recipe.steps[0]["options"]["dataset"] == "seven"
    with pytest.raises(InputError, match="holds one array: leave the dataset out"):
        (tmp_path / "x.isq").write_bytes(isq(VOLUME))
        tb.read(tmp_path / "x.isq", dataset="seven")


@pytest.mark.parametrize(
    ("module", "name", "extra"), [("pydicom", "x.dcm", "dicom"), ("h5py", "x.h5", "hdf5")]
)
def test_a_missing_extra_is_named(tmp_path, monkeypatch, module, name, extra):
    monkeypatch.setitem(sys.modules, module, None)
    (tmp_path / name).write_bytes(b"something")
    with pytest.raises(MissingExtraError, match=rf"pip install 'trabecula\[{extra}\]'"):
        tb.read(tmp_path / name)


def write_dicom(pydicom, path, plane, *, z, number, series="1.2.3", series_number=2, **more):
    head = pydicom.Dataset()
    head.file_meta = pydicom.dataset.FileMetaDataset()
    head.file_meta.TransferSyntaxUID = pydicom.uid.ExplicitVRLittleEndian
    head.file_meta.MediaStorageSOPClassUID = "1.2.840.10008.5.1.4.1.1.2"
    head.file_meta.MediaStorageSOPInstanceUID = f"1.2.3.{number}"
    head.SeriesInstanceUID, head.SeriesNumber = series, series_number
    head.InstanceNumber, head.Rows, head.Columns = number, *plane.shape
    head.SamplesPerPixel, head.PhotometricInterpretation = 1, "MONOCHROME2"
    head.BitsAllocated = head.BitsStored = 16
    head.HighBit, head.PixelRepresentation = 15, 0
    head.PixelSpacing = [0.3, 0.2]
    head.RescaleSlope, head.RescaleIntercept = 1, -1024
    if z is not None:
        head.ImagePositionPatient = [1, 2, z]
        head.ImageOrientationPatient = [1, 0, 0, 0, 1, 0]
    for name, value in more.items():
        setattr(head, name, value)
    head.PixelData = (plane + 1024).astype("<u2").tobytes()
    head.save_as(path, enforce_file_format=True)


@pytest.fixture
def series(tmp_path):
    """Return a function that writes VOLUME as a series of files whose names say no order."""
    pydicom = pytest.importorskip("pydicom", reason="pydicom is not installed: make test-readers")

    def make(places, **more):
        folder = tmp_path / "series"
        folder.mkdir(exist_ok=True)
        for old in folder.iterdir():
            old.unlink()
        for z, place in enumerate(places):
            if place != "gone":
                name = folder / f"IM{(7 * z) % 13:02d}"
                write_dicom(pydicom, name, VOLUME[z], z=place, number=z + 1, **more)
        return folder

    return make


def test_a_dicom_series_is_sorted_by_place(series):
    image = tb.read(series([10.0, 9.5, 9.0, 8.5, 8.0]))
    assert np.array_equal(image.values, VOLUME[::-1]) and image.values.dtype == np.int16
    assert (image.spacing, image.unit) == ((0.5, 0.3, 0.2), "mm")
    one = tb.read(next(series([None]).iterdir()))
    assert np.array_equal(one.values, VOLUME[0]) and one.spacing == (0.3, 0.2)
    numbered = tb.read(series([None] * 5, SpacingBetweenSlices=0.7), kind="grey")
    assert np.array_equal(numbered.values, VOLUME) and numbered.spacing == (0.7, 0.3, 0.2)
    half = tb.read(series([0, 1, 2, 3, 4], RescaleSlope=0.5, RescaleIntercept=0))
    assert np.array_equal(half.values, (VOLUME + 1024) / np.float32(2))


@pytest.mark.parametrize(
    ("places", "words"),
    [
        ([0, 1, "gone", 3, 4], "misses 1 slices of 5, the first gap between"),
        ([None, None, "gone", None, None], "misses 1 slices of 5, the first is number 3"),
        ([0, 1, 2.3, 3, 4], r"0.7 to 1.3 mm apart .*resample"),
        ([0, 1, 1, 2, 3], "two slices at 1 mm"),
    ],
)
def test_a_dicom_series_that_is_not_whole_is_refused(series, places, words):
    with pytest.raises(FileError, match=words):
        tb.read(series(places))


def test_several_dicom_series_need_a_choice(series):
    pydicom = pytest.importorskip("pydicom")
    folder = series([0, 1, 2, 3, 4])
    more = {"series": "1.2.9", "series_number": 7, "SeriesDescription": "scout"}
    write_dicom(pydicom, folder / "IM99", VOLUME[0, :3], z=0, number=1, **more)
    with pytest.raises(InputError, match=r"2 series: .*7: scout.*--dataset"):
        tb.read(folder)
    assert np.array_equal(tb.read(folder, dataset="2").values, VOLUME)
    assert tb.read(folder, dataset="scout").shape == (3, 7)
    with pytest.raises(InputError, match="no series '5'"):
        tb.read(folder, dataset="5")
    cut = folder / "IM99"
    cut.write_bytes(cut.read_bytes()[:-20])
    with pytest.raises(FileError, match="DICOM"):
        tb.read(folder, dataset="7")


@pytest.fixture
def hdf5(tmp_path):
    h5py = pytest.importorskip("h5py", reason="h5py is not installed: make test-readers")
    return lambda name="x.h5": h5py.File(tmp_path / name, "w")


def test_hdf5_of_usual_layouts(tmp_path, hdf5):
    path = tmp_path / "x.h5"
    with hdf5() as file:  # Data Exchange, with projections of other shapes beside it
        file["exchange/data"] = VOLUME
        file["exchange/data_dark"] = VOLUME[:2]
        file["exchange/data"].attrs["element_size_um"] = [3.0, 2.0, 1.5]
    image = tb.read(path)
    assert np.array_equal(image.values, VOLUME)
    assert (image.spacing, image.unit) == ((3.0, 2.0, 1.5), "um")
    assert tb.read(path, dataset="exchange/data_dark").shape == (2, 6, 7)
    with hdf5() as file:  # NeXus marks its default
        file["entry/other"], file["entry/rec/volume"] = VOLUME[:3], VOLUME
        file.attrs["default"], file["entry"].attrs["default"] = "entry", "rec"
        file["entry/rec"].attrs["signal"] = "volume"
        file["entry/rec"].attrs["voxel_size"] = 0.01
        file["entry/rec"].attrs["units"] = "mm"
    image = tb.read(path)
    assert np.array_equal(image.values, VOLUME) and image.spacing == (0.01,) * 3
    assert image.unit == "mm"
    with hdf5() as file:  # DREAM.3D: components last, spacing along x, y, z
        grid = file.create_group("DataContainers/Image")
        grid["CellData/FeatureIds"] = (VOLUME + 900)[..., None].astype(np.int32)
        grid["_SIMPL_GEOMETRY/SPACING"] = np.array([0.5, 1.0, 2.0], np.float32)
    image = tb.read(path)
    assert image.shape == VOLUME.shape and image.spacing == (2.0, 1.0, 0.5)


def test_hdf5_without_a_clear_data_set_is_refused(tmp_path, hdf5):
    path = tmp_path / "x.h5"
    with hdf5() as file:
        file["a"], file["b/c"], file["angles"] = VOLUME, VOLUME[:3], np.arange(9.0)
    with pytest.raises(InputError, match=r"several data sets: a 5x6x7, b/c 3x6x7; .*--dataset"):
        tb.read(path)
    assert tb.read(path, dataset="/b/c").shape == (3, 6, 7)
    with pytest.raises(UnknownNameError, match=r"unknown data set of x\.h5 'B/c'"):
        tb.read(path, dataset="B/c")
    path.write_bytes(path.read_bytes()[:900])
    with pytest.raises(FileError, match="HDF5"):
        tb.read(path)
    with hdf5() as file:
        file["angles"] = np.arange(9.0)
    with pytest.raises(InputError, match="no data set"):
        tb.read(path)
