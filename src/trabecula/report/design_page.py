"""The page of a finished part under its loads: compliance asked and got, peaks, weakest struts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np

from trabecula.core.checks import as_number
from trabecula.core.errors import InputError
from trabecula.core.image import Image, with_values
from trabecula.io.units import has_length, to_metres
from trabecula.measure.phases import indicator
from trabecula.measure.thickness import local_thickness
from trabecula.report.page import Pictures, document, gallery, json_details
from trabecula.report.summary_text import number

YIELD = 0.007
"""Effective strain at which bone fails where 2 % of it reach it (Pistoia 2002)."""

_MEGA = 1e6


@dataclass(frozen=True)
class PartScale:
    """Factors from the units of the solver to those of a real part.

    Attributes
    ----------
    stress : float
        Megapascals for a stress of 1.
    strain : float
        Strain for an effective strain of 1.
    """

    stress: float
    strain: float


@dataclass(frozen=True)
class WeakPlace:
    """A place of a part where it is stressed most."""

    voxel: tuple[int, int, int]
    stress: float
    thickness: float
    """Diameter of the largest sphere around it within the solid, in the image's unit."""


def part_scale(image: Image, modulus: float) -> PartScale:
    """Return the factors for forces in newton and a solid of a Young's modulus in pascal.

    Raises
    ------
    InputError
        A modulus out of range, or voxels without a length.
    """
    young = float(as_number(modulus, name="modulus", low=1.0, high=1e13))
    if not has_length(image.unit):
        raise InputError(
            f"the part's unit is {image.unit!r}, in which a stress has no pascal: give --spacing "
            "and --unit, or leave --modulus out"
        )
    area = (min(image.spacing) * to_metres(image.unit)) ** 2
    return PartScale(1 / area / _MEGA, 1 / (young * area))


def weak_places(image: Image, stress: Image) -> list[WeakPlace]:
    """Return the most stressed places of a part with how thick it is there, worst first.

    Parameters
    ----------
    image : Image of labels, (Z, Y, X)
    stress : Image
        As `part_stress` returns it.
    """
    step = stress.recipe.steps[-1]
    solid = indicator(image, step["settings"]["phase"])[1]
    # a part ends at the faces of its grid
    around = with_values(image, np.pad(solid, 1).view(np.uint8), phases=("void", "solid"))
    thick = local_thickness(around, phase="solid")[1:-1, 1:-1, 1:-1]
    found = []
    for place in step["report"]["weakest"]:
        z, y, x = (int(k) for k in place)
        at = (z, y, x)
        found.append(WeakPlace(at, float(stress.values[at]), float(thick[at])))
    return found


def design_page(
    image: Image,
    stress: Image,
    *,
    asked: Sequence[float] | None = None,
    scale: PartScale | None = None,
    pictures: Pictures = (),
) -> str:
    """Build one self-contained page of a part under its loads.

    Parameters
    ----------
    image : Image of labels, (Z, Y, X)
    stress : Image
        As `part_stress` returns it.
    asked : sequence of float, optional
        Compliance of the design over that of the form filled with solid, of every load case.
    scale : PartScale, optional
        To show stress in megapascal and strain of the real solid. Default: the solver's units.
    pictures : iterable of (caption, PNG file or its bytes), optional

    Returns
    -------
    html : str
    """
    report = stress.recipe.steps[-1]["report"]
    places = weak_places(image, stress)
    return document(
        "Part under its loads",
        [
            "<h1>Part under its loads</h1>",
            _about(image, report),
            _stiffness(report, asked),
            _peaks(report, scale),
            _weakest(places, image, scale),
            gallery(pictures, title="Where it is stressed"),
            _reading(scale),
            json_details("Figures as JSON", {**report, "asked": list(asked or ())}),
            json_details("Part: recipe", image.recipe.to_json()),
        ],
    )


def _about(image: Image, report: Mapping[str, Any]) -> str:
    extent = " x ".join(
        f"{side * edge:.4g}" for side, edge in zip(image.shape, image.spacing, strict=True)
    )
    voxels = " x ".join(map(str, image.shape))
    loose = (
        f"; {report['loose']:.2%} of the solid is held by no support and was left out"
        if report["loose"] > 0
        else "; all of the solid is held"
    )
    share = f", {report['fraction']:.1%} of the form is solid" if "fraction" in report else ""
    return f'<p class="about">{voxels} voxels, {extent} {escape(image.unit)}{share}{loose}</p>'


