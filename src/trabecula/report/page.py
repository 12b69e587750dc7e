"""The certificate as one page: no script, no remote asset, readable without colour, printable."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from html import escape
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from trabecula.core.errors import FileError, InputError
from trabecula.engine.files import replacing
from trabecula.measure.correlation import covariance_form
from trabecula.measure.curvatures import SHAPES
from trabecula.measure.registry import DESCRIPTORS, GROUPS, select
from trabecula.report.metrics import find_descriptor, group_verdicts
from trabecula.report.plot import curve_plot, density_map, hatching, key, place_plot
from trabecula.report.provenance import face, methods_text, today
from trabecula.report.summary_text import (
    IN_SPACE,
    VERDICTS,
    band,
    group_word,
    headline,
    number,
    sentences,
)
from trabecula.report.tables import csv_text, curve_rows, figure_rows

if TYPE_CHECKING:
    from trabecula.report.verdict import Certificate

Pictures = Iterable[tuple[str, str | Path | bytes]]

BASELINE = "Gaussian field"

# curve -> its title; the covariance form is made here from the radial S2
_CURVES = {
    "two_point": "Two-point function, radial",
    "covariance": "Two-point function, covariance form",
    "two_point_cluster": "Two-point cluster function",
    "shape_index": "Shape index of the interface",
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

_SHAPES = "-1 pore, -.5 channel, 0 saddle, .5 rod, 1 ball"
# curves over bins instead of distances: as `_axis`
_BINS = {
    "histogram": ("bin", 0.0, 1.0),
    "orientation": ("bin", 0.0, 1.0),
    "shape_index": (_SHAPES, float(SHAPES[0]), float(SHAPES[1] - SHAPES[0])),
}


def page(
    certificates: Sequence[Certificate],
    *,
    pictures: Pictures = (),
    source_maps: Pictures = (),
    date: str | None = None,
) -> str:
    """Build one self-contained page for one or more certificates of the same exemplar.

    Parameters
    ----------
    certificates : sequence of Certificate
    pictures : iterable of (caption, PNG file or its bytes), optional
    source_maps : iterable of (caption, PNG file or its bytes), optional
        Slices in the colours of their sources (see `source_map`).
    date : str, optional
        On its face; today's by default.

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
    date = today() if date is None else date
    body = [_front(certificates, date), _group_table(certificates), gallery(pictures)]
    body += [
        _maps(certificates),
        _source_maps(source_maps),
        _curves(certificates),
        _figure_table(certificates),
    ]
    body += [*map(_section, certificates), _reading(certificates)]
    body += [_methods(certificates, date), _tables(certificates)]
    about = certificates[0].about.get("exemplar")
    if about:
        body.append(json_details("Exemplar: fields and recipe", about))
    return document("Certificate", body)


def document(title: str, body: Sequence[str]) -> str:
    """Wrap parts of a page as a document with the style of all certificates."""
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<style>{_style()}</style></head>\n<body>{hatching()}\n"
        + "\n".join(body)
        + "\n</body></html>\n"
    )


@cache
def _style() -> str:
    return resources.files(__package__).joinpath("page.css").read_text(encoding="utf-8")


def write_page(html: str, path: str | Path) -> None:
    """Write a page so that it appears whole or not at all."""
    with replacing(Path(path)) as temporary:
        temporary.write_text(html, encoding="utf-8")


def _front(certificates: Sequence[Certificate], date: str) -> str:
    lines = [*map(_box, certificates)]
    said = dict.fromkeys(text for one in certificates for text in face(one, date=date))
    lines += [f'<p class="about">{escape(text)}</p>' for text in said]
    return "<h1>Is it the same material?</h1>" + "".join(lines)


def _methods(certificates: Sequence[Certificate], date: str) -> str:
    """Return the text for a paper's Methods section, to be copied."""
    text = methods_text(certificates, date=date)
    return f'<h2>For a Methods section</h2><pre class="text">{escape(text)}</pre>'


def _tables(certificates: Sequence[Certificate]) -> str:
    """Return the figures and curves as tables inside the page, to be saved."""
    tables = {"figures.csv": figure_rows(certificates)}
    for place, one in enumerate(certificates, start=1):
        name = "curves.csv" if len(certificates) == 1 else f"curves-{place}.csv"
        tables[name] = curve_rows(one)
    links = []
    for name, rows in tables.items():
        data = base64.b64encode(csv_text(rows).encode()).decode()
        links.append(f'<a download="{name}" href="data:text/csv;base64,{data}">{name}</a>')
    return f'<p class="screen">As tables: {", ".join(links)}.</p>'


