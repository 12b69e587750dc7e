"""The one table of looks: materials by their answer to light, and the colours of phases.

Stills and the page in a browser are shaded by the same model with these figures (see `kernels` and
page/march.frag). Colours are sRGB, 0..255; both work on linear light.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.checks import check_name
from trabecula.core.image import Image

Colour = tuple[int, int, int]


@dataclass(frozen=True)
class Look:
    """Answer of a material to light, in the words of Burley (2012), which Baravalle et al. (2016,
    section 5) render with.

    Parameters
    ----------
    solid : colour
        Of the first phase that is drawn.
    void : colour
        Of the void in slices.
    background : colour
        Behind a still.
    shade : colour
        Of the light that reaches a point from all round; what is hidden from the lamp takes this
        hue.
    cut : colour
        Dye of the faces of the box and of the cut (255 leaves a channel as it is), to tell them
        from the surface.
    roughness : float
        0 (polished) .. 1 (matt): width of the highlight, and how much light comes straight back at
        grazing angles.
    specular : float
        0..1: share of light that is mirrored, 0.08 of it when looked at squarely.
    absorption : float
        Per voxel edge, 0 or more, of what is black; of a colour the share that it does not reflect.
        High: light does not get through thin walls.
    scattering : float
        Per voxel edge, 0 or more: how often light in the material is turned. High beside the
        absorption: light that goes in comes out again nearby, and shadows have soft, warm edges.
    """

    solid: Colour
    void: Colour = (30, 36, 46)
    background: Colour = (243, 244, 246)
    shade: Colour = (214, 226, 245)
    cut: Colour = (255, 255, 255)
    roughness: float = 0.6
    specular: float = 0.4
    absorption: float = 6.0
    scattering: float = 0.5

    @property
    def finish(self) -> tuple[float, float, float, float]:
        """Return roughness, specular, absorption and scattering."""
        return self.roughness, self.specular, self.absorption, self.scattering


LOOKS = {
    "bone": Look(
        solid=(238, 222, 190), shade=(218, 218, 230), cut=(252, 222, 198),
        roughness=0.5, specular=0.45, absorption=2.5, scattering=1.0,
    ),
    "foam": Look(
        solid=(196, 206, 212), shade=(214, 224, 242), cut=(222, 234, 248),
        roughness=0.4, specular=0.6, absorption=3.0, scattering=0.6,
    ),
    "bread": Look(
        solid=(236, 202, 146), void=(74, 48, 28), shade=(238, 214, 186), cut=(255, 250, 240),
        roughness=0.9, specular=0.1, absorption=1.6, scattering=0.5,
    ),
    "sponge": Look(
        solid=(240, 204, 84), void=(70, 54, 16), shade=(236, 224, 196), cut=(255, 240, 214),
        roughness=0.8, specular=0.15, absorption=1.4, scattering=0.45,
    ),
    "stone": Look(
        solid=(196, 186, 172), void=(40, 40, 44), shade=(208, 216, 232), cut=(250, 240, 228),
        roughness=0.7, specular=0.35, absorption=12.0, scattering=0.0,
    ),
}  # fmt: skip

LAMP = (-0.26, 0.56, 0.78)
"""Where the lamp is, before the material to the upper left: (right, up, towards the viewer)."""

LAMP_STRENGTH, AMBIENCE, FILL = 0.92, 0.38, 0.12
"""Light of the lamp, from all round, and from the viewer, on a white surface that faces each."""

# Further phases, far apart in hue and lightness for all kinds of colour vision (an order after
# Okabe and Ito 2008).
_FURTHER: tuple[Colour, ...] = (
    (86, 150, 196),
    (214, 122, 60),
    (62, 150, 118),
    (204, 132, 172),
    (128, 96, 168),
    (46, 98, 160),
    (168, 72, 46),
)


def find_look(name: str) -> Look:
    """Return the look of that name; raise an error that suggests the nearest."""
    check_name(name, LOOKS, name="look")
    return LOOKS[name]


def all_round() -> np.ndarray:
    """Return (14, 3) directions from which light from all round comes, the faces and corners of a
    cube; the second half is opposite to the first.
    """
    corners = np.array([(x, y, 1) for x in (-1, 1) for y in (-1, 1)]) / np.sqrt(3)
    half = np.concatenate([np.eye(3), corners])
    return np.concatenate([half, -half])


def phase_colours(image: Image, look: Look) -> np.ndarray:
    """Return (N, 3) uint8, a colour for every phase of an image; the phase named "void" is dark."""
    colours: list[Colour] = []
    drawn = (look.solid, *_FURTHER)
    others = [name for name in image.phases if name != "void"]
    for name in image.phases:
        colours.append(look.void if name == "void" else drawn[others.index(name) % len(drawn)])
    return np.array(colours, np.uint8)


def to_linear(colour: ArrayLike) -> np.ndarray:
    """Convert sRGB 0..255 to linear light 0..1 (IEC 61966-2-1)."""
    value = np.asarray(colour, np.float64) / 255
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def to_srgb(light: np.ndarray) -> np.ndarray:
    """Convert linear light 0..1 to sRGB uint8."""
    light = np.clip(light, 0.0, 1.0)
    value = np.where(light <= 0.0031308, light * 12.92, 1.055 * light ** (1 / 2.4) - 0.055)
    return np.round(value * 255).astype(np.uint8)


def as_table() -> dict[str, Any]:
    """Return looks, light and further colours as plain JSON, for the page in a browser."""
    light = {
        "lamp": LAMP,
        "strength": (LAMP_STRENGTH, AMBIENCE, FILL),
        "around": all_round()[:7].tolist(),
    }
    return {
        "looks": {name: asdict(look) for name, look in LOOKS.items()},
        "light": light,
        "further": _FURTHER,
    }
