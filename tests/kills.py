"""A process that ends as `kill -9` ends it, at an event in place of a moment, every time."""

import os
import signal
import sys

_CHANGES = {"open", "os.rename", "os.remove", "os.rmdir", "os.mkdir", "os.truncate"}


def end_at_change(number: int, folder: str) -> None:
    """End this process just before its `number`-th change of a file below a folder."""
    left = number

    def count(event: str, args: tuple) -> None:
        nonlocal left
        if event not in _CHANGES or folder not in str(args[0]):
            return
        if event == "open" and not args[2] & (os.O_WRONLY | os.O_RDWR):
            return
        left -= 1
        if left == 0:
            os.kill(os.getpid(), getattr(signal, "SIGKILL", signal.SIGTERM))

    sys.addaudithook(count)
