"""Blocks made by workers: the same voxels whoever makes them, a lost worker, and a scheduler that
does not answer.
"""

import os
import signal
import socket

import numpy as np
import pytest

import trabecula as tb
from commands import refused, trabecula
from trabecula.core.errors import ClusterError, InputError, MemoryBudgetError
from trabecula.core.progress import listen
from trabecula.engine import blocks
from trabecula.engine.cluster import Cluster, Workers, workers_of
from trabecula.engine.multiscale import halve_resolution
from trabecula.pipeline.generate import generate_to, partial_path

distributed = pytest.importorskip("distributed", reason="workers need the extra cluster")

SHAPE = (70, 40, 90)


@pytest.fixture(scope="module")
def model():
    return tb.method("noise", reach=4, corrections=2).fit(tb.crop(tb.sample("bone"), 24))


@pytest.fixture(scope="module")
def whole(model):
    return model.generate(SHAPE, seed=3)


@pytest.fixture(scope="module")
def two():
    """A scheduler with two workers, as a user may have it."""
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        memory_limit="1GiB",
        dashboard_address="127.0.0.1:0",
    ) as cluster:
        yield cluster


def made(model, path, cluster, *, seed=3, chunks=16, **more):
    return generate_to(
        model, tb.Request(SHAPE, seed=seed), path, chunks=chunks, cluster=cluster, **more
    )


def test_two_workers_make_the_same_voxels(two, model, whole, tmp_path):
    found = made(model, tmp_path / "x.zarr", Cluster(two.scheduler_address))
    image = tb.read(tmp_path / "x.zarr")
    assert found.sha256 == whole.recipe.steps[-1]["sha256"]
    assert np.array_equal(image.values, whole.values)
    assert image.recipe.to_json() == whole.recipe.to_json()
    coarse = halve_resolution(whole.values, labels=True)
    assert np.array_equal(tb.read(tmp_path / "x.zarr", level=1).values, coarse)
    assert np.array_equal(
        tb.read(tmp_path / "x.zarr", level=2).values, halve_resolution(coarse, labels=True)
    )
    assert [entry.name for entry in tmp_path.iterdir()] == ["x.zarr"]


def test_a_lost_worker_costs_its_block(two, model, whole, tmp_path):
    """A worker is killed as soon as the first file is there; its nanny starts another."""
    with distributed.Client(two, set_as_default=False) as client:
        victim = next(iter(client.run(os.getpid).values()))
    part, path = partial_path(tmp_path / "x.zarr"), tmp_path / "x.zarr"
    killed = []

    def kill(label, fraction):
        if label == "blocks" and fraction > 0 and not killed:
            killed.append(victim)
            os.kill(victim, signal.SIGKILL)

    with listen(kill):
        found = made(model, path, Cluster(two.scheduler_address))
    assert killed and not part.exists()
    assert found.sha256 == whole.recipe.steps[-1]["sha256"]


def test_workers_go_on_from_what_one_process_left(two, model, whole, tmp_path, monkeypatch):
    real, count = blocks.do_task, []

    def stopped(task, *words, **more):
        count.append(task)
        if len(count) == 20:
            raise KeyboardInterrupt
        real(task, *words, **more)

    monkeypatch.setattr(blocks, "do_task", stopped)
    with pytest.raises(KeyboardInterrupt):
        generate_to(model, tb.Request(SHAPE, seed=3), tmp_path / "x.zarr", chunks=16)
    monkeypatch.undo()
    written = {file: file.stat().st_mtime_ns for file in tmp_path.rglob("c/*/*/*")}
    assert len(written) == 19
    found = made(model, tmp_path / "x.zarr", Cluster(two.scheduler_address))
    assert found.sha256 == whole.recipe.steps[-1]["sha256"]
    for file, when in written.items():
        now = tmp_path / "x.zarr" / file.relative_to(partial_path(tmp_path / "x.zarr"))
        assert now.stat().st_mtime_ns == when, "what was there was made again"


def test_workers_that_would_not_have_the_memory_are_told_first(two, model, tmp_path):
    with pytest.raises(MemoryBudgetError, match="a block of 16 voxels needs about"):
        made(model, tmp_path / "x.zarr", Cluster(two.scheduler_address), memory=200 << 20)
    assert list(tmp_path.iterdir()) == []


def test_workers_with_other_versions_are_refused(two, model, tmp_path, monkeypatch):
    monkeypatch.setattr("trabecula.__version__", "99.0")
    with pytest.raises(ClusterError, match=r"has trabecula .*, this process 99\.0"):
        made(model, tmp_path / "x.zarr", Cluster(two.scheduler_address))