def _box(certificate: Certificate) -> str:
    """Return the verdict in words, and what the level did not examine."""
    kind, word, long, short = {
        True: ("pass", "PASS", ": PASS, ", ": "),
        False: ("fail", "FAIL", ": FAIL in ", ": outside the band in "),
        None: ("open", "NOT DECIDED", ": NOT DECIDED, though", ":"),
    }[certificate.passed]
    if certificate.passed is None and certificate.beyond_picture:
        word = "NOT DECIDED BY THIS PICTURE"
        long = f": {word}, though"
    sentence, items = headline(certificate).replace(long, short), _items(certificate)
    reasons = f"<ul>{items}</ul>" if items else ""
    return f'<div class="verdict {kind}"><b>{word}</b> {escape(sentence)}{reasons}</div>'


def _items(certificate: Certificate) -> str:
    """Return the verdict in words as a list, and what the level left out."""
    left_out = {
        "quick": "Not examined: thickness, pore size, phases one by one, clusters, copying, "
        "transport, stiffness.",
        "default": "Not examined: transport and stiffness (--full).",
    }.get(str(certificate.about.get("level")))
    texts = [*sentences(certificate), *([left_out] if left_out else [])]
    return "".join(f"<li>{escape(text)}</li>" for text in texts)


def summary_html(certificate: Certificate) -> str:
    """Return the verdict and the groups of a certificate for a notebook, free of a page's style."""
    borders = {True: "2px solid #2b6b4f", False: "4px double #a3341f", None: "2px dashed #8a5a00"}
    rows = "".join(
        f"<tr><td>{GROUPS[group]}</td><td>{group_word(certificate, group, passed)}</td></tr>"
        for group, passed in certificate.groups.items()
    )
    return (
        f'<div style="border:{borders[certificate.passed]};padding:.5em 1em">'
        f"<b>{escape(headline(certificate))}</b><ul>{_items(certificate)}</ul></div>"
        f"<table>{rows}</table>"
    )


def _group_table(certificates: Sequence[Certificate]) -> str:
    """Build the table of verdicts, group by group, images side by side and the baseline last."""
    first = certificates[0]
    columns = {certificate.name: certificate.groups for certificate in certificates}
    if first.baseline:
        columns[f"{BASELINE} (baseline)"] = {
            name: None if first.by_pictures and name in IN_SPACE and passed else passed
            for name, passed in group_verdicts(first.baseline).items()
        }
    head = "".join(f"<th>{escape(name)}</th>" for name in columns)

    def cell(group: str, passed: bool | None) -> str:
        return _verdict_cell(passed, group_word(first, group, passed))

    rows = "".join(
        f"<tr><td>{GROUPS[group]}</td>"
        + "".join(cell(group, verdicts.get(group)) for verdicts in columns.values())
        + "</tr>"
        for group in certificates[0].groups
    )
    return (
        f'<table class="groups"><thead><tr><th></th>{head}</tr></thead>'
        f"<tbody>{rows}</tbody></table>"
    )


def _verdict_cell(passed: bool | None, text: str, classes: str = "") -> str:
    word = VERDICTS[passed]
    style = f"{classes} FAIL".strip() if passed is False else classes
    return f'<td class="{style}">{text or word}</td>'


def _figure_table(certificates: Sequence[Certificate]) -> str:
    """Build the table of figures: every image, the exemplar, band and baseline."""
    first = certificates[0]
    names = [certificate.name for certificate in certificates]
    if len(names) > 1:
        names = [f"{place} {name}" for place, name in enumerate(names, start=1)]
    heads = [*names, "exemplar", "real band", *([BASELINE] if first.baseline else [])]
    head = "".join(f'<th class="n">{escape(text)}</th>' for text in heads)
    rows, group = [], None
    for name in first.metrics:
        figure = find_descriptor(name)
        if figure.group != group:
            group = figure.group
            head_cell = f'<th colspan="{len(heads) + 2}">{GROUPS[group]}</th>'
            rows.append(f'<tr class="group">{head_cell}</tr>')
        rows.append(_row(name, certificates))
    return (
        f"<h2>Figures</h2><table><thead><tr><th>Figure</th>{head}"
        '<th class="place">place</th></tr></thead>'
        f"<tbody>{''.join(rows)}</tbody></table>"
    )


