"""A certificate as tables: figures and curves, a row each, with units."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from trabecula.report.metrics import find_descriptor

if TYPE_CHECKING:
    from trabecula.report.verdict import Certificate

FIGURES = (
    "image",
    "group",
    "figure",
    "value",
    "unit",
    "exemplar",
    "real_low",
    "real_high",
    "verdict",
)
CURVES = ("curve", "of", "position", "value")


def figure_rows(certificates: Sequence[Certificate]) -> list[Sequence[Any]]:
    """List the figures of certificates as rows, the head first."""
    rows: list[Sequence[Any]] = [FIGURES]
    for one in certificates:
        for name, metric in one.metrics.items():
            figure = find_descriptor(name)
            low, high = metric.real_band or ("", "")
            verdict = {True: "pass", False: "fail", None: ""}[metric.passed]
            ends = (_plain(metric.exemplar), low, high, verdict)
            rows.append(
                (one.name, figure.group, name, _plain(metric.value), figure_unit(name, one), *ends)
            )
    return rows


def curve_rows(certificate: Certificate) -> list[Sequence[Any]]:
    """List the curves of exemplar, image, its parts and the baseline as rows, the head first.

    The position is the distance in voxels, or the number of a bin, from 0. Curves of several
    channels are named NAME:CHANNEL.
    """
    rows: list[Sequence[Any]] = [CURVES]
    curves = certificate.curves
    sets = {who: curves[who] for who in ("exemplar", "image", "baseline") if who in curves}
    sets |= {f"part {n}": part for n, part in enumerate(curves.get("parts", ()), start=1)}
    for who, own in sets.items():
        for name, values in own.items():
            for named, line in _lines(name, np.asarray(values)):
                rows += [(named, who, place, float(value)) for place, value in enumerate(line)]
    return rows


def _lines(name: str, values: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """Return the lines of a curve by name: one, or one for each channel."""
    if values.ndim == 1:
        return [(name, values)]
    return [(f"{name}:{n}", line) for n, line in enumerate(values)]


def csv_text(rows: Sequence[Sequence[Any]]) -> str:
    """Return rows as the text of a CSV file."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


def figure_unit(name: str, certificate: Certificate) -> str:
    """Return the unit of a figure, by the unit of the image; nothing where it has none."""
    power = find_descriptor(name).power
    unit = certificate.about.get("image", {}).get("unit", "voxel")
    text = unit if abs(power) == 1 else f"{unit}^{abs(power)}"
    return "" if power == 0 else text if power > 0 else f"1/{text}"


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return " ".join(name for name, holds in value.items() if holds)
    return "" if value is None else value
