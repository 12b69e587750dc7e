"""`trabecula samples`."""

from __future__ import annotations

import argparse

from trabecula.cli import terminal


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the form of the output."""
    parser.add_argument("--json", action="store_true", help="print as JSON")


def run(options: argparse.Namespace) -> int:
    """List the samples, the data sets, and the places where real scans are published."""
    from trabecula.exemplar.datasets import datasets
    from trabecula.exemplar.samples import REAL_SCANS, samples

    if options.json:
        terminal.show_json(
            {"samples": samples(), "data": datasets(), "real_scans": dict(REAL_SCANS)}
        )
        return 0
    terminal.show_rows([(f"sample:{name}", summary) for name, summary in samples().items()])
    print("\nThey are stand-ins. Real scans and pictures (downloaded, or from TRABECULA_DATA=DIR):")
    terminal.show_rows([(f"data:{name}", summary) for name, summary in datasets().items()])
    print("\nMore are published by:")
    terminal.show_rows([("  " + name, what) for name, what in REAL_SCANS])
    return 0
