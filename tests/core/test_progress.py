"""Progress: told to whoever listens, at no cost where nobody does."""

from trabecula.core.progress import listen, notify, report, track


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