def _row(name: str, certificates: Sequence[Certificate]) -> str:
    figure = find_descriptor(name)
    unit = certificates[0].about.get("image", {}).get("unit", "voxel")
    power = unit + {1: "", 2: "\u00b2", 3: "\u00b3"}.get(abs(figure.power), "")
    suffix = "" if figure.power == 0 else power if figure.power > 0 else f"1/{power}"
    metrics = [certificate.metrics[name] for certificate in certificates]
    first, baseline = metrics[0], certificates[0].baseline
    cells = [_verdict_cell(metric.passed, number(metric.value), "n") for metric in metrics]
    cells += [f'<td class="n">{number(first.exemplar)}</td>', f'<td class="n">{band(first)}</td>']
    if baseline:
        other = baseline.get(name)
        own = _verdict_cell(other.passed, number(other.value), "n soft") if other else "<td></td>"
        cells.append(own)
    place = ""
    if first.real_band is not None:
        # Counts are scaled to each image's volume: the first image's place alone.
        alike = all(metric.real_band == first.real_band for metric in metrics)
        values = [metric.value for metric in (metrics if alike else metrics[:1])]
        place = place_plot(values, first.real_band, first.exemplar)
    return (
        f"<tr><td>{escape(figure.title)} "
        f'<span class="unit">{escape(suffix)}</span><br>'
        f'<code>{escape(name)}</code></td>{"".join(cells)}<td class="place">{place}</td></tr>'
    )


def _maps(certificates: Sequence[Certificate]) -> str:
    """Draw the local fraction in middle planes of exemplar and images, in one scale."""
    first = certificates[0]
    rows = {"exemplar": first.local_fractions.get("exemplar", {})}
    rows |= {one.name: one.local_fractions.get("image", {}) for one in certificates}
    planes = [plane for maps in rows.values() for plane in maps.values()]
    if not planes:
        return ""
    low = min(float(plane.min()) for plane in planes)
    high = max(float(plane.max()) for plane in planes)
    largest = max(max(plane.shape) for plane in planes)
    drawn = []
    for who, maps in rows.items():
        drawn.append('<div class="maps">')
        for axis, plane in maps.items():
            svg = density_map(plane, low=low, high=high, side=170 * max(plane.shape) / largest)
            drawn.append(_figure(svg, f"{escape(who)}, middle across {axis}"))
        drawn.append("</div>")
    of = first.about["exemplar"]["phases"]
    what = f"fraction of {of[-1]}" if of else "mean value"
    return (
        f'<h2>Where it is dense</h2><p class="soft">Local {escape(what)} over windows of medium '
        f"size: {low:.2g} (white) to {high:.2g} (dark), one scale for all.</p>{''.join(drawn)}"
    )


def _curves(certificates: Sequence[Certificate]) -> str:
    first = certificates[0]
    if not first.curves:
        return ""
    lines = {"exemplar": first.curves["exemplar"]}
    lines |= {one.name: one.curves["image"] for one in certificates}
    baseline = BASELINE if "baseline" in first.curves else None
    if baseline:
        lines[baseline] = first.curves["baseline"]
    lines = {name: _with_covariance(curves) for name, curves in lines.items()}
    parts = [_with_covariance(part) for part in first.curves["parts"]]
    figures = []
    for name, title in _curve_titles(lines["exemplar"]).items():
        if name in lines["exemplar"]:
            spread = np.array([part[name] for part in parts if name in part])
            label, start, step = _axis(name, first.about["image"])
            figures.append(
                curve_plot(
                    {who: curves[name] for who, curves in lines.items() if name in curves},
                    title=title,
                    x_label=label,
                    band=(spread.min(axis=0), spread.max(axis=0)) if len(spread) else None,
                    first=start,
                    step=step,
                    baseline=baseline,
                )
            )
    spread_of = f"spread of {len(parts)} parts of the exemplar" if parts else None
    return (
        f"<h2>Curves</h2>{key(list(lines), band=spread_of, baseline=baseline)}"
        f'<div class="figures">{"".join(figures)}</div>'
    )


def _curve_titles(curves: Mapping[str, Any]) -> dict[str, str]:
    """Return the titles of the curves that are drawn; of single phases and pairs without those
    along an axis.
    """
    stems = {name: DESCRIPTORS[name].title for name in ("two_point", "lineal_path", "shape_index")}
    stems["cross"] = DESCRIPTORS["cross_correlation"].title
    single = {one.name: one.title for one in select(source="") if one.curve}
    found = _CURVES | {name: title for name, title in single.items() if name in curves}
    for name in curves:
        stem = next((known for known in stems if name.startswith(f"{known}_")), None)
        along_axis = "_axis_" in name or name[-2:] in ("_z", "_y", "_x")
        if stem and name not in found and not along_axis:
            found[name] = f"{stems[stem]} of {name[len(stem) + 1 :]}"
    return found


