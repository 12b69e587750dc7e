"""The certificate as text: for a terminal."""

from __future__ import annotations

import textwrap

from trabecula.report.verdict import Certificate
from trabecula.report.metrics import GROUPS, figure_of
from trabecula.report.summary_text import VERDICTS, band, headline, number, sentences


def table(certificate: Certificate) -> str:
    """The verdict in words, then the figures by group, one a line."""
    baseline = certificate.baseline
    heads = [
        "figure",
        certificate.name,
        "exemplar",
        "real band",
        *(["Gaussian"] if baseline else []),
    ]
    rows: dict[str, list[list[str]]] = {}
    for name, metric in certificate.metrics.items():
        cells = [name, number(metric.value), number(metric.exemplar), band(metric)]
        if baseline:
            cells.append(number(baseline[name].value) if name in baseline else "")
        rows.setdefault(figure_of(name).group, []).append([*cells, VERDICTS[metric.passed]])
    everything = [heads, *(cells for group in rows.values() for cells in group)]
    widths = [max(len(cells[column]) for cells in everything) for column in range(len(heads))]

    def line(cells: list[str]) -> str:
        numbers = [
            cell.rjust(width) for cell, width in zip(cells[1 : len(heads)], widths[1:], strict=True)
        ]
        return "  ".join([cells[0].ljust(widths[0]), *numbers, *cells[len(heads) :]]).rstrip()

    lines = [
        headline(certificate),
        *(_folded("", text) for text in sentences(certificate)),
        "",
        line(heads),
    ]
    verdicts = certificate.groups
    for group, members in rows.items():
        lines.append(f"[{GROUPS[group]}: {VERDICTS[verdicts[group]]}]")
        lines += [line(cells) for cells in members]
    return "\n".join([*lines, *(_folded("note: ", note) for note in certificate.notes)])


def summary(certificate: Certificate) -> str:
    """Return the verdict in words and a line a group: what a terminal shows of a certificate, in at
    most 60 lines.
    """
    lines = [headline(certificate), *(_folded("", text) for text in sentences(certificate)), ""]
    members: dict[str, list[bool | None]] = {}
    for name, metric in certificate.metrics.items():
        members.setdefault(figure_of(name).group, []).append(metric.passed)
    width = max(len(title) for title in GROUPS.values())
    for group, passed in certificate.groups.items():
        judged = [verdict for verdict in members[group] if verdict is not None]
        count = f"{sum(judged)} of {len(judged)} figures" if judged else "no figure judged"
        lines.append(f"{GROUPS[group].ljust(width)}  {VERDICTS[passed].ljust(4)}  {count}")
    lines.append("Every figure: .to_table(), .metrics; as a page: .to_html(PATH)")
    return "\n".join("\n".join(lines).split("\n")[:60])


def _folded(lead: str, text: str) -> str:
    return textwrap.fill(text, 100, initial_indent=lead, subsequent_indent=" " * max(len(lead), 2))
