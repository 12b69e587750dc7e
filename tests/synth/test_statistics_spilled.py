"""The same in memory and with arrays in scratch files, cut into thin slabs; and what both take."""

import pickle

import numpy as np
import pytest

import trabecula as tb
from trabecula.core.request import Request
from trabecula.core.seeds import key
from trabecula.engine import checkpoint, memmap
from trabecula.engine.cluster import ReferencedFiles
from trabecula.engine.memory import check_releases
from trabecula.synth.shared import novel_layout
from trabecula.synth.shared.content.fields import FULL, noise, votes_of
from trabecula.synth.shared.content.kinds import Labels
from trabecula.synth.shared.matching.region import Region
from trabecula.synth.shared.specks import remove_specks
from trabecula.synth.shared.statistics.pairs import Pairs
from trabecula.synth.shared.statistics.sliced import (
    transport_neighbourhoods,
    transport_stages,
)
from trabecula.synth.shared.statistics.slices import Transport, slice_target
from trabecula.synth.shared.statistics.torus_steps import torus_step
from trabecula.synth.shared.statistics.two_point import correlations_of
from trabecula.synth.shared.statistics.two_point_steps import (
    misfit,
    step_stages,
    two_point_step,
)
from trabecula.synth.sliced import run
from trabecula.synth.sliced.run import regions_around_known
from trabecula.synth.sliced.steps import distance_stages, distance_step, slope
from trabecula.testing.peak import peak_bytes

OPEN, AROUND, MIXED = (False, False, False), (True, True, True), (True, False, True)


def smooth(shape, seed, *, channels=1):
    """A wrapping random field in int8, smooth over a few voxels."""
    field = np.random.default_rng(seed).standard_normal((channels, *shape))
    for axis in (1, 2, 3, 1, 2, 3):
        field = field + np.roll(field, 1, axis) + np.roll(field, -1, axis)
    return np.clip(np.rint(field / field.std() * 50), -FULL, FULL).astype(np.int8)


class Others:
    """Other processes, as far as work can tell: it comes to them in bytes, and more than once."""

    at_once = 2

    def spread(self, work, bounds):
        packed = ReferencedFiles().dumps(work)
        for start, stop in bounds:
            for _ in range(2):
                pickle.loads(packed)(start, stop)


FIELD, EXEMPLAR = smooth((19, 22, 25), 1, channels=2), smooth((18, 20, 16), 2, channels=2)
FREE = np.ones(FIELD.shape[1:], bool)
FREE[4:9, 5:, 3:20] = False
TARGET = correlations_of([EXEMPLAR], softness=50, r_max=6)
CUBES, SQUARES = (
    slice_target([EXEMPLAR], width=4),
    slice_target([EXEMPLAR[:, :1]], width=4, flat=True),
)
STAGE = key(5, "s")


def known(wraps):
    request = Request(
        FREE.shape,
        seed=0,
        periodic=wraps,
        fixed=tb.Image((FIELD[0] > 0).astype(np.uint8), "labels"),
        known=~FREE,
    )
    bounds = FIELD.astype(np.float32) / 9, FIELD.astype(np.float32) / 8 + 1
    regions = regions_around_known(request, bounds, 2, lambda index: 4.0 * 2**index, exact=True)
    return [part for region in regions for part in (region.free, region.low, region.high)]


