"""Draw the gallery and write its page, docs/gallery: what the package makes today of its own
samples, and its certificates.
"""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import numpy as np
from PIL import Image as Pillow

import trabecula as tb
from steps.networks import draw_network
from steps.paper import draw_paper
from steps.presets import draw_presets
from trabecula.report.source_map import source_map
from trabecula.view.looks import LOOKS
from trabecula.view.slices import montage

_SIDE = 120  # voxels of what is made for a picture
_SEED = 7
_THUMBNAIL = (320, 256)
_LOOK_OF = {"bone": "bone", "foam": "foam"}


def draw(folder: Path) -> None:
    """Draw every picture, and write the pages that show them."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    sections = [draw_sample(name, folder) for name in tb.samples()]
    sections += [draw_shapes(folder), draw_sources(folder), draw_network(folder)]
    sections += [draw_looks(folder), *draw_presets(folder), draw_paper(folder)]
    (folder / "sections.json").write_text(json.dumps(sections), encoding="utf-8")
    write_pages(folder)


def write_pages(folder: Path) -> None:
    """Write a small page for every section, and the one with a thumbnail of each."""
    text = (folder / "sections.json").read_text(encoding="utf-8")
    sections = [one for given in json.loads(text) for one in _split(given)]
    cards, names = [], []
    for section in sections:
        title, _, rest = section.removeprefix("## ").partition("\n")
        name = re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")
        page = re.sub(r"^### ", "## ", rest, flags=re.MULTILINE)
        (folder / f"{name}.md").write_text(f"# {title}\n{page}", encoding="utf-8")
        shown = re.search(r"!\[[^\]]*\]\(([^)]+\.png)\)", section)
        if shown is None:
            raise ValueError(f"the section {title!r} of the gallery shows no picture")
        _thumbnail(folder / shown[1], folder / f"thumb-{name}.png")
        cards.append(f"[![{title}](thumb-{name}.png)]({name}.md)\n[{title}]({name}.md)\n")
        names.append(name)
    page = _INDEX.format(cards="\n".join(cards), names="\n".join(names))
    (folder / "index.md").write_text(page, encoding="utf-8")


def _split(text: str) -> list[str]:
    """Split what was drawn at its titles of second order."""
    return [f"## {part.strip()}\n" for part in re.split(r"^## ", text, flags=re.MULTILINE)[1:]]


def _thumbnail(picture: Path, place: Path) -> None:
    """Write the left end of a picture as a thumbnail of 5 to 4."""
    with Pillow.open(picture) as opened:
        image = opened.convert("RGB")
    wide = min(image.width, image.height * 5 // 4)
    image.crop((0, 0, wide, wide * 4 // 5)).resize(_THUMBNAIL, Pillow.Resampling.LANCZOS).save(
        place
    )


def draw_sample(name: str, folder: Path) -> str:
    """Draw a sample, more of it, their slices and the certificate; return their section."""
    exemplar = tb.sample(name)
    material = tb.finish.connect(tb.method("texture").fit(exemplar).generate(_SIDE, seed=_SEED))
    look = _LOOK_OF.get(name, "stone")
    tb.render(exemplar, folder / f"{name}.png", look=look, size=(640, 480))
    tb.render(material, folder / f"{name}-more.png", look=look, size=(640, 480))
    titles = [f"sample:{name}, {exemplar.shape[0]}^3", f"texture, {_SIDE}^3, seed {_SEED}"]
    montage([exemplar, material], titles, folder / f"{name}-slices.png", look=look, side=300)
    verdict = tb.verify(exemplar, material, names=[f"{name}.zarr"])
    (folder / f"{name}-certificate.txt").write_text(verdict.to_table() + "\n", encoding="utf-8")
    return _SAMPLE.format(
        name=name,
        side=_SIDE,
        seed=_SEED,
        look=look,
        summary=tb.samples()[name].capitalize(),
        own=exemplar.shape[0],
    )


def draw_shapes(folder: Path) -> str:
    """Draw a filled form cut open, a tile set beside itself, a repaired hole; return the section of
    them.
    """
    foam, bone = tb.sample("foam"), tb.sample("bone")
    fill = tb.method("texture").fit(foam)
    sides = (_SIDE // 2, 3 * _SIDE // 2, 3 * _SIDE // 2)
    z, y, x = (index - (side - 1) / 2 for index, side in zip(np.indices(sides), sides, strict=True))
    ring = np.hypot(np.hypot(y, x) - _SIDE / 2, z) < _SIDE / 4
    filled = tb.finish.connect(fill.generate(sides, mask=ring, seed=_SEED))
    tb.render(filled, folder / "shape-ring.png", look="foam", size=(640, 480), camera=(32, 45))

    tile = fill.generate(56, periodic=True, seed=_SEED)
    wall = tb.Image(np.tile(tile.values, (2, 2, 2)), "labels", spacing=tile.spacing, unit=tile.unit)
    tb.render(wall, folder / "shape-tile.png", look="foam", size=(640, 480))

    half = (*bone.shape[:2], bone.shape[2] // 2)
    whole, other = (
        tb.crop(bone, half, corner=(0, 0, 0)),
        tb.crop(bone, half, corner=(0, 0, half[2])),
    )
    hole = np.zeros(half, bool)
    hole[34:62, 34:62, 10:38] = True
    damaged = tb.Image(
        np.where(hole, 0, whole.values), "labels", spacing=bone.spacing, unit=bone.unit
    )
    repaired = (
        tb.method("texture").fit(other).generate(half, fixed=damaged, known=~hole, seed=_SEED)
    )
    names = ["a half of sample:bone", "with a hole of 28^3", "repaired after the other half"]
    montage([whole, damaged, repaired], names, folder / "shape-repair.png", side=300)
    return _SHAPES


def draw_sources(folder: Path) -> str:
    """Draw source maps of a copy off the grid, of independent and of made material; return their
    section.
    """
    bone = tb.sample("bone")
    exemplar = tb.crop(bone, (64, 96, 96), corner=(0, 0, 0))
    shown = {
        "copy": tb.crop(exemplar, (48, 64, 64), corner=(8, 8, 8)),
        "independent": tb.crop(bone, (32, 64, 64), corner=(64, 16, 16)),
        "texture": tb.method("texture").fit(exemplar).generate(64, seed=_SEED),
        "fast": tb.method("texture", preset="fast").fit(exemplar).generate(64, seed=_SEED),
    }
    for name, image in shown.items():
        drawn = source_map(exemplar, image)
        if drawn is not None:
            tb.write(drawn.picture, folder / f"sources-{name}.png")
    pictures = " | ".join(f"![sources: {name}](sources-{name}.png)" for name in shown)
    return _SOURCES.format(pictures=pictures)


def draw_looks(folder: Path) -> str:
    """Draw one crop in every look; return their table."""
    piece = tb.crop(tb.sample("bone"), 64)
    for name in LOOKS:
        tb.render(piece, folder / f"look-{name}.png", look=name, size=(320, 240))
    names = " | ".join(f"`{name}`" for name in LOOKS)
    shown = " | ".join(f"![the look {name}](look-{name}.png)" for name in LOOKS)
    return f"""## Looks

