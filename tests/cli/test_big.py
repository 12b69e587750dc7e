"""Runs in blocks as a user types them: killed and resumed, divided, forecast, refused."""

import importlib.util
import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import trabecula as tb
from commands import attempt, refused, trabecula
from trabecula.core.recipe import digest
from trabecula.engine import blocks
from trabecula.engine.multiscale import halve_resolution
from trabecula.engine.store import open_unfinished

REACH = ("--set", "reach=4", "--set", "corrections=2")
ASKED = ("scan.npy", "--method", "noise", *REACH, "--shape", 150, 40, 90, "--seed", 3)


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    """Make a folder with a scan, a model of it, and the volume that all these runs make."""
    folder = tmp_path_factory.mktemp("big")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        np.save("scan.npy", tb.crop(tb.sample("bone"), 24).values)
        whole = trabecula("generate", *ASKED, "--out", "whole.npy")
        trabecula("fit", "scan.npy", "--method", "noise", *REACH, "--out", "scan.model")
    return folder, whole.sha256


@pytest.fixture
def place(home, tmp_path, monkeypatch):
    """Work in a copy."""
    shutil.copytree(home[0], tmp_path / "place")
    monkeypatch.chdir(tmp_path / "place")
    return home[1]


@pytest.fixture
def interrupted(place, monkeypatch):
    """Start the same run in blocks of 32, and stop it by Ctrl-C after two of them."""
    with monkeypatch.context() as patch:
        real, count = blocks.do_task, []

        def stopped(*words, **more):
            count.append(words)
            if len(count) == 3:
                raise KeyboardInterrupt
            real(*words, **more)

        patch.setattr(blocks, "do_task", stopped)
        left = attempt("generate", *ASKED, "--out", "big.zarr", "--chunks", 32)
    assert left.status == 130
    assert "resumes from big.zarr.part (generate --resume big.zarr)" in left.err
    return place


@pytest.mark.whole
def test_resume_needs_no_other_word(interrupted):
    begun = {path: path.stat().st_mtime_ns for path in Path("big.zarr.part").rglob("0/c/*/*/*")}
    assert len(begun) == 2
    done = trabecula("generate", "--resume", "big.zarr")
    assert done.sha256 == interrupted and "resuming from big.zarr.part" in done.err
    assert "150x40x90 labels" in done.out and not Path("big.zarr.part").exists()
    for path, written in begun.items():
        now = Path("big.zarr") / path.relative_to("big.zarr.part")
        assert now.stat().st_mtime_ns == written, "a finished block was made again"
    assert trabecula("rerun", "big.zarr").sha256 == interrupted
    image = tb.read("big.zarr")
    assert digest(image.values) == interrupted
    assert image.recipe.to_json() == tb.read("whole.npy").recipe.to_json()
    again = trabecula("generate", "--resume", "big.zarr", "--json")
    assert "big.zarr is finished" in again.err and json.loads(again.out)["sha256"] == interrupted
    assert (json.loads(again.out)["shape"], json.loads(again.out)["out"]) == (
        [150, 40, 90],
        "big.zarr",
    )


def test_the_unfinished_store_may_be_named_and_the_exemplar_moved(interrupted, tmp_path):
    Path("scan.npy").rename(tmp_path / "elsewhere.npy")
    assert "give its place with --exemplar" in refused("generate", "--resume", "big.zarr.part")
    done = trabecula(
        "generate",
        "--resume",
        "big.zarr.part",
        "--exemplar",
        tmp_path / "elsewhere.npy",
        "--memory",
        1,
    )
    assert done.sha256 == interrupted


@pytest.mark.whole
def test_another_exemplar_is_refused_and_nothing_lost(interrupted):
    kept = sorted(Path("big.zarr.part").rglob("*"))
    np.save("scan.npy", tb.crop(tb.sample("foam"), 24).values)
    assert "gives other voxels than recorded" in refused("generate", "--resume", "big.zarr")
    assert sorted(Path("big.zarr.part").rglob("*")) == kept


