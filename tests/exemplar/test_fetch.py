"""Published data: from a folder, from the cache, or downloaded, and only with the right voxels."""

import re
from dataclasses import replace
from urllib.error import URLError

import numpy as np
import pytest

import trabecula as tb
from trabecula.core.recipe import digest
from trabecula.errors import FileError, UnknownNameError
from trabecula.exemplar import fetch as module
from trabecula.exemplar.datasets import DATA_SETS, DataSet
from trabecula.pipeline.inputs import load


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A source with one file, and an empty cache."""
    values = np.arange(4 * 5 * 6).reshape(4, 5, 6) % 3 == 0
    source = tmp_path / "source"
    tb.write(tb.labels(values.astype(np.uint8)), source / "scan one.npy")
    entry = DataSet(
        "scan",
        "a scan",
        "copy.npy",
        digest(values[:3].astype(np.uint8)),
        (3, 5, 6),
        "labels",
        "none",
        "here",
        (source / "scan one.npy").as_uri(),
        2.0,
        "um",
        ("void", "solid"),
    )
    monkeypatch.setitem(DATA_SETS, "scan", entry)
    monkeypatch.setattr(module, "cache_folder", lambda: tmp_path / "cache")
    monkeypatch.delenv("TRABECULA_DATA", raising=False)
    return tmp_path


def refuse(*arguments, **named):
    raise URLError("no route to host")


def test_a_file_is_downloaded_once_and_cropped(place, monkeypatch):
    scan = tb.fetch("scan")
    assert scan.shape == (3, 5, 6) and scan.spacing == (2.0,) * 3 and scan.unit == "um"
    assert [path.name for path in (place / "cache").iterdir()] == ["scan one.npy"]
    monkeypatch.setattr(module.urllib.request, "urlopen", refuse)
    assert digest(tb.fetch("scan").values) == digest(scan.values)
    assert load("data:scan").shape == scan.shape


def test_a_folder_with_data_comes_first(place, monkeypatch):
    (place / "mine").mkdir()
    (place / "source" / "scan one.npy").rename(place / "mine" / "copy.npy")
    monkeypatch.setenv("TRABECULA_DATA", str(place / "mine"))
    assert tb.fetch("scan").recipe.steps[0]["source"].endswith("copy.npy")
    assert not (place / "cache").exists()


def test_without_a_network_the_address_and_the_place_are_named(place, monkeypatch):
    monkeypatch.setattr(module.urllib.request, "urlopen", refuse)
    with pytest.raises(FileError) as refused:
        tb.fetch("scan")
    said = str(refused.value)
    assert "no route to host" in said and DATA_SETS["scan"].address in said
    assert str(place / "cache") in said and "TRABECULA_DATA=DIR" in said
    assert not list((place / "cache").iterdir())


def test_other_voxels_are_refused_and_not_kept(place, monkeypatch):
    monkeypatch.setitem(DATA_SETS, "scan", replace(DATA_SETS["scan"], sha256="0" * 64))
    with pytest.raises(FileError, match=r"is not the data set 'scan': its voxels have SHA-256"):
        tb.fetch("scan")
    assert not list((place / "cache").iterdir())


def test_half_a_download_is_not_kept(place, monkeypatch):
    class Half:
        headers = {"Content-Length": "1000"}  # noqa: RUF012

        def __init__(self):
            self.parts = [b"half", b""]

        def read(self, size):
            return self.parts.pop(0)

        def __enter__(self):
            return self

        def __exit__(self, *error):
            pass

    monkeypatch.setattr(module.urllib.request, "urlopen", lambda *_, **__: Half())
    with pytest.raises(FileError, match="only 4 of 1000 bytes came"):
        tb.fetch("scan")
    assert not list((place / "cache").iterdir())


def test_a_full_disk_is_said(place, monkeypatch):
    def full(*arguments):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(module, "_copy", full)
    with pytest.raises(FileError, match="No space left on device"):
        tb.fetch("scan")


def test_what_has_no_address_says_where_it_is_from(place, monkeypatch):
    monkeypatch.setitem(DATA_SETS, "scan", replace(DATA_SETS["scan"], address=""))
    with pytest.raises(FileError, match=r"it is from here\): put a copy as copy.npy"):
        tb.fetch("scan")
    with pytest.raises(UnknownNameError, match="did you mean 'scan'"):
        tb.fetch("scam")


def test_every_data_set_is_described():
    for name, one in DATA_SETS.items():
        assert name == one.name and one.summary and one.licence and one.source
        assert re.fullmatch(r"[0-9a-f]{64}", one.sha256) and (one.kind != "labels" or one.phases)
        if one.address:
            assert re.match(r"https://\S+/[0-9a-f]{40}/\S+$", one.address)
    assert tb.datasets().keys() == DATA_SETS.keys()


@pytest.mark.whole
def test_real_scans_have_the_hashes(data, monkeypatch):
    monkeypatch.setenv("TRABECULA_DATA", str(data))
    for name, one in DATA_SETS.items():
        if (data / one.file).exists():
            assert tb.fetch(name).kind == one.kind
