"""The verdict in words: what matches, what does not, by how much."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from trabecula.report.verdict import Certificate, Metric
from trabecula.report.metrics import AT_LEAST, AT_MOST, COUNT, DISTANCE, GROUPS, figure_of, stem_of

VERDICTS = {True: "pass", False: "FAIL", None: "-"}

MOST = 4
"""Figures of a group that fail and are named in a sentence; the table has the rest."""

_UNEVEN = {"fraction_spread", "fraction_lowest", "fraction_highest", "fraction_trend"}
_BROKEN = {
    "floating",
    "floating_voxels",
    "components",
    "largest_fraction",
    "percolates",
    "percolating_fraction",
}


def headline(certificate: Certificate) -> str:
    """Return the verdict in one sentence."""
    judged = sum(metric.passed is not None for metric in certificate.metrics.values())
    if certificate.passed is False:
        return f"{certificate.name}: FAIL in {len(certificate.failed)} of {judged} figures"
    if certificate.passed is None:
        return f"{certificate.name}: NOT DECIDED, though none of {judged} figures failed"
    return f"{certificate.name}: PASS, all {judged} figures lie within what other samples of the material differ by"


def sentences(certificate: Certificate) -> list[str]:
    """Return why nothing is decided, what matches, and of every group that fails what is wrong and
    by how much.
    """
    verdicts = certificate.groups
    matching = [GROUPS[group].lower() for group, passed in verdicts.items() if passed]
    lead = "Not decided" if certificate.passed is None else "Even without a failure not decided"
    found = [f"{lead}: {reason}." for reason in certificate.undecided]
    found += [f"Matches real material in: {', '.join(matching)}."] if matching else []
    for group, passed in verdicts.items():
        if passed is False:
            wrong = [name for name in certificate.failed if figure_of(name).group == group]
            lead = GROUPS[group]
            if _BROKEN & {stem_of(name) for name in wrong}:
                lead += (
                    ": BROKEN, though its two-point function matches"
                    if verdicts.get("two-point")
                    else ": BROKEN"
                )
            elif _UNEVEN & {stem_of(name) for name in wrong}:
                lead += ": UNEVEN, its density differs from place to place unlike the exemplar's"
            elif group == "copying":
                lead += ": COPIED from the exemplar"
            more = f"; and {len(wrong) - MOST} more" if len(wrong) > MOST else ""
            told = "; ".join(_wrong(name, certificate.metrics[name]) for name in wrong[:MOST])
            found.append(f"{lead}: {told}{more}.")
    return found


def _wrong(name: str, metric: Metric) -> str:
    figure = figure_of(name)
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
    """The band of a figure, or nothing where it has none."""
    return (
        "" if metric.real_band is None else " .. ".join(number(edge) for edge in metric.real_band)
    )


def number(value: Any) -> str:
    """A figure with four digits; axes by name; nothing where there is nothing."""
    if value is None:
        return "none"
    if isinstance(value, Mapping):
        return " ".join(name for name, holds in value.items() if holds) or "no axis"
    if isinstance(value, int):
        return str(value)
    return f"{value:.4g}" if abs(value) < 1e4 else f"{value:.0f}"
