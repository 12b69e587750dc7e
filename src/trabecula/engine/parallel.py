"""Threads over slabs: a kernel that writes only its own slab gives the same result for any number
of threads.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from functools import cache
from itertools import pairwise
from threading import Lock
from typing import Any, TypeVar

from trabecula.core.errors import InputError
from trabecula.core.progress import part, report_count, track
from trabecula.engine import memmap
from trabecula.engine.thread_pool import share_work

S = TypeVar("S")
T = TypeVar("T")

_threads: ContextVar[int | None] = ContextVar("trabecula_threads", default=None)


def thread_count() -> int:
    """Return the number of threads in use: set by `threads`, or by TRABECULA_THREADS, or every core
    that this process may run on.
    """
    chosen = _threads.get()
    if chosen is not None:
        return chosen
    named = os.environ.get("TRABECULA_THREADS")
    if named:
        if not named.isdecimal() or int(named) < 1:
            raise InputError(f"TRABECULA_THREADS={named!r} should be a positive integer")
        return int(named)
    try:
        return max(1, len(os.sched_getaffinity(0)))
    except AttributeError:  # not on macOS and Windows
        return os.cpu_count() or 1


@contextmanager
def threads(count: int) -> Iterator[None]:
    """Use `count` threads inside the block."""
    if count < 1:
        raise InputError(f"threads must be at least 1, got {count}")
    token = _threads.set(count)
    try:
        yield
    finally:
        _threads.reset(token)


@cache
def _blas() -> Any:
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


def one_blas_thread() -> AbstractContextManager[Any]:
    """Limit matrix products inside the block to one thread: BLAS threads compete with ours, and
    with each other on small work.
    """
    return _blas().limit(limits=1)


def for_slabs(
    work: Callable[[int, int], object], length: int, *, least: int = 8, anywhere: bool = False
) -> None:
    """Call `work(start, stop)` on slabs that cover `0..length`, in as many threads as are in use.

    `work` must write nothing outside its slab and release the GIL. The slabs depend on the thread
    count, and where arrays are memory-mapped on what may be resident of them; the result of a
    kernel that honours the first sentence does not.

    With `anywhere` it may run in another process, and more than once: it can be pickled, writes
    nothing but its slab of memory-mapped arrays, and reads nothing that it writes. Large
    arrays in memory that it reads never change: they are sent once.
    """
    if anywhere and memmap.run_on_workers(work, length):
        return
    count = min(thread_count(), max(1, length // least))
    with one_blas_thread():
        _run(_by_thickness(work, length, count), length, count, least)


def for_items(work: Callable[[int, int], object], count: int, *, least: int = 1) -> None:
    """Call `work(start, stop)` on parts of a list of `count` items as `for_slabs` does on slabs.
    The list is in memory: no pages are released. BLAS is not called.
    """
    _run(work, count, min(thread_count(), max(1, count // least)), least)


def for_each(work: Callable[[S], object], items: Sequence[S]) -> None:
    """Call `work` with every item, as `for_items` shares a list."""

    def some(start: int, stop: int) -> None:
        for item in items[start:stop]:
            work(item)

    for_items(some, len(items))


def map_items(
    work: Callable[[S], T], items: Sequence[S], label: str, *, most: int | None = None
) -> list[T]:
    """Return `work(item)` of every item, in their order, as many at once as threads are in use but
    `most` at most; report under `label` how many are done.

    Small items gain more than from `for_slabs` inside them, which still shares its slabs with
    threads that have no item left. Costly ones should come first. Work that reports its own
    progress is done one by one (`most` 1).
    """
    count = thread_count() if most is None else min(thread_count(), most)
    if count == 1 or memmap.is_active():
        return [work(item) for item in track(items, label)]
    found: list[Any] = [None] * len(items)
    lock, done = Lock(), 0

    def fill(start: int, stop: int) -> None:
        nonlocal done
        for n in range(start, stop):
            with part(n / len(items), (n + 1) / len(items)):
                found[n] = work(items[n])
            with lock:
                done += 1
                report_count(label, done, len(items))

    report_count(label, 0, len(items))
    # Held here, since blocks that end in another order than they begin would leave the limit.
    with one_blas_thread():
        share_work(fill, [(n, n + 1) for n in range(len(items))], min(count, len(items)))
    return found


def do_together(label: str, *jobs: Callable[[], Any], most: int | None = None) -> list[Any]:
    """Return what each of several jobs returns, done at once as by `map_items`."""
    return map_items(lambda job: job(), jobs, label, most=most)


def in_order(work: Callable[[int, int], object], length: int) -> None:
    """Call `work(start, stop)` on slabs that cover `0..length` one after the other, the first one
    first.
    """
    _by_thickness(work, length, 1)(0, length)


def sum_slabs(work: Callable[[int, int], T], length: int, *, least: int = 8) -> T:
    """Return the sum of `work(start, stop)` over slabs that cover `0..length` (at least 1), in as
    many threads as are in use.

    Of whole numbers, or arrays of them, so that no order matters; `work` writes nothing that is not
    its own.
    """
    found: list[Any] = []
    lock = Lock()

    def add(start: int, stop: int) -> None:
        part = work(start, stop)
        with lock:
            found[:] = [part if not found else found[0] + part]

    for_slabs(add, length, least=least)
    total: T = found[0]
    return total


def _by_thickness(
    work: Callable[[int, int], object], length: int, count: int
) -> Callable[[int, int], object]:
    """Return the same work in slabs as thick as memory-mapped arrays allow, releasing pages after
    each.
    """
    if not memmap.is_active():
        return work

    def work_thin(start: int, stop: int) -> None:
        thick = memmap.slab_thickness(length, count)
        if thick >= length:  # all of them may stay
            work(start, stop)
            return
        for first in range(start, stop, thick):
            work(first, min(first + thick, stop))
            memmap.release_pages()

    return work_thin


def _run(work: Callable[[int, int], object], length: int, count: int, least: int) -> None:
    if count == 1:
        work(0, length)
        return
    # Four slabs a thread even out slabs of unequal cost.
    pieces = min(4 * count, max(count, length // least))
    bounds = [length * i // pieces for i in range(pieces + 1)]
    share_work(work, list(pairwise(bounds)), count)
