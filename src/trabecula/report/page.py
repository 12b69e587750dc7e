"""The certificate as one page: no script, no remote asset, readable without colour, made to be printed."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from trabecula.core.errors import FileError, InputError
from trabecula.engine.files import replacing
from trabecula.measure.correlation import covariance_form
from trabecula.report.plot import curve_plot, hatching, key, place_plot
from trabecula.report.table import VERDICTS, headline, row

if TYPE_CHECKING:
    from trabecula.report.certificate import Certificate, Metric

Pictures = Iterable[tuple[str, str | Path | bytes]]

# name -> what a reader would call it, and the power of the unit of length
_TITLES = {
    "porosity_error": ("Porosity error, relative", 0),
    "two_point_distance": ("Two-point function, raw distance", 0),
    "two_point_relative": ("Two-point function, relative", 0),
    "two_point_covariance": ("Two-point function, covariance form", 0),
    "two_point_axial": ("Two-point function, covariance form, worst axis", 0),
    "lineal_path_distance": ("Lineal path, relative", 0),
    "porosity": ("Porosity", 0),
    "specific_surface": ("Specific surface", -1),
    "mean_curvature": ("Mean curvature, integral per volume", -2),
    "euler_density": ("Euler number per volume", -3),
    "chord_length": ("Chord length of the solid", 1),
    "pore_size": ("Pore size", 1),
    "thickness": ("Thickness of the solid", 1),
    "largest_fraction": ("Largest component, share of the solid", 0),
    "components": ("Components", 0),
    "floating": ("Floating parts", 0),
    "floating_voxels": ("Floating parts, voxels", 0),
    "euler": ("Euler number of the image as cut", 0),
    "percolates": ("Percolates along", 0),
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
.verdict.open { border-style: dashed; }
.about { color: #55524b; margin: .1rem 0; } .notes li { margin: .25rem 0; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th { text-align: left; font-weight: 600; border-bottom: 2px solid #1c1b19; }
th, td { padding: .28rem .7rem .28rem 0; vertical-align: middle; } td { border-bottom: 1px solid #dedbd3; }
.n { text-align: right; white-space: nowrap; } tr.FAIL td { font-weight: 600; background: #faf1ee; }
code { font-size: .82rem; color: #6d695f; font-weight: 400; } .unit { color: #6d695f; font-weight: 400; }
.figures { display: grid; grid-template-columns: repeat(3, 1fr); gap: 1rem; }
figure { margin: 0; } figure img { width: 100%; border: 1px solid #dedbd3; } figcaption { color: #55524b; font-size:
.9rem; } svg { max-width: 100%; vertical-align: middle; } svg text { font: 11px system-ui, "DejaVu Sans", sans-serif;
fill: #1c1b19; } svg .title { font-weight: 600; font-size: 12.5px; } svg .tick { fill: #55524b; } .grid { stroke:
#dedbd3; stroke-width: 1; } .band { fill: url(#hatch); stroke: #b9b4a6; stroke-width: .6; } .dot { fill: #14507d; }
.own { stroke: #1c1b19; stroke-width: 1.6; } polyline { fill: none; } .line0 { stroke: #1c1b19; stroke-width: 1.5; }
.line1 { stroke: #14507d; stroke-width: 2.4; stroke-dasharray: 7 4; }
.line2 { stroke: #8a5a00; stroke-width: 2; stroke-dasharray: 2 3; }
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
    shown = _gallery(pictures)
    body = [_front(certificates), shown, *(_section(certificate) for certificate in certificates), _reading()]
    about = certificates[0].about.get("exemplar")
    if about:
        body.append(_json("Exemplar: fields and recipe", about))
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>Certificate</title>'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<style>{_STYLE}</style></head>\n<body>{hatching()}\n" + "\n".join(body) + "\n</body></html>\n"
    )


def write_page(html: str, path: str | Path) -> None:
    """Write a page so that it appears whole or not at all."""
    with replacing(Path(path)) as temporary:
        temporary.write_text(html, encoding="utf-8")


def _front(certificates: Sequence[Certificate]) -> str:
    boxes = []
    for certificate in certificates:
        kind, word = {True: ("pass", "PASS"), False: ("fail", "FAIL"), None: ("open", "OPEN")}[certificate.passed]
        sentence = headline(certificate).replace(": PASS, ", ": ").replace(": FAIL in ", ": outside the band in ")
        boxes.append(f'<p class="verdict {kind}"><b>{word}</b> {escape(sentence)}</p>')
    lines = [_about("Exemplar", certificates[0].about.get("exemplar"))]
    lines += [_about(certificate.name, certificate.about.get("image")) for certificate in certificates]
    return "<h1>Is it the same material?</h1>" + "".join(boxes) + "".join(lines)


def _about(name: str, about: Mapping[str, Any] | None) -> str:
    if not about:
        return ""
    size, edge = (" x ".join(f"{n:g}" for n in about[field]) for field in ("shape", "spacing"))
    phases = ", ".join(about["phases"])
    text = f"{name}: {size} voxels of {edge} {about['unit']}; phases {phases}"
    return f'<p class="about">{escape(text)}</p>'


def _section(certificate: Certificate) -> str:
    unit = certificate.about.get("image", {}).get("unit", "voxel")
    heads = ("Figure", certificate.name, "exemplar", "real band", "place", "verdict")
    marks = ("", "n", "n", "n", "place", "")
    cells = "".join(f'<th class="{mark}">{escape(head)}</th>' for head, mark in zip(heads, marks, strict=True))
    rows = "".join(_row(name, metric, unit) for name, metric in certificate.metrics.items())
    notes = "".join(f"<li>{escape(note)}</li>" for note in certificate.notes)
    return (
        f"<h2>{escape(certificate.name)}: curves</h2>{_curves(certificate)}"
        f"<h2>{escape(certificate.name)}: figures</h2>"
        f"<table><thead><tr>{cells}</tr></thead><tbody>{rows}</tbody></table>"
        + (f'<h2>{escape(certificate.name)}: notes</h2><ul class="notes">{notes}</ul>' if notes else "")
        + _json(f"{certificate.name}: figures as JSON", certificate.to_json())
        + _json(f"{certificate.name}: fields and recipe", certificate.about.get("image", {}))
    )


def _row(name: str, metric: Metric, unit: str) -> str:
    title, power = _TITLES.get(name, (name.replace("_", " ").capitalize(), 0))
    suffix = {0: "", 1: unit, -1: f"1/{unit}", -2: f"1/{unit}²", -3: f"1/{unit}³"}[power]
    value, own, band, verdict = row(metric)
    place = ""
    if metric.real_band is not None and not isinstance(metric.value, Mapping):
        place = place_plot(metric.value, metric.real_band, metric.exemplar)
    return (
        f'<tr class="{verdict}"><td>{escape(title)} <span class="unit">{escape(suffix)}</span><br>'
        f"<code>{escape(name)}</code></td>"
        f'<td class="n">{value}</td><td class="n">{own}</td><td class="n">{band}</td><td class="place">{place}</td>'
        f"<td>{verdict}</td></tr>"
    )


def _curves(certificate: Certificate) -> str:
    if not certificate.curves:
        return ""
    exemplar, image, parts = (certificate.curves[name] for name in ("exemplar", "image", "parts"))
    spacing = certificate.about["image"]["spacing"]
    unit = certificate.about["image"]["unit"]
    names = dict(zip("zyx"[3 - len(spacing) :], spacing, strict=True))

    def plot(title: str, pick: Any, step: float) -> str:
        spread = np.array([pick(part) for part in parts])
        band = (spread.min(axis=0), spread.max(axis=0)) if len(spread) else None
        both = {"exemplar": pick(exemplar), certificate.name: pick(image)}
        return curve_plot(both, title=title, x_label=f"r ({unit})", band=band, step=step)

    smallest = min(spacing)
    figures = [
        plot("Two-point function, radial", lambda c: c["two_point"]["radial"], smallest),
        plot("Two-point function, covariance form", lambda c: covariance_form(c["two_point"]["radial"]), smallest),
        plot("Lineal path", lambda c: c["lineal_path"], smallest),
    ]
    figures += [
        plot(f"Two-point function along {a}", lambda c, a=a: c["two_point"][a], step) for a, step in names.items()
    ]
    band = f"spread of {len(parts)} parts of the exemplar" if parts else None
    return key(["exemplar", certificate.name], band=band) + f'<div class="figures">{"".join(figures)}</div>'


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
            raise FileError(f"cannot read the picture {source}: {error.strerror}; render it first") from error
    if not data.startswith(b"\x89PNG"):
        raise InputError("a picture of the page is not PNG: save it as PNG first")
    return data


def _json(summary: str, value: Any) -> str:
    text = json.dumps(value, indent=1, ensure_ascii=False)
    return f"<details><summary>{escape(summary)}</summary><pre>{escape(text)}</pre></details>"


def _reading() -> str:
    return (
        "<h2>How to read this</h2><p>The real band is the spread of a figure between equal parts of the exemplar. "
        "Inside it, the result is no further from the exemplar than the exemplar is from itself. Distances fail above "
        "the band, and loose parts only where there are more of them than in the exemplar; counts are scaled to the "
        f"volume. {VERDICTS[None]!r} means that there is nothing to judge by. A small exemplar gives a wide band: look "
        "at the figures as well as at the verdict. Not measured here: copying from the exemplar, transport, "
        "stiffness.</p>"
    )
