"""The certificate as one page: no script, no remote asset, readable without colour, made to be
printed.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from trabecula.core.errors import FileError, InputError
from trabecula.engine.files import replacing
from trabecula.measure.correlation import covariance_form
from trabecula.report.verdict import Certificate, group_verdicts
from trabecula.report.metrics import GROUPS, figure_of
from trabecula.report.plot import curve_plot, density_map, hatching, key, place_plot
from trabecula.report.summary_text import VERDICTS, band, headline, number, sentences

Pictures = Iterable[tuple[str, str | Path | bytes]]

BASELINE = "Gaussian field"

# curve -> its title; the covariance form is made here from the radial S2
_CURVES = {
    "two_point": "Two-point function, radial",
    "covariance": "Two-point function, covariance form",
    "two_point_cluster": "Two-point cluster function",
    "lineal_path": "Lineal path of the solid",
    "lineal_path_void": "Lineal path of the void",
    "two_point_axis_z": "Two-point function along z",
    "two_point_axis_y": "Two-point function along y",
    "two_point_axis_x": "Two-point function along x",
    "histogram": "Histogram",
    "orientation": "Local orientations",
    "autocorrelation_z": "Autocorrelation along z",
    "autocorrelation_y": "Autocorrelation along y",
    "autocorrelation_x": "Autocorrelation along x",
}

_STYLE = """
:root { color-scheme: light; }
body { font: 15px/1.5 system-ui, "Segoe UI", "DejaVu Sans", sans-serif; color: #1c1b19; background: #fff; max-width:
1180px;
  margin: 2rem auto; padding: 0 1.5rem; }
