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

    model, request = prepare(options)
    plan = model.plan(request)
    if options.json:
        terminal.show_json({**plan.to_json(), "available": available_memory()})
        return 0
    rows = [(name, format_bytes(size)) for name, size in plan.memory.items()]
    rows += [("peak memory", format_bytes(plan.peak)), ("available", format_bytes(available_memory()))]
    terminal.show_rows([*rows, ("disk", format_bytes(plan.disk))])
    return 0
