"""`view`: images -> page, with the key figures of certificates beside them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import prod
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.errors import InputError
from trabecula.core.image import Image, as_image
from trabecula.engine.lazy_volume import Slabs, as_slabs
from trabecula.io.units import has_length, to_metres
from trabecula.measure.registry import DESCRIPTORS
from trabecula.view.looks import find_look
from trabecula.view.page.document import Live, Page, document, pack
from trabecula.view.page.endless import as_endless
from trabecula.view.page.fitting import FittedVolume, fit_field, fit_volume
from trabecula.view.page.joining import join_labels
from trabecula.view.page.lines import pack_lines
from trabecula.view.page.server import Boxes, Triple
from trabecula.view.volume import visible_phases

MOST = 6
"""Volumes side by side."""

_BOX = 256
"""Voxels along an edge of the largest box of finer voxels that is sent."""

_FULL = 1.25
"""Letters a voxel that a grey volume may take packed (10 MB for 200^3); beyond, it is shown in 64
greys.
"""


def view(
    *images: Image | Slabs | ArrayLike,
    names: Sequence[str] | None = None,
    look: str = "bone",
    certificate: Any = None,
    fields: Mapping[str, Image | ArrayLike] | None = None,
    streamlines: Sequence[ArrayLike] | None = None,
    endless: Any = None,
    side: int = 64,
    seed: int = 0,
    title: str | None = None,
    height: int = 640,
) -> Page:
    """Show volumes side by side on a page: turned together, cut, sliced and shaded in a browser.

    Parameters
    ----------
    *images : Image, Slabs or array, (Z, Y, X) or (Y, X)
        Labels, grey or colour, such as an exemplar and what was made from it; 6 at most. More than
        256^3 voxels are drawn as means of blocks (labels by their coverage, thin walls kept), and
        the page says so; served by `show`, labels come in finer voxels where one zooms in.
    names : sequence of str, optional
        A name for each.
    look : {"bone", "foam", "bread", "sponge", "stone"}
        To begin with.
    certificate : Certificate or what its `to_json` gives, or a list of them, optional
        Whose key figures stand beside: one for each image, or for each but the first.
    fields : mapping of name to grey Image or array, (Z, Y, X), optional
        Thickness, velocity, stress, source map: each may colour the labels of its shape, and the
        probe reads it. The first one does at the beginning.
    streamlines : sequence of (N, 4) arrays, optional
        Of the first image, labels: what `tb.measure.streamlines` returns. They are drawn among
        its material, coloured by speed.
    endless : model, optional
        A trained model of method "gan" (`tb.load_model("bone")`), labels by the sub-pixel
        generator: the page makes its material, with another seed, size, place or porosity as one
        asks for it. It stands beside the images, of which the first is its exemplar: its
        two-point function is drawn.
    side, seed : int
        Of the first box of endless material: 32, 64, 96 or 128 voxels an edge.
    title : str, optional
        Of the page. Default: the names.
    height : int
        Pixels that the page takes in a notebook, 200..4000.

    Returns
    -------
    Page
        With `save(path)` and `show()`; a notebook displays it.

    Raises
    ------
    InputError
        No images or too many, not as many names or certificates, an unknown look, height out of
        range, a field of no image's shape.
    """
    several = [
        image if isinstance(image, Slabs) else as_image(image, name=f"image {index}")
        for index, image in enumerate(images)
    ]
    made = [] if endless is None else [as_endless(endless, next(iter(several), None), side, seed)]
    if not 1 <= len(several) + len(made) <= MOST:
        raise InputError(f"a page shows 1 to {MOST} images, got {len(several) + len(made)}")
    find_look(look)
    if not 200 <= height <= 4000:
        raise InputError(f"height {height} is outside 200..4000 pixels")
    named = _names(names, len(several))
    titles = [*named, *(f"{each.settings['name']}, endless" for each in made)]
    title = _text(" | ".join(titles) if title is None else title)
    figures = key_figures(certificate, len(several))
    scales = _scales([*(image.unit for image in several), *(one.settings["unit"] for one in made)])
    tints = _check_fields(fields or {}, several)
    volumes, texts, packed = [], [], dict[str, str]()
    for k, (image, name, scale, rows) in enumerate(
        zip(several, named, (scales or [1.0] * MOST)[: len(several)], figures, strict=True)
    ):
        volume, text, found = _volume(image, name, scale, rows, tints[k])
        packed |= {f"field-{k}-{j}": each for j, each in enumerate(found)}
        if streamlines is not None and k == 0:
            volume["lines"], values = _lines(streamlines, image, volume)
            packed["lines-0"] = pack(values)
        if scales is None:
            volume["notes"].append(
                "no common unit: each volume fills its place, they are not to one scale"
            )
        volumes.append(volume)
        texts.append(text)
    about: dict[str, Any] = {"look": look, "aligned": scales is not None, "volumes": volumes}
    for each in made:
        about["endless"] = each.about(len(volumes))
        volumes.append(each.volume((scales or [1.0])[-1]))
        packed |= {name: pack(values) for name, values in each.blocks().items()}
    html = document(title, about, texts, packed)
    boxes, fine = _boxes(several, volumes), [_has_detail(volume) for volume in volumes]
    if not any(fine):
        return Page(html, title, height)
    with_detail = [{**one, "detail": here} for one, here in zip(volumes, fine, strict=True)]
    served = document(title, {**about, "volumes": with_detail}, texts, packed, live=True)
    return Page(html, title, height, Live(served, boxes))


def _has_detail(volume: Mapping[str, Any]) -> bool:
    """Return whether there are finer voxels than the page holds, the same along every axis."""
    block = volume["block"]
    return volume["kind"] == "labels" and block[0] > 1 and len(set(block)) == 1


def _boxes(images: Sequence[Image | Slabs], volumes: Sequence[Mapping[str, Any]]) -> Boxes:
    """Return what gives a server the finer voxels of the images."""

    def box(number: int, fine: int, low: Triple, size: Triple) -> bytes:
        if not 0 <= number < len(volumes) or not _has_detail(volumes[number]):
            raise InputError(f"volume {number} has no finer voxels than the page holds")
        image, shape, edge = images[number], volumes[number]["shape"], volumes[number]["block"][0]
        if fine < 1 or edge % fine:
            raise InputError(f"fine {fine} does not divide a block of {edge} voxels")
        spans = [(a, a + n) for a, n in zip(low, size, strict=True)]
        if not all(0 <= a < b <= n for (a, b), n in zip(spans, shape, strict=True)):
            raise InputError(f"box {low} of {size} is outside the volume of {shape}")
        if prod(size) * fine**3 > _BOX**3:
            raise InputError(f"a box has at most {_BOX}^3 voxels: ask for a smaller one")
        volume = image if isinstance(image, Slabs) else as_slabs(image)
        wanted = [(a * fine, b * fine) for a, b in spans]
        return join_labels(volume, (edge // fine,) * 3, wanted).tobytes()

    return box


def _check_fields(
    fields: Mapping[str, Image | ArrayLike], images: Sequence[Image | Slabs]
) -> list[dict[str, np.ndarray]]:
    """Return the fields of each image: those of its shape, finite."""
    found: list[dict[str, np.ndarray]] = [{} for _ in images]
    for name, field in fields.items():
        given = field if isinstance(field, Image) else Image(np.asarray(field), "grey")
        fits = [
            k
            for k, image in enumerate(images)
            if image.kind == "labels" and image.ndim == 3 and image.shape == given.shape
        ]
        if given.kind != "grey" or not fits:
            shapes = ", ".join(f"{image.kind} of {image.shape}" for image in images)
            raise InputError(
                f"field {name} is {given.kind} of shape {given.shape}, the images are {shapes}: "
                "give a grey field of the shape of labels"
            )
        for k in fits:
            if isinstance(images[k], Slabs):
                raise InputError(
                    f"field {name}: the volume is too large to be read whole; show a --crop"
                )
            found[k][_text(name)] = np.nan_to_num(given.values)
    return found


def _lines(
    lines: Sequence[ArrayLike], image: Image | Slabs, volume: dict[str, Any]
) -> tuple[dict[str, Any], np.ndarray]:
    """Return the lines of a volume as the page holds them; the facts of the volume name them."""
    if image.kind != "labels" or image.ndim != 3:
        raise InputError(f"streamlines are of a volume of labels, the first image is {image.kind}")
    about, values = pack_lines(lines, image.shape, volume["block"])
    many, most = len(about["points"]), about["most"]
    volume["facts"].append(["Streamlines", f"{many}, coloured from rest to {most:.3g} of the mean"])
    return about, values


def _names(names: Sequence[str] | None, count: int) -> list[str]:
    if names is None:
        return [f"image {k}" for k in range(1, count + 1)]
    if len(names) != count:
        raise InputError(f"{count} images and {len(names)} names: give one for each")
    return [_text(name) for name in names]


def _text(name: str) -> str:
    """Return a name that can be written: that of a file may hold bytes that are no text."""
    return str(name).encode(errors="replace").decode()


def _scales(units: Sequence[str]) -> list[float] | None:
    """Return the lengths of each volume's unit in a shared one; None where they share none."""
    if len(set(units)) == 1:
        return [1.0] * len(units)
    return [to_metres(unit) for unit in units] if all(has_length(unit) for unit in units) else None


