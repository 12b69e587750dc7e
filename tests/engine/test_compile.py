"""`kernel`: compiled code that keeps the order of sums, works without the GIL, and says once that
it compiles.
"""

import subprocess
import sys
import threading

import numpy as np
import pytest

from trabecula.core.progress import listen
from trabecula.engine.compile import kernel

SCRIPT = """
import numpy as np
import pytest
from trabecula.core.progress import listen
from trabecula.engine.compile import kernel

@kernel
def one(values):
    return values.sum()

@kernel
def two(values):
    return values.max()

said = []
with listen(lambda line, fraction: said.append((line, fraction))):
    one(np.ones(3)), two(np.ones(3)), one(np.ones((2, 2), np.int32))
print(said)
"""


@kernel
def _sum(values):
    total = np.float32(0)
    for i in range(len(values)):
        total += values[i]
    return total


@kernel
def _spin(flag, turns):
    # `turns` may share memory with `flag` for all the compiler knows, so both are read again every
    # time.
    while flag[0] == 0 and turns[0] < 2_000_000_000:
        turns[0] += 1


def test_sums_keep_their_order():
    """With fast mathematics the terms are added in lanes, and the small ones would not be lost one
    by one.
    """
    values = np.full(4097, 2**-24, np.float32)
    values[0] = 1
    assert _sum(values) == np.float32(1)


def test_division_by_zero_is_ieee():
    @kernel
    def divide(a, b):
        return a / b

    assert divide(1.0, 0.0) == np.inf


def test_a_kernel_releases_the_gil():
    flag, turns = np.zeros(1, np.int64), np.zeros(1, np.int64)
    _spin(np.ones(1, np.int64), turns)  # compiled before the thread starts
    worker = threading.Thread(target=_spin, args=(flag, turns))
    worker.start()
    flag[0] = 1  # with the lock held this waits for all the turns
    worker.join()
    assert turns[0] < 2_000_000_000


@pytest.mark.whole
def test_compiling_is_said_once_and_not_at_all_from_the_cache(tmp_path):
    script = tmp_path / "kernels.py"
    script.write_text(SCRIPT)
    first, second = (
        subprocess.run(
            [sys.executable, script], capture_output=True, text=True, check=True
        ).stdout.strip()
        for _ in range(2)
    )
    assert (
        first
        == "[('compiling kernels (once on this machine; later runs load them from the cache)', "
        "-1.0)]"
    )
    assert second == "[]"


def test_nothing_is_said_where_nobody_listens(capsys):
    @kernel
    def three(values):
        return values.min()

    assert three(np.array([2.0, 1.0])) == 1
    assert capsys.readouterr() == ("", "")
    heard = []
    with listen(lambda line, fraction: heard.append(line)):
        three(np.array([2.0, 1.0]))
    assert heard == []
