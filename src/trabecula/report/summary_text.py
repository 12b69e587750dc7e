"""The certificate as text: the verdict in words, and tables for a terminal."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from trabecula.measure.registry import AT_LEAST, AT_MOST, COUNT, DESCRIPTORS, DISTANCE, GROUPS
from trabecula.report.metrics import VOLUME, Metric, find_descriptor, stem
from trabecula.report.tables import figure_unit

if TYPE_CHECKING:
    from trabecula.report.verdict import Certificate

VERDICTS = {True: "pass", False: "FAIL", None: "-"}

IN_SPACE = ("connectivity", "physics")
"""Groups that are about three dimensions: no picture can pass them."""

MOST = 4
"""Figures of a group that fail and are named in a sentence; the table has the rest."""


def headline(certificate: Certificate) -> str:
    """Return the verdict in one sentence."""
    judged = sum(metric.passed is not None for metric in certificate.metrics.values())
    if certificate.passed is False:
        return f"{certificate.name}: FAIL in {len(certificate.failed)} of {judged} figures"
    if certificate.passed is None:
        by = " BY THIS PICTURE" if certificate.beyond_picture else ""
        return f"{certificate.name}: NOT DECIDED{by}, though none of {judged} figures failed"
    return (
        f"{certificate.name}: PASS, all {judged} figures lie within what other samples of the "
        "material differ by"
    )


def sentences(certificate: Certificate) -> list[str]:
    """Return the reasons why nothing is decided, the groups that match, and of each that fails its
    figures and by how much they fail.
    """
    verdicts = certificate.groups
    matching = [GROUPS[group].lower() for group, passed in verdicts.items() if passed]
    lead = "Not decided" if certificate.passed is None else "Even without a failure not decided"
    found = [f"Not decided by this picture: {text}." for text in certificate.beyond_picture]
    found += [f"{lead}: {reason}." for reason in certificate.undecided]
    found += [f"Matches real material in: {', '.join(matching)}."] if matching else []
    for group, passed in verdicts.items():
        if passed is False:
            wrong = [name for name in certificate.failed if find_descriptor(name).group == group]
            wrong.sort(key=lambda name: VOLUME not in name.split("_"))  # what slices imply first
            lead = GROUPS[group]
            faults = {DESCRIPTORS[stem(name)].fault for name in wrong}
            if "broken" in faults:
                lead += (
                    ": BROKEN, though its two-point function matches"
                    if verdicts.get("two-point")
                    else ": BROKEN"
                )
            elif "uneven" in faults:
                lead += ": UNEVEN, its density differs from place to place unlike the exemplar's"
            elif group == "copying":
                turned = certificate.metrics[wrong[-1]].symmetry
                partly = "partly " if turned and len(wrong) > 1 else ""
                lead += ": COPIED from the exemplar" + (f", {partly}{turned}" if turned else "")
            more = f"; and {len(wrong) - MOST} more" if len(wrong) > MOST else ""
            figures = "; ".join(_failure(name, certificate.metrics[name]) for name in wrong[:MOST])
            found.append(f"{lead}: {figures}{more}.")
    return found


def _failure(name: str, metric: Metric) -> str:
    """Return a figure that failed beside the band that it missed."""
    figure = find_descriptor(name)
    title = figure.title[0].lower() + figure.title[1:]
    if metric.real_band is None:
        return f"{title} {number(metric.value)} (exemplar: {number(metric.exemplar)})"
    low, high = (number(edge) for edge in metric.real_band)
    if figure.rule in (DISTANCE, AT_MOST, COUNT):
        real = f"up to {high}"
    else:
        real = f"from {low}" if figure.rule == AT_LEAST else f"{low} to {high}"
    return f"{title} {number(metric.value)} (real: {real})"


def band(metric: Metric) -> str:
    """Return the band of a figure, or nothing where it has none."""
    return (
        "" if metric.real_band is None else " .. ".join(number(edge) for edge in metric.real_band)
    )


def number(value: Any) -> str:
    """Return a value with four digits; axes by name; "none" where there is no value."""
    if value is None:
        return "none"
    if isinstance(value, Mapping):
        return " ".join(name for name, holds in value.items() if holds) or "no axis"
    if isinstance(value, int):
        return str(value)
    return f"{value:.4g}" if abs(value) < 1e4 else f"{value:.0f}"


def table(certificate: Certificate) -> str:
    """Return the verdict in words, then the figures by group, one a line."""
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
        unit = figure_unit(name, certificate)
        named = f"{name} ({unit})" if unit else name
        cells = [named, number(metric.value), number(metric.exemplar), band(metric)]
        if baseline:
            cells.append(number(baseline[name].value) if name in baseline else "")
        rows.setdefault(find_descriptor(name).group, []).append([*cells, VERDICTS[metric.passed]])
    everything = [heads, *(cells for group in rows.values() for cells in group)]
    widths = [max(len(cells[column]) for cells in everything) for column in range(len(heads))]

    def line(cells: list[str]) -> str:
        numbers = [
            cell.rjust(width) for cell, width in zip(cells[1 : len(heads)], widths[1:], strict=True)
        ]
        return "  ".join([cells[0].ljust(widths[0]), *numbers, *cells[len(heads) :]]).rstrip()

    lines = [
        headline(certificate),
        *(fold("", text) for text in sentences(certificate)),
        "",
        line(heads),
    ]
    verdicts = certificate.groups
    for group, members in rows.items():
        lines.append(f"[{GROUPS[group]}: {group_word(certificate, group, verdicts[group])}]")
        lines += [line(cells) for cells in members]
    return "\n".join([*lines, *(fold("note: ", note) for note in certificate.notes)])


def summary(certificate: Certificate) -> str:
    """Return the verdict in words and a line a group, at most 60 lines: the certificate as a
    terminal shows it.
    """
    lines = [headline(certificate), *(fold("", text) for text in sentences(certificate)), ""]
    members: dict[str, list[bool | None]] = {}
    for name, metric in certificate.metrics.items():
        members.setdefault(find_descriptor(name).group, []).append(metric.passed)
    width = max(len(title) for title in GROUPS.values())
    for group, passed in certificate.groups.items():
        judged = [verdict for verdict in members[group] if verdict is not None]
        count = f"{sum(judged)} of {len(judged)} figures" if judged else "no figure judged"
        word = group_word(certificate, group, passed)
        lines.append(f"{GROUPS[group].ljust(width)}  {word.ljust(4)}  {count}")
    lines.append("Every figure: .to_table(), .metrics; as a page: .to_html(PATH)")
    return "\n".join("\n".join(lines).split("\n")[:60])


def group_word(certificate: Certificate, group: str, passed: bool | None) -> str:
    """Return the verdict of a group in a word; of connections where a picture cannot decide them,
    in words."""
    if passed is None and group in IN_SPACE and certificate.by_pictures:
        return "not decided by this picture"
    return VERDICTS[passed]


def fold(lead: str, text: str) -> str:
    """Return a text in lines of a terminal, indented by what leads it."""
    return textwrap.fill(text, 100, initial_indent=lead, subsequent_indent=" " * max(len(lead), 2))
