"""`print_check`: the faults of a part that a printer would refuse, or its operator warn of.

It checks the voxels. The surface that `export` gives is closed by construction; here the question
is whether the part can be printed. z is the direction of the layers; the first slice rests on the
plate, or on supports (sla). The faces of the image are faces of the part.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.engine.memory import Plan, check_budget
from trabecula.finish.labels import check_present
from trabecula.finish.print_layers import (
    check_bridges,
    check_cups,
    check_islands,
    check_overhangs,
)
from trabecula.finish.printers import Finding, Part, Printer, printer_of
from trabecula.finish.struts import thin_cores
from trabecula.io.units import to_metres
from trabecula.measure.distance import distance_transform
from trabecula.measure.labelling import label_components
from trabecula.measure.phases import indicator

_SPARE = 0.001
"""Share of the part, or of its pores, that may be too narrow: roughness of a scan."""

_MUCH = 0.01
"""Share of the part in thin struts above which it would come apart; share of the pores that may be
closed.
"""

_NEAR = 1.5
"""Widths of the passage within which a pore is cleared."""

_PER_VOXEL = 14
"""Bytes of the most expensive check, per voxel of the part with its margin."""

_SMALLER = "check a crop (--crop N), or a coarser level of a .zarr (--level 1)"

VERDICTS = ("pass", "warn", "refuse")


@dataclass(frozen=True)
class PrintCheck:
    """The result of a print check: the printer's limits, and a finding for each check."""

    printer: Printer
    findings: tuple[Finding, ...]

    @property
    def verdict(self) -> str:
        """Return the worst verdict of the findings."""
        return max((finding.verdict for finding in self.findings), key=VERDICTS.index)

    def to_json(self) -> dict[str, Any]:
        """Return plain values: `verdict`, `printer` (limits), `checks` (by name)."""
        checks = {
            finding.name: {"verdict": finding.verdict, **finding.figures, "says": finding.says}
            for finding in self.findings
        }
        limits = {name: value for name, value in asdict(self.printer).items() if value is not None}
        limits["box"] = list(self.printer.box)
        return {"verdict": self.verdict, "printer": limits, "checks": checks}

    def to_table(self) -> str:
        """Return a table as text: a line for each check, and the verdict."""
        width = max(len(finding.name) for finding in self.findings)
        lines = [
            f"{finding.name:{width}}  {finding.verdict:6}  {finding.says}"
            for finding in self.findings
        ]
        return "\n".join([*lines, "", f"{self.printer.process}: {self.verdict}"])


def print_check(
    image: Image | ArrayLike,
    *,
    printer: str = "sls",
    phase: str | int | None = None,
    memory: int | None = None,
    **limits: Any,
) -> PrintCheck:
    """Check the faults of a part that a printer of a process would refuse, or warn of.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X)
        In a unit of length. z is the direction of the layers, the first slice rests on the plate.
    printer : {"sls", "sla", "fdm", "slm"}
        Powder sintered by a laser, resin cured by light, molten filament, melted metal powder.
    phase : str or int, optional
        The phase to print. Default: "solid", which is every phase but "void" taken together.
    memory : int, optional
        Bytes that may be used. Default: what is available.
    **limits
        Limits of the printer other than the typical ones (`trabecula.finish.printers.PRINTERS`), in
        millimetres: box, wall, gap, layer; passage (sls, sla, slm), cup (sla, mm**3), overhang
        (degrees) and bridge (fdm, slm); density (g/cm**3), pause (s a layer) and speed (fdm, slm,
        mm**3/s).

    Returns
    -------
    PrintCheck
        `verdict` ("pass", "warn" or "refuse"), `findings`, `to_json()`, `to_table()`. The checks of
        every part: size, surface (voxels that touch along an edge or at a corner only), pieces
        (connected components), walls (struts thinner than `wall`), gaps (pores narrower than
        `gap`); of powder and resin: trapped (closed pores), passage (pores that a ball of that
        width cannot come near); of resin: cups; of resin and filament: islands (layers that start
        in the air); of filament: overhangs (share of the surface facing down that leans more than
        `overhang` from the vertical), bridges. The last one, estimate, tells mass and time.

    Raises
    ------
    InputError
        Not 3-D, no unit of length, an empty phase, a limit out of range.
    UnknownNameError
        No such printer, limit or phase.
    MemoryBudgetError
        The arrays of the checks do not fit into memory.

    Examples
    --------
    >>> import trabecula as tb
    >>> cube = np.zeros((8, 8, 8), np.uint8); cube[:, 1:7, 1:7] = 1; cube[3:5, 3:5, 3:5] = 0
    >>> found = print_check(tb.Image(cube, "labels", spacing=0.5, unit="mm"), printer="sls")
    >>> found.verdict, [finding.name for finding in found.findings if finding.verdict == "refuse"]
    ('refuse', ['trapped'])
    """
    machine = printer_of(printer, limits)
    image, solid = indicator(image, phase)
    if image.ndim != 3:
        raise InputError(
            f"a print needs a volume, the image has shape {image.shape}: give 3 axes (z, y, x)"
        )
    check_present(bool(solid.any()), phase, "to print")
    factor = 1000 * _metres(image.unit)
    solid = np.ascontiguousarray(solid[_bounding_box(solid)])
    room = int(np.prod([side * 3 / 2 + 8 for side in solid.shape]))
    check_budget(
        Plan({"distances and components": _PER_VOXEL * room}), budget=memory, advice=_SMALLER
    )
    part = Part(solid, np.pad(solid, 1), tuple(edge * factor for edge in image.spacing))
    findings = [
        check_size(part, machine),
        check_surface(part),
        check_components(part, machine),
        check_walls(part, machine),
        check_gaps(part, machine),
    ]
    if machine.passage is not None:
        findings += [check_trapped(part), check_passage(part, machine.passage)]
    if machine.cup is not None:
        findings.append(check_cups(part, machine.cup))
    if machine.process in ("sla", "fdm", "slm"):
        findings.append(check_islands(part, machine))
    if machine.overhang is not None:
        findings.append(check_overhangs(part, machine.overhang))
    if machine.bridge is not None:
        findings.append(check_bridges(part, machine.bridge))
    findings.append(estimate(part, machine))
    return PrintCheck(machine, tuple(findings))