h1 { font-size: 1.5rem; margin: 0 0 .2rem; } h2 { font-size: 1.1rem; margin: 2.2rem 0 .6rem; }
.verdict { border: 2px solid #1c1b19; border-left-width: 14px; padding: .7rem 1rem; margin: 1rem 0; font-size: 1.1rem; }
.verdict b { display: inline-block; min-width: 4.5rem; font-size: 1.35rem; letter-spacing: .04em; }
.verdict.pass { border-color: #2b6b4f; } .verdict.fail { border-color: #a3341f; border-left-style: double; }
.verdict.open { border-style: dashed; border-color: #8a5a00; }
.maps { display: flex; flex-wrap: wrap; gap: 1rem 2rem; margin: .8rem 0; } .maps svg { image-rendering: pixelated; }
.about { color: #55524b; margin: .1rem 0; } .notes li { margin: .25rem 0; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th { text-align: left; font-weight: 600; border-bottom: 2px solid #1c1b19; }
th, td { padding: .28rem .7rem .28rem 0; vertical-align: middle; } td { border-bottom: 1px solid #dedbd3; }
.n { text-align: right; white-space: nowrap; } td.FAIL { font-weight: 700; background: #faf1ee; }
td.FAIL::before { content: "✗ "; } tr.group th { border-bottom: 1px solid #1c1b19; padding-top: .9rem; }
.groups { width: auto; } .groups td, .groups th { padding-right: 2rem; } .soft { color: #6d695f; }
.verdict ul { margin: .4rem 0 0; padding-left: 1.2rem; font-size: .95rem; }
code { font-size: .82rem; color: #6d695f; font-weight: 400; } .unit { color: #6d695f; font-weight: 400; }
.figures { display: grid; grid-template-columns: repeat(3, 1fr); gap: 1rem; }
figure { margin: 0; } figure img { width: 100%; border: 1px solid #dedbd3; } figcaption { color: #55524b; font-size:
.9rem; } svg { max-width: 100%; vertical-align: middle; } svg text { font: 11px system-ui, "DejaVu Sans", sans-serif;
fill: #1c1b19; } svg .title { font-weight: 600; font-size: 12.5px; } svg .tick { fill: #55524b; } .grid { stroke:
#dedbd3; stroke-width: 1; } .band { fill: url(#hatch); stroke: #b9b4a6; stroke-width: .6; } .dot { fill: #14507d; }
.own { stroke: #1c1b19; stroke-width: 1.6; } polyline { fill: none; } .line0 { stroke: #1c1b19; stroke-width: 1.5; }
.line1 { stroke: #14507d; stroke-width: 2.4; stroke-dasharray: 7 4; }
.line2 { stroke: #8a5a00; stroke-width: 2.2; stroke-dasharray: 2 3; }
.line3 { stroke: #2b6b4f; stroke-width: 2; stroke-dasharray: 9 3 2 3; }
.line4 { stroke: #7a2a5e; stroke-width: 2; stroke-dasharray: 4 2 1 2 1 2; }
.baseline { stroke: #8d8a82; stroke-width: 1.2; stroke-dasharray: 12 3; }
svg .mark { fill: #fff; font-size: 9px; font-weight: 600; }
.key span { margin-right: 1.6rem; white-space: nowrap; }
details { margin: .6rem 0; } summary { cursor: pointer; } pre { background: #f6f5f1; padding: .8rem; overflow-x: auto;
  font-size: .8rem; white-space: pre-wrap; overflow-wrap: anywhere; }
@media (max-width: 800px) { .figures { grid-template-columns: 1fr; } .place { display: none; } }
@media print { body { margin: 0; max-width: none; font-size: 11px; } .verdict, tr, figure { break-inside: avoid; } }
"""


def page(certificates: Sequence[Certificate], *, pictures: Pictures = ()) -> str:
    """One self-contained page for one or more certificates of the same exemplar.

    Parameters
    ----------
    certificates : sequence of Certificate
    pictures : iterable of (caption, PNG file or its bytes), optional

    Returns
    -------
    html : str

    Raises
    ------
    InputError
        No certificate, or a picture that is not PNG.
    FileError
        A picture that cannot be read.
    """
    if not certificates:
        raise InputError("a page needs at least one certificate")
    body = [
        _front(certificates),
        _group_table(certificates),
        _gallery(pictures),
        _maps(certificates),
        _curves(certificates),
        _figure_table(certificates),
        *(_section(certificate) for certificate in certificates),
        _reading(certificates),
    ]
    about = certificates[0].about.get("exemplar")
    if about:
        body.append(_json("Exemplar: fields and recipe", about))
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>Certificate</title>'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<style>{_STYLE}</style></head>\n<body>{hatching()}\n"
        + "\n".join(body)
        + "\n</body></html>\n"
    )


def write_page(html: str, path: str | Path) -> None:
    """Write a page so that it appears whole or not at all."""
    with replacing(Path(path)) as temporary:
        temporary.write_text(html, encoding="utf-8")


def _front(certificates: Sequence[Certificate]) -> str:
    boxes = [_box(certificate) for certificate in certificates]
    lines = [_about("Exemplar", certificates[0].about.get("exemplar"))]
    lines += [
        _about(certificate.name, certificate.about.get("image")) for certificate in certificates
    ]
    return "<h1>Is it the same material?</h1>" + "".join(boxes) + "".join(lines)


def _box(certificate: Certificate) -> str:
    """The verdict in words; a box that passes also says what was not examined."""
    kind, word = {True: ("pass", "PASS"), False: ("fail", "FAIL"), None: ("open", "NOT DECIDED")}[
        certificate.passed
    ]
    sentence = headline(certificate)
    for verdict, short in (
        (": PASS, ", ": "),
        (": FAIL in ", ": outside the band in "),
        (": NOT DECIDED, though", ":"),
    ):
        sentence = sentence.replace(verdict, short)
    items = [
        *sentences(certificate),
        *([_unexamined(certificate)] if _unexamined(certificate) else []),
    ]
    told = "".join(f"<li>{escape(text)}</li>" for text in items)
    return f'<div class="verdict {kind}"><b>{word}</b> {escape(sentence)}{f"<ul>{told}</ul>" if told else ""}</div>'


def _unexamined(certificate: Certificate) -> str:
    """What the level left out."""
    return {
        "quick": "Not examined: thickness, pore size, phases one by one, clusters, copying, transport, stiffness.",
        "default": "Not examined: transport and stiffness (--full).",
    }.get(str(certificate.about.get("level")), "")


def summary_html(certificate: Certificate) -> str:
    """Return the verdict and the groups of a certificate for a notebook; nothing in it depends on a
    page's style.
    """
    border = {True: "2px solid #2b6b4f", False: "4px double #a3341f", None: "2px dashed #8a5a00"}[
        certificate.passed
    ]
    told = "".join(
        f"<li>{escape(text)}</li>"
        for text in [*sentences(certificate), _unexamined(certificate)]
        if text
    )
    rows = "".join(
        f"<tr><td>{GROUPS[group]}</td><td>{VERDICTS[passed]}</td></tr>"
        for group, passed in certificate.groups.items()
    )
    return (
        f'<div style="border:{border};padding:.5em 1em"><b>{escape(headline(certificate))}</b><ul>{told}</ul></div>'
        f"<table>{rows}</table>"
    )


def _about(name: str, about: Mapping[str, Any] | None) -> str:
    if not about:
        return ""
    size, edge = (" x ".join(f"{n:g}" for n in about[field]) for field in ("shape", "spacing"))
    what = f"phases {', '.join(about['phases'])}" if about["phases"] else about["kind"]
    text = f"{name}: {size} voxels of {edge} {about['unit']}; {what}"
    return f'<p class="about">{escape(text)}</p>'


def _group_table(certificates: Sequence[Certificate]) -> str:
    """What passes, group by group, images side by side and the baseline last."""
    columns = {certificate.name: certificate.groups for certificate in certificates}
    baseline = certificates[0].baseline
    if baseline:
        columns[f"{BASELINE} (baseline)"] = group_verdicts(baseline)
    head = "".join(f"<th>{escape(name)}</th>" for name in columns)
    rows = "".join(
        f"<tr><td>{GROUPS[group]}</td>"
        + "".join(_verdict_cell(verdicts.get(group), "") for verdicts in columns.values())
        + "</tr>"
        for group in certificates[0].groups
    )
    return f'<table class="groups"><thead><tr><th></th>{head}</tr></thead><tbody>{rows}</tbody></table>'


def _verdict_cell(passed: bool | None, text: str, classes: str = "") -> str:
    word = VERDICTS[passed]
    style = f"{classes} FAIL".strip() if passed is False else classes
    return f'<td class="{style}">{text or word}</td>'


def _figure_table(certificates: Sequence[Certificate]) -> str:
    """Every figure of every image beside the exemplar's, the band and the baseline's."""
    first = certificates[0]
    names = [certificate.name for certificate in certificates]
    marks = (
        names
        if len(names) == 1
        else [f"{place} {name}" for place, name in enumerate(names, start=1)]
    )
    heads = [*marks, "exemplar", "real band", *([BASELINE] if first.baseline else [])]
    head = "".join(f'<th class="n">{escape(text)}</th>' for text in heads)
    rows, group = [], None
    for name in first.metrics:
        figure = figure_of(name)
        if figure.group != group:
            group = figure.group
            rows.append(
                f'<tr class="group"><th colspan="{len(heads) + 2}">{GROUPS[group]}</th></tr>'
            )
        rows.append(_row(name, certificates))
    return (
        f'<h2>Figures</h2><table><thead><tr><th>Figure</th>{head}<th class="place">place</th></tr></thead>'
        f"<tbody>{''.join(rows)}</tbody></table>"
    )


def _row(name: str, certificates: Sequence[Certificate]) -> str:
    figure, unit = figure_of(name), certificates[0].about.get("image", {}).get("unit", "voxel")
    suffix = {
        0: "",
        1: unit,
        2: f"{unit}\u00b2",
        -1: f"1/{unit}",
        -2: f"1/{unit}\u00b2",
        -3: f"1/{unit}\u00b3",
    }
    metrics = [certificate.metrics[name] for certificate in certificates]
    first, baseline = metrics[0], certificates[0].baseline
    cells = [_verdict_cell(metric.passed, number(metric.value), "n") for metric in metrics]
    cells += [f'<td class="n">{number(first.exemplar)}</td>', f'<td class="n">{band(first)}</td>']
    if baseline:
        other = baseline.get(name)
        cells.append(
            _verdict_cell(other.passed, number(other.value), "n soft") if other else "<td></td>"
        )
    place = ""
    if first.real_band is not None:
        # Counts are scaled to each image's volume: the first image's place alone.
        shown = (
            metrics
            if all(metric.real_band == first.real_band for metric in metrics)
            else metrics[:1]
        )
        place = place_plot([metric.value for metric in shown], first.real_band, first.exemplar)
    return (
        f'<tr><td>{escape(figure.title)} <span class="unit">{escape(suffix[figure.power])}</span><br>'
        f'<code>{escape(name)}</code></td>{"".join(cells)}<td class="place">{place}</td></tr>'
    )


def _maps(certificates: Sequence[Certificate]) -> str:
    """The local fraction in middle planes of the exemplar and of every image, in one scale."""
    first = certificates[0]
    rows = {"exemplar": first.local_fractions.get("exemplar", {})}
    rows |= {one.name: one.local_fractions.get("image", {}) for one in certificates}
    planes = [plane for maps in rows.values() for plane in maps.values()]
    if not planes:
        return ""
    low, high = (
        min(float(plane.min()) for plane in planes),
        max(float(plane.max()) for plane in planes),
    )
    largest = max(max(plane.shape) for plane in planes)
    drawn = []
    for who, maps in rows.items():
        drawn.append('<div class="maps">')
        for axis, plane in maps.items():
            svg = density_map(plane, low=low, high=high, side=170 * max(plane.shape) / largest)
            drawn.append(
                f"<figure>{svg}<figcaption>{escape(who)}, middle across {axis}</figcaption></figure>"
            )
        drawn.append("</div>")
    of = first.about["exemplar"]["phases"]
    what = f"fraction of {of[-1]}" if of else "mean value"
    return (
        f'<h2>Where it is dense</h2><p class="soft">Local {escape(what)} over windows of medium size: {low:.2g} (white) to '
        f"{high:.2g} (dark), one scale for all.</p>{''.join(drawn)}"
    )


def _curves(certificates: Sequence[Certificate]) -> str:
    first = certificates[0]
    if not first.curves:
        return ""
    lines = {
        "exemplar": first.curves["exemplar"],
        **{c.name: c.curves["image"] for c in certificates},
    }
    baseline = BASELINE if "baseline" in first.curves else None
    if baseline:
        lines[baseline] = first.curves["baseline"]
    lines = {name: _with_covariance(curves) for name, curves in lines.items()}
    parts = [_with_covariance(part) for part in first.curves["parts"]]
    figures = []
    for name, title in (_CURVES | _phase_curves(lines["exemplar"])).items():
        if name in lines["exemplar"]:
            spread = np.array([part[name] for part in parts])
            figures.append(
                curve_plot(
                    {who: curves[name] for who, curves in lines.items() if name in curves},
                    title=title,
                    x_label=_x_label(name, first.about["image"]["unit"]),
                    band=(spread.min(axis=0), spread.max(axis=0)) if len(spread) else None,
                    step=_step(name, first.about["image"]["spacing"]),
                    baseline=baseline,
                )
            )
    told = f"spread of {len(parts)} parts of the exemplar" if parts else None
    return f'<h2>Curves</h2>{key(list(lines), band=told, baseline=baseline)}<div class="figures">{"".join(figures)}</div>'


def _phase_curves(curves: Mapping[str, Any]) -> dict[str, str]:
    """Titles of the curves of single phases and of pairs of them, without those along an axis."""
    stems = {
        "two_point": "Two-point function",
        "lineal_path": "Lineal path",
        "cross": "Cross-correlation",
    }
    found = {}
    for name in curves:
        stem = next((known for known in stems if name.startswith(f"{known}_")), None)
        if (
            stem
            and name not in _CURVES
            and "_axis_" not in name
            and name[-2:] not in ("_z", "_y", "_x")
        ):
            found[name] = f"{stems[stem]} of {name[len(stem) + 1 :]}"
    return found


def _with_covariance(curves: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    found = dict(curves)
    if "two_point" in found:
        found["covariance"] = covariance_form(found["two_point"])
    return found


def _x_label(name: str, unit: str) -> str:
    return {"histogram": "bin", "orientation": "bin"}.get(name, f"r ({unit})")


def _step(name: str, spacing: Sequence[float]) -> float:
    if name in ("histogram", "orientation"):
        return 1.0
    axis = "zyx"[3 - len(spacing) :].find(name[-1]) if name[-2:-1] == "_" else -1
    return spacing[axis] if axis >= 0 else min(spacing)


def _section(certificate: Certificate) -> str:
    notes = "".join(f"<li>{escape(note)}</li>" for note in certificate.notes)
    return (
        (
            f'<h2>{escape(certificate.name)}: notes</h2><ul class="notes">{notes}</ul>'
            if notes
            else ""
        )
        + _physics(certificate)
        + _json(f"{certificate.name}: figures as JSON", certificate.to_json())
        + _json(f"{certificate.name}: fields and recipe", certificate.about.get("image", {}))
    )


def _physics(certificate: Certificate) -> str:
    """Whether the solvers converged, and what halving the voxel changes."""
    details = certificate.about.get("physics")
    if not details:
        return ""
    rows = []
    for who in ("exemplar", "image"):
        name = certificate.name if who == "image" else who
        for what, axes in (details[who].get("physics") or {}).items():
            for axis, result in axes.items():
                halving = "" if result["halving"] is None else f"{result['halving']:+.1%}"
                cells = (
                    name,
                    f"{what} {axis}",
                    "yes" if result["converged"] else "NO",
                    f"{result['imbalance']:.2%}",
                    halving,
                )
                rows.append(
                    "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in cells) + "</tr>"
                )
    heads = ("Image", "Property", "converged", "flux differs by", "halving the voxel changes it by")
    head = "".join(f"<th>{text}</th>" for text in heads)
    return (
        f"<details><summary>{escape(certificate.name)}: how far to trust transport and stiffness</summary>"
        f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table></details>"
    )


def _gallery(pictures: Pictures) -> str:
    figures = []
    for caption, source in pictures:
        text = base64.b64encode(_png(source)).decode()
        image = f'<img alt="{escape(caption)}" src="data:image/png;base64,{text}">'
        figures.append(f"<figure>{image}<figcaption>{escape(caption)}</figcaption></figure>")
    return f'<h2>Side by side</h2><div class="figures">{"".join(figures)}</div>' if figures else ""


def _png(source: str | Path | bytes) -> bytes:
    if isinstance(source, bytes):
        data = source
    else:
        try:
            data = Path(source).read_bytes()
        except OSError as error:
            raise FileError(
                f"cannot read the picture {source}: {error.strerror}; render it first"
            ) from error
    if not data.startswith(b"\x89PNG"):
        raise InputError("a picture of the page is not PNG: save it as PNG first")
    return data


def _json(summary: str, value: Any) -> str:
    text = json.dumps(value, indent=1, ensure_ascii=False)
    return f"<details><summary>{escape(summary)}</summary><pre>{escape(text)}</pre></details>"


def _reading(certificates: Sequence[Certificate]) -> str:
    baseline = (
        f"The {BASELINE} is the baseline: noise, filtered and cut so that fractions and two-point function are the "
        "exemplar's. Where it passes as well, a figure says little about the material. "
        if certificates[0].baseline
        else ""
    )
    return (
        "<h2>How to read this</h2><p>The real band of a figure is where another sample of the material, as large as the image, "
        "lies 99 times in 100: the spread of equal parts of the exemplar, extrapolated to the image's size, with the exemplar's "
        "own uncertainty. Distances fail above the band, and loose parts only where there are more of them than in the "
        f"exemplar; counts are scaled to the volume. {VERDICTS[None]!r} means that there is nothing to judge by. "
        "NOT DECIDED means that no figure failed, and that this proves nothing: the reasons stand in the box. "
        f"{baseline}</p>"
    )
