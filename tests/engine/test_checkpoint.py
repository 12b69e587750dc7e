"""A run that was killed goes on where it stopped, and makes the voxels of one that was not."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import trabecula as tb
from trabecula.core.progress import listen
from trabecula.core.recipe import digest
from trabecula.core.request import Request
from trabecula.core.seeds import generator
from trabecula.engine import checkpoint
from trabecula.engine.checkpoint import identity_of, kept_at, offer, resume, running
from trabecula.synth.api import registry
from trabecula.synth.api.method import Capabilities, Method, Model
from trabecula.synth.noise.config import NoiseConfig

EXEMPLAR = tb.Image(np.eye(12, dtype=np.uint8), "labels")
ROUNDS = 40


@pytest.fixture(autouse=True)
def _at_once(monkeypatch):
    monkeypatch.setattr(checkpoint, "EVERY", 0.0)
    monkeypatch.setattr(checkpoint, "_SHARE", 0)


class StoppedError(Exception):
    """The run is cut off here."""


def walk(request, *, stop=None, told=None, end=None):
    """Two loops in a row, as methods are made: each round is a function of the state, the seed and
    the round.
    """
    field, last = np.zeros(request.shape, np.int64), None
    stages = ("coarse", "fine")
    left = [resume(stage) for stage in reversed(stages)][::-1]
    first = next((n for n, state in enumerate(left) if state is not None), 0)
    for index, stage in enumerate(stages):
        if index < first:
            continue
        begin = 0
        if left[index] is not None:
            begin, field, last = (
                left[index].number,
                left[index].arrays["field"],
                left[index].arrays["last"],
            )
        for number in range(begin, ROUNDS):
            if stop == (stage, number):
                raise StoppedError
            last = generator(request.seed, stage, number).integers(100, size=request.shape)
            field = field * 3 % 1009 + last
            offer(stage, number + 1, field=field, last=last)
            if (stage, number) == ("fine", 7) and end is not None:
                os.kill(os.getpid(), end)
            if told is not None:
                told.append((stage, number))
    return field


WALK = Capabilities(
    "walk", "for tests", "nobody", method="test_checkpoint:Walk", learns_from=("picture",)
)


class Walked(Model):
    capabilities = WALK

    def make(self, request):
        end = os.environ.get("WALK_END")
        return (walk(request, end=end and int(end)) % 2).astype(np.uint8)

    def _result_fields(self):
        return {"kind": "labels", "spacing": (1.0,) * 3}


class Walk(Method):
    capabilities = WALK
    config_type = NoiseConfig
    model_type = Walked


def whole(request):
    return walk(request)


def cut(path, request, *, at, exemplars=(EXEMPLAR,), settings=None):
    """Run up to a round and die there."""
    with (
        pytest.raises(StoppedError),
        kept_at(path),
        running("walk", settings or {}, request, exemplars),
    ):
        walk(request, stop=at)


def gone_on(path, request, *, exemplars=(EXEMPLAR,), settings=None):
    """Run once more; the result, the rounds that were done, and what was said."""
    rounds, lines = [], []
    told = listen(lambda line, fraction: lines.append(line))
    with told, kept_at(path), running("walk", settings or {}, request, exemplars):
        field = walk(request, told=rounds)
    return field, rounds, lines


@pytest.mark.parametrize("at", [("coarse", 1), ("coarse", 17), ("fine", 0), ("fine", 39)])
def test_a_run_goes_on_where_it_stopped(tmp_path, at):
    request = Request((5, 6, 7), seed=3)
    cut(tmp_path / "rock.zarr.part", request, at=at)
    field, rounds, lines = gone_on(tmp_path / "rock.zarr.part", request)
    assert np.array_equal(field, whole(request))
    assert rounds[0] == at
    assert "resuming" in lines[0] and "rock.zarr.part" in lines[0]
    assert list(tmp_path.iterdir()) == [], "the state is removed with the block"


def test_a_second_interruption_is_no_worse(tmp_path):
    request = Request(4, seed=1)
    for at in (("coarse", 9), ("coarse", 30), ("fine", 5)):
        cut(tmp_path / "a.part", request, at=at)
    field, rounds, _ = gone_on(tmp_path / "a.part", request)
    assert rounds[0] == ("fine", 5) and np.array_equal(field, whole(request))


OTHERS = {
    "seed": {"request": Request(4, seed=2)},
    "shape": {"request": Request((4, 4, 5), seed=1)},
    "periodic": {"request": Request(4, seed=1, periodic=True)},
    "mask": {"request": Request(4, seed=1, mask=np.ones((4, 4, 4), bool))},
    "exemplar": {"exemplars": (tb.Image(np.eye(12, dtype=np.uint8)[::-1], "labels"),)},
    "spacing": {"exemplars": (tb.Image(np.eye(12, dtype=np.uint8), "labels", spacing=2.0),)},
    "settings": {"settings": {"levels": 2}},
}


@pytest.mark.parametrize("other", OTHERS.values(), ids=OTHERS)
def test_another_run_does_not_use_it(tmp_path, other):
    request = Request(4, seed=1)
    cut(tmp_path / "a.part", request, at=("fine", 20))
    field, rounds, lines = gone_on(tmp_path / "a.part", **{"request": request, **other})
    assert rounds[0] == ("coarse", 0)
    assert "another run" in lines[0]
    assert np.array_equal(field, whole(other.get("request", request)))


@pytest.mark.parametrize("text", [b"", b"my own notes", b"PK\x03\x04" + bytes(300)])
def test_a_file_that_is_no_state_is_left_as_it_is(tmp_path, text):
    request = Request(4, seed=1)
    (tmp_path / "a.part").write_bytes(text)
    field, rounds, lines = gone_on(tmp_path / "a.part", request)
    assert rounds[0] == ("coarse", 0) and "left as it is" in lines[0]
    assert np.array_equal(field, whole(request))
    assert (tmp_path / "a.part").read_bytes() == text


def test_a_run_that_ends_before_it_keeps_anything_leaves_the_state_of_another(
    tmp_path, monkeypatch
):
    request = Request(4, seed=1)
    cut(tmp_path / "a.part", request, at=("fine", 20))
    with monkeypatch.context() as patch:
        patch.setattr(checkpoint, "EVERY", 3600.0)
        gone_on(tmp_path / "a.part", Request(4, seed=2))
    assert gone_on(tmp_path / "a.part", request)[1][0] == ("fine", 20)


def test_one_wrong_byte_in_an_array_is_seen(tmp_path):
    request = Request(16, seed=1)
    cut(tmp_path / "a.part", request, at=("fine", 20))
    data = bytearray((tmp_path / "a.part").read_bytes())
    data[len(data) // 3] ^= 1
    (tmp_path / "a.part").write_bytes(data)
    field, rounds, lines = gone_on(tmp_path / "a.part", request)
    assert rounds[0] == ("coarse", 0) and "damaged" in lines[0]
    assert np.array_equal(field, whole(request))


def test_nothing_is_written_before_it_is_due_or_without_a_place(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    request = Request(4, seed=1)
    with running("walk", {}, request, (EXEMPLAR,)):
        walk(request)
    monkeypatch.setattr(checkpoint, "EVERY", 3600.0)
    with pytest.raises(StoppedError), kept_at("a.part"), running("walk", {}, request, (EXEMPLAR,)):
        walk(request, stop=("fine", 30))
    assert list(tmp_path.iterdir()) == []


def test_a_place_that_cannot_be_written_does_not_end_the_run(tmp_path):
    (tmp_path / "file").write_text("in the way")
    request, lines = Request(4, seed=1), []
    told = listen(lambda line, fraction: lines.append(line))
    with told, kept_at(tmp_path / "file" / "a.part"), running("walk", {}, request, (EXEMPLAR,)):
        assert np.array_equal(walk(request), whole(request))
    assert len(lines) == 1 and "cannot be resumed" in lines[0]


def test_models_use_the_place_that_is_set(tmp_path):
    model = Walk(NoiseConfig()).fit(EXEMPLAR)
    expected = model.generate((6, 7, 8), seed=4).values
    request = Request((6, 7, 8), seed=4)
    cut(
        tmp_path / "a.part",
        request,
        at=("fine", 3),
        exemplars=model.exemplars,
        settings=model._decisive(),
    )
    lines = []
    with listen(lambda line, fraction: lines.append(line)), kept_at(tmp_path / "a.part"):
        assert np.array_equal(model.generate(request).values, expected)
    assert any("resuming" in line for line in lines)


# Run as a program: `generate` on the command line, with the method above in the registry.
def _program(words):
    # A shell starts what runs in its background with interrupts ignored, and children inherit that.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    specs = {**registry.methods(), "walk": Walk.capabilities}
    registry.methods = lambda: specs
    original = registry.method
    registry.method = lambda name, **settings: (
        Walk(NoiseConfig()) if name == "walk" else original(name, **settings)
    )
    checkpoint.EVERY = checkpoint._SHARE = 0
    from trabecula.cli.main import main

    return main(words)


def _command(tmp_path, *, seed=5, end=None, resume=False):
    tb.write(EXEMPLAR, tmp_path / "flat.png")
    words = [
        "generate",
        "flat.png",
        "--method",
        "walk",
        "--shape",
        "6",
        "--seed",
        str(seed),
        "--out",
        "rock.npy",
    ]
    words += ["--phases", "void", "solid", "--kind", "labels"]
    words = ["generate", "--resume", "rock.npy"] if resume else words
    paths = [str(Path(__file__).parent), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
    if end is not None:
        environment["WALK_END"] = str(int(end))
    program = f"import sys, test_checkpoint; sys.exit(test_checkpoint._program({words!r}))"
    return {
        "args": [sys.executable, "-c", program],
        "cwd": tmp_path,
        "env": environment,
        "stdout": subprocess.PIPE,
        "stderr": subprocess.PIPE,
        "text": True,
    }


@pytest.mark.parametrize(
    "sign",
    [signal.SIGKILL, pytest.param(signal.SIGINT, marks=pytest.mark.whole)]
    if os.name == "posix"
    else [],
)
def test_the_command_line_goes_on_after_a_kill(tmp_path, sign):
    part = tmp_path / "rock.npy.part"
    child = subprocess.run(**_command(tmp_path, end=sign), check=False)
    err = child.stderr
    assert child.returncode == (130 if sign == signal.SIGINT else -sign), err
    assert part.exists() and not (tmp_path / "rock.npy").exists()
    if sign == signal.SIGINT:
        assert "resumes from rock.npy.part" in err
    done = subprocess.run(**_command(tmp_path, resume=sign == signal.SIGKILL), check=True)
    assert "resuming from rock.npy.part" in done.stderr
    assert not part.exists()
    expected = (whole(Request(6, seed=5)) % 2).astype(np.uint8)
    assert digest(np.load(tmp_path / "rock.npy")) == digest(expected)


def test_the_identity_of_a_run_holds_every_part_of_the_request():
    mask, known = np.zeros((2, 8, 8, 8), bool)
    mask[2:], known[:4] = True, True
    fixed = tb.Image(np.arange(512).reshape(8, 8, 8) % 2, "labels")
    parts = [
        {}, {"seed": 1}, {"periodic": True}, {"mask": mask}, {"target": {"porosity": 0.5}},
        {"target": {"porosity": 0.6}}, {"fixed": fixed, "known": known},
        {"fixed": fixed, "known": ~known}, {"coarse": tb.Image(fixed.values[:4, :4, :4], "labels")},
        {"coarse": tb.Image(1 - fixed.values[:4, :4, :4], "labels")},
    ]  # fmt: skip
    found = {identity_of("noise", {}, tb.Request(8, **each), []) for each in parts}
    found |= {identity_of("noise", {"reach": 4}, tb.Request(8), [])}
    found |= {identity_of("noise", {}, tb.Request(8), [fixed])}
    assert len(found) == len(parts) + 2
