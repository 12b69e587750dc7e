"""Workers of a Dask cluster write their blocks straight into an object store."""

from pathlib import Path

import pytest

import trabecula as tb
from commands import attempt, refused, trabecula

pytest.importorskip("distributed", reason="workers need the extra cluster")

ASKED = ("--method", "bubbles", "--shape", 70, 30, 40, "--seed", 3)


@pytest.mark.slow
def test_two_workers_make_the_same_voxels(bucket, objects):
    whole = trabecula("generate", *ASKED, "--out", "foam.npy")
    for file in Path.cwd().iterdir():
        file.unlink()
    foam = f"{bucket}/foam.zarr"
    made = trabecula("generate", *ASKED, "--out", foam, "--chunks", 32, "--workers", 2)
    assert made.sha256 == whole.sha256 == tb.read(foam).recipe.steps[-1]["sha256"]
    assert len([name for name in objects() if "/c/" in name]) == 8
    assert list(Path.cwd().iterdir()) == []


def test_workers_without_the_keys_say_what_is_wrong(bucket, monkeypatch):
    """Start workers from an environment without keys; this process has its connection."""
    trabecula("generate", *ASKED[:-1], 4, "--out", f"{bucket}/other.zarr")
    monkeypatch.delenv("AWS_ACCESS_KEY_ID")
    monkeypatch.delenv("AWS_SECRET_ACCESS_KEY")
    words = ("generate", *ASKED, "--out", f"{bucket}/foam.zarr", "--chunks", 32, "--workers", 1)
    left = attempt(*words)
    assert left.status == 2 and f"cannot reach {bucket}/foam.zarr: " in left.lines[-1]
    assert "credentials" in left.lines[-1]
    monkeypatch.undo()
    assert "did not finish" in refused("measure", f"{bucket}/foam.zarr")
    assert "resuming from" in trabecula("generate", "--resume", f"{bucket}/foam.zarr").err
