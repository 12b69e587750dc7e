"""Progress: told to whoever listens, at no cost where nobody does."""

from trabecula.core.progress import listen, say, track


def test_items_pass_with_and_without_a_listener():
    told = []
    assert list(track(iter("abc"), "work")) == ["a", "b", "c"]
    with listen(lambda label, fraction: told.append((label, fraction))):
        assert list(track(iter("ab"), "work")) == ["a", "b"]
        assert list(track(range(4), "more", total=2)) == [0, 1, 2, 3]
        say("a line")
    say("nobody hears this")
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
            say("one")
        say("two")
    assert (outer, inner) == (["two"], ["one"])
