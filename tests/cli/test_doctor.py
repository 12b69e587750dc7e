"""`trabecula doctor` on whole and broken installations."""

import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from commands import attempt, trabecula
from trabecula.cli import doctor
from trabecula.pipeline import self_check

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def checked(monkeypatch):
    """Leave the volumes out: their digests are those of the release."""
    found = dict.fromkeys(self_check.RELEASED, "same")
    monkeypatch.setattr(self_check, "self_check", lambda: found)
    return found


def test_its_packages_are_those_of_the_project():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]

    def names(lines):
        return {re.split(r"[>=\[]", line)[0] for line in lines}

    assert names(project["dependencies"]) == set(doctor.BASE)
    extras = project["optional-dependencies"]
    for extra, packages in doctor.EXTRAS.items():
        assert names(extras[extra]) == set(packages)


def test_a_whole_installation(checked):
    text = trabecula("doctor").out
    for word in (
        "python",
        "numba",
        "extra learn",
        "threads used",
        "free memory",
        "the same voxels",
    ):
        assert word in text
    found = json.loads(trabecula("doctor", "--json").out)
    assert found["missing"] == [] and found["memory"] > 0 and found["temporary"]["writable"]
    assert found["cache"]["folder"] and found["self_check"] == checked


def test_other_voxels_are_no_error(checked):
    checked["noise"] = "other"
    assert "other voxels than on the machine of the release" in trabecula("doctor").out


def test_what_is_missing_is_named(checked, monkeypatch, tmp_path):
    monkeypatch.setitem(doctor.BASE, "nibabel", "nibabel_that_is_not_there")
    monkeypatch.setitem(doctor.EXTRAS, "mesh", ("trimesh_that_is_not_there",))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "no" / "folder"))
    monkeypatch.setattr(doctor, "_folder", lambda path: {"folder": str(path), "writable": False})
    output = attempt("doctor")
    assert output.status == 2 and len(output.lines) == 1
    assert "nibabel (not installed)" in output.lines[0] and "no/folder" in output.lines[0]
    assert "not installed: pip install 'trabecula[mesh]'" in output.out
    assert "left out: the base install is not whole" in output.out


def test_a_run_that_fails_is_missing(checked):
    checked["texture"] = "failed: no locator"
    output = attempt("doctor")
    assert output.status == 2 and "a run of texture (failed: no locator)" in output.err


def test_a_broken_package_is_no_traceback(monkeypatch, tmp_path):
    (tmp_path / "broken_of_base.py").write_text("raise SystemError('built for another NumPy')")
    monkeypatch.syspath_prepend(tmp_path)
    assert "another NumPy" in doctor._base_package("broken", "broken_of_base")["problem"]


@pytest.mark.whole
def test_this_machine_makes_the_voxels_of_the_release():
    assert self_check.self_check(limit=300) == dict.fromkeys(self_check.RELEASED, "same")


def answer(monkeypatch, code):
    """Let the process of the self-check run some code."""
    run = subprocess.run
    monkeypatch.setattr(
        subprocess, "run", lambda words, **more: run([sys.executable, "-c", code], **more)
    )
    return self_check.self_check(limit=60)


def test_the_time_is_limited(monkeypatch):
    def run(words, *, timeout, **more):
        first = json.dumps(["noise", self_check.RELEASED["noise"]]) + "\n"
        raise subprocess.TimeoutExpired(words, timeout, output=first.encode())

    monkeypatch.setattr(subprocess, "run", run)
    assert self_check.self_check() == {"noise": "same", "texture": "unfinished"}


def test_other_digests_and_failures_are_reported(monkeypatch):
    assert answer(monkeypatch, "print('[\"noise\", \"00\"]'); raise OSError('no disk')") == {
        "noise": "other",
        "texture": "failed: OSError: no disk",
    }