def estimate(part: Part, printer: Printer) -> Finding:
    """Estimate the mass of a part, and the time of its print, without supports."""
    volume = float(np.count_nonzero(part.solid) * part.voxel)
    mass = volume * printer.density / 1000
    layers = math.ceil(part.solid.shape[0] * part.spacing[0] / printer.layer - 1e-6)
    seconds = layers * printer.pause + (volume / printer.speed if printer.speed else 0.0)
    figures = {"volume": volume, "mass": mass, "layers": layers, "hours": seconds / 3600}
    says = (
        f"{mass:.3g} g at {printer.density:g} g/cm3, {layers} layers of {printer.layer:g} mm, "
        f"about {_hours(seconds)} on a typical machine"
    )
    return Finding("estimate", "pass", figures, says)


def _hours(seconds: float) -> str:
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02d} min"


def check_size(part: Part, printer: Printer) -> Finding:
    """Check that the part fits into the printer."""
    sides = [
        float(f"{side * edge:.6g}")
        for side, edge in zip(part.solid.shape, part.spacing, strict=True)
    ]
    # The part may be turned about the vertical.
    fits = sides[0] <= printer.box[0] and all(
        a <= b for a, b in zip(sorted(sides[1:]), sorted(printer.box[1:]), strict=True)
    )
    text = " x ".join(f"{side:.4g}" for side in sides)
    room = " x ".join(f"{side:g}" for side in printer.box)
    says = (
        f"{text} mm (z, y, x)"
        if fits
        else f"{text} mm (z, y, x) do not fit into {room}: scale it, or print a part"
    )
    return Finding(
        "size", "pass" if fits else "refuse", {"extent": sides, "box": list(printer.box)}, says
    )


def check_surface(part: Part) -> Finding:
    """Check that no voxels touch along an edge or at a corner only."""
    edges, corners = _contacts(part.room)
    says = "every part holds by faces"
    if edges or corners:
        says = (
            f"voxels touch along {edges} edges and at {corners} corners without a common face: "
            "smooth, or thicken"
        )
    verdict = "warn" if edges or corners else "pass"
    return Finding("surface", verdict, {"edges": edges, "corners": corners}, says)


