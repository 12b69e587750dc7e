"""Where stores lie: a folder and an address answer alike, and a volume in blocks does not care
which it is.
"""

import sys
from pathlib import Path

import numpy as np
import pytest

import trabecula as tb
from commands import refused
from trabecula.core.progress import listen
from trabecula.core.recipe import Recipe, digest
from trabecula.engine import store
from trabecula.engine.blocks import StoredVolume, boxes_of, slices_of, stream
from trabecula.engine.multiscale import halve_resolution
from trabecula.engine.storage import (
    Folder,
    Remote,
    is_address,
    location_of,
    path_or_remote,
)
from trabecula.errors import FileError, MemoryBudgetError, MissingExtraError
from trabecula.pipeline.generate import generate_to
from trabecula.pipeline.plan import plan_to

SHAPE = (70, 33, 40)
FIELDS = {
    "kind": "labels",
    "spacing": [1.0, 1.0, 1.0],
    "unit": "voxel",
    "phases": ["void", "solid"],
}


def voxels(box):
    z, y, x = np.ogrid[slices_of(box)]
    return ((z * 7 + y * 5 + x * 3) % 11 < 4).astype(np.uint8)


WHOLE = voxels(tuple((0, side) for side in SHAPE))


@pytest.mark.parametrize(
    ("path", "folder"),
    [
        ("rock.zarr", "rock.zarr"),
        ("a/b://c.zarr", "a/b:/c.zarr"),
        ("C://rock.zarr", "C:/rock.zarr"),
        ("file:///data/two%20rocks.zarr", "/data/two rocks.zarr"),
        (Path("a") / "rock.zarr", "a/rock.zarr"),
    ],
)
def test_what_is_a_folder(path, folder):
    assert not is_address(path)
    assert location_of(path).path == path_or_remote(path) == Path(folder)


@pytest.mark.parametrize(
    "path", ["s3://bucket/a/rock.zarr", "memory://rock.zarr", "GS://bucket/rock.zarr/"]
)
def test_what_is_an_address(path):
    assert is_address(path)
    found = location_of(path)
    assert (
        isinstance(found, Remote)
        and str(found) == path.rstrip("/") == found.name
        and found.stem == "rock"
    )
    assert location_of(found) is found is path_or_remote(found) and found.growing() is found
    assert found.beside(".scratch") == Path.cwd() / "rock.zarr.scratch"


def test_a_folder_grows_beside_itself(tmp_path):
    place = location_of(tmp_path / "rock.zarr")
    assert place.growing().path == place.beside(".part") == tmp_path / "rock.zarr.part"


def test_without_the_package_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "fsspec", None)
    for words in (
        ("measure", "s3://b/x.zarr"),
        ("generate", "--method", "bubbles", "--shape", 9, "--out", "s3://b/x.zarr"),
    ):
        line = refused(*words)
        assert (
            line == "reaching s3://b/x.zarr needs fsspec, which is not installed: "
            "pip install 'trabecula[remote]'"
        )


def test_of_another_package_the_name_is_told(monkeypatch):
    pytest.importorskip("fsspec", reason="addresses need the extra remote")
    monkeypatch.setitem(sys.modules, "gcsfs", None)
    with pytest.raises(
        MissingExtraError, match=r"gs://b/x\.zarr needs a package that is not installed.*gcsfs"
    ):
        tb.read("gs://b/x.zarr")


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("xyz://b/x.zarr", "Protocol not known: xyz; give a path, or an address"),
        ("simplecache::memory://x.zarr", "chains of addresses are not followed"),
        ("memory://nothing-here.zarr", "there is no Zarr store at memory://nothing-here.zarr"),
        ("memory://", "there is no Zarr store at memory://, "),
    ],
)
def test_addresses_that_are_none(address, message):
    pytest.importorskip("fsspec", reason="addresses need the extra remote")
    assert message in refused("measure", address)


