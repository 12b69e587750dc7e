"""`trabecula plan ...`: as generate, but only the forecast."""

from __future__ import annotations

import argparse

from trabecula.cli import terminal
from trabecula.cli.generate import add_request, prepare


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The request of `generate`."""
    add_request(parser)
    parser.add_argument("--json", action="store_true", help="print the forecast as JSON, in bytes")


def run(options: argparse.Namespace) -> int:
    """Print the forecast."""
    from trabecula.engine.plan import available_memory, format_bytes

    method, exemplar, request = prepare(options)
    learning = method.plan_fit(exemplar)
    making = method.fit(exemplar, memory=options.memory).plan(request)
    peak = max(learning.peak, making.peak)
    if options.json:
        found = {**making.to_json(), "peak": peak, "learning": learning.to_json(), "available": available_memory()}
        terminal.show_json(found)
        return 0
    rows = [("learning: " + name, format_bytes(size)) for name, size in learning.memory.items()]
    rows += [("making: " + name, format_bytes(size)) for name, size in making.memory.items()]
    rows += [("peak memory", format_bytes(peak)), ("available", format_bytes(available_memory()))]
    terminal.show_rows([*rows, ("disk", format_bytes(making.disk))])
    return 0
