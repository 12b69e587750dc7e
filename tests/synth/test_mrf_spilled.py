"""`mrf` in scratch files: the same voxels whatever may be resident, and no array of the volume's
size in memory.
"""

import gc
import pickle
from pathlib import Path

import numpy as np
import pytest

import trabecula as tb
from alone import call_alone
from trabecula.core.request import Request
from trabecula.engine import memmap, parallel
from trabecula.engine.cluster import ReferencedFiles
from trabecula.synth.mrf import site_update
from trabecula.testing.peak import peak_bytes

SHAPE = (11, 14, 13)
LARGE = {"_FEW": 1, "_MANY": 0, "_SMALL": 0}


@pytest.fixture(scope="module")
def pictures():
    return make_pictures()


def make_pictures():
    rng = np.random.default_rng(7)
    wave = np.hypot(*np.meshgrid(np.fft.fftfreq(36), np.fft.fftfreq(36)))
    smooth = np.fft.ifft2(
        np.fft.fft2(rng.normal(size=(36, 36))) * np.exp(-((wave - 1 / 8) ** 2) * 600)
    ).real
    smooth /= smooth.std()
    grey = np.clip(128 + 60 * smooth, 0, 255).astype(np.uint8)
    return {
        "labels": tb.Image((smooth > 0.3).astype(np.uint8), "labels"),
        "phases": tb.Image((smooth > 0.3).astype(np.uint8) + (smooth > 1), "labels"),
        "grey": tb.Image(grey, "grey"),
        "colour": tb.Image(np.stack([grey, 255 - grey, grey // 2], axis=-1), "colour"),
    }


class Others:
    """Other processes, as far as work can tell: it comes to them in bytes, and more than once."""

    at_once = 2
    worked = 0

    def spread(self, work, bounds):
        packed = ReferencedFiles().dumps(work)
        for start, stop in bounds:
            for _ in range(2):
                pickle.loads(packed)(start, stop)
                self.worked += 1


def as_if_large(monkeypatch):
    """Treat a class of few sites as one of many."""
    for name, value in LARGE.items():
        monkeypatch.setattr(site_update, name, value)


def split_request(picture, names):
    """Return the parts of a request."""
    form = np.hypot.outer(np.hypot.outer(np.arange(-5, 6), np.arange(-7, 7)), np.arange(-6, 7)) < 7
    known = np.zeros(SHAPE, bool)
    known[4, 2:10] = known[8:, 3, 5] = True
    held = np.resize(picture.values[: SHAPE[1], : SHAPE[2]], (*SHAPE, *picture.values.shape[2:]))
    every = {
        "periodic": {"periodic": (False, True, True)},
        "mask": {"mask": form},
        "fixed": {"fixed": tb.Image(held, picture.kind), "known": known},
        "target": {"target": {"porosity": 0.5}},
    }
    return {name: value for part in names for name, value in every[part].items()}


@pytest.mark.whole
@pytest.mark.parametrize(
    ("kind", "settings", "parts"),
    [
        ("labels", {"sweeps": (2,), "scales": 1, "polish": 0, "oblique": True}, ()),
        ("labels", {"sweeps": (2, 1), "neighbourhood": 3}, ("mask", "fixed")),
        ("phases", {"sweeps": (1,)}, ("mask", "periodic")),
        ("grey", {"sweeps": (1,), "scales": 2, "candidates": 128, "upsampling": "one"}, ("mask",)),
        (
            "colour",
            {
                "sweeps": (1,),
                "scales": 1,
                "candidates": 64,
                "heuristic": "h2a",
                "spread": False,
                "oblique": False,
            },
            ("fixed",),
        ),
        (
            "labels",
            {"sweeps": (3,), "relaxation": "icm", "heuristic": "h1b", "resynthesis": False},
            ("mask", "fixed"),
        ),
        ("grey", {"sweeps": (1,), "relaxation": "icm", "candidates": 128, "scales": 1}, ()),
        (
            "labels",
            {"sweeps": (3,), "relaxation": "annealing", "shares": False},
            ("periodic", "target"),
        ),
    ],
)
def test_in_scratch_files_the_voxels_are_the_same(
    kind, settings, parts, pictures, tmp_path, monkeypatch
):
    model = tb.method("mrf", **{"oblique": False, **settings}).fit(pictures[kind])
    request = Request(SHAPE, seed=5, **split_request(pictures[kind], parts))
    whole, told = model.make(request)
    monkeypatch.setattr(memmap, "SMALLEST", 1)
    as_if_large(monkeypatch)
    # A part of everything at once; two threads where there are few passes, of which each starts
    # them anew.
    with (
        memmap.map_large_arrays(tmp_path, memory=1 << 15),
        parallel.threads(2 if settings.get("heuristic") == "h1b" else 1),
    ):
        made, again = model.make(request)
        assert memmap.file_of(made) is not None
        assert np.array_equal(made, whole)
    assert again == told
    assert whole.std() > 0 and sum(told["scales"][-1]["changed"]) > 0


@pytest.mark.parametrize("heuristic", ["h2b", pytest.param("h1a", marks=pytest.mark.slow)])
def test_densities_may_come_from_other_processes(heuristic, pictures, tmp_path, monkeypatch):
    pytest.importorskip("cloudpickle")
    settings = {"relaxation": "icm"} if heuristic == "h1a" else {"oblique": False}
    model = tb.method("mrf", sweeps=(1,), scales=2, heuristic=heuristic, **settings).fit(
        pictures["labels"]
    )
    request = Request(SHAPE, seed=5, **split_request(pictures["labels"], ("mask",)))
    whole = model.make(request)[0]
    as_if_large(monkeypatch)
    others = Others()
    with memmap.map_large_arrays(tmp_path, memory=1 << 30, thickest=9, workers=others):
        assert np.array_equal(model.make(request)[0], whole)
    assert others.worked


def peaks_of(kind, masked, depths, folder):
    """Return the traced peak of runs of some depths, after another run, and what was forecast for
    tables and a slab. Globals of `mrf` are changed: for a process of its own.
    """
    for name, value in LARGE.items():
        setattr(site_update, name, value)
    model = tb.method("mrf", sweeps=(1,), scales=2, candidates=128, reach=5, polish=0).fit(
        make_pictures()[kind]
    )
    peaks, forecasts = [], []
    for depth in (depths[-1], *depths):
        form = {"mask": np.ones((depth, 30, 34), bool)} if masked else {}
        request = Request((depth, 30, 34), seed=1, **form)
        gc.collect()
        with tb.threads(1), memmap.map_large_arrays(Path(folder), memory=1 << 16):
            peaks.append(peak_bytes(lambda request=request: model.make(request)))
        with tb.threads(1):
            plan = model.resident_memory(request)
        assert set(plan) == {"interpreter and kernels", "exemplar", "tables", "slab"}
        forecasts.append(plan["tables"] + plan["slab"])
    return peaks[1:], forecasts[1:]


@pytest.mark.whole
@pytest.mark.parametrize(
    ("kind", "masked"),
    [("labels", True), pytest.param("grey", False, marks=pytest.mark.slow)],
)
def test_spilled_no_array_of_the_volume_is_in_memory(kind, masked, tmp_path):
    """Trace NumPy's own arrays: four times as many planes take no more of them."""
    peaks, forecasts = call_alone(peaks_of, kind, masked, (22, 88), str(tmp_path))
    assert all(peak <= most for peak, most in zip(peaks, forecasts, strict=True))
    assert peaks[1] <= 1.1 * peaks[0], peaks