def _volume(
    image: Image | Slabs,
    name: str,
    scale: float,
    figures: list[list[str]],
    tints: Mapping[str, np.ndarray],
) -> tuple[dict[str, Any], str, list[str]]:
    """Return the facts of a volume for the page, its voxels and its fields."""
    fit, phases = fit_volume(image), _phases(image)
    values, notes = fit.values, _notes(image, fit)
    text = pack(values)
    if image.kind == "grey" and len(text) > max(4096, _FULL * values.size):
        values = values & 0xFC | 2
        text = pack(values)
        notes.append("shown in 64 greys, to keep the page small")
    edges = _spacing(image)[::-1] * np.array(fit.block[::-1])
    about = {
        "name": name,
        "shape": list(values.shape[:3]),
        "kind": image.kind,
        "edges": edges.tolist(),
        "unit": image.unit,
        "scale": scale,
        "coarse": max(fit.block),
        "block": list(fit.block),
        "fields": [],
        "field": 0 if tints else -1,
        "range": list(fit.range),
        "low": fit.ramp[0] if image.kind == "grey" else 0,
        "high": fit.ramp[1] if image.kind == "grey" else 0,
        "window": [0, 255],
        "phases": phases,
        "facts": _facts(image, phases),
        "figures": figures,
        "notes": notes,
    }
    packed = []
    if isinstance(image, Image):
        for tint, field in tints.items():
            drawn = np.isin(image.values, visible_phases(image, None))
            levels, limits = fit_field(field, drawn, fit.block)
            about["fields"].append({"name": tint, "limits": list(limits)})
            packed.append(pack(levels))
    return about, text, packed


