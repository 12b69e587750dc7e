"""`print_check`: what a printer would refuse, and what its operator would warn of.

It looks at the voxels. The surface that `export` makes of them is closed by construction, whatever
they are; what is asked here is whether the thing can be made. z is the direction of the layers; the
first slice lies on the plate, or on supports (sla). The faces of the image are faces of the part.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from trabecula.core.errors import InputError
from trabecula.core.image import Image
from trabecula.engine.memory import Plan, check_budget
from trabecula.finish import print_checks
from trabecula.finish.print_checks import Finding
from trabecula.finish.printers import Printer, printer_of
from trabecula.io.units import to_metres
from trabecula.measure.phases import indicator

_PER_VOXEL = 14
"""Bytes of the question that needs most, a voxel of the part with its margin."""

_SMALLER = "check a crop (--crop N), or a coarser level of a .zarr (--level 1)"

VERDICTS = ("pass", "warn", "refuse")


@dataclass(frozen=True)
class PrintCheck:
    """What a check of a part found: the printer's limits, and a finding for each question."""

    printer: Printer
    findings: tuple[Finding, ...]

    @property
    def verdict(self) -> str:
        """The worst of the findings."""
        return max((finding.verdict for finding in self.findings), key=VERDICTS.index)

    def to_json(self) -> dict[str, Any]:
        """Plain values: `verdict`, `printer` (limits), `checks` (name -> verdict, figures and
        words).
        """
        checks = {
            finding.name: {"verdict": finding.verdict, **finding.figures, "says": finding.says}
            for finding in self.findings
        }
        limits = {name: value for name, value in asdict(self.printer).items() if value is not None}
        limits["box"] = list(self.printer.box)
        return {"verdict": self.verdict, "printer": limits, "checks": checks}

    def to_table(self) -> str:
        """A line for each question, and the verdict."""
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
    """What a printer of a process would refuse about a part, or warn of.

    Parameters
    ----------
    image : Image or array of labels, (Z, Y, X)
        In a unit of length. z is the direction of the layers, the first slice lies on the plate.
    printer : {"sls", "sla", "fdm"}
        Powder sintered by a laser, resin cured by light, molten filament.
    phase : str or int, optional
        What is printed. Default: "solid", which is every phase but "void" taken together.
    memory : int, optional
        Bytes that may be used. Default: what is available.
    **limits
        Limits of the printer other than the typical ones (`trabecula.finish.printers.PRINTERS`), in
        millimetres: box, wall, gap; passage (sls, sla), cup (sla, mm**3), overhang (degrees) and
        bridge (fdm).

    Returns
    -------
    PrintCheck
        `verdict` ("pass", "warn" or "refuse"), `findings`, `to_json()`, `to_table()`. Asked is of
        every part: size, surface (places where voxels meet in an edge or a corner only), pieces,
        walls (struts thinner than `wall`), gaps (pores narrower than `gap`); of powder and resin:
        trapped (pores without a way out), passage (pores that a ball of that width cannot come
        near); of resin: cups; of resin and filament: islands (what starts in the air); of filament:
        overhangs (share of the surface facing down that leans more than `overhang` from the
        vertical), bridges.

    Raises
    ------
    InputError
        Not 3-D, no unit of length, an empty phase, a limit out of range.
    UnknownNameError
        No such printer, limit or phase.
    MemoryBudgetError
        The part does not fit into memory with what is asked of it.

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
    if not solid.any():
        raise InputError(
            f"the image holds nothing of phase {'solid' if phase is None else phase!r}: nothing to print"
        )
    factor = 1000 * _metres(image.unit)
    solid = np.ascontiguousarray(solid[_box(solid)])
    room = int(np.prod([side * 3 / 2 + 8 for side in solid.shape]))
    check_budget(
        Plan({"distances and components": _PER_VOXEL * room}), budget=memory, advice=_SMALLER
    )
    part = print_checks.Part(
        solid, np.pad(solid, 1), tuple(edge * factor for edge in image.spacing)
    )
    findings = [
        print_checks.size(part, machine),
        print_checks.surface(part),
        print_checks.pieces(part, machine),
        print_checks.walls(part, machine),
        print_checks.gaps(part, machine),
    ]
    if machine.passage is not None:
        findings += [print_checks.trapped(part), print_checks.passage(part, machine.passage)]
    if machine.cup is not None:
        findings.append(print_checks.cups(part, machine.cup))
    if machine.process in ("sla", "fdm"):
        findings.append(print_checks.islands(part, machine))
    if machine.overhang is not None:
        findings.append(print_checks.overhangs(part, machine.overhang))
    if machine.bridge is not None:
        findings.append(print_checks.bridges(part, machine.bridge))
    return PrintCheck(machine, tuple(findings))


def _box(solid: np.ndarray) -> tuple[slice, ...]:
    """The smallest box that holds all of a part."""
    found = []
    for axis in range(solid.ndim):
        used = np.flatnonzero(
            solid.any(axis=tuple(other for other in range(solid.ndim) if other != axis))
        )
        found.append(slice(int(used[0]), int(used[-1]) + 1))
    return tuple(found)


def _metres(unit: str) -> float:
    try:
        return to_metres(unit)
    except InputError:
        raise InputError(
            f"the image's unit is {unit!r}, which is no length, so it cannot be held against a printer's millimetres: give "
            "its spacing and unit (--spacing 19.5 --unit um)"
        ) from None
