"""Draw a pore network: a slice with the pores in colours, and pores and throats in space."""

from __future__ import annotations

import colorsys
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

import trabecula as tb

_SIDE = 480
_WHITE, _GREY = (255, 255, 255), (70, 74, 82)


def draw_network(folder: Path) -> str:
    """Draw the network of the foam's void; return its section."""
    foam = tb.crop(tb.sample("foam"), 64)
    net = tb.measure.network(foam)
    sheet = Image.new("RGB", (2 * _SIDE + 20, _SIDE), _WHITE)
    panels = {"network-pores": _slice(net), "network-balls": _balls(net)}
    for number, (name, panel) in enumerate(panels.items()):
        sheet.paste(panel, (number * (_SIDE + 20), 0))
        panel.save(folder / f"{name}.png")
    sheet.save(folder / "network.png")
    return _SECTION.format(pores=len(net), throats=len(net.throats))


def _colours(count: int) -> np.ndarray:
    """Return colours that differ from one pore to the next, (count + 1, 3); grey for 0."""
    hues = (np.arange(count) * 0.618034) % 1
    found = [colorsys.hsv_to_rgb(hue, 0.45 + 0.3 * (k % 3) / 2, 0.92) for k, hue in enumerate(hues)]
    return np.array([np.array(_GREY) / 255, *found]) * 255


def _slice(net: tb.measure.PoreNetwork) -> Image.Image:
    middle = net.regions[len(net.regions) // 2]
    picture = _colours(len(net))[middle].astype(np.uint8)
    return Image.fromarray(picture).resize((_SIDE, _SIDE), Image.Resampling.NEAREST)


def _balls(net: tb.measure.PoreNetwork) -> Image.Image:
    """Draw pores as balls of their radius and throats as sticks of theirs, the farthest first."""
    picture = Image.new("RGB", (_SIDE, _SIDE), _WHITE)
    pen = ImageDraw.Draw(picture)
    turn, tilt = np.radians(30), np.radians(25)
    across = np.array([0, -np.sin(turn), np.cos(turn)])
    back = np.array([np.sin(tilt), np.cos(turn) * np.cos(tilt), np.sin(turn) * np.cos(tilt)])
    axes = np.stack([across, np.cross(across, back), back])
    sides = np.array(net.shape) * np.array(net.spacing)
    scale = 0.62 * _SIDE / sides.max()
    at = (net.centres - sides / 2) @ axes.T * scale
    at[:, :2] += _SIDE / 2
    colours = _colours(len(net))[1:]
    items = []
    for k, (a, b) in enumerate(net.throats.pores):
        items.append(((at[a, 2] + at[b, 2]) / 2, None, (a, b), net.throats.radius[k]))
    items += [(at[k, 2], k, None, net.radius[k]) for k in range(len(net))]
    for _, pore, ends, radius in sorted(items, key=lambda item: -item[0]):
        width = radius * scale
        if ends is not None:
            line = [tuple(at[k, :2]) for k in ends]
            pen.line(line, fill=(150, 155, 165), width=max(1, round(0.5 * width)))
        else:
            x, y = at[pore, :2]
            half = 0.6 * width
            colour = tuple(int(one) for one in colours[pore])
            pen.ellipse((x - half, y - half, x + half, y + half), fill=colour, outline=_GREY)
    return picture


_SECTION = """## A pore network

The void of 64^3 of `sample:foam`: left the middle slice, every pore in a colour, right its
{pores} pores (balls of .6 times their radius) and {throats} throats. [How](../howto/networks.md).

| pores in a slice | the network |
| --- | --- |
| ![a slice with pores in colours](network-pores.png) | ![pores and throats](network-balls.png) |

```sh
trabecula network sample:foam --crop 64 --out network.vtp
```
"""