def _spacing(image: Image | Slabs) -> np.ndarray:
    """Return the spacing (z, y, x); a picture is as thick as its pixels are wide."""
    return np.array(image.spacing if image.ndim == 3 else (image.spacing[-1], *image.spacing))


def _phases(image: Image | Slabs) -> list[dict[str, Any]]:
    """Return the phases, and which are drawn; of greys the dark and bright end, whose colours run
    into each other.
    """
    if image.kind != "labels":
        return [{"name": "dark", "visible": True}, {"name": "bright", "visible": True}]
    # A slice at a time: bincount widens what it counts to 8 bytes.
    planes = (
        (slab.values for slab in image.slabs(image.grain))
        if isinstance(image, Slabs)
        else image.values
    )
    counts = np.sum(
        [np.bincount(plane.ravel(), minlength=len(image.phases)) for plane in planes], axis=0
    )
    return [
        {
            "name": name,
            "visible": name != "void",
            "dark": name == "void",
            "share": f"{count / prod(image.shape):.1%}",
        }
        for name, count in zip(image.phases, counts, strict=True)
    ]


def _facts(image: Image | Slabs, phases: Sequence[dict[str, Any]]) -> list[list[str]]:
    unit = "voxels" if image.unit == "voxel" else image.unit
    sides = [f"{side * edge:.4g}" for side, edge in zip(image.shape, image.spacing, strict=True)]
    axes = "(z, y, x)" if image.ndim == 3 else "(y, x)"
    facts = [
        ["Kind", image.kind],
        ["Voxels", f"{' x '.join(map(str, image.shape))} {axes}"],
        ["Voxel", " x ".join(f"{edge:g}" for edge in image.spacing) + f" {image.unit}"],
        ["Size", " x ".join(sides) + f" {unit}"],
    ]
    if image.kind == "labels":
        shares = [f"{phase['name']} {phase['share']}" for phase in phases]
        facts.append(["Phases", ", ".join(shares)])
    made = next((step for step in reversed(image.recipe.steps) if "method" in step), None)
    if made is not None:
        seed = f", seed {made['seed']}" if "seed" in made else ""
        facts.append(["Made by", f"{made['method']}{seed}"])
    return facts


