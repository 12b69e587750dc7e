"""The certificate as text: for a terminal."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from trabecula.report.certificate import Certificate, Metric

VERDICTS = {True: "pass", False: "FAIL", None: "-"}


def table(certificate: Certificate) -> str:
    """Metrics, one a line, under the verdict."""
    rows = [("metric", certificate.name, "exemplar", "real band", "")]
    rows += [(name, *row(metric)) for name, metric in certificate.metrics.items()]
    widths = [max(len(cells[column]) for cells in rows) for column in range(5)]
    lines = [headline(certificate), ""]
    for cells in rows:
        numbers = (cell.rjust(width) for cell, width in zip(cells[1:4], widths[1:4], strict=True))
        lines.append("  ".join((cells[0].ljust(widths[0]), *numbers, cells[4])).rstrip())
    lines += [
        textwrap.fill(note, 100, initial_indent="note: ", subsequent_indent="      ") for note in certificate.notes
    ]
    return "\n".join(lines)


def headline(certificate: Certificate) -> str:
    """The verdict in one sentence."""
    judged = sum(metric.passed is not None for metric in certificate.metrics.values())
    if certificate.passed is None:
        return f"{certificate.name}: not judged, the exemplar is too small to say what real material differs by"
    if certificate.passed:
        return f"{certificate.name}: PASS, all {judged} figures lie within what parts of the exemplar differ by"
    failed = certificate.failed
    return f"{certificate.name}: FAIL in {len(failed)} of {judged} figures: {', '.join(failed)}"


def row(metric: Metric) -> tuple[str, str, str, str]:
    """Value, exemplar's value, band and verdict as text."""
    band = "" if metric.real_band is None else f"{number(metric.real_band[0])} .. {number(metric.real_band[1])}"
    return number(metric.value), number(metric.exemplar), band, VERDICTS[metric.passed]


def number(value: Any) -> str:
    """A figure with four digits; axes by name; nothing where there is nothing."""
    if value is None:
        return "none"
    if isinstance(value, Mapping):
        return " ".join(name for name, holds in value.items() if holds) or "no axis"
    if isinstance(value, int):
        return str(value)
    return f"{value:.4g}" if abs(value) < 1e4 else f"{value:.0f}"
