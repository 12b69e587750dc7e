"""An inspection in words: a table for a terminal, and where the fields of a scan come from."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from trabecula.core.image import Image, default_phases
from trabecula.report.decidability import Decidable
from trabecula.report.trend_text import trend_text

if TYPE_CHECKING:
    from trabecula.report.inspection import Inspection

SEPARATE, WEAK = 0.8, 0.7
"""Otsu's share of the variance from which two classes are apart, and below which a normal
distribution (.64) splits as well.
"""
THIN = 3.0
"""Voxels: a phase that is thinner breaks in a method's coarser levels, and its thickness is half
error.
"""
SATURATED = 0.01
"""Share of the voxels at the ends of the range from which greys are lost."""
DIRECTED = 0.2
"""Degree of anisotropy above which a material looks different along one axis; chance alone reaches
.1 in small scans.
"""
WIDTH, HEAD = 110, 14

FIELDS = ("kind", "phases", "spacing", "unit")


def table(found: Inspection) -> str:
    """Return the findings of an `Inspection`, a topic a row: at most 40 lines."""
    rows = [
        ("scan", _scan(found)),
        *_phase_rows(found),
        ("spacing", _spacing(found)),
        *_margin_rows(found),
        *([("greys", text) for text in _grey(found)]),
        ("correlated", _correlation(found)),
        *_direction_rows(found),
        *[("components", text) for text in _components(found)],
        ("same all over", _stationarity(found)),
        ("order", _order(found)),
        ("recommended", str(found.recommendation)),
        ("decidable", _decidable(found.decidable)),
        *[("not decidable", text) for text in found.decidable.limits],
    ]
    lines: list[str] = []
    before, below = "", " " * (HEAD + 2)
    for head, text in rows:
        lead = ("" if head == before else head).ljust(HEAD + 2)
        wrap = textwrap.TextWrapper(WIDTH, lead, below, break_on_hyphens=False)
        lines += wrap.wrap(text)
        before = head
    text = "\n".join(lines)
    return text.replace("voxel", "pixel") if len(found.shape) == 2 else text


def _scan(found: Inspection) -> str:
    box = ""
    if found.whole is not None:
        box = f", the centre box of {_size(found.whole)}: the rest was not looked at"
    return f"{_size(found.shape)} voxels of {found.kind} ({found.origin.get('kind', 'given')}){box}"


def _phase_rows(found: Inspection) -> Iterator[tuple[str, str]]:
    if found.kind == "labels":
        shares = ", ".join(f"{name} {share:.3f}" for name, share in found.fractions.items())
        where = found.origin.get("phases", "given")
        hint = ", the darkest first: --phases names them" if where == "default names" else ""
        yield "phases", f"{shares} ({where}{hint})"


def _spacing(found: Inspection) -> str:
    edges = found.spacing[:1] if len(set(found.spacing)) == 1 else found.spacing
    where, unit_from = (found.origin.get(name, "given") for name in ("spacing", "unit"))
    both = where if where == unit_from else f"{where}; unit: {unit_from}"
    advice = "" if found.unit != "voxel" else "; a length needs --spacing and --unit"
    return f"{' x '.join(f'{edge:g}' for edge in edges)} {found.unit} ({both}){advice}"


def _margin_rows(found: Inspection) -> Iterator[tuple[str, str]]:
    margins = found.margins
    if found.whole is not None:
        yield "margins", "not looked at: they lie outside the centre box"
        return
    yield "margins", str(margins)
    if not margins:
        return
    yield "margins", f"--crop auto keeps {_size(margins.size)}; what follows is of that box"
    if found.fractions and found.phases:
        changed = [
            f"{name} {share:.3f} with them, {found.phases[name].fraction:.3f} without"
            for name, share in list(found.fractions.items())[: max(1, len(found.fractions) - 1)]
            if name in found.phases
        ]
        yield "margins", "; ".join(changed)


def _grey(found: Inspection) -> Iterator[str]:
    grey = found.grey
    if grey is None:
        return
    lost = f"{grey.saturated:.1%} at an end of the range"
    lost += ": greys are lost there" if grey.saturated > SATURATED else ""
    noise = f", noise {grey.noise:.2g}" if grey.noise > 0 else ""
    yield f"{grey.bits} bit a value, from {grey.low:g} to {grey.high:g}, {lost}{noise}"
    if grey.threshold is None or found.kind == "colour":
        return
    word, more = "well", ""
    if grey.separability < SEPARATE:
        word = "weakly" if grey.separability >= WEAK else "badly"
        more = ": look at slices, give --threshold, or keep greys with --threshold none"
    share = f"{grey.separability:.2f} of the variance lies between the classes"
    yield f"threshold {grey.threshold:g} (Otsu) parts {word}: {share}{more}"


def _correlation(found: Inspection) -> str:
    axes = ", ".join("zyx"[3 - len(found.margins.size) :])
    lengths = ", ".join(
        f"{length:.1f}" if np.isfinite(length) else "unknown" for length in found.structure.lengths
    )
    sizes = ", ".join(
        f"{size:.0f}" if np.isfinite(length) else "few"
        for size, length in zip(found.sizes, found.structure.lengths, strict=True)
    )
    return f"over {lengths} voxels along {axes}; the sides are {sizes} times as long"


def _decidable(decidable: Decidable) -> str:
    if not decidable.anything:
        return "nothing"
    return (
        f"{decidable.figures}, by the spread of {decidable.parts} parts of {_size(decidable.part)} "
        "voxels"
    )


def _direction_rows(found: Inspection) -> Iterator[tuple[str, str]]:
    if found.anisotropy is not None:
        directed = found.anisotropy > DIRECTED
        word = f"longest along {found.longest}" if directed else "alike in all directions"
        hint = ""
        if directed and len(found.shape) == 2:
            hint = "; one picture cannot show the third axis: give more, or --set views=yx,zx"
        yield "direction", f"anisotropy {found.anisotropy:.2f} of mean intercepts: {word}{hint}"


def _components(found: Inspection) -> Iterator[str]:
    for name, phase in found.phases.items():
        share = "" if found.kind == "labels" else f" {phase.fraction:.3f}"
        count, thick = "1 component", ""
        if phase.components != 1:
            count = f"{phase.components} components, the largest {phase.largest_fraction:.3f} of it"
        spans = ", ".join(axis for axis, holds in phase.percolates.items() if holds) or "no axis"
        if phase.thickness is not None:
            thick = f"; {phase.thickness:.1f} voxels thick"
            if phase.thickness < THIN:
                thick += ": too few, thin parts will break; a finer scan helps"
        yield f"{name}{share}: {count}, spans {spans}{thick}"


def _stationarity(found: Inspection) -> str:
    state = found.stationarity
    if state.stationary is None:
        return f"not decided: {state.windows} windows of {_size(state.edge)} voxels are too few"
    trends = [f"{trend_text(trend)}, {trend.errors:.1f} standard errors" for trend in state.surest]
    if trends:
        return f"no: {'; '.join(trends)}"
    return (
        f"no trend along the axes or from centre to rim ({state.windows} windows of "
        f"{_size(state.edge)} voxels)"
    )


def _order(found: Inspection) -> str:
    structure = found.structure
    if structure.period is not None:
        offset = ", ".join(map(str, structure.period))
        text = f"regular: repeats {offset} voxels on, correlated by {structure.order:.2f}"
    else:
        text = "none beyond 5 correlation lengths"
    bodies = f"; {found.bodies} consists of separate bodies of one shape" if found.bodies else ""
    return text + bodies


def _size(shape: Sequence[int]) -> str:
    return " x ".join(map(str, shape))


def origins_of(image: Image) -> dict[str, str]:
    """Return the origin of each field, from the recipe: given, stated by the file, found in the
    content, or the default.
    """
    found = {name: _unknown(image, name) for name in FIELDS}
    for step in image.recipe.steps:
        found.update(_of_step(step, image))
    if image.kind != "labels":
        del found["phases"]
    return found


def _unknown(image: Image, name: str) -> str:
    if name == "phases" and image.phases == default_phases(len(image.phases)):
        return "default names"
    default = {"spacing": set(image.spacing) == {1.0}, "unit": image.unit == "voxel"}
    if default.get(name):
        return "default: nothing states it"
    return "given with the array"


def _of_step(step: Mapping[str, Any], image: Image) -> dict[str, str]:
    """Return the origins of the fields that a step of a recipe sets."""
    verb = step["verb"]
    if verb == "sample":
        return dict.fromkeys(FIELDS, "the sample")
    if verb == "declare":
        return dict.fromkeys(step.get("fields", {}), "given")
    if verb == "segment":
        how = step.get("found_by", "given")
        threshold = step["threshold"]
        numbers = threshold if isinstance(threshold, list) else [threshold]
        text = ", ".join(f"{number:g}" for number in numbers)
        found = {"kind": f"segmented at {text} ({'given' if how == 'given' else f'found: {how}'})"}
        return found | {"phases": "default names" if image.phases == ("void", "solid") else "given"}
    if verb == "generate":
        return dict.fromkeys(FIELDS, "its exemplar")
    if verb != "read":
        return {}
    found = dict.fromkeys(step.get("stated", ()), "stated in the file")
    if "kind" not in found:
        kinds = {"labels": "few levels", "grey": "more than 8 levels", "colour": "three channels"}
        levels = ", ".join(f"{level:g}" for level in step.get("levels") or ())
        found["kind"] = f"the file's levels {levels}" if levels else kinds[image.kind]
    if "spacing_from" in step:
        found |= dict.fromkeys(("spacing", "unit"), step["spacing_from"])
    found |= dict.fromkeys((name for name in step.get("options", {}) if name in FIELDS), "given")
    if "ignored" in step:
        spacing = found.get("spacing", _unknown(image, "spacing"))
        found["spacing"] = f"{spacing} (ignored: {step['ignored']})"
    return found
