"""The certificate of an ensemble as one page: distributions drawn, real beside made."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

from trabecula.report.distribution_plot import distribution_plot
from trabecula.report.ensemble_tests import Comparison
from trabecula.report.ensemble_text import (
    effect_cell,
    ensemble_headline,
    ensemble_sentences,
    p_cell,
)
from trabecula.report.page import Pictures, document, gallery, json_details
from trabecula.report.plot import key
from trabecula.report.summary_text import number

if TYPE_CHECKING:
    from trabecula.report.ensemble_certificate import EnsembleCertificate

_READING = (
    "Every figure is a distribution: of the members, and of parts of the exemplar as large as they "
    "are. The ratio of their standard deviations is 1 where members differ as real parts do, and 0 "
    "where they are all alike; the shift is that of the mean, in real standard deviations. "
    "Intervals are of 95 %, and hold what overlap and nearness of the real parts make uncertain. A "
    "figure fails where a test is sure (p below 0.05, corrected by Benjamini-Hochberg for all "
    "tests of all figures) and the difference matters: a spread more than a quarter off, a mean "
    "more than 0.2 standard deviations off. CANNOT TELL means that no test is sure, and that half "
    "the spread, or a mean 2.5 standard deviations off, would not have been seen either. KS: "
    "Kolmogorov-Smirnov; MW: Mann-Whitney; p values are shown uncorrected."
)


_TESTS = {
    "mean": "p of mean",
    "spread": "of spread",
    "kolmogorov_smirnov": "of KS",
    "mann_whitney": "of MW",
}
"""Tests with the heads of their columns."""


def ensemble_page(certificate: EnsembleCertificate, *, pictures: Pictures = ()) -> str:
    """Build one self-contained page.

    Parameters
    ----------
    certificate : EnsembleCertificate
    pictures : iterable of (caption, PNG file or its bytes), optional

    Returns
    -------
    html : str

    Raises
    ------
    InputError
        A picture that is not PNG.
    FileError
        A picture that cannot be read.
    """
    notes = "".join(f"<li>{escape(note)}</li>" for note in certificate.notes)
    body = [
        "<h1>Is the ensemble the material?</h1>",
        _box(certificate),
        _about(certificate),
        _distributions(certificate),
        _table(certificate),
        f'<h2>Notes</h2><ul class="notes">{notes}</ul>',
        gallery(pictures),
        f"<h2>How to read this</h2><p>{_READING}</p>",
        json_details("Figures as JSON", certificate.to_json()),
        json_details("Exemplars: fields and recipes", certificate.about.get("exemplars", [])),
    ]
    return document("Certificate of an ensemble", body)


def ensemble_summary_html(certificate: EnsembleCertificate) -> str:
    """Return the verdict for a notebook, free of a page's style."""
    return f"<b>{escape(ensemble_headline(certificate))}</b>{_items(certificate)}"


def _box(certificate: EnsembleCertificate) -> str:
    kind, word = {True: ("pass", "PASS"), False: ("fail", "FAIL"), None: ("open", "CANNOT TELL")}[
        certificate.passed
    ]
    headline = escape(ensemble_headline(certificate))
    return f'<div class="verdict {kind}"><b>{word}</b> {headline}{_items(certificate)}</div>'


def _items(certificate: EnsembleCertificate) -> str:
    texts = "".join(f"<li>{escape(text)}</li>" for text in ensemble_sentences(certificate))
    return f"<ul>{texts}</ul>"


def _about(certificate: EnsembleCertificate) -> str:
    copying, real = certificate.copying, certificate.real
    size = " x ".join(map(str, certificate.shape))
    part = " x ".join(map(str, real["shape"]))
    lines = [
        f"Ensemble: {len(certificate.names)} members of {size} voxels",
        f"Real: {real['parts']} parts of {part} voxels from {real['exemplars']} exemplar"
        + ("s" if real["exemplars"] > 1 else ""),
        f"The two members most alike, {copying.pair[0]} and {copying.pair[1]}, differ in "
        f"{copying.closest:.0%} of what independent ones would",
    ]
    if copying.exemplar is not None and copying.limit is not None:
        among = "not known" if copying.among is None else f"{copying.among:.0%}"
        lines.append(
            f"Of {len(copying.examined)} members searched, at most {copying.exemplar:.0%} of the "
            f"voxels continue a patch of the exemplar, {among} one of another member (real "
            f"material: up to {copying.limit:.0%})"
        )
    return "".join(f'<p class="about">{escape(line)}</p>' for line in lines)


def _distributions(certificate: EnsembleCertificate) -> str:
    drawn = [
        distribution_plot(
            one.members,
            one.real,
            band=one.band,
            real=(one.real_mean, one.real_deviation),
            title=certificate.titles[name],
            verdict=one.verdict,
        )
        for name, one in certificate.metrics.items()
    ]
    parts = any(one.real for one in certificate.metrics.values())
    real = "real parts" if parts else "predicted from smaller real parts"
    names = key([real, "members"], band="95 % of real parts of the members' size")
    return (
        "<h2>Distributions</h2><p>The share of members, and of real parts, below each value; every "
        f"value is a mark below.</p>{names}"
        f'<div class="figures">{"".join(drawn)}</div>'
    )


def _table(certificate: EnsembleCertificate) -> str:
    heads = ["members", "real", "ratio of spreads", "shift of mean", *_TESTS.values()]
    head = "".join(f'<th class="n">{text}</th>' for text in heads)
    rows = "".join(
        _row(name, certificate.titles[name], one) for name, one in certificate.metrics.items()
    )
    return (
        f"<h2>Figures</h2><table><thead><tr><th>Figure</th>{head}"
        f'<th class="word">verdict</th></tr></thead><tbody>{rows}</tbody></table>'
    )


def _row(name: str, title: str, one: Comparison) -> str:
    """Build a row of the table; what makes a cell wide stands in a second line."""
    cells = [
        f"{number(one.mean)}<br>\u00b1 {number(one.deviation)}",
        f"{number(one.real_mean)}<br>\u00b1 {number(one.real_deviation)}",
        effect_cell(one.ratio, one.ratio_interval).replace(" (", "<br>("),
        effect_cell(one.shift, one.shift_interval, "+").replace(" (", "<br>("),
        *(escape(p_cell(one, test)) for test in _TESTS),
    ]
    numbers = "".join(f'<td class="n">{cell}</td>' for cell in cells)
    style = "word FAIL" if one.faults else "word"
    verdict = "<br>".join(one.faults) or one.verdict
    return (
        f"<tr><td>{escape(title)}<br><code>{escape(name)}</code></td>{numbers}"
        f'<td class="{style}">{verdict}</td></tr>'
    )
