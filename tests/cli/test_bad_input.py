"""What cannot work is refused: one line that says what to do, exit status 2, nothing written and
nothing lost.
"""

import errno
import os
import shutil
import subprocess
import sys
from collections import namedtuple

import numpy as np
import pytest

import trabecula as tb
from commands import SMALL, attempt, contents, refused, trabecula

TARGETS = ("new.zarr", "old.npy", "old.zarr", "new.tif")


@pytest.fixture(scope="module")
def scans(tmp_path_factory, bone):
    """Make a folder of files that are bad in every way, beside two good ones."""
    folder = tmp_path_factory.mktemp("scans")
    good = tb.crop(bone, 24).values
    np.save(folder / "scan.npy", good)
    np.save(folder / "grey.npy", good * np.uint8(90) + np.arange(24, dtype=np.uint8))
    for suffix in (".npy", ".tif", ".mha", ".nrrd", ".nii.gz", ".vti", ".zarr"):
        tb.write(good, folder / f"good{suffix}")
    for suffix in (".npy", ".tif", ".mha", ".nrrd", ".nii.gz", ".vti"):
        (folder / f"empty{suffix}").touch()
        (folder / f"noise{suffix}").write_bytes(bytes(range(256)) * 8)
        whole = (folder / f"good{suffix}").read_bytes()
        (folder / f"short{suffix}").write_bytes(whole[: len(whole) * 2 // 3])
    shutil.rmtree(folder / "good.zarr" / "0" / "c")
    (folder / "good.zarr").rename(folder / "short.zarr")
    (folder / "folder.npy").mkdir()
    (folder / "nothing").mkdir()
    with (folder / "huge.npy").open("wb") as file:
        np.lib.format.write_array_header_1_0(
            file, {"descr": "|u1", "fortran_order": False, "shape": (10**5,) * 3}
        )
    np.save(folder / "nan.npy", np.where(good == 1, np.nan, 1.5 * good))
    np.save(folder / "infinite.npy", np.where(good == 1, np.inf, 1.5 * good))
    np.save(folder / "complex.npy", good + 1j)
    np.save(folder / "text.npy", np.full((20, 20, 20), "a"))
    np.save(folder / "void.npy", np.zeros_like(good))
    np.save(folder / "solid.npy", np.full_like(good, 255))
    np.save(folder / "flat.npy", np.full(good.shape, 0.5, np.float32))
    np.save(folder / "floats.npy", good.astype(np.float32))
    np.save(folder / "small.npy", good[:9])
    np.save(folder / "tiny.npy", good[:1, :1, :1])
    np.save(folder / "plane.npy", good[12])
    np.save(folder / "line.npy", good[12, 12])
    np.save(folder / "film.npy", np.stack([good, good]))
    np.save(folder / "none.npy", good[:0])
    (folder / "scan.xyz").write_bytes(b"DICM")
    (folder / "scan.txt").write_text("a scan")
    (folder / "file.zarr").write_text("precious")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        trabecula("generate", "scan.npy", "--shape", 16, "--out", "made.npy", *SMALL)
    tb.write(np.eye(5, dtype=np.uint8)[None], folder / "old.npy")
    tb.write(np.eye(5, dtype=np.uint8)[None], folder / "old.zarr")
    return folder


@pytest.fixture
def place(scans, monkeypatch):
    """Work in the folder of scans; check afterwards that it holds what it held before."""
    monkeypatch.chdir(scans)
    before, names = contents(scans), sorted(str(path) for path in scans.rglob("*"))
    yield scans
    assert contents(scans) == before
    assert sorted(str(path) for path in scans.rglob("*")) == names


def generate(exemplar, *words, out="new.zarr", shape=("--shape", "16")):
    return refused("generate", exemplar, *shape, "--out", out, *SMALL, *words)


UNREADABLE = [
    ("missing.npy", "there is no file missing.npy"),
    ("scna.npy", "did you mean scan.npy"),
    ("nowhere/scan.npy", "there is no folder nowhere either"),
    *(
        (f"empty{suffix}", "it is empty (0 bytes)")
        for suffix in (".npy", ".tif", ".mha", ".nrrd", ".nii.gz", ".vti")
    ),
    *(
        (f"short{suffix}", f"cannot read short{suffix} as")
        for suffix in (".npy", ".tif", ".mha", ".nrrd", ".nii.gz", ".vti", ".zarr")
    ),
    *(
        (f"noise{suffix}", f"cannot read noise{suffix} as")
        for suffix in (".npy", ".tif", ".mha", ".nrrd", ".nii.gz", ".vti")
    ),
    ("folder.npy", "it is a folder"),
    ("nothing", "holds no slices"),
    ("huge.npy", "huge.npy"),
    ("nan.npy", "NaN or infinite values"),
    ("infinite.npy", "NaN or infinite values"),
    ("complex.npy", "complex"),
    ("text.npy", "numbers are needed"),
    ("floats.npy", "labels or grey? give kind='labels' or kind='grey'"),
    ("line.npy", "2 or 3 axes"),
    ("film.npy", "2 or 3 axes"),
    ("none.npy", "none.npy"),
    ("scan.xyz", "unknown suffix '.xyz'"),
    ("scan.txt", "unknown suffix '.txt'"),
    ("x" * 300 + ".npy", "name too long"),
    ("", ""),
]
READERS = [
    ("generate", "{}", "--shape", "16", "--out", "new.zarr", *SMALL),
    ("generate", "{}", "--shape", "16", "--out", "old.npy", *SMALL),
    ("plan", "{}", "--shape", "16"),
    ("measure", "{}"),
    ("verify", "scan.npy", "{}"),
    ("verify", "{}", "scan.npy", "--report", "new.html"),
    ("generate", "scan.npy", "{}", "--shape", "16", "--out", "new.zarr", *SMALL),
    ("plan", "scan.npy", "--mask", "{}"),
    ("plan", "scan.npy", "--fixed", "{}", "--at", "0", "0", "0", "--shape", "40"),
    ("plan", "scan.npy", "--fixed", "scan.npy", "--known", "{}"),
    ("check", "{}"),
    ("finish", "{}", "--connect", "--out", "old.zarr"),
    ("finish", "scan.npy", "--prune", "--like", "{}", "--out", "old.zarr"),
    ("export", "{}", "--out", "new.stl"),
    ("export", "{}", "--out", "old.npy"),
    ("render", "{}", "--out", "new.png"),
    ("rerun", "{}"),
    ("rerun", "made.npy", "--exemplar", "{}"),
]


@pytest.mark.parametrize(
    "words", READERS, ids=lambda words: "-".join(word for word in words[:6] if word[0].isalpha())
)
def test_files_that_cannot_be_read(place, words):
    for name, says in UNREADABLE:
        line = refused(*(word.format(name) for word in words))
        assert says.lower() in line.lower(), f"{name}: {line}"


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("void.npy", "the exemplar holds one phase only (void): give a crop with both"),
        ("solid.npy", "the exemplar holds one phase only"),
        ("flat.npy", "one value only (0.5)"),
        ("small.npy", "larger exemplar"),
        ("tiny.npy", "one phase only"),
        ("sample:bnoe", "unknown sample 'bnoe': did you mean 'bone'"),
    ],
)
def test_exemplars_that_nothing_can_be_learnt_from(place, name, says):
    for out in TARGETS:
        line = refused("generate", name, "--shape", 16, "--out", out, "--set", "neighbourhood=8")
        assert says in line


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--shape", "0"), "shape (0, 0, 0) must be positive"),
        (("--shape", "-4"), "must be positive"),
        (("--shape", "16", "-1", "16"), "must be positive"),
        (("--shape", "16.5"), "--shape 16.5: give one whole number or three"),
        (("--shape", "nan"), "--shape nan: give one whole number"),
        (
            ("--shape", "16", "16"),
            "makes 3-D images of this exemplar, the request is for (16, 16): give 3 numbers",
        ),
        (("--shape", "1", "2", "3", "4"), "has 4 numbers"),
        (("--shape", "1" * 5000), "give one whole number"),
        (("--shape", "9" * 30), "more than 2**48 voxels"),
        (("--shape", "20000"), ""),
        (("--shape", "16", "other.npy"), "a file comes before --shape"),
        (("--shape",), "argument --shape"),
        ((), "the size of the result is not given: add --shape N"),
    ],
)
def test_shapes(place, words, says):
    assert says in generate("scan.npy", shape=words)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--seed", "-1"), "seed -1 is outside 0 .. 2**63 - 1"),
        (("--seed", str(2**63)), "is outside 0 .. 2**63 - 1"),
        (("--seed", "1.5"), "--seed 1.5: give one whole number"),
        (("--seed", "nan"), "--seed nan: give one whole number"),
        (("--seed", "lucky"), "--seed lucky: give one whole number"),
        *(
            (("--memory", word), "should be a number of GiB above 0")
            for word in ("nan", "inf", "-1", "0", "much", "1e999")
        ),
        (("--memory", "0.001"), "1.0 MiB may be used: "),
        (("--threads", "0"), "threads must be at least 1, got 0"),
        (("--threads", "-2"), "threads must be at least 1, got -2"),
        (("--threads", "nan"), "argument --threads"),
        (("--threads", "1.5"), "argument --threads"),
        (("--method", "textrue"), "unknown method 'textrue': did you mean 'texture'"),
        (("--method", ""), "unknown method ''"),
        (("--preset", "fats"), "unknown preset of texture 'fats'"),
        (("--periodic", "w"), "--periodic w: name axes among z, y, x"),
        (
            ("--mehtod", "texture"),
            "unrecognized arguments: --mehtod texture; did you mean --method? (see trabecula "
            "generate",
        ),
        (("--treads=2",), "did you mean --threads?"),
        (("--meth", "texture"), "unrecognized arguments"),
        (("",), "unrecognized arguments: ''"),
        (("scan.npy",), "unrecognized arguments: scan.npy"),
        (("--set", "tires=3"), "unknown setting of texture 'tires': did you mean 'tries'"),
        (("--set", "tries"), "write --set name=value"),
        (("--set", "=3"), "write --set name=value"),
        (("--set", "preset=quick"), "unknown preset of texture 'quick'"),
        (
            ("--preset", "fast", "--set", "preset=best"),
            "--preset fast and --set preset=best: give one of them",
        ),
        (("--set", "tries=many"), "tries='many' should be a whole number from 0 to 64"),
        (("--set", "tries=-1"), "tries=-1 is outside 0 .. 64"),
        (("--set", "tries=1.5"), "tries=1.5 should be a whole number"),
        (("--set", "tries=true"), "tries=True should be a whole number"),
        (("--set", "clip=NaN"), "NaN is not a finite number"),
        (("--set", "clip=-Infinity"), "-Infinity is not a finite number"),
        (("--set", "clip=1e999"), "1e999 is not a finite number"),
        (("--set", "rounds=[1,NaN]"), "NaN is not a finite number"),
        (("--set", "rounds=[]"), "rounds is empty"),
        (("--set", "rounds=[0]"), "rounds=0 is outside 1 .. 100"),
        (("--threshold", "100"), "holds labels, a threshold is for grey images"),
        (("--kind", "lables"), "unknown kind of image 'lables': did you mean 'labels'"),
        (("--unit", "parsec"), "unknown unit 'parsec'"),
        (("--spacing", "0"), "must be positive and finite"),
        (("--spacing", "-1"), "must be positive and finite"),
        (("--spacing", "nan"), "must be positive and finite"),
        (("--spacing", "1", "inf", "1"), "must be positive and finite"),
        (("--spacing", "1", "1", "1e154"), "check its numbers, or choose another unit"),
        (("--spacing", "1", "1"), "has 2 numbers"),
        (("--spacing", "fine"), "--spacing fine: give numbers"),
        (("--phases", "bone"), "must name at least 2 labels"),
        (("--phases", "bone", "bone"), "each name once"),
        (("--crop", "0"), "must be positive"),
        (("--crop", "99"), "a crop of (99, 99, 99) does not lie inside the image of (24, 24, 24)"),
        (("--crop", "8"), "larger exemplar"),
        (("--crop", "1.5"), "--crop 1.5: give one whole number"),
    ],
)
def test_options(place, words, says):
    for out in ("new.zarr", "old.npy"):
        if words[:2] == ("--crop", "8"):
            words = (*words, "--set", "neighbourhood=8")
        assert says in generate("scan.npy", *words, out=out)


