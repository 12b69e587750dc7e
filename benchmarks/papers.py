"""The five papers beside this package: the page's tables from saved results, and how these are made
again.
"""

from __future__ import annotations

from common import asked
from papers_runs import RUNS
from papers_saved import measure
from trabecula.core.checks import check_name


def papers() -> None:
    """The five papers' tables and figures beside ours: prints the page from saved results; `--run
    NAME ...` measures results again and saves them.
    """
    for name in asked("RUN"):
        check_name(name, RUNS, name="run")
        print(f"\n### {name}\n", flush=True)
        measure(name, RUNS[name])
