"""Runs of `texture` that are put into scratch files, or cut off."""

import numpy as np
import pytest

import trabecula as tb
from trabecula.core.progress import listen
from trabecula.engine import checkpoint, memmap
from trabecula.engine.memory import check_releases
from trabecula.synth.shared import novel_layout
from trabecula.testing.peak import peak_bytes


class StoppedError(Exception):
    """The run is cut off here."""


def check_in_files(model, request, folder):
    """Check that scratch files and threads change no voxel; return the result and its report."""
    with check_releases():
        at_once, report = model.compute(request)
    with tb.threads(2), memmap.map_large_arrays(folder, memory=1 << 20, thickest=3):
        values, _ = model.compute(request)
        assert memmap.file_of(values) is not None
        assert np.array_equal(values, at_once)
        del values
    assert not list(folder.iterdir()), "a file stayed"
    return at_once, report


def check_memory(model, request):
    """Check that a run's arrays are forecast."""
    plan = model.plan(request)
    arrays = plan.peak - plan.memory["interpreter and kernels"] - plan.memory["exemplar"]
    assert peak_bytes(lambda: model.make(request)) <= arrays


def write_every_checkpoint(monkeypatch):
    """Let a run write a checkpoint wherever it may."""
    monkeypatch.setattr(checkpoint, "EVERY", 0.0)
    monkeypatch.setattr(checkpoint, "_SHARE", 0)


def resume_after_search(call, model, request, path, monkeypatch):
    """Return the result of a run of new material that was interrupted in search number `call`, with
    its checkpoint at a path.
    """
    write_every_checkpoint(monkeypatch)
    own, done = novel_layout.coherent_search, []

    def counted(*parts, **settings):
        done.append(call)
        if len(done) == call:
            raise KeyboardInterrupt
        return own(*parts, **settings)

    monkeypatch.setattr(novel_layout, "coherent_search", counted)
    with pytest.raises(KeyboardInterrupt), checkpoint.kept_at(path):
        model.generate(request)
    resumed = []
    with listen(lambda line, fraction: resumed.append(line)), checkpoint.kept_at(path):
        values = model.generate(request).values
    assert any("resuming from" in line for line in resumed), "it began anew"
    return values
