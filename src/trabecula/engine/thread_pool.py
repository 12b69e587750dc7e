"""Threads that stay and wait for pieces of work: to wake one takes a tenth of the time that it
takes to start one, and much of a small volume's work is shorter than either.

The thread that has the work does pieces of it as well, from the first on, and those that wake up
wake others while pieces are left. So short work is over before many are awake, and nobody waits for
a thread that is busy elsewhere: threads inside threads cannot lock each other out.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Sequence
from contextvars import Context, copy_context
from threading import Condition, Thread

Piece = tuple[int, int]

_WAKES = 2
"""Threads that a thread wakes before it begins."""


class _SharedWork:
    """Pieces that threads take one after the other, until none is left or one has failed."""

    def __init__(
        self, work: Callable[[int, int], object], pieces: Sequence[Piece], threads: int
    ) -> None:
        self._work: Callable[[int, int], object] | None = work
        self._pieces = list(reversed(pieces))
        self._threads = threads
        self._asleep = min(threads, len(pieces)) - 1
        self._running = 0
        self._error: BaseException | None = None
        self._changed = Condition()

    def take_pieces(self) -> None:
        """Wake others, and do pieces while there are any."""
        with self._changed:
            few = min(_WAKES, self._asleep, len(self._pieces))
            self._asleep -= few
        for _ in range(few):
            _pool.call(self, most=self._threads - 1)
        while True:
            with self._changed:
                if not self._pieces or self._work is None:
                    return
                work, piece = self._work, self._pieces.pop()
                self._running += 1
            error = None
            try:
                work(*piece)
            except BaseException as caught:  # noqa: BLE001 - `finish` raises it
                error = caught
            del work
            with self._changed:
                self._running -= 1
                if error is not None:
                    self._error = self._error or error
                    self._pieces.clear()
                if not self._running:
                    self._changed.notify_all()
            del error  # whose traceback holds this call

    def finish(self) -> None:
        """Wait for the pieces that others do; raise the first error. Nothing of the work is held
        afterwards.
        """
        _pool.withdraw(self)
        waiting = True
        while waiting:
            try:
                with self._changed:
                    while self._running:
                        self._changed.wait()
                waiting = False
            except KeyboardInterrupt as interrupt:  # the others end their pieces, unless it is told
                waiting = not isinstance(self._error, KeyboardInterrupt)  # a second time
                self._error = interrupt
                self._pieces.clear()
        error, self._error, self._work = self._error, None, None
        try:
            if error is not None:
                raise error
        finally:
            del error  # whose traceback holds this call


class _Pool:
    """Threads of this process that wait for calls."""

    def __init__(self) -> None:
        self._calls: deque[tuple[_SharedWork, Context]] = deque()
        self._changed = Condition()
        self._count = self._waiting = 0

    def call(self, shared: _SharedWork, *, most: int) -> None:
        """Let a thread take pieces of a work in a copy of the caller's context: one that waits, or
        a new one unless there are `most`, or the first that is free.
        """
        with self._changed:
            self._calls.append((shared, copy_context()))
            short = self._waiting < len(self._calls) and self._count < most
            self._count += short
            self._changed.notify()
        if short:
            Thread(target=self._answer, name=f"trabecula-{self._count}", daemon=True).start()

    def withdraw(self, shared: _SharedWork) -> None:
        """Take back the calls for a work that nobody has answered."""
        with self._changed:
            if self._calls:
                self._calls = deque(call for call in self._calls if call[0] is not shared)

    def _answer(self) -> None:
        while True:
            with self._changed:
                self._waiting += 1
                while not self._calls:
                    self._changed.wait()
                self._waiting -= 1
                shared, context = self._calls.popleft()
            context.run(shared.take_pieces)
            del shared, context


_pool = _Pool()


def _forget_threads() -> None:
    """Begin anew in a process that was forked: it has none of the threads."""
    global _pool
    _pool = _Pool()


if hasattr(os, "register_at_fork"):  # not on Windows
    os.register_at_fork(after_in_child=_forget_threads)


def share_work(work: Callable[[int, int], object], pieces: Sequence[Piece], threads: int) -> None:
    """Call `work` on every piece in this thread and `threads - 1` others, the first pieces first.

    Others run in copies of the caller's context: they obey the same settings, and progress reaches
    its listener. After an error no further piece is begun; it is raised once those that run have
    ended.
    """
    shared = _SharedWork(work, pieces, threads)
    try:
        shared.take_pieces()
    finally:
        shared.finish()