def _stiffness(report: Mapping[str, Any], asked: Sequence[float] | None) -> str:
    """Build the table of compliances, over that of the form filled with solid."""
    rows = []
    pairs = zip(report["compliance"], report["solid_compliance"], strict=True)
    for n, (got, solid) in enumerate(pairs):
        cells = [str(n + 1), number(got / solid)]
        if asked is not None:
            cells += [number(asked[n]), number(got / solid / asked[n])]
        rows.append("<tr>" + "".join(f'<td class="n">{cell}</td>' for cell in cells) + "</tr>")
    heads = ["load case", "got", *(["asked", "got / asked"] if asked is not None else [])]
    head = "".join(f'<th class="n">{text}</th>' for text in heads)
    return (
        "<h2>Compliance</h2>"
        '<p class="soft">Work of the loads, over that of the same form filled with solid.'
        + (
            " Asked: of the design, whose elements are as stiff as density^penalty; with penalty 1 "
            "no porous material reaches that."
            if asked
            else ""
        )
        + f'</p><table class="groups"><thead><tr>{head}</tr></thead>'
        f"<tbody>{''.join(rows)}</tbody></table>"
    )


def _peaks(report: Mapping[str, Any], scale: PartScale | None) -> str:
    stress, strain = (1.0, 1.0) if scale is None else (scale.stress, scale.strain)
    unit = "of the forces over a voxel's face" if scale is None else "MPa"
    rows = [
        ("Stress", unit, report["99 %"] * stress, report["largest"] * stress),
        (
            "Effective strain",
            "for E = 1" if scale is None else "",
            report["99 % strain"] * strain,
            report["largest strain"] * strain,
        ),
    ]
    body = "".join(
        f'<tr><td>{name} <span class="unit">{word}</span></td><td class="n">{number(most)}</td>'
        f'<td class="n">{number(peak)}</td></tr>'
        for name, word, most, peak in rows
    )
    return (
        '<h2>Peaks</h2><table class="groups"><thead><tr><th></th>'
        '<th class="n">99 % of the solid below</th><th class="n">largest</th></tr></thead>'
        f"<tbody>{body}</tbody></table>"
    )


def _weakest(places: Sequence[WeakPlace], image: Image, scale: PartScale | None) -> str:
    factor = 1.0 if scale is None else scale.stress
    unit = escape(image.unit)
    rows = []
    for one in places:
        at = " ".join(
            f"{(k + 0.5) * edge:.4g}" for k, edge in zip(one.voxel, image.spacing, strict=True)
        )
        cells = [" ".join(map(str, one.voxel)), at, number(one.thickness)]
        cells += [number(one.thickness / min(image.spacing)), number(one.stress * factor)]
        rows.append("<tr>" + "".join(f'<td class="n">{cell}</td>' for cell in cells) + "</tr>")
    heads = ["voxel z y x", f"place z y x ({unit})", f"thickness ({unit})", "in voxels"]
    heads += ["stress" if scale is None else "stress (MPa)"]
    head = "".join(f'<th class="n">{text}</th>' for text in heads)
    return (
        "<h2>Weakest struts</h2>"
        '<p class="soft">The most stressed places, no two nearer than four voxels, with the '
        "diameter of the largest sphere around them inside the solid.</p>"
        f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table>"
    )


def _reading(scale: PartScale | None) -> str:
    units = (
        "Stress and strain are for a solid of Young's modulus 1 and forces as the case gives them, "
        "over the face of a voxel: times F / edge^2 they are pascal, and times F / (E edge^2) a "
        "strain (--modulus does it, for forces in newton)."
        if scale is None
        else "Forces are in newton, and the solid has the modulus that was given."
    )
    return (
        f'<h2>Reading it</h2><ul class="notes"><li>{units}</li>'
        f"<li>Effective strain: sqrt(2 U / E). Bone fails where 2 % of it exceeds {YIELD:.1%} "
        "(Pistoia 2002).</li>"
        "<li>Bricks of a voxel are too stiff in bending where struts are one or two voxels thick, "
        "and stress at the steps of a surface is not resolved: compare parts of one resolution, "
        "and trust the 99 % more than the largest.</li></ul>"
    )
