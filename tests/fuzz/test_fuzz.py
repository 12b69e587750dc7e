"""A slice of `make fuzz`: damaged files and strange arguments give an error of ours or a sound
result, and neither a hang nor memory without bounds.
"""

import sys

import pytest

import run

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs links, pipes and limits")


@pytest.mark.parametrize(("what", "count"), [("files", 200), ("arguments", 60)])
def test_a_slice(what, count):
    found = list(run.run(what, count, seed=0))
    assert not run.failures(found), "\n".join(run.failures(found))
    assert len(found) == count
    # Most are refused, and some are whole all the same: neither reading everything nor refusing
    # everything would pass.
    outcomes = [case["outcome"] for case in found]
    assert outcomes.count(run.REFUSED) > count / 4 and outcomes.count(run.SOUND) > count / 20


def test_every_reader_and_every_damage_has_its_turn():
    import files

    seen = [files.choose(1, number)[:2] for number in range(2000)]
    assert {reader.name for reader, _ in seen} == {reader.name for reader in files.READERS}
    assert {damage for _, damage in seen} == {*files.DAMAGES, files.MADE}
