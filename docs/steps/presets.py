"""Draw the presets of methods that need no exemplar: a still and a slice of each,
`METHOD-PRESET.png`, and one sheet of all.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image as Pillow

import trabecula as tb
from trabecula.synth.api.registry import methods
from trabecula.view.looks import LOOKS

_SEED = 7
_TALL = 320  # pixels
_LOOK_OF = {"baguette": "bread", "cheese": "sponge"}
_SIDES = (88, 120, 120)
_LOAVES = {"bread": (116, 128, 176), "baguette": (88, 104, 232)}
"""Presets that are shown as a loaf, with its sides; of the others a block."""


_SECTION = """## {title}, by {method}

Made without an exemplar, in the look of its name or one near to it: a still, and a slice. The
settings of the preset are on [the method's page](../methods/{method}.md).

![{preset}: a still and a slice]({method}-{preset}.png)

```sh
trabecula generate --method {method} --preset {preset} \\
  --shape {shape} --seed {seed} --out {preset}.zarr
trabecula render {preset}.zarr --look {look} --size 420 320 --out {preset}.png
```
{form}"""
_LOAF = """
The picture's form is a loaf: `--mask FILE` with a mesh, or a mask of your own.
"""


def pictured() -> dict[str, tuple[str, ...]]:
    """Return the presets that have a picture, by method."""
    return {name: spec.presets for name, spec in methods().items() if spec.alone and spec.presets}


def draw_presets(folder: Path) -> list[str]:
    """Draw all of them and return the section of each."""
    sections = []
    for method, presets in pictured().items():
        stills = []
        for preset in presets:
            still, slice_ = _draw(method, preset)
            stills.append(still)
            sections.append(_section(method, preset))
            Pillow.fromarray(_beside([still, slice_])).save(folder / f"{method}-{preset}.png")
        half = -(-len(stills) // 2)
        rows = [_beside(stills[:half]), _beside(stills[half:])]
        wide = max(row.shape[1] for row in rows)
        sheet = [
            np.pad(row, [(0, 0), (0, wide - row.shape[1]), (0, 0)], mode="edge") for row in rows
        ]
        Pillow.fromarray(np.concatenate(sheet)).save(folder / f"{method}.png")
    return sections


def _section(method: str, preset: str) -> str:
    return _SECTION.format(
        method=method,
        preset=preset,
        title=preset.capitalize(),
        look=_look(preset),
        shape=" ".join(map(str, _LOAVES.get(preset, _SIDES))),
        seed=_SEED,
        form=_LOAF if preset in _LOAVES else "",
    )


def _look(preset: str) -> str:
    return _LOOK_OF.get(preset, preset if preset in LOOKS else "stone")


def _draw(method: str, preset: str) -> tuple[np.ndarray, np.ndarray]:
    """Draw a still, and the middle slice that shows most."""
    look: Any = LOOKS[_look(preset)]
    mask = loaf(_LOAVES[preset]) if preset in _LOAVES else None
    sides = _SIDES if mask is None else mask.shape
    material = tb.method(method, preset=preset).fit().generate(sides, seed=_SEED, mask=mask)
    still = tb.render(
        material,
        look=_look(preset),
        size=(420, _TALL),
    )
    colours = np.array([look.void, look.solid], np.uint8)
    # A loaf across its length, a block from the side.
    plane = (
        material.values[:, :, sides[2] // 2]
        if mask is not None
        else material.values[:, sides[1] // 2]
    )
    within = np.ones_like(plane, bool) if mask is None else mask[:, :, sides[2] // 2]
    shown = np.where(within[..., None], colours[plane], np.array(look.background, np.uint8))[::-1]
    times = (_TALL - 40) // shown.shape[0]
    return still.values, np.kron(shown, np.ones((times, times, 1), np.uint8))


def loaf(sides: tuple[int, ...]) -> np.ndarray:
    """Return a form that is flat below, round above and blunt at its ends."""
    z, y, x = (
        2 * (index + 0.5) / side - 1 for index, side in zip(np.indices(sides), sides, strict=True)
    )
    return (np.abs(x) ** 3.5 + np.abs(y) ** 2.5 + np.abs(z) ** np.where(z < 0, 5, 2.2)) < 1


def _beside(pictures: Sequence[np.ndarray]) -> np.ndarray:
    """Join pictures of the same height or less in a row, on the first one's ground."""
    ground, tall = pictures[0][0, 0], max(len(picture) for picture in pictures)
    row = []
    for picture in pictures:
        above = (tall - len(picture)) // 2
        frame = np.empty((tall, picture.shape[1] + 24 * (len(picture) < tall), 3), np.uint8)
        frame[:] = ground
        frame[above : above + len(picture), : picture.shape[1]] = picture
        row.append(frame)
    return np.concatenate(row, axis=1)
