"""`trabecula methods`."""

from __future__ import annotations

import argparse

from trabecula.cli import terminal


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the form of the output."""
    parser.add_argument("--json", action="store_true", help="print as JSON")


def run(options: argparse.Namespace) -> int:
    """List the methods that the registry finds."""
    from trabecula.synth.api.registry import methods

    found = methods()
    if options.json:
        terminal.show_json(
            {
                name: {
                    "summary": spec.summary,
                    "paper": spec.paper,
                    "exemplar": spec.exemplar,
                    "alone": spec.alone,
                    "kinds": spec.kinds,
                    "scaling": spec.scaling,
                }
                for name, spec in found.items()
            }
        )
    else:
        terminal.show_rows([(name, spec.summary, spec.paper) for name, spec in found.items()])
    return 0
