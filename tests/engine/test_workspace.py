"""The allocator of large arrays: as declared, freed by stages; the forecast is the declaration."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trabecula.engine import memmap
from trabecula.engine.memory import (
    Array,
    Stage,
    Workspace,
    check_releases,
    forecast,
    forecast_mapped,
    within,
)
from trabecula.engine.parallel import threads

VOTES = Array((2, 10, 8, 6), np.int16)
FIELD = Array((10, 8, 6), np.float32)
PICKED = Array(480, np.uint8, at_most=True)
STAGES = (
    Stage("vote", {"votes": VOTES, "field": FIELD}, working=100, planes=3),
    Stage("deliver", {"votes": VOTES, "picked": PICKED, "known": None}, working=2000),
)


def test_an_array_has_the_size_that_numpy_gives_it():
    assert VOTES.nbytes == np.empty((2, 10, 8, 6), np.int16).nbytes == 1920
    assert VOTES.plane == 192 and FIELD.plane == 192 and PICKED.plane == 1
    assert Array((), np.float64).nbytes == Array((), np.float64).plane == 8
    assert Array((0, 3), np.uint8).plane == 0


@pytest.mark.whole
@given(
    st.lists(
        st.tuples(st.lists(st.integers(0, 9), min_size=1, max_size=4), st.sampled_from("bBhfd")),
        min_size=1,
        max_size=6,
    ),
    st.randoms(use_true_random=False),
)
def test_what_is_allocated_is_what_was_forecast(arrays, random):
    """Property: entering every stage and allocating all of it, in any order, takes the forecast."""
    declared = {str(n): Array(shape, kind) for n, (shape, kind) in enumerate(arrays)}
    names = list(declared)
    stages = [
        Stage(str(n), {name: declared[name] for name in random.sample(names, len(names) // 2)})
        for n in range(3)
    ]
    work = Workspace(stages)
    for stage in random.sample(stages, 3):
        work.enter(stage.name)
        for name in stage.arrays:
            if name not in work:
                made = work.empty(name)
                assert made.nbytes == declared[name].nbytes and made.dtype == declared[name].dtype
    assert work.peak == forecast(stages, {}).peak


def test_the_forecast_is_the_stage_with_the_highest_peak():
    plan = forecast(STAGES, {"exemplar": 7}, disk=3)
    assert plan.memory == {"exemplar": 7, "votes": 1920, "picked": 480, "working": 2000}
    assert plan.disk == 3 and plan.scratch == 0


def test_a_stage_frees_what_it_does_not_hold():
    work = Workspace(STAGES)
    work.enter("vote")
    votes = work.zeros("votes")
    work.full("field", 2.5)
    assert not votes.any() and (work["field"] == 2.5).all()
    work.enter("deliver")
    assert "field" not in work and work["votes"] is votes
    work.adopt("picked", np.arange(5, dtype=np.uint8))
    assert work.take("votes") is votes and "votes" not in work
    assert work.peak == VOTES.nbytes + FIELD.nbytes


def test_what_is_not_declared_is_refused():
    work = Workspace(STAGES)
    with pytest.raises(LookupError, match="no stage"):
        work.empty("votes")
    work.enter("vote")
    with pytest.raises(LookupError, match="stage 'vote' declares no array 'picked'"):
        work.empty("picked")
    with pytest.raises(LookupError, match="not allocated"):
        work["votes"]
    with pytest.raises(ValueError, match="declared as float32"):
        work.adopt("field", np.empty((10, 8, 6)))
    with pytest.raises(ValueError, match=r"shape \(6, 8, 10\)"):
        work.adopt("field", np.empty((6, 8, 10), np.float32))
    work.empty("field")
    with pytest.raises(ValueError, match="there already"):
        work.empty("field")
    work.enter("deliver")
    with pytest.raises(ValueError, match="at most"):
        work.adopt("picked", np.empty(481, np.uint8))


def test_an_array_of_another_size_cannot_go_on_under_its_name():
    work = Workspace([Stage("a", {"x": Array(3, np.uint8)}), Stage("b", {"x": Array(4, np.uint8)})])
    work.enter("a")
    work.empty("x")
    with pytest.raises(ValueError, match="declared"):
        work.enter("b")


@pytest.mark.parametrize("part", [lambda array: array, lambda array: array[1:]])
def test_an_array_that_outlives_its_release_is_found(part):
    work = Workspace(STAGES)
    work.enter("vote")
    kept = part(work.empty("field"))
    with check_releases(), pytest.raises(AssertionError, match="'field' is released"):
        work.enter("deliver")
    work.enter("vote")
    work.empty("field")
    with check_releases():
        work.enter("deliver")
    assert kept.dtype == np.float32


def test_a_step_counts_beside_what_its_caller_holds():
    step = (Stage("blur", {"field": FIELD, "copy": FIELD}, 50), Stage("sharpen", {"field": FIELD}))
    stages = within({"votes": VOTES, "field": FIELD, "known": None}, step)
    assert [stage.peak for stage in stages] == [1920 + 2 * 1920 + 50, 1920 + 1920]
    with pytest.raises(ValueError, match="'field'"):
        within({"field": VOTES}, step)


@pytest.mark.parametrize("count", [1, 3])
def test_mapped_arrays_count_as_files_and_slabs(count):
    with threads(count):
        plan = forecast_mapped(STAGES, {"exemplar": 7}, budget=10_000, disk=3)
        slab = max(100 + 2 * min(1920, count * 3 * 192), 2000 + count * 193)
    assert plan.memory == {"exemplar": 7, "slab": slab, "pages": min(3840, 10_000 - 7 - slab)}
    assert plan.scratch == 3840 + 3
    assert forecast_mapped(STAGES, {}, budget=0).memory["pages"] == 0


def test_arrays_are_files_where_large_arrays_are_mapped(tmp_path):
    work = Workspace([Stage("all", {"large": Array((64, 64, 64), np.uint8)}), Stage("end", {})])
    with memmap.map_large_arrays(tmp_path, memory=1 << 20):
        work.enter("all")
        assert not work.zeros("large").any() and len(list(tmp_path.glob("*.raw"))) == 1
        with check_releases():
            work.enter("end")
        assert not list(tmp_path.glob("*.raw"))