def test_other_versions_are_refused_by_name(interrupted, monkeypatch):
    monkeypatch.setattr("trabecula.__version__", "99.0")
    assert "trabecula 0.1.0, here 99.0" in refused("generate", "--resume", "big.zarr").replace(
        tb_version(), "0.1.0"
    )


def tb_version():
    part = json.loads(Path("big.zarr.part/zarr.json").read_text())
    return part["attributes"]["trabecula"]["recipe"][-1]["versions"]["trabecula"]


def test_a_store_that_is_not_finished_says_so_to_every_reader(interrupted):
    for verb in (
        ("measure",),
        ("render", "--out", "x.png"),
        ("export", "--out", "x.npy"),
        ("rerun",),
        ("check",),
    ):
        goes_on = "trabecula generate --resume big.zarr resumes"
        for name, words in (("big.zarr.part", "did not finish"), ("big.zarr", "is not finished")):
            line = refused(verb[0], name, *verb[1:])
            assert words in line and goes_on in line


def test_the_blocks_of_another_run_are_not_lost(interrupted):
    other = ("generate", *ASKED[:-1], 4, "--out", "big.zarr", "--chunks", 32)
    assert "holds the blocks of another run, of 150x40x90 voxels" in refused(*other)
    assert "begun in chunks of 32 voxels, not of 64" in refused(
        "generate", *ASKED, "--out", "big.zarr", "--chunks", 64
    )
    assert trabecula("generate", *ASKED, "--out", "big.zarr").sha256 == interrupted


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("nothing.zarr",), "nothing to resume: no run that makes nothing.zarr was interrupted"),
        (("big.zarr", "--shape", "9"), "--shape beside --resume"),
        (("big.zarr", "--seed", "0"), "--seed beside --resume"),
        (("big.zarr", "--set", "reach=4"), "--set beside --resume"),
        (("big.zarr", "--chunks", "32"), "--chunks beside --resume"),
        (("scan.npy",), "was not made by generate"),
    ],
)
def test_what_cannot_be_gone_on_with(interrupted, words, message):
    assert message in refused("generate", "--resume", *words)


def test_an_exemplar_beside_resume_is_told_its_option(interrupted):
    assert "--exemplar gives its place now" in refused(
        "generate", "scan.npy", "--resume", "big.zarr"
    )
    assert "--exemplar is for --resume" in refused(
        "generate", *ASKED, "--exemplar", "scan.npy", "--out", "x.zarr"
    )
    assert "add --out FILE" in refused("generate", *ASKED)


def test_a_part_that_says_nothing_is_left_alone(place):
    for make in (lambda path: path.write_bytes(b"mine"), lambda path: path.mkdir()):
        part = Path("x.zarr.part")
        make(part)
        assert "does not say which run left it" in refused("generate", "--resume", "x.zarr")
        assert part.exists()
        shutil.rmtree(part) if part.is_dir() else part.unlink()


@pytest.mark.parametrize("chunk", [64, 96, 128])
def test_however_it_is_cut_the_voxels_are_the_same(place, chunk):
    words = ("--out", "big.zarr", "--chunks", chunk)
    assert (
        trabecula("generate", *ASKED, *words, "--threads", 2 if chunk == 96 else 1).sha256 == place
    )


def test_a_model_in_a_file_is_found_again(place, monkeypatch):
    asked = ("--model", "scan.model", *ASKED[len(("scan.npy", "--method", "noise", *REACH)) :])
    real = blocks.digest_of
    monkeypatch.setattr(
        blocks, "digest_of", lambda *words: (_ for _ in ()).throw(KeyboardInterrupt)
    )
    assert attempt("generate", *asked, "--out", "big.zarr", "--chunks", 64).status == 130
    monkeypatch.setattr(blocks, "digest_of", real)
    assert trabecula("generate", "--resume", "big.zarr").sha256 == place


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ("--out", "x.zarr", "--chunks", "40"),
            "--chunks 40 should be a multiple of 16 from 16 to 1024",
        ),
        (("--out", "x.zarr", "--chunks", "0"), "--chunks 0 should be a multiple of 16"),
        (("--out", "x.zarr", "--chunks", "2048"), "--chunks 2048 should be"),
        (("--out", "x.npy", "--chunks", "64"), "into a .zarr"),
        (("--out", "x.zarr", "--chunks", "1024", "--memory", "0.2"), "smaller --chunks (64)"),
    ],
)
def test_chunks_that_do_not_fit_are_refused(place, words, message):
    shape = ("--shape", 600, 600, 600)
    assert message in refused("generate", "scan.npy", "--method", "noise", *REACH, *shape, *words)
    assert not Path("x.zarr.part").exists()