def test_workers_that_do_not_see_the_store_say_so(two, model, tmp_path, monkeypatch):
    """The store is taken away behind the back of the run, as if the workers had another file
    system.
    """
    real = blocks._missing_tasks

    def hidden(opened, side):
        tasks = real(opened, side)
        opened.place.path.rename(opened.place.path.with_name("elsewhere"))
        return tasks

    monkeypatch.setattr(blocks, "_missing_tasks", hidden)
    with pytest.raises(ClusterError, match=r"does not see .*x\.zarr\.part"):
        made(model, tmp_path / "x.zarr", Cluster(two.scheduler_address))


def test_a_scheduler_that_does_not_answer(model, tmp_path):
    with socket.socket() as taken:  # listens, and says nothing
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        address = f"tcp://127.0.0.1:{taken.getsockname()[1]}"
        with (
            pytest.raises(ClusterError, match=f"no answer from a scheduler at {address}"),
            workers_of(Cluster(address), wait=1),
        ):
            pass


def test_a_scheduler_without_workers(model, tmp_path):
    with (
        distributed.LocalCluster(n_workers=0, dashboard_address="127.0.0.1:0") as empty,
        pytest.raises(ClusterError, match=r"with a worker within 0\.2 s"),
        workers_of(Cluster(empty.scheduler_address), wait=0.2),
    ):
        pass


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({}, "give either"),
        ({"scheduler": "tcp://a:1", "workers": 2}, "give either"),
        ({"workers": 0}, "--workers 0 should be from 1"),
        ({"scheduler": "localhost:8786"}, "is no address: write tcp://HOST:PORT"),
    ],
)
def test_a_cluster_that_is_none(words, message):
    with pytest.raises(InputError, match=message):
        Cluster(**words)


def test_the_command_with_a_worker_of_its_own(model, whole, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    model.save("scan.model")
    words = ("generate", "--model", "scan.model", "--shape", *SHAPE, "--seed", 3, "--out", "x.zarr")
    assert (
        trabecula(*words, "--chunks", 32, "--workers", 1).sha256 == whole.recipe.steps[-1]["sha256"]
    )
    assert "into a .zarr" in refused(*words[:-1], "x.npy", "--workers", 1)
    assert "--workers 0" in refused(*words, "--workers", 0)


WHOLE = {
    "texture": ({"preset": "fast"}, (40, 33, 36)),
    "quilt": ({"preset": "fast"}, (40, 33, 36)),
    "kopf": ({"first_rounds": 1, "rounds": (1,), "sweeps": (1,)}, (24, 20, 22)),
    "chen": (
        {"first_rounds": 1, "rounds": (1,), "sweeps": (1,), "corrections": (0,)},
        (24, 20, 22),
    ),
    "sliced": (
        {"layout_rounds": 2, "rounds": (1,), "corrections": (1,), "sweeps": 1},
        (24, 20, 22),
    ),
    "mrf": ({"sweeps": (1, 1, 2)}, (20, 16, 18)),
}


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=[pytest.mark.slow] * (n == "chen")) for n in sorted(WHOLE)],
)
def test_workers_help_with_what_is_made_as_a_whole(two, name, tmp_path, monkeypatch):
    """The dear steps go to them, slab by slab; what was sent and what not makes no difference."""
    settings, shape = WHOLE[name]
    bone = tb.crop(tb.sample("bone"), 40)
    picture = tb.Image(bone.values[20], "labels", bone.spacing[1:], bone.unit, bone.phases)
    model = tb.method(name, **settings).fit(
        picture if tb.method(name).capabilities.exemplar == "2d" else bone
    )
    sent, real = [], Workers.spread
    monkeypatch.setattr(
        Workers, "spread", lambda self, work, bounds: (sent.append(work), real(self, work, bounds))
    )
    request = tb.Request(shape, seed=2)
    made = generate_to(
        model, request, tmp_path / "x.zarr", chunks=16, cluster=Cluster(two.scheduler_address)
    )
    assert made.sha256 == model.generate(request).recipe.steps[-1]["sha256"]
    assert sent or name == "quilt", "quilt lays one piece after the other"
    assert [entry.name for entry in tmp_path.iterdir()] == ["x.zarr"]


@pytest.mark.slow
def test_a_worker_that_is_lost_with_a_slab_costs_that_slab(two, tmp_path):
    model = tb.method("texture", preset="fast").fit(tb.crop(tb.sample("bone"), 40))
    with distributed.Client(two, set_as_default=False) as client:
        victim = next(iter(client.run(os.getpid).values()))
    killed = []

    def kill(label, fraction):
        if label.startswith("level") and fraction > 0.3 and not killed:
            killed.append(victim)
            os.kill(victim, signal.SIGKILL)

    request = tb.Request((64, 50, 48), seed=2)
    with listen(kill):
        made = generate_to(
            model, request, tmp_path / "x.zarr", chunks=16, cluster=Cluster(two.scheduler_address)
        )
    assert killed and made.sha256 == model.generate(request).recipe.steps[-1]["sha256"]