def _with_covariance(curves: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    found = dict(curves)
    if "two_point" in found:
        found["covariance"] = covariance_form(found["two_point"])
    return found


def _axis(name: str, image: Mapping[str, Any]) -> tuple[str, float, float]:
    """Return the label of a curve's axis, the place of its first point, and the step."""
    stem = next((known for known in _BINS if f"{name}_".startswith(f"{known}_")), None)
    if stem:
        return _BINS[stem]
    spacing = image["spacing"]
    axis = "zyx"[3 - len(spacing) :].find(name[-1]) if name[-2:-1] == "_" else -1
    return f"r ({image['unit']})", 0.0, spacing[axis] if axis >= 0 else min(spacing)


def _section(certificate: Certificate) -> str:
    notes = "".join(f"<li>{escape(note)}</li>" for note in certificate.notes)
    if notes:
        notes = f'<h2>{escape(certificate.name)}: notes</h2><ul class="notes">{notes}</ul>'
    return (
        notes
        + _physics(certificate)
        + json_details(f"{certificate.name}: figures as JSON", certificate.to_json())
        + json_details(f"{certificate.name}: fields and recipe", certificate.about.get("image", {}))
    )


def _physics(certificate: Certificate) -> str:
    """Build the table of the solvers: convergence, and the change on halving the voxel."""
    details = certificate.about.get("physics")
    if not details:
        return ""
    rows = []
    for who in ("exemplar", "image"):
        name = certificate.name if who == "image" else who
        for what, axes in (details[who].get("physics") or {}).items():
            for axis, result in axes.items():
                halving = "" if result["halving"] is None else f"{result['halving']:+.1%}"
                settled = "yes" if result["converged"] else "NO"
                cells = (name, f"{what} {axis}", settled, f"{result['imbalance']:.2%}", halving)
                row = "".join(f"<td>{escape(cell)}</td>" for cell in cells)
                rows.append(f"<tr>{row}</tr>")
    heads = ("Image", "Property", "converged", "flux differs by", "halving the voxel changes it by")
    head = "".join(f"<th>{text}</th>" for text in heads)
    return (
        f"<details><summary>{escape(certificate.name)}: how far to trust transport and stiffness"
        f"</summary><table><thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table>"
        "</details>"
    )


def gallery(pictures: Pictures, *, title: str = "Side by side") -> str:
    """Show pictures side by side, kept in the page."""
    figures = _embed(pictures)
    return f'<h2>{title}</h2><div class="figures">{figures}</div>' if figures else ""


def _source_maps(pictures: Pictures) -> str:
    """Show from where voxels might have been taken, with how to read it."""
    figures = _embed(pictures)
    if not figures:
        return ""
    return (
        '<h2>Where it comes from</h2><p class="soft">Middle slices. The colour of a voxel is the '
        "shift from it to the place of the exemplar whose neighbourhood is nearest to its own. A "
        "patch of one colour was moved as a whole; new material is crumbs, as real material is "
        "that was not copied. Void is paler; white and grey are far from any interface.</p>"
        f'<div class="figures">{figures}</div>'
    )


def _embed(pictures: Pictures) -> str:
    figures = []
    for caption, source in pictures:
        text = base64.b64encode(_png(source)).decode()
        image = f'<img alt="{escape(caption)}" src="data:image/png;base64,{text}">'
        figures.append(_figure(image, escape(caption)))
    return "".join(figures)


def _figure(content: str, caption: str) -> str:
    return f"<figure>{content}<figcaption>{caption}</figcaption></figure>"


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


def json_details(summary: str, value: Any) -> str:
    """Show a value as JSON, folded."""
    text = json.dumps(value, indent=1, ensure_ascii=False)
    return f"<details><summary>{escape(summary)}</summary><pre>{escape(text)}</pre></details>"


def _reading(certificates: Sequence[Certificate]) -> str:
    baseline = (
        f"The {BASELINE} is the baseline: noise, filtered and cut so that fractions and two-point "
        "function are the exemplar's. Where it passes as well, a figure says little about the "
        "material. "
    )
    if not certificates[0].baseline:
        baseline = ""
    return (
        "<h2>How to read this</h2><p>The real band of a figure is where another sample of the "
        "material, as large as the image, lies 99 times in 100: the spread of equal parts of the "
        "exemplar, extrapolated to the image's size, with the exemplar's own uncertainty. "
        "Distances fail above the band, and loose parts only where there are more of them than in "
        f"the exemplar; counts are scaled to the volume. {VERDICTS[None]!r} means that there is "
        "nothing to judge by. NOT DECIDED means that no figure failed, and that this proves "
        "nothing: the reasons stand in the box. "
        f"{baseline}</p>"
    )