`--look` of `trabecula render`, `look=` of {{py:func}}`trabecula.render`: the same 64^3 voxels of
`sample:bone`.
A look is colour, gloss and how light goes through; it changes no voxel ([more](../howto/look.md)).

```sh
trabecula render sample:bone --crop 64 --look bread --size 320 240 --out look-bread.png
```

| {names} |
|{" --- |" * len(LOOKS)}
| {shown} |
"""


_INDEX = """# Gallery

Drawn at the build of this site, from samples that the package makes and from processes. The samples
are stand-ins for scans: right in kind, wrong in detail. Nothing here is chosen: it is one seed, the
first that was tried. Every picture has a page, which says how to make it again.

:::{{container}} cards

{cards}
:::

```{{toctree}}
:hidden:

{names}
```
"""

_SHAPES = """## Forms, tiles, repairs

How they are made: [forms, tiles and repairs](../howto/shapes.md); these by

```python
model = tb.method("texture").fit(tb.sample("foam"))
tile = model.generate(56, periodic=True, seed=7)
filled = tb.finish.connect(model.generate(form.shape, mask=form, seed=7))
```

| a ring filled with foam and connected, cut open | 2 x 2 x 2 of a periodic tile of 56^3 |
| --- | --- |
| ![a ring of foam, cut open](shape-ring.png) | ![eight tiles of foam](shape-tile.png) |

![slices of a bone, of the same with a hole, and of the repaired one](shape-repair.png)

The exemplar of the repair is the half that has no hole: what comes into it is new, and meets
what is around it.
"""

_SOURCES = """## Where material comes from

Middle slices of bone, every voxel in the colour of the shift to the place of the exemplar (64
planes of `sample:bone`) whose neighbourhood is nearest to its own
([what it says](../howto/copying.md)).

| a copy | the same bone, farther on | made by `texture` | made by its preset `fast` |
| --- | --- | --- | --- |
| {pictures} |
"""

_SAMPLE = """## More {name} from a sample

{summary}. Left the sample, {own}^3 voxels; right {side}^3 voxels made from it by `texture` and
then connected.

| sample:{name} | made from it |
| --- | --- |
| ![a still of sample:{name}]({name}.png) | ![a still of the result of texture]({name}-more.png) |

![middle slices across z, y and x, of both]({name}-slices.png)

```sh
trabecula generate sample:{name} --shape {side} --seed {seed} --out more.zarr
trabecula finish more.zarr --connect --out {name}.zarr
trabecula render {name}.zarr --look {look} --size 640 480 --out {name}-more.png
trabecula verify sample:{name} {name}.zarr
```

```{{literalinclude}} {name}-certificate.txt
:language: text
```
"""
