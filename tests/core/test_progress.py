"""Progress: told to whoever listens, at no cost where nobody does."""

from trabecula.core.progress import Fraction, StageClock, listen, notify, report, track


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