def _contacts(room: np.ndarray) -> tuple[int, int]:
    """Count the edges and the corners at which voxels touch without a common face.

    An edge counts where just two voxels that are opposite across it are solid; a corner where just
    two of the eight around it are, at the ends of a diagonal.
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


def check_components(part: Part, printer: Printer) -> Finding:
    """Check that the part is one connected component."""
    _, sizes = label_components(part.solid)
    loose = np.delete(sizes, np.argmax(sizes))
    figures = {"pieces": len(sizes), "loose_volume": float(loose.sum() * part.voxel)}
    if not len(loose):
        return Finding("pieces", "pass", figures, "one piece")
    says = (
        f"{len(loose)} loose pieces, {figures['loose_volume']:.3g} mm3: join or remove them "
        "(finish --connect)"
    )
    return Finding("pieces", "warn" if printer.process == "sls" else "refuse", figures, says)


def check_walls(part: Part, printer: Printer) -> Finding:
    """Check that struts and walls are thick enough."""
    limit = printer.wall
    cores = thin_cores(part.room, part.spacing, limit)
    thinnest = round(cores.thinnest, 6) if len(cores.places) else None
    figures = {"thin_share": round(cores.share, 6), "thinnest": thinnest, "wall": limit}
    if cores.share > _SPARE:
        says = (
            f"{cores.share:.1%} of it is thinner than {limit:g} mm, down to "
            f"{cores.thinnest:.2g}: thicken, or scale up"
        )
        return Finding("walls", "refuse" if cores.share > _MUCH else "warn", figures, says)
    if _is_too_coarse(part.room, part.spacing, limit):
        return Finding("walls", "warn", figures, _coarse_text(part, limit))
    return Finding("walls", "pass", figures, f"nothing to speak of is thinner than {limit:g} mm")


def check_gaps(part: Part, printer: Printer) -> Finding:
    """Check that pores are wide enough to stay open."""
    void, limit = ~part.solid, printer.gap
    if not void.any():
        empty = {"narrow_share": 0.0, "narrowest": None, "gap": limit}
        return Finding("gaps", "pass", empty, "no pores")
    cores = thin_cores(void, part.spacing, limit)
    narrowest = round(cores.thinnest, 6) if len(cores.places) else None
    figures = {"narrow_share": round(cores.share, 6), "narrowest": narrowest, "gap": limit}
    if cores.share > _SPARE:
        says = (
            f"{cores.share:.1%} of the pores is narrower than {limit:g} mm and may close: "
            "scale it up"
        )
        return Finding("gaps", "warn", figures, says)
    if _is_too_coarse(void, part.spacing, limit):
        return Finding("gaps", "warn", figures, _coarse_text(part, limit))
    return Finding("gaps", "pass", figures, f"no pore to speak of is narrower than {limit:g} mm")


def _is_too_coarse(inside: np.ndarray, spacing: tuple[float, ...], limit: float) -> bool:
    """Return whether the voxels are too coarse for the limit, and something has about that width.

    One voxel is below the limit then and two are above: the error of a thickness, half a voxel,
    would decide.
    """
    edge = min(spacing)
    return edge < limit < 2 * edge and thin_cores(inside, spacing, limit + edge).share > _SPARE


def _coarse_text(part: Part, limit: float) -> str:
    return (
        f"voxels of {min(part.spacing):.2g} mm are too coarse to tell {limit:g} mm: check a finer "
        "image of the part"
    )


def check_trapped(part: Part) -> Finding:
    """Check that every pore is open to the outside."""
    labels, sizes = label_components(~part.room)
    closed = np.delete(sizes, labels[0, 0, 0] - 1)
    figures = {"pores": len(closed), "volume": float(closed.sum() * part.voxel)}
    if not len(closed):
        return Finding("trapped", "pass", figures, "every pore has a way out")
    says = (
        f"{len(closed)} pores without a way out hold {figures['volume']:.3g} mm3: fill them "
        "(finish --fill), or drill"
    )
    much = closed.sum() > _MUCH * np.count_nonzero(~part.solid)
    return Finding("trapped", "refuse" if much else "warn", figures, says)


def check_passage(part: Part, passage: float) -> Finding:
    """Check that every pore can be cleared.

    A ball as wide as the passage, coming from outside, has to come near: within `_NEAR` times its
    width.
    """
    figures = {"far_share": 0.0, "passage": passage}
    passed = Finding("passage", "pass", figures, f"ways of {passage:g} mm lead near every pore")
    # The first plane outside in which the ball fits; then it fits everywhere in it.
    away = [int(np.ceil((passage + min(part.spacing)) / 2 / edge)) for edge in part.spacing]
    deepest = [
        edge * (first + (side - 1) // 2)
        for edge, first, side in zip(part.spacing, away, part.solid.shape, strict=True)
    ]
    if min(deepest) <= _NEAR * passage:
        # From outside the ball comes near to everything: the part is hardly wider than the ball.
        return passed
    # Now its sides are longer than twice the passage, and the margin is at most a quarter of them.
    margin = [(first + 1,) * 2 for first in away]
    void = np.pad(~part.solid, margin, constant_values=True)
    # Half a voxel less: the wall is the voxel's face, not its centre.
    half, least = min(part.spacing) / 2, passage / 2 * (1 - 1e-6)
    wide = distance_transform(void, spacing=part.spacing) - half >= least
    labels, _ = label_components(wide)
    paths = labels == labels[0, 0, 0]
    inner = tuple(slice(a, -a) for a, _ in margin)
    open_pores = label_components(void)[0]
    far = (distance_transform(~paths, spacing=part.spacing) > _NEAR * passage) & (
        open_pores == open_pores[0, 0, 0]
    )
    share = np.count_nonzero(far[inner]) / max(1, np.count_nonzero(~part.solid))
    figures["far_share"] = round(float(share), 6)
    if share <= _SPARE:
        return passed
    says = (
        f"{share:.1%} of the pores lies off every way of {passage:g} mm: hard to clear; scale it "
        "up, or blow it out well"
    )
    return Finding("passage", "warn", figures, says)


def _bounding_box(solid: np.ndarray) -> tuple[slice, ...]:
    """Return the smallest box that contains a part."""
    found = []
    for axis in range(solid.ndim):
        used = np.flatnonzero(
            solid.any(axis=tuple(other for other in range(solid.ndim) if other != axis))
        )
        found.append(slice(int(used[0]), int(used[-1]) + 1))
    return tuple(found)


def _metres(unit: str) -> float:
    """Return the metres of a unit of length."""
    try:
        return to_metres(unit)
    except InputError:
        raise InputError(
            f"the image's unit is {unit!r}, which is no length, so it cannot be compared with a "
            "printer's millimetres: give its spacing and unit (--spacing 19.5 --unit um)"
        ) from None