def test_the_levels_of_what_was_made(place):
    trabecula("generate", *ASKED, "--out", "big.zarr", "--chunks", 64)
    coarse = tb.read("big.zarr", level=1)
    assert np.array_equal(coarse.values, halve_resolution(tb.read("big.zarr").values, labels=True))
    trabecula(
        "export", "big.zarr", "--out", "coarse.npy", "--level", 1
    ) if exports_levels() else None
    found = json.loads(trabecula("measure", "big.zarr", "--level", 1, "--quick", "--json").out)
    assert found["porosity"] == pytest.approx((coarse.values == 0).mean())
    assert "levels 0 (the finest) to 1: got level 3" in refused(
        "measure", "big.zarr", "--level", 3, "--quick"
    )


def exports_levels():
    return "--level" in attempt("export", "--help").out


@pytest.mark.whole
def test_plan_tells_the_time(place):
    plan = json.loads(trabecula("plan", *ASKED, "--out", "big.zarr", "--chunks", 64, "--json").out)
    assert plan["seconds"] > 0
    assert "time " in trabecula("plan", *ASKED).out
    # And of what is made as a whole, unless something in it is tied to its shape.
    for words in (("--preset", "fast"), ("--method", "noise", *REACH, "--set", "exact=true")):
        assert (
            json.loads(trabecula("plan", "scan.npy", "--shape", 40, *words, "--json").out)[
                "seconds"
            ]
            > 0
        )
    np.save("form.npy", np.arange(40**3).reshape(40, 40, 40) > 99)
    masked = ("plan", "scan.npy", "--preset", "fast", "--mask", "form.npy")
    assert "not forecast" in trabecula(*masked).out
    assert json.loads(trabecula(*masked, "--json").out)["seconds"] is None


PROGRAM = """
import sys
sys.path.insert(0, {tests!r})
from kills import end_at_change
from trabecula.cli.main import main

end_at_change({number}, "big.zarr")
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="kill -9 is of POSIX")
def test_killed_again_and_again_and_resumed_by_the_command(place):
    """Kill runs of 30 blocks and coarser levels; the first command is typed once, then only
    --resume.
    """
    words = ["generate", *map(str, ASKED), "--out", "big.zarr", "--chunks", "32"]
    for number in np.random.default_rng(1).integers(20, 70, size=2):
        program = PROGRAM.format(tests=str(Path(__file__).parents[1]), number=number)
        run = subprocess.run([sys.executable, "-c", program, *words], check=False)
        assert run.returncode == -signal.SIGKILL
        words = ["generate", "--resume", "big.zarr"]
    assert open_unfinished(Path("big.zarr.part")) is not None
    assert trabecula("generate", "--resume", "big.zarr").sha256 == place
    assert sorted(path.name for path in Path().iterdir() if "big" in path.name) == ["big.zarr"]


@pytest.mark.skipif(
    importlib.util.find_spec("distributed") is not None, reason="the extra cluster is installed"
)
def test_workers_without_their_package_are_told_the_extra(place):
    line = refused("generate", *ASKED, "--out", "x.zarr", "--workers", 2)
    assert "needs distributed, which is not installed: pip install 'trabecula[cluster]'" in line
    assert not Path("x.zarr.part").exists()


def test_a_picture_in_blocks(place):
    asked = (
        "generate",
        "--method",
        "noise",
        "--set",
        "kind=perlin",
        "--shape",
        150,
        90,
        "--seed",
        2,
    )
    whole = trabecula(*asked, "--out", "flat.npy")
    assert trabecula(*asked, "--out", "flat.zarr", "--chunks", 48).sha256 == whole.sha256
    assert tb.read("flat.zarr", level=1).shape == (75, 45)
