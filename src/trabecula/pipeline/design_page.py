"""The page of a finished part under its loads, with pictures of its stress."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trabecula import fields
from trabecula.core.image import Image
from trabecula.fields.topology.cases import Case
from trabecula.pipeline.certificate_page import png_bytes
from trabecula.report.design_page import design_page, part_scale
from trabecula.report.page import write_page
from trabecula.view.still import render

_VIEWS: dict[str, dict[str, Any]] = {
    "From the front right": {"camera": (32.0, 26.0), "cut": "none"},
    "From the back left, below": {"camera": (212.0, -26.0), "cut": "none"},
    "Cut through the middle": {"camera": (32.0, 26.0), "cut": "y=0.5"},
}


def asked_compliance(
    density: Image,
    of: str | Path | Mapping[str, Any] | Case,
    *,
    mask: Image | ArrayLike | None = None,
) -> list[float]:
    """Return the compliance of a design over that of its form filled with solid, by load case.

    Parameters
    ----------
    density : Image
        As `simp` returns it, of elements or resampled.
    of, mask
        As of `simp`; a mask has the density's shape.
    """
    design = fields.principal_stress(density, of, mask=mask)
    solid = fields.principal_stress(
        Image(np.ones_like(density.values), "grey", density.spacing, density.unit), of, mask=mask
    )
    return [a / b for a, b in zip(design.compliance, solid.compliance, strict=True)]


def write_design_page(
    path: str | os.PathLike[str],
    image: Image,
    stress: Image,
    *,
    asked: list[float] | None = None,
    modulus: float | None = None,
) -> None:
    """Write the page of a part under its loads.

    Parameters
    ----------
    path : path
        Ending in .html.
    image : Image of labels
    stress : Image
        As `part_stress` returns it.
    asked : list of float, optional
        As `asked_compliance` returns it.
    modulus : float, optional
        Young's modulus of the solid in pascal; the case's forces are then newtons.
    """
    scale = None if modulus is None else part_scale(image, modulus)
    pictures = [
        (f"{name}; stress", png_bytes(render(image, size=(800, 500), field=stress, **view)))
        for name, view in _VIEWS.items()
    ]
    html = design_page(image, stress, asked=asked, scale=scale, pictures=pictures)
    write_page(html, Path(path))