@pytest.mark.parametrize(
    "setting",
    [
        *("rounds=abc", 'rounds=[1,"a"]', "rounds=[[1]]", "rounds=null", "rounds=[1.5]"),
        *("levels=1.5", "levels=true", "first_rounds=2.1", "name=x", "cls=x"),
    ],
)
def test_settings_of_the_wrong_type(place, setting):
    generate("scan.npy", "--set", setting)


def test_a_whole_number_may_be_written_with_a_point():
    assert (
        tb.method("texture", levels=2.0, rounds=3).config
        == tb.method("texture", levels=2, rounds=[3]).config
    )


@pytest.mark.parametrize(
    ("threshold", "says"),
    [
        ("nan", "should be one finite number"),
        ("inf", "should be one finite number"),
        ("300", "threshold 300 leaves one phase only: the image runs from 0 to"),
        ("-5", "leaves one phase only"),
        ("90,20", "should be one finite number, or a pair (low, high)"),
        ("1,2,3", "should be one finite number, or a pair (low, high)"),
        ("otus", "unknown way to find a threshold 'otus': did you mean 'otsu'"),
        ("", "unknown way to find a threshold ''"),
        ("1,", "unknown way to find a threshold '1,'"),
    ],
)
def test_thresholds(place, threshold, says):
    for words in (
        ("generate", "grey.npy", "--shape", 16, "--out", "old.npy", *SMALL),
        ("measure", "grey.npy"),
    ):
        assert says in refused(*words, "--threshold", threshold)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (
            ("generat", "scan.npy"),
            "unknown verb 'generat': did you mean 'generate'? known are demo, methods",
        ),
        (("",), "unknown verb ''"),
        (("--bogus",), "unrecognized arguments: --bogus (see trabecula --help)"),
        (("--versoin",), "did you mean --version?"),
        (("measure",), "the following arguments are required: FILE"),
        (("measure", "scan.npy", "--jsno"), "did you mean --json?"),
        (("verify", "scan.npy"), "the following arguments are required: FILE"),
        (("verify", "scan.npy", "scan.npy", "--r-max", "0"), "r_max 0 must be at least 1"),
        (("verify", "scan.npy", "scan.npy", "--r-max", "far"), "argument --r-max"),
        (("verify", "scan.npy", "plane.npy"), "compare images of equal dimension"),
        (("verify", "void.npy", "scan.npy"), "there is nothing to compare"),
        (
            ("verify", "scan.npy", "scan.npy", "--report", "page.pdf"),
            "page.pdf should end in .html",
        ),
        (
            ("verify", "scan.npy", "scan.npy", "--report", "scan.npy/page.html"),
            "is a file, not a folder",
        ),
        (("finish", "scan.npy", "--out", "new.zarr"), "nothing to do: give --connect"),
        (
            ("finish", "scan.npy", "--connect", "--out", "new.zrar"),
            "unknown format '.zrar': did you mean '.zarr'",
        ),
        (("finish", "grey.npy", "--connect", "--out", "new.zarr"), "segment it first"),
        (("finish", "void.npy", "--connect", "--out", "new.zarr"), "nothing to connect"),
        (
            ("finish", "scan.npy", "--connect", "--phase", "bone", "--out", "new.zarr"),
            "unknown phase 'bone'",
        ),
        (("export", "scan.npy", "--out", "new.slt"), "unknown format '.slt': did you mean '.stl'"),
        (("export", "scan.npy", "--out", "new"), "has no suffix to tell its format"),
        (("export", "scan.npy", "--out", ""), "has no suffix to tell its format"),
        (
            ("export", "scan.npy", "--phase", "sloid", "--out", "new.stl"),
            "unknown phase 'sloid': did you mean 'solid'",
        ),
        (("export", "void.npy", "--out", "new.stl"), "void"),
        (("export", "plane.npy", "--out", "new.stl"), "volume"),
        (("export", "grey.npy", "--out", "new.stl"), "segment it first"),
        (("export", "scan.npy", "--out", "new.png"), "PNG holds pictures of 2 axes"),
        (
            ("render", "scan.npy", "--out", "new.png", "--look", "bnoe"),
            "unknown look 'bnoe': did you mean 'bone'",
        ),
        (
            ("render", "scan.npy", "--out", "new.png", "--cut", "cornre"),
            "unknown cut 'cornre': did you mean 'corner'",
        ),
        (("render", "scan.npy", "--out", "new.png", "--size", "0", "10"), "must be positive"),
        (("render", "scan.npy", "--out", "new.png", "--size", "64"), "expected 2 arguments"),
        (
            ("render", "scan.npy", "--out", "new.png", "--size", "99999", "99999"),
            "is outside 16..8192 pixels",
        ),
        (("render", "scan.npy", "--out", "new.png", "--camera", "nan", "0"), "are finite"),
        (("render", "plane.npy", "--out", "new.png"), "a still needs a volume"),
        (("render", "scan.npy", "--out", "new.gif"), "unknown format '.gif'"),
        (
            ("render", "void.npy", "--out", "new.png", "--size", "64", "64", "--cut", "w"),
            "unknown cut 'w'",
        ),
        (("measure", "plane.npy", "--crop", "99"), "does not lie inside"),
        (
            ("measure", "sample:bone", "--spacing", "2"),
            "comes with its spacing, unit and phases: give none",
        ),
        (("rerun", "scan.npy"), "holds no recipe"),
        (("demo", "--out", "scan.npy"), "is a file, not a folder"),
    ],
)
def test_words(place, words, says):
    assert says in refused(*words)


