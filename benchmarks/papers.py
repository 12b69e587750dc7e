"""The five papers beside this package: the page's tables from saved results, and how these are made
again.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from common import asked, pictures
from papers_page import page
from papers_pictures import keep
from papers_runs import RUNS
from papers_saved import measure
from trabecula.core.checks import check_name

PAGE = "papers.md"


def papers() -> None:
    """The five papers' tables and figures beside ours, from saved results: the page of the docs,
    into the folder of `--out`; `--run NAME ...` measures results again, and saves them.

    Pictures that the page shows are kept beside it; `--run` with `--out` also leaves them at their
    full size.
    """
    runs = asked("RUN")
    for name in runs:
        check_name(name, RUNS, name="run")
    for name in runs:
        print(f"\n### {name}\n", flush=True)
        _run(name)
    if runs:
        return
    text, folder = page(), pictures()
    if folder is None:
        print(text)
    else:
        (folder / PAGE).write_text(text, encoding="utf-8")
        print(folder / PAGE)


def _run(name: str) -> None:
    given = pictures()
    if given is not None:
        measure(name, RUNS[name])
        keep(name, given)
        return
    with tempfile.TemporaryDirectory() as folder:
        os.environ["TRABECULA_BENCH_OUT"] = folder
        try:
            measure(name, RUNS[name])
        finally:
            del os.environ["TRABECULA_BENCH_OUT"]
        keep(name, Path(folder))
