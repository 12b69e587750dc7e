"""Search and vote with arrays in scratch files, slab by slab, and after an interruption: the voxels
of one run in memory.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from texture_runs import StoppedError, check_in_files, write_every_checkpoint

import trabecula as tb
from trabecula.core.progress import listen
from trabecula.engine import checkpoint, memmap
from trabecula.synth.shared.content.histogram import Histogram, match_histogram, mix_with_neighbours
from trabecula.synth.shared.content.phase_fractions import assign_phases, brightest_voxels
from trabecula.synth.shared.matching.region import Region, regions_of
from trabecula.synth.shared.pyramid import double, fit_to, halve

SHAPE = (35, 30, 32)
QUICK = {
    "novelty": 0.0,
    "neighbourhood": (5,),
    "first_rounds": 2,
    "rounds": (2, 2),
    "sweeps": 1,
    "tries": 1,
}


@pytest.fixture(autouse=True)
def _every_array_in_a_file(monkeypatch):
    monkeypatch.setattr(memmap, "SMALLEST", 64)


@pytest.fixture(scope="module")
def bone():
    return tb.crop(tb.sample("bone"), 32)


def shades(bone):
    values = np.cumsum(bone.values, axis=0, dtype=np.uint8)
    return tb.Image(values, "grey", bone.spacing, bone.unit)


def colours(bone):
    values = shades(bone).values
    return tb.Image(
        np.stack([values, 255 - values, values // 2], axis=-1), "colour", bone.spacing, bone.unit
    )


def phases(bone):
    values = bone.values.copy()
    values[:, 10:20][values[:, 10:20] == 1] = 2
    return tb.Image(values, "labels", bone.spacing, bone.unit, ("void", "bone", "other"))


def form():
    z, y, x = np.indices(SHAPE)
    return (z - 17) ** 2 + (y - 15) ** 2 + (x - 16) ** 2 < 15**2


def held(exemplar):
    values = np.zeros(SHAPE + exemplar.values.shape[3:], exemplar.values.dtype)
    values[:32] = exemplar.values[:, :30]
    known = np.zeros(SHAPE, bool)
    known[:9] = known[20:24, 4:12, 4:9] = True
    fixed = tb.Image(values, exemplar.kind, exemplar.spacing, exemplar.unit, exemplar.phases)
    return {"fixed": fixed, "known": known}


CASES = {
    "two levels": (None, {}, lambda _: {}),
    "sums over blocks": (
        None,
        {"neighbourhood": (8,)},
        lambda _: {"periodic": (True, False, True)},
    ),
    "several widths and sweeps": (
        None,
        {"neighbourhood": (5, 4), "sweeps": 2},
        lambda _: {"periodic": True},
    ),
    "a form": (None, {}, lambda _: {"mask": form()}),
    "known beside a form": (None, {}, lambda e: {"mask": form(), **held(e)}),
    "without a histogram": (None, {"histogram": False}, lambda _: {}),
    "corrected": (None, {"corrections": (1,)}, lambda _: {}),
    "exact": (None, {"search": "exact"}, lambda _: {"mask": form()}),
    "indicators": (None, {"field": "indicator"}, held),
    "grey": (shades, {}, held),
    "plain grey": (shades, {"histogram": False}, lambda _: {}),
    "colour": (colours, {}, lambda _: {"mask": form()}),
    "three phases": (phases, {}, held),
}


@pytest.mark.whole
@pytest.mark.parametrize("case", CASES)
def test_in_slabs_and_at_once_are_the_same(case, bone, tmp_path):
    made_of, settings, parts = CASES[case]
    exemplar = bone if made_of is None else made_of(bone)
    model = tb.method("texture", **{**QUICK, **settings}).fit(exemplar)
    check_in_files(model, tb.Request(SHAPE, seed=3, **parts(exemplar)), tmp_path)


@pytest.mark.whole
@pytest.mark.parametrize(
    "settings",
    [
        {"neighbourhood": (5, 4), "corrections": (1,)},
        {"gradient": 0.1, "adaptive": True, "rounds": (3, 2)},
        {"gradient": 0.1, "tolerance": 0.05, "rounds": (6, 2)},
    ],
    ids=["corrected", "energy", "energy that settles"],
)
def test_a_run_that_was_cut_off_goes_on_after_any_round(settings, bone, tmp_path, monkeypatch):
    write_every_checkpoint(monkeypatch)
    model = tb.method("texture", **{**QUICK, **settings}).fit(bone)
    request = tb.Request(SHAPE, seed=3)
    values, report = model.compute(request)
    told, stop, went_on = [], 0, []
    while True:
        seen = iter(range(stop))

        def listener(label, done, seen=seen):
            if done < 0:
                went_on.append(label)
            elif label.startswith("level") and done > 0 and next(seen, None) is None:
                raise StoppedError

        try:
            with listen(listener), checkpoint.kept_at(tmp_path / "x.part"):
                made, told = model.compute(request)
            break
        except StoppedError:
            stop = 1  # the first time after a round, then after two
    assert np.array_equal(made, values)
    assert told == report, "the energies are those of one run"
    assert any(line.startswith("resuming from x.part") for line in went_on)
    assert len(went_on) >= 2
    assert not list(tmp_path.iterdir())


@given(
    seed=st.integers(0, 99),
    share=st.floats(0, 1),
    levels=st.sampled_from([2, 9, 9999]),
    masked=st.booleans(),
)
def test_the_brightest_are_those_of_a_sorted_list(seed, share, levels, masked):
    rng = np.random.default_rng(seed)
    field = (rng.integers(0, levels, (5, 4, 6)) * (30000 // levels)).astype(np.int16)
    inside = rng.random(field.shape) < 0.7 if masked else np.ones(field.shape, bool)
    count = round(share * np.count_nonzero(inside))
    padded = np.pad(field.astype(int), 1, mode="edge")
    around = np.lib.stride_tricks.sliding_window_view(padded, (3, 3, 3)).sum((3, 4, 5))
    order = np.lexsort(
        (np.arange(field.size), -around.ravel(), -mix_with_neighbours(field).ravel().astype(int))
    )
    expected = np.zeros(field.size, bool)
    expected[[place for place in order if inside.ravel()[place]][:count]] = True
    assert np.array_equal(
        brightest_voxels(field, count, inside if masked else None).ravel(), expected
    )


def test_ties_are_settled_in_raster_order_across_slabs(tmp_path):
    field = np.zeros((11, 4, 5), np.int16)
    with tb.threads(2), memmap.map_large_arrays(tmp_path, memory=1 << 20, thickest=2):
        chosen = np.array(brightest_voxels(field, 87))
    assert np.array_equal(chosen.ravel(), np.arange(field.size) < 87)


def test_an_auction_gives_every_phase_its_share():
    rng = np.random.default_rng(2)
    fields = (rng.normal(size=(3, 14, 13, 12)) * 3000).astype(np.int16)
    fields[0] += 4000  # would win nearly everything
    inside = rng.random(fields.shape[1:]) < 0.6
    counts = np.rint(np.count_nonzero(inside) * np.array([0.2, 0.5, 0.3])).astype(np.int64)
    winners = assign_phases(fields, counts, inside)
    assert np.abs(np.bincount(winners[inside], minlength=3) - counts).max() <= 3
    # Within the share of two phases the larger difference decides.
    ranks = np.stack([mix_with_neighbours(field) for field in fields]).astype(int)
    lead = ranks[1] - ranks[2]
    assert lead[inside & (winners == 1)].min() >= lead[inside & (winners == 2)].max()


@given(
    st.tuples(*[st.integers(1, 6)] * 3),
    st.tuples(*[st.booleans()] * 3),
    st.integers(-2, 3),
    st.sampled_from([1, 2]),
)
def test_doubling_and_fitting_in_one_pass(shape, wraps, more, factor):
    field = np.random.default_rng(sum(shape)).integers(-127, 128, (2, *shape)).astype(np.int8)
    wanted = tuple(max(1, 2 * side + more) for side in shape)
    fine = field.astype(int)
    for axis, wrap in zip((1, 2, 3), wraps, strict=True):
        ends = [(0, 0)] * 4
        ends[axis] = (1, 1)
        near = np.pad(fine, ends, mode="wrap" if wrap else "edge")
        side = fine.shape[axis]
        pair = [
            3 * fine + near.take(range(side), axis),
            3 * fine + near.take(range(2, side + 2), axis),
        ]
        fine = np.stack(pair, axis + 1).reshape(
            *fine.shape[:axis], 2 * side, *fine.shape[axis + 1 :]
        )
    fine = ((fine + 32) >> 6) * factor
    expected = fit_to(
        np.clip(fine, -127, 127).astype(np.int8) if factor == 2 else fine.astype(np.int8), wanted
    )
    made = double(field, wraps, shape=wanted, factors=[factor] * len(field))
    assert np.array_equal(made, expected)


def test_slabs_change_no_field(tmp_path):
    rng = np.random.default_rng(4)
    field = rng.normal(size=(2, 13, 7, 9)).astype(np.float32)
    votes = (rng.normal(size=(13, 7, 9)) * 6000).astype(np.int16)
    target = Histogram.of(rng.integers(-90, 90, 500).astype(np.int8))
    free = rng.random((13, 7, 9)) < 0.1
    region = Region(free.shape, (True, False, True), free)
    grid = region.grid(box=(4, 4, 4), steps=(2, 2, 2))

    def everything():
        covered = region.cover(box=(4, 4, 4), steps=(2, 2, 2))
        active = covered.active(grid, box=(4, 4, 4), steps=(2, 2, 2))
        seen = covered.view_along(1)
        known = {"fixed": tb.Image(np.zeros(free.shape, np.uint8), "labels"), "known": ~free}
        request = tb.Request(free.shape, seed=1, **known)
        halves = regions_of(
            request,
            3,
            (field - 1, field + 1),
            lambda bound, _: np.rint(bound).astype(np.int8),
            thin=True,
        )
        parts = [
            halve(field),
            fit_to(field, (16, 5, 9)),
            match_histogram(votes, target),
            active,
            covered.free,
            seen.free,
        ]
        return [
            np.array(part)
            for part in parts + [half.low for half in halves] + [half.free for half in halves]
        ]

    whole = everything()
    with tb.threads(2), memmap.map_large_arrays(tmp_path, memory=1 << 20, thickest=2):
        slabs = everything()
    assert all(np.array_equal(a, b) for a, b in zip(whole, slabs, strict=True))
    # What is active by its definition: a free voxel in the neighbourhood, which goes round where
    # the axis wraps.
    padded = np.pad(whole[4], [(0, 4), (0, 0), (0, 4)], mode="wrap")
    for site in np.ndindex(grid):
        z, y, x = (2 * s for s in site)
        assert whole[3][site] == padded[z : z + 4, y : y + 4, x : x + 4].any()
