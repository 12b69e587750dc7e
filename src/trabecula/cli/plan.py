"""`trabecula plan ...`: the forecast of a generate: memory, disk, and time by a short trial."""

from __future__ import annotations

import argparse
from typing import Any

from trabecula.cli import terminal
from trabecula.cli.generate import GenerateTask, add_request, prepare
from trabecula.cli.messages import brief_time


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the request of `generate`."""
    add_request(parser)
    parser.add_argument(
        "--out",
        default="",
        metavar="FILE",
        help="a .zarr may be made block by block where all at once is over the budget",
    )
    parser.add_argument("--json", action="store_true", help="print the forecast as JSON, in bytes")


def run(options: argparse.Namespace) -> int:
    """Print the forecast."""
    from trabecula.engine.memory import Plan, available_memory, format_bytes

    job = prepare(options)
    if job.asked:
        terminal.note(
            "the forecast is of one result: a property takes small trials, one to six results, and "
            "what measuring them takes"
        )
    learning = Plan() if job.method is None else job.method.plan_fit(job.exemplars)
    making = _making(job, options)
    peak = max(learning.peak, making.peak)
    if options.json:
        found = {
            **making.to_json(),
            "peak": peak,
            "learning": learning.to_json(),
            "available": available_memory(),
        }
        terminal.show_json(found)
        return 0
    rows = [("learning: " + name, format_bytes(size)) for name, size in learning.memory.items()]
    rows += [("making: " + name, format_bytes(size)) for name, size in making.memory.items()]
    rows += [("peak memory", format_bytes(peak)), ("available", format_bytes(available_memory()))]
    rows += [("disk", format_bytes(making.disk))]
    rows += [("scratch files", format_bytes(making.scratch))] if making.scratch else []
    rows += [("time", _time(making.seconds))]
    terminal.show_rows(rows)
    return 0


def _time(seconds: float | None) -> str:
    """Format seconds for a person."""
    if seconds is None:
        return "not forecast: no small part of it can be tried"
    return f"about {brief_time(seconds)}"


def _making(job: GenerateTask, options: argparse.Namespace) -> Any:
    from trabecula.engine.parallel import thread_count, threads
    from trabecula.pipeline.plan import plan_to

    with threads(options.threads if options.threads is not None else thread_count()):
        model = job.fit(memory=options.memory)
        return plan_to(
            model,
            job.request,
            options.out,
            memory=options.memory,
            chunks=options.chunks,
            trial=True,
        )