def _notes(image: Image | Slabs, fit: FittedVolume) -> list[str]:
    if prod(fit.block) == 1:
        return []
    block, shape = (" x ".join(map(str, sides)) for sides in (fit.block, fit.values.shape[:3]))
    if image.kind != "labels":
        return [
            f"too large for a tab: drawn is the mean of blocks of {block} voxels, {shape} in all; "
            "--crop keeps a box as it is"
        ]
    return [
        f"too large for a tab: drawn are blocks of {block} voxels, {shape} in all, where half of a "
        "block is material or a thin wall runs through it, which is then one block thick; shares "
        "and figures are of all voxels. Served by `trabecula view`, finer voxels come where you "
        "zoom in; --crop keeps a box as it is"
    ]


def key_figures(certificate: Any, count: int) -> list[list[list[str]]]:
    """Return rows of (name, value, band, verdict) for every one of `count` images.

    Raises
    ------
    InputError
        Not a certificate, or not as many as there are images (or one less: none for the first).
    """
    if certificate is None:
        return [[] for _ in range(count)]
    one = isinstance(certificate, Mapping) or not isinstance(certificate, Sequence)
    several = [certificate] if one else list(certificate)
    if len(several) == count - 1:
        several.insert(0, None)
    if len(several) != count:
        raise InputError(
            f"{len(several)} certificates for {count} images: give one for each, or for each but "
            "the first"
        )
    return [[] if each is None else _rows(each) for each in several]


def _rows(certificate: Any) -> list[list[str]]:
    plain = certificate.to_json() if hasattr(certificate, "to_json") else certificate
    metrics = plain.get("metrics") if isinstance(plain, Mapping) else None
    if not isinstance(metrics, Mapping) or not all(
        isinstance(metric, Mapping) for metric in metrics.values()
    ):
        raise InputError(
            "certificate: give what tb.verify returns, or what `trabecula verify --json` prints"
        )
    key = {one.name for one in DESCRIPTORS.values() if one.key}
    verdicts = {True: "pass", False: "fail", None: ""}
    return [
        [name, _number(one.get("value")), _band(one.get("real_band")), verdicts[one.get("pass")]]
        for name, one in metrics.items()
        if name in key or one.get("pass") is False
    ]


def _number(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return ", ".join(map(_number, value))
    return f"{value:.3g}" if isinstance(value, (int, float)) else "-"


def _band(band: Any) -> str:
    return " .. ".join(map(_number, band)) if isinstance(band, Sequence) and band else ""
