"""Recommendations: the method and preset that fit an exemplar, with the reason.

The rules are those of the methods' cards and of the tables of figures: docs/guide/figures.md for
pictures, the known failures of `texture` for volumes.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from trabecula.core.image import Image
from trabecula.exemplar.views import is_isotropic
from trabecula.measure.closed_cells import wall_phase
from trabecula.report.structure import has_bodies, has_round_grains, measure_structure

LEAST = 12
"""Voxels along every axis that methods of neighbourhoods need: a neighbourhood of 8 and 4 places
for it.
"""
LEAST_NOISE = 8
_DENSITIES = ("porosity", "volume_fraction")
FINE = 3.0
"""Pixels: a picture whose lines change phase more often than this on average is finer than what
`kopf` can follow, which draws stripes of three pixels only on its finest level."""


@dataclass(frozen=True)
class Recommendation:
    """A method for an exemplar.

    Attributes
    ----------
    method : str or None
        None where no method can learn from it.
    preset : str or None
    settings : mapping
    reason : str
    """

    method: str | None
    reason: str
    preset: str | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)

    def __str__(self) -> str:
        if self.method is None:
            return f"none: {self.reason}"
        return f"--method {self.method}{self.words}: {self.reason}"

    @property
    def words(self) -> str:
        """Return the options for its preset and settings."""
        preset = f" --preset {self.preset}" if self.preset else ""
        settings = "".join(f" --set {name}={value}" for name, value in self.settings.items())
        return preset + settings

    def to_json(self) -> dict[str, Any]:
        """Return plain JSON."""
        settings = dict(self.settings)
        return {
            "method": self.method,
            "preset": self.preset,
            "settings": settings,
            "reason": self.reason,
        }


def recommend(image: Image, *, graded: Collection[str] = (), alone: bool = True) -> Recommendation:
    """Choose a method, a preset and settings for an exemplar.

    Parameters
    ----------
    image : Image
        As it would be learnt from: a grey scan that is to be segmented, segmented.
    graded : collection of str
        Names of the target descriptors that vary from place to place.
    alone : bool
        Whether it is the only exemplar; of several pictures each is of a plane.
    """
    if min(image.shape) < LEAST:
        return _for_little(image)
    if graded and image.ndim == 3 and image.kind == "labels":
        return _for_fields(image, graded)
    return _for_picture(image, alone=alone) if image.ndim == 2 else _for_volume(image)


def _for_little(image: Image) -> Recommendation:
    size = " x ".join(map(str, image.shape))
    if image.ndim == 3 and image.kind == "labels" and min(image.shape) >= LEAST_NOISE:
        return Recommendation(
            "noise",
            f"{size} is too small for neighbourhoods, which need {LEAST} voxels along every axis; "
            "noise takes over the fractions "
            "and the two-point function alone",
        )
    return Recommendation(
        None,
        f"{size} is too small to learn from: {LEAST} voxels along every axis are the least; give a "
        "larger scan",
    )


def _for_fields(image: Image, names: Collection[str]) -> Recommendation:
    """Choose for a volume of labels and target fields."""
    others = sorted(name for name in names if name not in _DENSITIES)
    if "orientation" in others:
        return Recommendation(
            "quilt",
            "its turned patches keep plates and rods whole where directions change, and struts of "
            "texture break up into beads there",
            settings={"weights": {"orientation": 2.0}},
        )
    if "size" in others:
        return Recommendation("quilt", "its patches come from copies that are scaled to the sizes")
    if others:
        return Recommendation("quilt", f"texture grades by density alone, not by {others[0]}")
    if measure_structure(image).period is not None:
        return Recommendation(
            "quilt",
            "the material is regular, and patches of whole periods keep its cells; turned copies "
            "are there for gradients in every direction",
            settings={"orientations": "all"},
        )
    if len(image.phases) == 2 and (walls := wall_phase(image)) is not None:
        return _for_cells(image, walls)
    if len(image.phases) > 2:
        return Recommendation(
            "quilt", f"{len(image.phases)} phases, and texture grades a void and one other phase"
        )
    return Recommendation(
        "texture",
        "two phases without long-range order: graded without seams, in one component where the "
        "scan's solid is one",
    )


def _for_volume(image: Image) -> Recommendation:
    period = measure_structure(image).period
    if period is not None:
        offset = ", ".join(map(str, period))
        return Recommendation(
            "texture",
            f"the material is regular (it repeats {offset} voxels on, as far as beyond 5 "
            "correlation lengths), and only moved "
            "patches of the scan keep such order; the result copies",
            preset="best",
        )
    if image.kind != "labels":
        return Recommendation(
            "texture",
            f"it makes a new structure and {image.kind} values on it; segment first for a part to "
            "be printed",
        )
    walls = wall_phase(image)
    if walls is not None:
        return _for_cells(image, walls)
    two = len(np.unique(image.values)) == 2
    body = has_bodies(image) if two else None
    if body is not None:
        return Recommendation(
            "packing",
            f"{body} consists of separate round bodies: those of the scan are turned and packed "
            "anew, with their shapes and sizes",
        )
    if two and has_round_grains(image):
        return Recommendation(
            "packing",
            "its solid consists of round grains: those of the scan are turned and packed anew, "
            "with their shapes, sizes and contacts",
        )
    if len(image.phases) > 2:
        return Recommendation(
            "texture",
            f"{len(image.phases)} phases without long-range order: new material, not copied",
        )
    return Recommendation(
        "texture", "a volume of two phases without long-range order: new material, not copied"
    )


def _for_cells(image: Image, walls: int) -> Recommendation:
    return Recommendation(
        "tessellation",
        f"{image.phases[walls]} is walls between closed cells: new cells of the scan's sizes, with "
        "closed walls",
    )


def _for_picture(image: Image, *, alone: bool) -> Recommendation:
    if image.kind != "labels":
        return Recommendation(
            "chen",
            f"a {image.kind} picture: it takes the picture's own pixels, where means of three "
            "views lose their grain",
        )
    width = _mean_run(image)
    if width < FINE:
        return Recommendation(
            "mrf",
            f"a picture of {width:.1f} pixels from one phase to the next: mrf alone draws "
            "structures that fine",
        )
    if alone and len(np.unique(image.values)) == 2 and is_isotropic(image):
        return Recommendation(
            "kopf",
            "a picture of two phases that is alike from all sides: in space as the process whose "
            "slices it resembles most; a scan of a similar material (--like) says more",
            settings={"process": "auto"},
        )
    return Recommendation(
        "kopf",
        "a picture of labels: in space its phases are connected most nearly as those of real scans "
        "are; mrf draws nearer slices, in more components",
    )


def _mean_run(image: Image) -> float:
    """Return the mean length of runs of one phase along rows and columns, pixels."""
    changes = [
        (image.values[1:] != image.values[:-1]).mean(),
        (image.values[:, 1:] != image.values[:, :-1]).mean(),
    ]
    mean = sum(map(float, changes)) / 2
    return 1 / mean if mean else float("inf")


def misfit(image: Image, method: str, exemplar: str | None, *, flat: bool) -> str | None:
    """Explain why a method cannot learn from an exemplar of these axes, and which can; None where
    it can.

    Parameters
    ----------
    image : Image
    method : str
    exemplar : {"2d", "3d", None}
        Dimension of the exemplars that the method learns from.
    flat : bool
        It also learns from pictures.
    """
    if exemplar is None or f"{image.ndim}d" == exemplar or (flat and image.ndim == 2):
        return None
    size = " x ".join(map(str, image.shape))
    needs = "a 3-D exemplar" if exemplar == "3d" else "a picture"
    what = f"this is a picture of {size}" if image.ndim == 2 else f"this is a volume of {size}"
    fits = recommend(image)
    use = f"use --method {fits.method}" if fits.method else fits.reason
    return f"{method} needs {needs}; {what}: {use}"
