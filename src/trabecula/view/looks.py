"""The one table of looks: what materials are made to look like, and the colours of phases.

Colours are sRGB, 0..255; the renderer works on linear light.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import check_name
from trabecula.core.image import Image

Colour = tuple[int, int, int]


@dataclass(frozen=True)
class Look:
    """How a material answers to light.

    Parameters
    ----------
    solid : colour
        Of the first phase that is drawn.
    void : colour
        Of the void in slices.
    background : colour
        Behind a still.
    shade : colour
        Of the light that reaches a point from all round; what is hidden from the lamp takes this hue.
    cut : colour
        Dye of the faces of the box and of the cut (255 leaves a channel as it is), to tell them from the surface.
    gloss : float
        Strength of the highlight, 0..1.
    polish : float
        Its sharpness (exponent of Blinn-Phong).
    """

    solid: Colour
    void: Colour = (30, 36, 46)
    background: Colour = (243, 244, 246)
    shade: Colour = (214, 226, 245)
    cut: Colour = (255, 255, 255)
    gloss: float = 0.15
    polish: float = 24.0


LOOKS = {
    "bone": Look(solid=(238, 222, 190), shade=(206, 216, 240), cut=(252, 222, 198), gloss=0.16),
    "foam": Look(solid=(196, 206, 212), shade=(214, 224, 242), cut=(222, 234, 248), gloss=0.30, polish=40.0),
    "bread": Look(
        solid=(236, 202, 146), void=(74, 48, 28), shade=(238, 214, 186), cut=(255, 244, 228), gloss=0.02, polish=8.0
    ),
    "sponge": Look(
        solid=(240, 204, 84), void=(70, 54, 16), shade=(236, 224, 196), cut=(255, 240, 214), gloss=0.05, polish=12.0
    ),
    "stone": Look(
        solid=(196, 186, 172), void=(40, 40, 44), shade=(208, 216, 232), cut=(250, 240, 228), gloss=0.06, polish=16.0
    ),
}

# Further phases, far apart in hue and lightness for all kinds of colour vision (an order after Okabe and Ito 2008).
_FURTHER: tuple[Colour, ...] = (
    (86, 150, 196),
    (214, 122, 60),
    (62, 150, 118),
    (204, 132, 172),
    (128, 96, 168),
    (46, 98, 160),
    (168, 72, 46),
)


def look_named(name: str) -> Look:
    """The look of that name, or an error that suggests the nearest."""
    check_name(name, LOOKS, name="look")
    return LOOKS[name]


def phase_colours(image: Image, look: Look) -> np.ndarray:
    """(N, 3) uint8: a colour for every phase of an image of labels; the phase named "void" is dark."""
    colours: list[Colour] = []
    drawn = (look.solid, *_FURTHER)
    others = [name for name in image.phases if name != "void"]
    for name in image.phases:
        colours.append(look.void if name == "void" else drawn[others.index(name) % len(drawn)])
    return np.array(colours, np.uint8)


def to_linear(colour: ArrayLike) -> np.ndarray:
    """sRGB 0..255 to linear light 0..1 (IEC 61966-2-1)."""
    value = np.asarray(colour, np.float64) / 255
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def to_srgb(light: np.ndarray) -> np.ndarray:
    """Linear light 0..1 to sRGB uint8."""
    light = np.clip(light, 0.0, 1.0)
    value = np.where(light <= 0.0031308, light * 12.92, 1.055 * light ** (1 / 2.4) - 0.055)
    return np.round(value * 255).astype(np.uint8)
