"""Slabs: every index once, whatever the threads; errors come out."""

import threading

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from threadpoolctl import threadpool_info

import trabecula as tb
from trabecula.engine.parallel import for_slabs, map_items, thread_count
from trabecula.errors import InputError


@given(st.integers(0, 300), st.integers(1, 9), st.integers(1, 40))
def test_slabs_cover_every_index_once(length, count, least):
    touched = np.zeros(length, int)
    sizes = []

    def work(start, stop):
        assert 0 <= start <= stop <= length
        touched[start:stop] += 1
        sizes.append(stop - start)

    with tb.threads(count):
        for_slabs(work, length, least=least)
    assert (touched == 1).all()
    assert sum(sizes) == length
    assert len(sizes) == 1 or min(sizes) >= 1


def test_short_work_stays_in_the_calling_thread():
    seen = []
    with tb.threads(4):
        for_slabs(lambda a, b: seen.append((a, b, threading.get_ident())), 15, least=8)
    assert seen == [(0, 15, threading.get_ident())]


def test_threads_work_at_the_same_time():
    meeting = threading.Barrier(3, timeout=20)
    with tb.threads(3):
        for_slabs(lambda a, b: meeting.wait() if a < 3 else None, 12, least=1)
    assert not meeting.broken


@pytest.mark.parametrize("count", [1, 3])
def test_an_error_in_a_slab_comes_out(count):
    def work(start, stop):
        if start <= 50 < stop:
            raise ZeroDivisionError("slab of 50")

    with tb.threads(count), pytest.raises(ZeroDivisionError, match="slab of 50"):
        for_slabs(work, 100)


@pytest.mark.parametrize("count", [1, 3])
@pytest.mark.parametrize("number", [0, 1, 7])
def test_items_come_back_in_order_and_are_counted(count, number):
    seen = []
    with tb.threads(count), tb.progress(lambda label, done: seen.append((label, done.done))):
        assert map_items(lambda n: n * n, list(range(number)), "squares") == [
            n * n for n in range(number)
        ]
    assert seen == [("squares", n) for n in range(number + 1)]


def test_items_meet_unless_one_at_most():
    meeting = threading.Barrier(2)

    def meets(_):
        try:
            meeting.wait(timeout=0.2)
        except threading.BrokenBarrierError:
            meeting.reset()
            return False
        return True

    with tb.threads(2):
        assert any(map_items(meets, [0] * 20, "meeting"))
        assert not any(map_items(meets, [0] * 3, "alone", most=1))


@pytest.mark.parametrize("count", [1, 3])
def test_an_error_in_an_item_comes_out(count):
    with tb.threads(count), pytest.raises(ZeroDivisionError):
        map_items(lambda n: 1 // n, [2, 1, 0], "shares")


def test_threads_inside_items_leave_blas_as_it_was():
    """Two blocks with one BLAS thread, the second of which ends last, restore what they found."""
    matrix = np.eye(64)

    def work(n):
        for_slabs(lambda a, b: matrix @ matrix, 64)

    before = [each["num_threads"] for each in threadpool_info()]
    with tb.threads(4):
        map_items(work, list(range(40)), "products")
    assert [each["num_threads"] for each in threadpool_info()] == before


def test_threads_nest_and_end_with_their_block(monkeypatch):
    monkeypatch.setenv("TRABECULA_THREADS", "3")
    assert thread_count() == 3
    with tb.threads(2):
        with tb.threads(5):
            assert thread_count() == 5
        assert thread_count() == 2
    assert thread_count() == 3
    monkeypatch.delenv("TRABECULA_THREADS")
    assert thread_count() >= 1


@pytest.mark.parametrize("text", ["0", "-2", "two", "1.5", "²"])
def test_a_bad_environment_is_told(monkeypatch, text):
    monkeypatch.setenv("TRABECULA_THREADS", text)
    with pytest.raises(InputError, match=r"TRABECULA_THREADS='.*' should be a positive integer"):
        thread_count()


@pytest.mark.parametrize("count", [0, -1])
def test_no_threads_are_refused(count):
    with (
        pytest.raises(InputError, match=f"threads must be at least 1, got {count}"),
        tb.threads(count),
    ):
        pytest.fail("the block ran")