@pytest.mark.parametrize(
    "run",
    [
        pytest.param(lambda: two_point_step(FIELD, TARGET, debt=0.01 * TARGET.curves), id="step"),
        pytest.param(lambda: two_point_step(FIELD, TARGET, periodic=AROUND), id="step around"),
        pytest.param(
            lambda: two_point_step(FIELD, TARGET, periodic=MIXED, free=FREE),
            id="step of what is free",
        ),
        pytest.param(lambda: torus_step(FIELD, TARGET, renew=True)[0], id="step on a torus"),
        pytest.param(lambda: misfit(FIELD, TARGET, periodic=MIXED, free=FREE), id="misfit"),
        pytest.param(
            lambda: distance_step(FIELD, TARGET, Region(FREE.shape, MIXED, FREE)),
            id="step of distances",
        ),
        pytest.param(
            lambda: transport_neighbourhoods(votes_of(FIELD), [(0, CUBES)], key=STAGE, number=2),
            id="round",
        ),
        pytest.param(
            lambda: transport_neighbourhoods(
                votes_of(FIELD), [(0, CUBES)], key=STAGE, number=3, periodic=MIXED, free=FREE
            ),
            id="round of what is free",
        ),
        pytest.param(
            lambda: transport_neighbourhoods(
                votes_of(FIELD),
                [(a, SQUARES) for a in range(3)],
                key=STAGE,
                number=1,
                step=1,
                periodic=MIXED,
            ),
            id="views",
        ),
        pytest.param(
            lambda: transport_neighbourhoods(
                votes_of(FIELD), [(2, SQUARES), (1, SQUARES)], key=STAGE, number=1, free=FREE
            ),
            id="views of what is free",
        ),
        pytest.param(lambda: noise((2, 7, 5, 9), 11), id="noise"),
        pytest.param(lambda: known(MIXED), id="around what is known"),
        pytest.param(
            lambda: remove_specks(votes_of(FIELD[:1]), (FIELD[0] > 40).astype(np.uint8), (0, 1), 9),
            id="specks",
        ),
    ],
)
@pytest.mark.parametrize("hands", [None, Others()], ids=["here", "elsewhere"])
def test_scratch_files_change_nothing(run, hands, tmp_path, monkeypatch):
    """Nor do thin slabs, nor others who work on those that they may."""
    if hands is not None:
        pytest.importorskip("cloudpickle")
    here = run()
    if hands is None:
        monkeypatch.setattr(memmap, "SMALLEST", 64)
    with memmap.map_large_arrays(tmp_path / "scratch", memory=1 << 16, thickest=5, workers=hands):
        there = run()
        for a, b in zip(here, there, strict=True):
            assert np.array_equal(a, b)


def test_rounds_are_put_back_batch_by_batch(monkeypatch):
    """However few neighbourhoods at a time: planes of sites, some of their rows, one row."""
    wanted = transport_neighbourhoods(
        votes_of(FIELD), [(0, CUBES)], key=STAGE, number=2, periodic=MIXED, free=FREE
    )
    for batch in (1 << 16, 1 << 12, 1):
        monkeypatch.setattr("trabecula.synth.shared.statistics.sites.BATCH", batch)
        found = transport_neighbourhoods(
            votes_of(FIELD), [(0, CUBES)], key=STAGE, number=2, periodic=MIXED, free=FREE
        )
        assert np.array_equal(found, wanted)


@pytest.mark.parametrize("shape", [(1, 5, 7, 3), (2, 4, 3, 5), (3, 6, 8, 8)])
def test_noise_is_one_stream(shape):
    words = np.random.Philox(key=77).random_raw(int(np.prod(shape))) >> np.uint64(50)
    assert np.array_equal(noise(shape, 77), words.reshape(shape).astype(int) - 8192)


def test_a_field_may_be_given_by_planes():
    """And both are NumPy's transform of it, continued by zeros."""
    values = FIELD[0].astype(np.float32)
    pairs = Pairs(values.shape, 4, MIXED)
    found = pairs.forward(values)
    assert np.array_equal(pairs.forward(lambda a, b: values[a:b]), found)
    wanted = np.fft.rfftn(values.astype(float), pairs.sides, axes=(0, 1, 2))
    assert np.abs(found - wanted).max() < 1e-6 * np.abs(wanted).max()


