"""Drawings: what a layer's file holds, a class for each form that has a file a layer."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from trabecula.layers.contour_files import svg_text
from trabecula.layers.contours import find_contours, signed_area
from trabecula.layers.droplets import COLOURS, Palette
from trabecula.layers.sampling import LayerSampler

FINE = 4
"""A mask's grey is the share of so many times so many places of a pixel."""


class Drawing(ABC):
    """Layers as files of a folder; `about` is what the manifest says of them."""

    def __init__(self, sampler: LayerSampler, printed: Sequence[int]) -> None:
        self.sampler, self.printed = sampler, printed
        self.about: dict[str, Any] = {"printed": [*map(int, printed)]}

    @abstractmethod
    def write(self, layer: int, path: Path) -> dict[str, float]:
        """Write a layer; return the area of each material in square millimetres."""

    @property
    def pixel(self) -> float:
        """Return the area of a pixel in square millimetres."""
        return self.sampler.pitch[1] * self.sampler.pitch[2]


class Droplets(Drawing):
    """Pictures with a colour for each material."""

    def __init__(self, sampler: LayerSampler, palette: Palette, seed: int) -> None:
        super().__init__(sampler, palette.phases)
        self.palette, self.seed = palette, seed
        self.about |= {**palette.about, "seed": seed}

    def write(self, layer: int, path: Path) -> dict[str, float]:
        from PIL import Image as Picture

        drops = self.palette.layer(self.sampler, layer, self.seed)
        picture = Picture.fromarray(drops[::-1])
        picture.putpalette([value for colour in COLOURS for value in colour])
        picture.save(path, format="PNG", dpi=_dots(self.sampler.pitch))
        counts = np.bincount(drops.ravel(), minlength=len(self.palette.materials))
        areas = counts[1:] * self.pixel
        return dict(zip(self.palette.materials[1:], areas.tolist(), strict=True))


class Masks(Drawing):
    """Grey masks: the share of each pixel that is printed."""

    def write(self, layer: int, path: Path) -> dict[str, float]:
        from PIL import Image as Picture

        inside = self.sampler.shares(layer, self.printed, fine=FINE).sum(axis=0) >= 0.5
        height, width = (side // FINE for side in inside.shape)
        lit = inside.reshape(height, FINE, width, FINE).sum(axis=(1, 3), dtype=np.uint16)
        grey = ((lit * 255 + FINE**2 // 2) // FINE**2).astype(np.uint8)
        Picture.fromarray(grey[::-1]).save(path, format="PNG", dpi=_dots(self.sampler.pitch))
        return {"solid": np.count_nonzero(inside) * self.pixel / FINE**2}


class Outlines(Drawing):
    """Contours as SVG."""

    def write(self, layer: int, path: Path) -> dict[str, float]:
        lines = contours_of(self.sampler, self.printed, layer)
        _, height, width = self.sampler.size
        path.write_text(svg_text(lines, width, height), encoding="ascii")
        return {"solid": area_within(lines)}


def contours_of(sampler: LayerSampler, printed: Sequence[int], layer: int) -> list[np.ndarray]:
    """Return the closed lines of a layer, (N, 2) x and y in millimetres."""
    solid = sampler.shares(layer, printed).sum(axis=0)
    return [line * sampler.pitch[:0:-1] for line in find_contours(solid)]


def area_within(lines: Sequence[np.ndarray]) -> float:
    """Return the area within closed lines, less that of holes."""
    return sum(signed_area(line) for line in lines)


def _dots(pitch: Sequence[float]) -> tuple[float, float]:
    """Return the dots an inch along x and y."""
    return 25.4 / pitch[2], 25.4 / pitch[1]
