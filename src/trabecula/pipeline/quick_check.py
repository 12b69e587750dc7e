"""The quick figures of a result, against the band of its exemplar: what is off is named where it
was made.
"""

from __future__ import annotations

from math import prod

from trabecula.core.image import Image
from trabecula.core.request import Request
from trabecula.io import files
from trabecula.pipeline.generate import Result
from trabecula.pipeline.trials import band_line
from trabecula.report.certificate import verify
from trabecula.synth.api.model import Model

LEAST = 64
"""Voxels a side of exemplar and result: of smaller ones the bands decide little."""

MOST = 1 << 24
"""Voxels of a result that is measured unasked: 256^3, a few seconds."""


def quick_check(model: Model, request: Request, result: Result) -> str:
    """Return a line that names the figures of level "quick" outside their band; empty where a
    result is not measured: too small, too large, of no single volume of phases, or asked to differ
    from its exemplar.
    """
    exemplars = model.exemplars
    if len(exemplars) != 1 or request.asks_for() - {"periodic"}:
        return ""
    if not _decides(exemplars[0]) or min(request.shape) < LEAST or prod(request.shape) > MOST:
        return ""
    judged = verify(exemplars[0], files.read(result.path), level="quick")
    outside = tuple(name for name, metric in judged.metrics.items() if metric.passed is False)
    decided = sum(metric.passed is not None for metric in judged.metrics.values())
    if not outside:
        return f"all {decided} quick figures lie in the band of the exemplar's own parts"
    return f"{band_line(outside, decided)}; trabecula verify says how far, and measures more"


def _decides(exemplar: Image) -> bool:
    return exemplar.kind == "labels" and exemplar.ndim == 3 and min(exemplar.shape) >= LEAST
