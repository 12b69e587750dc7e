"""The questions that a print check asks of a part; each gives a `Finding`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from trabecula.finish import print_layers
from trabecula.finish.printers import Printer
from trabecula.finish.struts import thin_cores
from trabecula.measure.distance import distance_transform
from trabecula.measure.labelling import label_components

_SPARE = 0.001
"""Share of the part, or of its pores, that may be too narrow without a word: roughness of a scan.
"""

_MUCH = 0.01
"""Share of the part in struts that are too thin above which it would come apart, and of the pores
without a way out.
"""

_NEAR = 1.5
"""Widths of the passage within which a pore is cleared."""

_LEANING = 0.05
"""Share of the surface that faces down above which supports are worth a warning."""


@dataclass(frozen=True)
class Finding:
    """One question to a part.

    Parameters
    ----------
    name : str
    verdict : {"pass", "warn", "refuse"}
    figures : dict
        Plain values; lengths in millimetres.
    says : str
        What that means, and what to do where it is no pass.
    """

    name: str
    verdict: str
    figures: dict[str, Any]
    says: str


@dataclass(frozen=True)
class Part:
    """The part in millimetres. `room` is the part with a margin of void, as a printer sees it:
    alone.
    """

    solid: np.ndarray
    room: np.ndarray
    spacing: tuple[float, ...]

    @property
    def voxel(self) -> float:
        """Volume of a voxel, mm**3."""
        return float(np.prod(self.spacing))


def size(part: Part, machine: Printer) -> Finding:
    """Does it fit into the printer?"""
    sides = [
        float(f"{side * edge:.6g}")
        for side, edge in zip(part.solid.shape, part.spacing, strict=True)
    ]
    # The part may be turned about the vertical.
    fits = sides[0] <= machine.box[0] and all(
        a <= b for a, b in zip(sorted(sides[1:]), sorted(machine.box[1:]), strict=True)
    )
    text = " x ".join(f"{side:.4g}" for side in sides)
    room = " x ".join(f"{side:g}" for side in machine.box)
    says = (
        f"{text} mm (z, y, x)"
        if fits
        else f"{text} mm (z, y, x) do not fit into {room}: scale it, or print a part"
    )
    return Finding(
        "size", "pass" if fits else "refuse", {"extent": sides, "box": list(machine.box)}, says
    )


def surface(part: Part) -> Finding:
    """Does it hold by faces, or do voxels touch in an edge or a corner only?"""
    edges, corners = _contacts(part.room)
    says = "every part holds by faces"
    if edges or corners:
        says = f"voxels touch along {edges} edges and at {corners} corners without a common face: smooth, or thicken"
    return Finding(
        "surface",
        "warn" if edges or corners else "pass",
        {"edges": edges, "corners": corners},
        says,
    )


def _contacts(room: np.ndarray) -> tuple[int, int]:
    """Edges at which two voxels meet that share no face with a third there, and corners at which
    two meet alone.
    """
    edges = corners = 0
    for axis in range(3):
        lines = np.moveaxis(room, axis, 0)
        a, b, c, d = lines[:, :-1, :-1], lines[:, :-1, 1:], lines[:, 1:, :-1], lines[:, 1:, 1:]
        edges += int(np.count_nonzero((a & d & ~b & ~c) | (b & c & ~a & ~d)))
    eight = [
        room[z : z - 1 or None, y : y - 1 or None, x : x - 1 or None]
        for z in (0, 1)
        for y in (0, 1)
        for x in (0, 1)
    ]
    code = np.zeros(eight[0].shape, np.uint8)
    for bit, octant in enumerate(eight):
        code |= octant.view(np.uint8) << np.uint8(bit)
    counts = np.bincount(code.ravel(), minlength=256)
    corners = int(sum(counts[1 << bit | 1 << (7 - bit)] for bit in range(4)))
    return edges, corners


def pieces(part: Part, machine: Printer) -> Finding:
    """Is it one piece?"""
    _, sizes = label_components(part.solid)
    loose = np.delete(sizes, np.argmax(sizes))
    figures = {"pieces": len(sizes), "loose_volume": float(loose.sum() * part.voxel)}
    if not len(loose):
        return Finding("pieces", "pass", figures, "one piece")
    says = f"{len(loose)} loose pieces, {figures['loose_volume']:.3g} mm3: join or remove them (finish --connect)"
    return Finding("pieces", "warn" if machine.process == "sls" else "refuse", figures, says)


def walls(part: Part, machine: Printer) -> Finding:
    """Are struts and walls thick enough?"""
    cores = thin_cores(part.room, part.spacing, machine.wall)
    thinnest = round(cores.thinnest, 6) if len(cores.places) else None
    figures = {"thin_share": round(cores.share, 6), "thinnest": thinnest, "wall": machine.wall}
    if cores.share > _SPARE:
        says = f"{cores.share:.1%} of it is thinner than {machine.wall:g} mm, down to {cores.thinnest:.2g}: thicken, or scale up"
        return Finding("walls", "refuse" if cores.share > _MUCH else "warn", figures, says)
    if _cannot_tell(part.room, part.spacing, machine.wall):
        return Finding("walls", "warn", figures, _too_coarse(part, machine.wall))
    return Finding(
        "walls", "pass", figures, f"nothing to speak of is thinner than {machine.wall:g} mm"
    )


def gaps(part: Part, machine: Printer) -> Finding:
    """Are pores wide enough to stay open?"""
    void = ~part.solid
    if not void.any():
        return Finding(
            "gaps", "pass", {"narrow_share": 0.0, "narrowest": None, "gap": machine.gap}, "no pores"
        )
    cores = thin_cores(void, part.spacing, machine.gap)
    narrowest = round(cores.thinnest, 6) if len(cores.places) else None
    figures = {"narrow_share": round(cores.share, 6), "narrowest": narrowest, "gap": machine.gap}
    if cores.share > _SPARE:
        says = f"{cores.share:.1%} of the pores is narrower than {machine.gap:g} mm and may close: scale it up"
        return Finding("gaps", "warn", figures, says)
    if _cannot_tell(void, part.spacing, machine.gap):
        return Finding("gaps", "warn", figures, _too_coarse(part, machine.gap))
    return Finding(
        "gaps", "pass", figures, f"no pore to speak of is narrower than {machine.gap:g} mm"
    )


def _cannot_tell(inside: np.ndarray, spacing: tuple[float, ...], limit: float) -> bool:
    """Whether one voxel is narrower than the limit, two are wider, and something has about that
    width: there the half voxel by which a thickness is uncertain decides."""
    edge = min(spacing)
    return edge < limit < 2 * edge and thin_cores(inside, spacing, limit + edge).share > _SPARE


def _too_coarse(part: Part, limit: float) -> str:
    return f"voxels of {min(part.spacing):.2g} mm are too coarse to tell {limit:g} mm: check a finer image of the part"


def trapped(part: Part) -> Finding:
    """Has every pore a way out?"""
    labels, sizes = label_components(~part.room)
    closed = np.delete(sizes, labels[0, 0, 0] - 1)
    figures = {"pores": len(closed), "volume": float(closed.sum() * part.voxel)}
    if not len(closed):
        return Finding("trapped", "pass", figures, "every pore has a way out")
    says = f"{len(closed)} pores without a way out hold {figures['volume']:.3g} mm3: fill them (finish --fill), or drill"
    much = closed.sum() > _MUCH * np.count_nonzero(~part.solid)
    return Finding("trapped", "refuse" if much else "warn", figures, says)


def passage(part: Part, passage: float) -> Finding:
    """Can every pore be cleared? Not where a ball as wide as the passage, coming from outside,
    stays away from it by more than its width."""
    figures = {"far_share": 0.0, "passage": passage}
    way = Finding("passage", "pass", figures, f"ways of {passage:g} mm lead near every pore")
    # The first plane outside at which the ball has room, and with it all of the plane, since it is
    # free.
    away = [int(np.ceil((passage + min(part.spacing)) / 2 / edge)) for edge in part.spacing]
    deepest = [
        edge * (first + (side - 1) // 2)
        for edge, first, side in zip(part.spacing, away, part.solid.shape, strict=True)
    ]
    if min(deepest) <= _NEAR * passage:
        # from outside the ball comes near to everything: the part is hardly wider than the ball
        return way
    # Else its sides are longer than twice the passage, and the margin is no more than a quarter of
    # them.
    margin = [(first + 1,) * 2 for first in away]
    void = np.pad(~part.solid, margin, constant_values=True)
    # Half a voxel: the wall is the voxel's face, not its centre.
    wide = distance_transform(void, spacing=part.spacing) - min(part.spacing) / 2 >= passage / 2 * (
        1 - 1e-6
    )
    labels, _ = label_components(wide)
    ways = labels == labels[0, 0, 0]
    inner = tuple(slice(a, -a) for a, _ in margin)
    open_pores = label_components(void)[0]
    far = (distance_transform(~ways, spacing=part.spacing) > _NEAR * passage) & (
        open_pores == open_pores[0, 0, 0]
    )
    share = np.count_nonzero(far[inner]) / max(1, np.count_nonzero(~part.solid))
    figures["far_share"] = round(float(share), 6)
    if share <= _SPARE:
        return way
    says = f"{share:.1%} of the pores lies off every way of {passage:g} mm: hard to clear; scale it up, or blow it out well"
    return Finding("passage", "warn", figures, says)


def cups(part: Part, limit: float) -> Finding:
    """Is resin sealed off while it is printed?"""
    volume = print_layers.sealed(part.solid) * part.voxel
    figures = {"volume": float(volume), "cup": limit}
    if volume <= limit:
        return Finding("cups", "pass", figures, f"the largest cup holds {volume:.3g} mm3")
    says = f"a cup of {volume:.3g} mm3 seals resin off while it is printed: turn the part, or give the cup a drain"
    return Finding("cups", "warn", figures, says)


def islands(part: Part, machine: Printer) -> Finding:
    """Does anything start in the air?"""
    count, places = print_layers.islands(part.solid)
    figures = {"islands": count, "volume": float(np.count_nonzero(places) * part.voxel)}
    if not count:
        return Finding("islands", "pass", figures, "every layer lies on the one before")
    says = f"{count} places start in the air: print with supports (soluble ones inside of pores), or turn the part"
    return Finding("islands", "refuse" if machine.process == "fdm" else "warn", figures, says)


def overhangs(part: Part, angle: float) -> Finding:
    """How much of the surface leans too far to carry itself?"""
    down, leaning = print_layers.overhang(part.solid, part.spacing, angle)
    share = leaning / down if down else 0.0
    figures = {"share": round(share, 6), "area": leaning, "overhang": angle}
    says = f"{share:.1%} of the surface facing down leans more than {angle:g} degrees"
    if share <= _LEANING:
        return Finding("overhangs", "pass", figures, says)
    return Finding("overhangs", "warn", figures, f"{says}: it needs supports, or sags")


def bridges(part: Part, limit: float) -> Finding:
    """Does anything span too far? Held at both ends, its middle lies half of the span away from
    what holds it.
    """
    span = 2 * print_layers.reach(part.solid, part.spacing)
    figures = {"span": float(span), "bridge": limit}
    if span <= limit:
        return Finding("bridges", "pass", figures, f"the longest span is {span:.3g} mm")
    return Finding(
        "bridges",
        "warn",
        figures,
        f"a span of {span:.3g} mm is longer than {limit:g}: it needs supports",
    )
