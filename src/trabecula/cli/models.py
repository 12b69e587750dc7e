"""`trabecula models`."""

from __future__ import annotations

import argparse

from trabecula.cli import terminal


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add a name, and the form of the output."""
    parser.add_argument("name", nargs="?", metavar="NAME", help="print the card of this model")
    parser.add_argument("--json", action="store_true", help="print as JSON")


def run(options: argparse.Namespace) -> int:
    """List the shipped models, or print the card of one."""
    from trabecula.core.checks import check_name
    from trabecula.models import card, shipped_models, summary

    found = shipped_models()
    if options.name is not None:
        check_name(options.name, found, name="model")
        print(card(options.name).rstrip() or f"{options.name} has no card")
    elif options.json:
        terminal.show_json(
            {name: {"summary": summary(name), "file": str(path)} for name, path in found.items()}
        )
    elif found:
        terminal.show_rows([(name, summary(name)) for name in found])
    else:
        print("no model comes with this package: train one with trabecula fit")
    return 0
