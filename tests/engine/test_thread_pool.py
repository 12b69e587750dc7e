"""Threads that share work: every piece once, whoever does it; nothing is left behind."""

import gc
import os
import sys
import threading
import time
import weakref
from contextlib import suppress
from contextvars import ContextVar, copy_context

import numpy as np
import pytest

import trabecula as tb
from trabecula.engine.parallel import for_slabs
from trabecula.engine.thread_pool import share_work

VARIABLE = ContextVar("variable")
PIECES = [(n, n + 1) for n in range(24)]


def test_every_piece_is_done_once_by_several_threads():
    done, who, begun = [], set(), threading.Barrier(3, timeout=20)

    def work(start, stop):
        if start < 3:
            begun.wait()
        done.append(start)
        who.add(threading.get_ident())

    share_work(work, PIECES, 3)
    assert sorted(done) == list(range(24))
    assert len(who) == 3 and threading.get_ident() in who


def test_the_caller_does_what_nobody_else_has_time_for():
    hold, held = threading.Event(), threading.Barrier(3, timeout=20)

    def busy(start, stop):
        held.wait()
        hold.wait(20)

    others = threading.Thread(target=share_work, args=(busy, [(0, 1), (1, 2)], 2))
    others.start()
    held.wait()
    before = threading.active_count()
    who = []
    share_work(lambda a, b: who.append(threading.get_ident()), PIECES, 2)
    assert set(who) == {threading.get_ident()} and len(who) == 24
    assert threading.active_count() == before
    hold.set()
    others.join()


def test_threads_inside_threads_end():
    found = np.zeros((8, 40), int)

    def outer(start, stop):
        for n in range(start, stop):
            for_slabs(lambda a, b, n=n: found[n, a:b].__iadd__(1), 40, least=1)

    with tb.threads(4):
        for_slabs(outer, 8, least=1)
    assert (found == 1).all()


def test_after_an_error_no_piece_is_begun():
    begun = []

    def work(start, stop):
        begun.append(start)
        raise ZeroDivisionError(f"piece {start}")

    with pytest.raises(ZeroDivisionError, match="piece"):
        share_work(work, PIECES, 2)
    assert len(begun) <= 2
    share_work(lambda a, b: begun.append(-1), PIECES, 2)
    assert begun.count(-1) == 24


def test_an_interruption_waits_for_those_who_work():
    ended, meeting = [], threading.Barrier(2, timeout=20)

    def work(start, stop):
        meeting.wait()
        if threading.current_thread() is threading.main_thread():
            raise KeyboardInterrupt
        time.sleep(0.1)
        ended.append(start)

    with pytest.raises(KeyboardInterrupt):
        share_work(work, [(0, 1), (1, 2)], 2)
    assert len(ended) == 1


@pytest.mark.whole
def test_nothing_of_work_that_failed_is_held_afterwards():
    class Large:
        pass

    large = Large()
    gone = weakref.ref(large)

    def fails(start, stop, large=large):
        raise ZeroDivisionError

    gc.collect()
    gc.disable()
    try:
        with suppress(ZeroDivisionError):
            share_work(fails, PIECES, 2)
        del large, fails
        assert gone() is None
    finally:
        gc.enable()


@pytest.mark.whole
def test_nothing_of_the_work_is_held_afterwards():
    """Also where the other threads are busy elsewhere and have not heard of it."""
    hold, held = threading.Event(), threading.Semaphore(0)

    def busy(start, stop):
        held.release()
        hold.wait(20)

    others = threading.Thread(target=share_work, args=(busy, PIECES[:9], 9))
    others.start()
    for _ in range(9):
        assert held.acquire(timeout=20)

    def inside():
        array, named = np.zeros(3), np.zeros(4)
        VARIABLE.set(named)
        share_work(lambda a, b: array.sum(), [(0, 1), (1, 2)], 2)
        return weakref.ref(array), weakref.ref(named)

    refs = copy_context().run(inside)
    gc.collect()
    assert [ref() for ref in refs] == [None, None]
    hold.set()
    others.join()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork")
def test_a_forked_process_starts_threads_of_its_own():
    share_work(lambda a, b: None, PIECES, 3)  # so that there are threads to forget
    sys.stdout.flush()
    child = os.fork()
    if child == 0:
        meeting = threading.Barrier(2, timeout=20)
        share_work(lambda a, b: meeting.wait(), [(0, 1), (1, 2)], 2)
        os._exit(0)
    _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) == 0