@pytest.mark.parametrize(
    ("out", "says"),
    [
        ("new.zrar", "unknown format '.zrar': did you mean '.zarr'"),
        ("new", "new has no suffix to tell its format: known are .tif"),
        ("nothing", "nothing has no suffix to tell its format"),
        ("", "has no suffix to tell its format"),
        ("scan.npy/new.zarr", "scan.npy is a file, not a folder; choose another place"),
        ("scan.npy/deep/new.zarr", "scan.npy is a file, not a folder; choose another place"),
        ("folder.npy", "a folder of that name is there; choose another name"),
        ("file.zarr", "a file of that name is there; choose another name"),
        ("x" * 300 + ".npy", "File name too long"),
    ],
)
def test_targets_are_refused_before_the_work(place, monkeypatch, out, says):
    def work(*anything, **more):
        pytest.fail("the exemplar was read although the target is bad")

    monkeypatch.setattr("trabecula.io.files.read", work)
    assert says in generate("scan.npy", out=out)
    assert says in refused("finish", "scan.npy", "--connect", "--out", out)


def test_a_surface_or_page_does_not_take_the_place_of_a_folder(tmp_path, scans, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("part.stl", "part.png", "page.html", "part.npy"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "precious").write_text("data")
    before = contents(tmp_path)
    scan = scans / "scan.npy"
    for words in (
        ("export", scan, "--out", "part.stl"),
        ("render", scan, "--out", "part.png"),
        ("verify", scan, scan, "--report", "page.html"),
        ("finish", scan, "--connect", "--out", "part.npy"),
    ):
        assert "a folder of that name is there; choose another name" in refused(*words)
    assert contents(tmp_path) == before


@pytest.mark.whole
def test_a_store_does_not_take_the_place_of_a_file_or_of_a_strange_folder(
    tmp_path, scans, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file.zarr").write_text("precious")
    (tmp_path / "folder.zarr").mkdir()
    (tmp_path / "folder.zarr" / "thesis.txt").write_text("precious")
    before = contents(tmp_path)
    assert "a file of that name is there" in generate(scans / "scan.npy", out="file.zarr")
    assert "a folder that is no Zarr store is there" in generate(
        scans / "scan.npy", out="folder.zarr"
    )
    assert contents(tmp_path) == before


def test_a_shape_beyond_memory_is_refused_before_anything_is_made(place, monkeypatch):
    for home in ("engine.memory", "pipeline.plan"):
        monkeypatch.setattr(f"trabecula.{home}.available_memory", lambda: 1 << 28)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: namedtuple("usage", "free")(1 << 60))
    monkeypatch.setattr(
        "trabecula.synth.texture.method.TextureModel.make",
        lambda *anything: pytest.fail("it started"),
    )
    for out in ("new.zarr", "old.npy"):
        line = generate("scan.npy", shape=("--shape", 20000), out=out)
        assert "of memory, 256 MiB may be used: " in line and "ask for a smaller --shape" in line


@pytest.mark.whole
def test_plan_tells_of_a_shape_beyond_memory_instead(place):
    assert "TiB" in trabecula("plan", "scan.npy", "--shape", 20000, *SMALL).out


def test_a_full_disk_is_noticed_before_the_work(place, monkeypatch):
    monkeypatch.setattr(shutil, "disk_usage", lambda path: namedtuple("usage", "free")(100))
    monkeypatch.setattr(
        "trabecula.synth.texture.method.TextureModel.make",
        lambda *anything: pytest.fail("it started"),
    )
    assert "are free in" in generate("scan.npy", out="old.npy")
    assert "are free in" in refused("demo", "--out", "demo")


@pytest.mark.whole
@pytest.mark.parametrize("out", TARGETS)
def test_a_disk_that_fills_up_while_writing(place, monkeypatch, out):
    def full(*names, **more):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "replace", full)
    monkeypatch.setattr("pathlib.Path.rename", full)
    assert "No space left on device" in generate("scan.npy", out=out)
    assert "No space left on device" in refused("finish", "scan.npy", "--connect", "--out", out)


