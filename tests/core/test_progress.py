"""Progress: told to whoever listens, at no cost where nobody does."""

import pytest

from trabecula.core.progress import (
    Fraction,
    StageClock,
    WholeRun,
    listen,
    notify,
    part,
    part_of,
    report,
    track,
    whole_run,
)


def test_items_pass_with_and_without_a_listener():
    told = []
    assert list(track(iter("abc"), "work")) == ["a", "b", "c"]
    with listen(lambda label, fraction: told.append((label, fraction))):
        assert list(track(iter("ab"), "work")) == ["a", "b"]
        assert list(track(range(4), "more", total=2)) == [0, 1, 2, 3]
        notify("a line")
    notify("nobody hears this")
    assert told == [
        ("work", 0.0),
        ("work", 0.5),
        ("work", 1.0),
        ("more", 0.0),
        ("more", 0.5),
        ("more", 1.0),
        ("more", 1.0),
        ("more", 1.0),
        ("a line", -1.0),
    ]


def test_listeners_nest_and_end_with_their_block():
    outer, inner = [], []
    with listen(lambda label, fraction: outer.append(label)):
        with listen(lambda label, fraction: inner.append(label)):
            notify("one")
        notify("two")
    assert (outer, inner) == (["two"], ["one"])


def test_work_that_is_no_loop_tells_how_far_it_is():
    told = []
    report("unheard", 0.5)
    with listen(lambda label, fraction: told.append((label, fraction))):
        report("round 1", 0.25)
        report("round 2", 1.0)
    assert told == [("round 1", 0.25), ("round 2", 1.0)]


def test_items_are_counted():
    heard = []
    with listen(lambda label, fraction: heard.append(fraction)):
        list(track("abc", "work"))
        list(track("", "nothing"))
    assert [(one.done, one.total) for one in heard] == [(0, 3), (1, 3), (2, 3), (3, 3), (0, 0)]
    assert Fraction(5, 4) == 1


def test_a_clock_says_how_long_a_stage_takes_and_will():
    now = 100.0
    clock = StageClock(lambda: now)
    assert clock.update("outer", 0.0) == (0, None)
    now = 110.0
    assert clock.update("inner", 0.0) == (0, None)
    now = 114.0
    assert clock.update("inner", 0.25) == (4, 12)
    now = 130.0
    assert clock.update("inner", 1.0) == (20, 0)
    assert clock.update("outer", 0.5) == (30, 30)
    now = 140.0
    assert clock.update("outer", 1.0) == (40, 0)


def test_a_stage_may_change_its_label():
    now = 0.0
    clock = StageClock(lambda: now)
    clock.update("iteration 1", 0.2)
    now = 10.0
    assert clock.update("iteration 2", 0.4) == (10, 30)
    now = 40.0
    assert clock.update("training", 1.0) == (40, 0)
    assert clock.update("iteration 1", 0.1) == (0, None)


@pytest.fixture
def reached():
    """Where the run was at each call of the listener."""
    heard = []
    with listen(lambda label, fraction: heard.append((label, round(fraction.run.reached, 6)))):
        yield heard


def test_stages_of_a_run_move_one_bar_by_their_costs(reached):
    with whole_run("reading"):
        with part(0, 0.2):
            list(track("ab", "learning"))
        with part(0.2, 1):
            for place in range(2):
                with part_of([1, 3], place):
                    list(track("ab", "making"))
    assert reached == [
        ("reading", 0),
        *[("learning", place) for place in (0, 0.1, 0.2)],
        *[("making", place) for place in (0.2, 0.3, 0.4, 0.4, 0.7, 1)],
    ]


def test_loops_inside_an_item_move_on_within_it(reached):
    def make(item):
        list(track("xy", "inner"))
        return item

    with whole_run():
        for _ in track((make(item) for item in "ab"), "outer", total=2):
            pass
        list(track("a", "again"))
    places = [place for _, place in reached]
    assert places == sorted(places)
    assert ("inner", 0.25) in reached and ("inner", 0.75) in reached
    assert reached[-1] == ("again", 1)


def test_a_loop_that_ends_early_leaves_its_part(reached):
    with whole_run():
        with part(0, 0.5):
            for _ in track("abcd", "sweeps"):
                break
        assert reached[-1] == ("sweeps", 0)
        with part(0.5, 1):
            report("rest", 0.5)
    assert reached[-1] == ("rest", 0.75)


def test_a_run_inside_a_run_is_a_part_of_it(reached):
    with whole_run("outer"), part(0.5, 1), whole_run("inner"):
        report("stage", 0.5)
    assert reached == [("outer", 0), ("stage", 0.75)]


def test_the_time_left_of_a_run_follows_its_speed():
    now = 10.0
    run = WholeRun(lambda: now)
    assert run.left() is None
    now = 13.0
    run.reach(0.25)
    assert run.left() == 9
    run.reach(0.1)
    assert run.reached == 0.25


def test_without_a_run_stages_stand_alone():
    heard = []
    with listen(lambda label, fraction: heard.append(fraction)), part(0, 0.5):
        list(track("a", "work"))
    assert [one.run for one in heard] == [None, None]