def test_transport_does_not_know_how_values_are_cut():
    rng = np.random.default_rng(3)
    ours, theirs = (np.rint(rng.normal(0, 5000, (n, 4))).astype(np.float32) for n in (300, 211))
    whole = Transport.between(lambda a, b: [ours[a:b]], len(ours), theirs)
    cut = Transport.between(lambda a, b: np.array_split(ours[30 * a : 30 * b], 7), 10, theirs)
    assert np.array_equal(cut.table, whole.table)
    assert np.array_equal(cut.moves(ours), whole.moves(ours))


@pytest.mark.parametrize("wraps", [OPEN, AROUND, MIXED])
def test_a_slope_is_that_of_central_differences_averaged(wraps):
    channel = FIELD[0]
    modes = ["wrap" if wrap else "edge" for wrap in wraps]

    def beside(values, axis):
        padded = np.pad(
            values, [(1, 1) if a == axis else (0, 0) for a in range(3)], mode=modes[axis]
        )
        cells = np.arange(values.shape[axis])
        return padded.take(cells, axis), padded.take(cells + 2, axis)

    square = sum(
        ((after - before) / 2) ** 2
        for before, after in (beside(channel.astype(float), a) for a in range(3))
    )
    mean = np.sqrt(square)
    for axis in range(3):
        before, after = beside(mean, axis)
        mean = (before + 2 * mean + after) / 4
    found = np.concatenate([slope(channel, wraps, a, b) for a, b in ((0, 1), (1, 8), (8, 19))])
    assert np.allclose(found, np.maximum(mean, 1), rtol=1e-5)


@pytest.mark.whole
@pytest.mark.parametrize("periodic", [OPEN, AROUND])
def test_the_forecast_of_a_step_holds(periodic):
    field = smooth((64, 60, 72), 4)
    target = correlations_of([smooth((32, 32, 32), 5)], softness=60, r_max=10)
    two_point_step(field, target, periodic=periodic)
    with tb.threads(1):
        peak = peak_bytes(lambda: two_point_step(field, target, periodic=periodic)) - 2 * field.size
    forecast = max(stage.peak for stage in step_stages(field.shape[1:], target, periodic))
    assert peak <= forecast <= 1.3 * peak


ALONE = smooth((64, 60, 72), 7)
ITS = correlations_of([EXEMPLAR[:1]], softness=50, r_max=6)
CUBE, SQUARE = (
    slice_target([EXEMPLAR[:1]], width=4),
    slice_target([EXEMPLAR[:1, :1]], width=4, flat=True),
)


def resident_bytes(stages):
    return max(stage.working for stage in stages)


@pytest.mark.whole
@pytest.mark.parametrize(
    ("run", "forecast"),
    [
        (
            lambda: two_point_step(ALONE, ITS),
            lambda: resident_bytes(step_stages(ALONE.shape[1:], ITS)),
        ),
        (
            lambda: distance_step(ALONE, ITS, Region(ALONE.shape[1:])),
            lambda: resident_bytes(distance_stages(ALONE.shape, ITS, OPEN)),
        ),
        (
            lambda: transport_neighbourhoods(votes_of(ALONE), [(0, CUBE)], key=STAGE, number=1),
            lambda: resident_bytes(transport_stages(ALONE.shape, [(0, CUBE)], step=2)),
        ),
        (
            lambda: transport_neighbourhoods(
                votes_of(ALONE), [(a, SQUARE) for a in range(3)], key=STAGE, number=1, step=1
            ),
            lambda: resident_bytes(transport_stages(ALONE.shape, [(0, SQUARE)], step=1)),
        ),
    ],
    ids=["step", "step of distances", "round", "views"],
)
def test_what_stays_in_memory_is_forecast(run, forecast, tmp_path):
    """Arrays in scratch files are none of Python's memory, nor are the kernels, which are loaded
    before.
    """
    with tb.threads(1), memmap.map_large_arrays(tmp_path, memory=1 << 20):
        run()
        assert peak_bytes(run) <= forecast()


SHAPE = (32, 32, 34)


