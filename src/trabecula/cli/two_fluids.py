"""`measure --drainage`: the curves of two fluids in a phase, in place of the descriptors."""

from __future__ import annotations

import argparse
import math
from typing import Any

from trabecula.cli import options as shared
from trabecula.cli import terminal
from trabecula.core.errors import InputError

_ROWS = 12


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of drainage and imbibition."""
    group = parser.add_argument_group("two fluids in the pores")
    group.add_argument(
        "--drainage",
        nargs="?",
        const="z",
        metavar="AXIS",
        help="drainage and imbibition in place of the descriptors: saturation by radius, and the "
        "radius at which the non-wetting fluid breaks through along z (default), y or x; all: it "
        "enters from all faces, as mercury does",
    )
    group.add_argument(
        "--trapping",
        action="store_true",
        help="with --drainage: fluid that loses its way out stays",
    )
    group.add_argument(
        "--surface-tension",
        metavar="N",
        help="with --drainage: N/m, gives capillary pressures in Pa (mercury .48, water .072)",
    )
    group.add_argument(
        "--relative-permeability",
        nargs="*",
        metavar="S",
        help="with --drainage z, y or x: solve the flow of each fluid at these saturations of the "
        "non-wetting one (no number: .2 .4 .6 .8); minutes from 100 voxels a side on",
    )
    group.add_argument(
        "--contact-angle",
        metavar="DEGREES",
        help="with --surface-tension (default 0; mercury 140)",
    )


def check(options: argparse.Namespace) -> None:
    """Raise where options do not go together."""
    if options.drainage is None:
        if (
            options.trapping
            or options.surface_tension
            or options.contact_angle
            or options.relative_permeability is not None
        ):
            raise InputError(
                "--trapping, --surface-tension, --contact-angle and --relative-permeability are of "
                "two fluids: give --drainage as well"
            )
        return
    if options.drainage not in ("z", "y", "x", "all"):
        raise InputError(
            f"--drainage {options.drainage}: give z, y, x or all (a file comes before --drainage)"
        )
    if options.drainage == "all" and options.trapping:
        raise InputError("--drainage all leaves no face to flow out of: leave out --trapping")
    if options.drainage == "all" and options.relative_permeability is not None:
        raise InputError(
            "--drainage all has no way to flow along: give an axis for --relative-permeability"
        )
    if options.contact_angle and not options.surface_tension:
        raise InputError("--contact-angle needs a tension: give --surface-tension as well")
    if options.level != "default" or options.confidence is not None or options.phase == "all":
        raise InputError(
            "--drainage is of one phase alone (default: void): leave out --quick, --full, "
            "--confidence and --phase all"
        )


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Return the curves as JSON prints them."""
    from trabecula.measure import drainage, imbibition, relative_permeability
    from trabecula.measure.relative_permeability import SATURATIONS

    image = shared.load_exemplar(options.file, options)
    inlet: Any = "all"
    axis = -1
    if options.drainage != "all":
        axis = "zyx"[-image.ndim :].find(options.drainage)
        if axis < 0:
            raise InputError(f"--drainage {options.drainage}: a picture has the axes y and x")
        inlet = (axis, 0)
    given: dict[str, Any] = {"inlet": inlet, "phase": options.phase, "trapping": options.trapping}
    if options.surface_tension:
        given["surface_tension"] = shared.number(options.surface_tension, name="--surface-tension")
    if options.contact_angle:
        given["contact_angle"] = shared.number(options.contact_angle, name="--contact-angle")
    out, back = drainage(image, **given), imbibition(image, **given)
    found = {
        "shape": list(image.shape),
        "spacing": list(image.spacing),
        "unit": image.unit,
        "inlet": options.drainage,
        "entry_radius": out.entry_radius,
        "drainage": _to_json(out),
        "imbibition": _to_json(back),
    }
    if options.relative_permeability is not None:
        words = options.relative_permeability or SATURATIONS
        wanted = [shared.number(str(word), name="--relative-permeability") for word in words]
        found["relative_permeability"] = {
            process: relative_permeability(
                image,
                axis=axis,
                phase=options.phase,
                saturations=wanted,
                process=process,
                trapping=options.trapping,
            ).to_json()
            for process in ("drainage", "imbibition")
        }
    return found


def _to_json(found: Any) -> dict[str, Any]:
    """Return a curve; the infinite radius at its end is None."""
    return {
        "radii": [one if math.isfinite(one) else None for one in found.radii.tolist()],
        "saturation": found.saturation.tolist(),
        "pressure": None if found.pressure is None else found.pressure.tolist(),
        "trapped": found.trapped,
    }


def show(found: dict[str, Any]) -> None:
    """Print the figures, and a few rows of each curve."""
    curves = ("drainage", "imbibition")
    apart = (*curves, "relative_permeability")
    terminal.show_mapping({name: value for name, value in found.items() if name not in apart})
    for name in curves:
        curve = found[name]
        print()
        print(f"{name}: trapped {terminal.brief(curve['trapped'])} of the phase")
        last = len(curve["radii"]) - 1
        kept = sorted({round(k * last / (_ROWS - 1)) for k in range(_ROWS)}) if last >= 0 else []
        pressures = curve["pressure"]
        head = ("radius", "saturation") + (("pressure, Pa",) if pressures else ())
        rows: list[tuple[str, ...]] = [head]
        for at in kept:
            radius = curve["radii"][at]
            cells = ["end" if radius is None else radius, curve["saturation"][at]]
            if pressures:
                cells.append(pressures[at])
            rows.append(tuple(map(terminal.brief, cells)))
        terminal.show_rows(rows)
    for name, flow in found.get("relative_permeability", {}).items():
        print()
        print(f"relative permeability, {name}: of {terminal.brief(flow['permeability'])}")
        rows = [("radius", "saturation", "non-wetting", "wetting", "")]
        columns = (flow["radii"], flow["saturation"], flow["nonwetting"], flow["wetting"])
        for *cells, sure in zip(*columns, flow["converged"], strict=True):
            rows.append((*map(terminal.brief, cells), "" if sure else "not converged"))
        terminal.show_rows(rows)
