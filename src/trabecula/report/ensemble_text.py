"""The certificate of an ensemble as text: the verdict in words, and a table for a terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from trabecula.report.ensemble_tests import Comparison
from trabecula.report.summary_text import fold, number

if TYPE_CHECKING:
    from trabecula.report.ensemble_certificate import EnsembleCertificate


def ensemble_headline(certificate: EnsembleCertificate) -> str:
    """Return the verdict in one sentence."""
    count, judged = len(certificate.names), len(certificate.metrics)
    lead = f"{count} members: "
    if certificate.passed is False:
        if not certificate.failed:
            return f"{lead}FAIL, though the figures agree"
        return f"{lead}FAIL in {len(certificate.failed)} of {judged} figures"
    if certificate.passed is None:
        return (
            f"{lead}CANNOT TELL, though none of {judged} figures failed: "
            f"{len(certificate.undecided)} of them are not known well enough"
        )
    return f"{lead}PASS, their distribution is the material's in {judged} figures"


def ensemble_sentences(certificate: EnsembleCertificate) -> list[str]:
    """Return the faults and doubts, one sentence each."""
    copying = certificate.copying
    found = [f"{fault}." for fault in copying.faults]
    for names, lead in ((certificate.failed, ""), (certificate.undecided, "Cannot tell: ")):
        for name in names:
            one = certificate.metrics[name]
            title = certificate.titles[name]
            found.append(f"{lead}{title}: {one.reason}.")
    found.append(
        f"{certificate.within:.0%} of the figures have the real spread within a quarter and no "
        f"test below p = 0.05; with so few members and parts, of real material at most about "
        f"{certificate.chance:.0%} would."
    )
    return found


def p_cell(one: Comparison, test: str) -> str:
    """Return the p value of a test as it is shown."""
    value = one.p.get(test)
    if value is None:
        return "-"
    return "<1e-4" if value < 1e-4 else f"{value:.2g}" if value < 0.1 else f"{value:.2f}"


def effect_cell(value: float | None, interval: tuple[float, float] | None, sign: str = "") -> str:
    """Return an effect with its interval."""
    if value is None or interval is None:
        return "-"
    low, high = interval
    return f"{value:{sign}.2f} ({low:{sign}.2f} to {high:{sign}.2f})"


def ensemble_table(certificate: EnsembleCertificate) -> str:
    """Return the verdict in words, then the figures, one a line."""
    rows = [["figure", "mean", "sd", "real mean", "real sd", "sd ratio", "shift"]]
    rows[0] += ["KS p", "MW p", "verdict"]
    for name, one in certificate.metrics.items():
        cells = [name, *map(number, (one.mean, one.deviation, one.real_mean, one.real_deviation))]
        cells.append(effect_cell(one.ratio, one.ratio_interval))
        cells.append(effect_cell(one.shift, one.shift_interval, "+"))
        cells += [p_cell(one, test) for test in ("kolmogorov_smirnov", "mann_whitney")]
        rows.append([*cells, ", ".join(one.faults) or one.verdict])
    widths = [max(len(cells[column]) for cells in rows) for column in range(len(rows[0]))]
    lines = [ensemble_headline(certificate)]
    lines += [fold("", text) for text in ensemble_sentences(certificate)] + [""]
    for cells in rows:
        middle = [cell.rjust(width) for cell, width in zip(cells[1:-1], widths[1:-1], strict=True)]
        lines.append("  ".join([cells[0].ljust(widths[0]), *middle, cells[-1]]))
    return "\n".join([*lines, "", *(fold("note: ", note) for note in certificate.notes)])


def ensemble_summary(certificate: EnsembleCertificate) -> str:
    """Return the verdict in words: the certificate as a prompt shows it."""
    lines = [ensemble_headline(certificate)]
    lines += [fold("", text) for text in ensemble_sentences(certificate)]
    return "\n".join([*lines, "Every figure: .to_table(), .metrics; as a page: .to_html(PATH)"])
