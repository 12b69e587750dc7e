"""Forecasts: their sum, their refusal, their text."""

import math
import re
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

import trabecula as tb
from trabecula.engine import memory as plans
from trabecula.engine.memory import (
    GIB,
    Plan,
    available_memory,
    check_budget,
    format_bytes,
    largest_within,
)
from trabecula.errors import MemoryBudgetError

PLAN = Plan({"votes": 3 * GIB, "output": GIB}, disk=5)


def test_the_peak_is_the_sum_and_goes_into_json():
    assert PLAN.peak == 4 * GIB and Plan().peak == 0
    assert PLAN.to_json() == {
        "memory": {"votes": 3 * GIB, "output": GIB},
        "disk": 5,
        "scratch": 0,
        "seconds": None,
        "peak": 4 * GIB,
    }


def test_a_run_over_its_budget_is_refused():
    check_budget(PLAN, budget=4 * GIB)
    with pytest.raises(MemoryBudgetError) as caught:
        check_budget(PLAN, budget=4 * GIB - 1, advice="render a crop")
    assert str(caught.value) == (
        "this run needs about 4.0 GiB of memory, 4.0 GiB may be used: render a crop, or raise "
        "--memory"
    )


def test_without_a_budget_what_is_available_counts(monkeypatch):
    monkeypatch.setattr(plans, "available_memory", lambda: 2 * GIB)
    check_budget(Plan({"all": 2 * GIB}))
    with pytest.raises(MemoryBudgetError, match=r"2\.0 GiB may be used"):
        check_budget(PLAN)


def test_the_lower_of_machine_and_group_is_available(monkeypatch):
    import psutil

    assert 0 < available_memory() <= psutil.virtual_memory().total
    for machine, group, lower in [(5, 3, 3), (3, 5, 3), (7, None, 7)]:
        found = SimpleNamespace(available=machine)
        monkeypatch.setattr(psutil, "virtual_memory", lambda found=found: found)
        monkeypatch.setattr(plans, "_cgroup_available", lambda group=group: group)
        assert available_memory() == lower


@pytest.mark.parametrize(
    ("count", "text"),
    [
        (0, "0 B"),
        (1023, "1023 B"),
        (1024, "1.0 KiB"),
        (1536, "1.5 KiB"),
        (150 << 20, "150 MiB"),
        (99.94 * GIB, "99.9 GiB"),
        (5 << 40, "5.0 TiB"),
        (3 << 50, "3072 TiB"),
    ],
)
def test_bytes_as_a_person_reads_them(count, text):
    assert format_bytes(count) == text


@given(st.integers(0, 2**60))
def test_the_text_of_bytes_is_right_to_a_twentieth(count):
    number, unit = format_bytes(count).split()
    size = float(number) * 1024 ** ["B", "KiB", "MiB", "GiB", "TiB"].index(unit)
    assert abs(size - count) <= 0.05 * count


@given(st.lists(st.integers(1, 300), min_size=2, max_size=3), st.integers(0, 10**8))
def test_the_largest_shape_within_a_budget(shape, budget):
    def peak(sides):
        return 1000 + 4 * math.prod(sides)

    found = largest_within(shape, peak, budget)
    if found is None:
        assert peak((1,) * len(shape)) > budget
        return
    assert peak(found) <= budget
    if found != tuple(shape):
        longest = max(found) + 1
        assert peak([max(1, side * longest // max(shape)) for side in shape]) > budget


@pytest.mark.whole
def test_a_run_over_its_budget_is_told_a_shape_that_fits():
    model = tb.method("texture").fit(tb.crop(tb.sample("bone"), 32))
    with pytest.raises(
        MemoryBudgetError, match=r"smaller --shape \(\d+ \d+ \d+ fits\), or raise --memory"
    ) as caught:
        model.generate((500, 1000, 250), memory=1 << 30)
    sides = [int(word) for word in re.search(r"\((.*) fits", str(caught.value))[1].split()]
    assert sides[1] == pytest.approx(2 * sides[0], abs=2) and sides[0] == pytest.approx(
        2 * sides[2], abs=2
    )
    peak = model.plan(tb.Request(sides)).peak
    assert 0.95 * 2**30 < peak <= 2**30