@pytest.mark.whole
def test_surfaces_and_stills_on_a_full_disk(place, monkeypatch):
    def full(*names, **more):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "replace", full)
    for words in (
        *(
            ("export", "scan.npy", "--out", f"new{suffix}")
            for suffix in (".stl", ".3mf", ".ply", ".obj", ".mhd", ".vti")
        ),
        ("render", "scan.npy", "--out", "new.png", "--size", 64, 48),
        ("verify", "scan.npy", "scan.npy", "--report", "new.html", "--r-max", 3),
    ):
        assert "No space left on device" in refused(*words)


@pytest.mark.skipif(
    hasattr(os, "geteuid") and os.geteuid() == 0, reason="root may write everywhere"
)
def test_a_folder_without_the_right_to_write(tmp_path, scans):
    (tmp_path / "closed").mkdir(mode=0o500)
    assert "no right to write" in generate(
        scans / "scan.npy", out=str(tmp_path / "closed" / "new.zarr")
    )
    assert list((tmp_path / "closed").iterdir()) == []


def test_a_folder_without_the_right_to_write_as_the_system_tells_it(place, monkeypatch):
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    assert "no right to write into" in generate("scan.npy", out="old.npy")


def test_running_out_of_memory_is_no_traceback(place, monkeypatch):
    def too_much(*anything):
        raise MemoryError

    monkeypatch.setattr("trabecula.synth.texture.method.TextureModel.make", too_much)
    assert (
        generate("scan.npy", out="old.npy")
        == "out of memory: ask for a smaller --shape, or see trabecula plan"
    )


