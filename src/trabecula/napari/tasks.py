"""Work of the panels, in a thread of its own, with its progress: napari stays alive meanwhile."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from trabecula.core.errors import TrabeculaError
from trabecula.core.progress import listen

_EVERY = 100
"""Milliseconds between looks at the progress."""


class PanelTask:
    """One piece of work at a time, of one panel.

    Parameters
    ----------
    button : magicgui PushButton
        Is disabled while it runs.
    bar : magicgui ProgressBar
    show : callable
        Called with a line of text.
    """

    def __init__(self, button: Any, bar: Any, show: Callable[[str], None]) -> None:
        from qtpy.QtCore import QTimer

        self._button, self._bar, self._show = button, bar, show
        self._latest: tuple[str, float] = ("", 0.0)
        self._timer = QTimer()
        self._timer.setInterval(_EVERY)
        self._timer.timeout.connect(self._look)
        self.worker: Any = None

    def start(self, work: Callable[[], Any], finish: Callable[[Any], None]) -> None:
        """Do `work` in a thread; call `finish` with what it returns in napari's own thread."""
        from napari.qt.threading import create_worker

        def run() -> Any:
            with listen(self._hear):
                return work()

        self._button.enabled = False
        self._show("works ...")
        self.worker = create_worker(run, _start_thread=False, _ignore_errors=True)
        self.worker.returned.connect(finish)
        self.worker.errored.connect(self._fail)
        self.worker.finished.connect(self._end)
        self._timer.start()
        self.worker.start()

    def _hear(self, label: str, fraction: float) -> None:
        self._latest = (label, fraction)  # in the worker's thread: no widget is touched

    def _look(self) -> None:
        label, fraction = self._latest
        self._bar.label = label[:40] or "progress"
        self._bar.value = round(100 * max(fraction, 0.0))

    def _fail(self, error: BaseException) -> None:
        # an exception that leaves a slot of Qt ends napari
        ours = isinstance(error, TrabeculaError)
        kind = type(error).__name__
        self._show(str(error) if ours else f"{kind}: {error}: a defect, please report it")

    def _end(self) -> None:
        self._timer.stop()
        self._bar.value = 0
        self._button.enabled = True