@pytest.fixture(params=["folder", "address"])
def place(request, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if request.param == "folder":
        return Folder(tmp_path / "x.zarr")
    fsspec = pytest.importorskip("fsspec", reason="addresses need the extra remote")
    fsspec.filesystem("memory").store.clear()
    return Remote("memory://some/x.zarr")


def made(place, make, *, identity="one", chunk=32):
    said = []
    volume = StoredVolume(
        shape=SHAPE,
        dtype=np.dtype(np.uint8),
        make=make,
        describe=lambda sha256: {
            **FIELDS,
            "recipe": Recipe().then_digest("generate", sha256).to_json(),
        },
        identity=identity,
        scale=(1.0,) * 3,
        unit=None,
    )
    with listen(lambda label, fraction: said.append(label) if fraction < 0 else None):
        sha256 = stream(volume, place, side=chunk, chunk=chunk)
    return sha256, said


class Maker:
    """Makes voxels, remembers which, and stops where it is told to."""

    def __init__(self, stop_at=None):
        self.made, self.stop_at = [], stop_at

    def __call__(self, box):
        if len(self.made) == self.stop_at:
            raise KeyboardInterrupt
        self.made.append(box)
        return voxels(box)


def test_a_volume_in_blocks_is_gone_on_with_wherever_it_lies(place):
    with pytest.raises(KeyboardInterrupt):
        made(place, Maker(stop_at=4))
    grown = place.growing()
    with pytest.raises(FileError, match="did not finish; trabecula generate --resume"):
        tb.read(grown)
    left = store.open_unfinished(grown)
    assert not left.complete and left.identity == "one"
    assert len([name for name in grown.files() if "/c/" in name]) == 4
    with pytest.raises(FileError, match="holds the blocks of another run, of 70x33x40 voxels"):
        made(place, Maker(), identity="two")
    with pytest.raises(FileError, match="begun in chunks of 32 voxels, not of 64"):
        made(place, Maker(), chunk=64)
    second = Maker()
    sha256, said = made(place, second)
    assert second.made == boxes_of(SHAPE, 32)[4:] and said == [f"resuming from {grown.name}"]
    assert sha256 == digest(WHOLE) and np.array_equal(tb.read(place).values, WHOLE)
    assert np.array_equal(tb.read(place, level=1).values, halve_resolution(WHOLE, labels=True))
    assert store.open_unfinished(place).complete


def test_a_lost_file_is_made_again_and_told_to_readers(place):
    with pytest.raises(KeyboardInterrupt):
        made(place, Maker(stop_at=4))
    place.growing().remove(["0/c/0/0/1", "0/c/9/9/9"])
    second = Maker()
    made(place, second)
    order = boxes_of(SHAPE, 32)
    assert second.made == [order[1], *order[4:]]
    place.remove(["0/c/2/1/0"])
    with pytest.raises(FileError, match="1 of its 12 chunks are missing"):
        tb.read(place)


def test_a_block_that_goes_before_the_level_above_is_made_from_it_is_told(place):
    """Zarr would give zeros for it."""

    def make(box):
        if box[0][0] == 32:
            place.growing().remove(["0/c/0/0/0"])
        return voxels(box)

    with pytest.raises(
        FileError, match=r"files of .* were written and are not there, 0/c/0/0/0 among them"
    ):
        made(place, make)
    assert made(place, Maker())[0] == digest(WHOLE)


def test_both_tell_their_files_alike(place):
    tb.write(tb.Image(WHOLE, "labels"), place)
    files = {"zarr.json", "0/zarr.json", "0/c/0/0/0"}
    assert place.is_there() and place.is_store() and place.files() == files
    assert sorted(place.missing([*files, "1/zarr.json"])) == ["1/zarr.json"]
    many = [f"0/c/0/0/{number}" for number in range(20)]
    assert place.missing(many) == many[1:]
    place.remove(["zarr.json", "nothing"])
    assert not place.is_store() and place.files() == files - {"zarr.json"}
    assert not location_of(f"{place}-of-others").is_there()


def test_a_store_appears_whole_or_not_at_all(place):
    def cut_off():
        with place.appearing() as folder:
            store.create(
                folder, SHAPE, np.dtype(np.uint8), scale=(1.0,) * 3, unit=None, fields=FIELDS
            )
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        cut_off()
    assert not place.is_there() and place.files() == set()


def test_what_is_at_an_address_is_not_replaced():
    pytest.importorskip("fsspec", reason="addresses need the extra remote")
    place = tb.write(tb.Image(WHOLE, "labels"), "memory://not-replaced.zarr")
    assert isinstance(place, Remote)
    for again in (
        lambda: tb.write(tb.Image(1 - WHOLE, "labels"), place),
        lambda: tb.export(1 - WHOLE, place),
    ):
        with pytest.raises(FileError, match=r"memory://not-replaced\.zarr: something is there"):
            again()
    with pytest.raises(FileError, match="something else of that name is there; remove it"):
        made(place, Maker())
    assert np.array_equal(tb.open_slabs(place).planes(3, 9).values, WHOLE[3:9])


def test_the_forecast_counts_what_reaching_takes():
    pytest.importorskip("fsspec", reason="addresses need the extra remote")
    model, request = tb.method("bubbles").fit(), tb.Request(64)
    here, there = (plan_to(model, request, f"{way}x.zarr", chunks=32) for way in ("", "memory://"))
    assert there.peak - here.peak == Remote.memory and there.disk == here.disk
    with pytest.raises(MemoryBudgetError):
        generate_to(model, request, "memory://too-large.zarr", memory=here.peak, chunks=32)
    assert not location_of("memory://too-large.zarr").is_there()
    made = generate_to(model, request, "memory://fits.zarr", memory=there.peak, chunks=32)
    assert np.array_equal(tb.read(made.path).values, model.generate(request).values)


def test_a_file_address_is_a_folder(tmp_path):
    address = (tmp_path / "x.zarr").as_uri()
    assert tb.write(tb.Image(WHOLE, "labels"), address) == tmp_path / "x.zarr"
    assert np.array_equal(tb.read(address).values, WHOLE)