@pytest.mark.whole
def test_an_interrupted_run_leaves_everything_as_it_was(place, monkeypatch):
    def stop(*anything, **more):
        raise KeyboardInterrupt

    monkeypatch.setattr("trabecula.io.npy.np.save", stop)
    output = attempt("generate", "scan.npy", "--shape", 16, "--out", "old.npy", *SMALL)
    assert output.status == 130
    assert output.lines == ["trabecula: interrupted: nothing was written that is not whole"]


def test_a_bad_environment_is_told(place, monkeypatch):
    monkeypatch.setenv("TRABECULA_THREADS", "many")
    assert generate("scan.npy") == "TRABECULA_THREADS='many' should be a positive integer"


@pytest.mark.whole
def test_names_that_no_terminal_shows(tmp_path, scans):
    """Read, write and print a name of stray bytes, escaped."""
    shutil.copy(scans / "scan.npy", tmp_path / os.fsdecode(b"knochen-\xff.npy"))
    for words in (
        [b"export", b"knochen-\xff.npy", b"--out", b"teil-\xff.npy"],
        [b"measure", b"kein-\xff.npy"],
    ):
        done = subprocess.run(
            [sys.executable, b"-m", b"trabecula.cli.main", *words],
            cwd=tmp_path,
            env={**os.environ, "PYTHONUTF8": "1"},
            capture_output=True,
        )
        assert b"Traceback" not in done.stderr and b"-\\udcff.npy" in done.stdout + done.stderr
        assert done.returncode == (0 if words[0] == b"export" else 2)
    np.testing.assert_array_equal(
        tb.read(tmp_path / os.fsdecode(b"teil-\xff.npy")).values, np.load(scans / "scan.npy")
    )