@pytest.fixture(scope="module")
def model():
    image = tb.Image((smooth((32, 32, 32), 6)[0] > 20).astype(np.uint8), "labels")
    return tb.method("texture", sweeps=1, tries=1).fit(image)


@pytest.fixture(scope="module")
def whole(model):
    assert model._makes_new(Request(SHAPE, seed=3))
    with check_releases():
        return model.generate(SHAPE, seed=3).values


@pytest.mark.whole
def test_new_material_is_the_same_in_scratch_files(model, whole, tmp_path):
    with memmap.map_large_arrays(tmp_path, memory=1 << 19, thickest=5):
        assert np.array_equal(model.make(Request(SHAPE, seed=3))[0], whole)


@pytest.mark.slow
def test_leaves_are_searched_alike_in_scratch_files_and_by_threads(model, tmp_path):
    """Features are held in memory, and made twice where arrays are in files."""
    settings = {"sweeps": 1, "tries": 1, "search": "leaves"}
    model = tb.method("texture", **settings).fit(model.exemplars[0])
    with tb.threads(1), check_releases():
        whole = model.generate(SHAPE, seed=3).values
    with tb.threads(3):
        assert np.array_equal(model.generate(SHAPE, seed=3).values, whole)
    with memmap.map_large_arrays(tmp_path, memory=1 << 19, thickest=5):
        assert np.array_equal(model.make(Request(SHAPE, seed=3))[0], whole)


@pytest.mark.whole
@pytest.mark.parametrize(
    ("owner", "name", "call", "left"),
    [
        (novel_layout, "coherent_search", 3, 9),
        (novel_layout, "coherent_search", 10, 2),
        (novel_layout, "coherent_search", 11, 1),
        (Labels, "to_values", 1, 4),  # three counts of small bodies before the result
    ],
    ids=["in the first pass", "in a pass", "after a pass", "after the last"],
)
def test_interrupted_it_goes_on_bit_for_bit(
    owner, name, call, left, model, whole, tmp_path, monkeypatch
):
    """And does nothing again that was done before."""
    monkeypatch.setattr(checkpoint, "EVERY", 0.0)
    monkeypatch.setattr(checkpoint, "_SHARE", 0)
    own, done = getattr(owner, name), []

    def broken(*parts, **settings):
        done.append(name)
        if len(done) == call:
            raise KeyboardInterrupt
        return own(*parts, **settings)

    monkeypatch.setattr(owner, name, broken)
    with pytest.raises(KeyboardInterrupt), checkpoint.kept_at(tmp_path / "a.part"):
        model.generate(SHAPE, seed=3)
    with checkpoint.kept_at(tmp_path / "a.part"):
        again = model.generate(SHAPE, seed=3)
    assert np.array_equal(again.values, whole)
    assert len(done) == call + left


@pytest.mark.whole
def test_a_layout_goes_on_bit_for_bit(tmp_path, monkeypatch):
    """Of `sliced`: what is kept is the field."""
    monkeypatch.setattr(checkpoint, "EVERY", 0.0)
    monkeypatch.setattr(checkpoint, "_SHARE", 0)
    picture = tb.Image((smooth((1, 40, 40), 8)[0, 0] > 15).astype(np.uint8), "labels")
    model = tb.method("sliced", preset="fast", layout_rounds=5).fit(picture)
    own, done = run.transport_neighbourhoods, []

    def broken(*parts, **settings):
        done.append(settings["number"])
        if len(done) == 5:
            raise KeyboardInterrupt
        return own(*parts, **settings)

    def made():
        with checkpoint.kept_at(tmp_path / "a.part"):
            return model.generate((16, 16, 16), seed=1).values

    whole = made()
    monkeypatch.setattr(run, "transport_neighbourhoods", broken)
    with pytest.raises(KeyboardInterrupt):
        made()
    assert np.array_equal(made(), whole)
    assert done == [0, 1, 2, 3, 4, 4]
