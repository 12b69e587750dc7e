"""`measure --bone` and `measure --coating`: reports of bone and of porous coatings, in place of the
descriptors.
"""

from __future__ import annotations

import argparse
from typing import Any

from trabecula.cli import options as shared
from trabecula.cli import terminal
from trabecula.core.errors import InputError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of both reports."""
    group = parser.add_argument_group("bone and coatings")
    either = group.add_mutually_exclusive_group()
    either.add_argument(
        "--bone",
        action="store_true",
        help="every figure of a micro-CT report of bone in place of the descriptors (Bouxsein et "
        "al. 2010), plates and rods",
    )
    either.add_argument(
        "--coating",
        nargs="?",
        const="z",
        metavar="AXIS",
        help="a porous coating in place of the descriptors: thickness, void and intercepts in "
        "sections (the figures of ASTM F1854-25), and the window of 21 CFR 888.3358; across AXIS z "
        "(default), y or x; ends with a minus where the substrate is at the last layer, as in z-",
    )


def is_asked(options: argparse.Namespace) -> bool:
    """Return whether one of the reports is requested; raise where options do not go together."""
    if not options.bone and options.coating is None:
        return False
    name = "--bone" if options.bone else "--coating"
    if (
        options.level != "default"
        or options.confidence is not None
        or options.phase == "all"
        or options.drainage is not None
    ):
        raise InputError(
            f"{name} is a report by itself, of one phase: leave out --quick, --full, --confidence, "
            "--drainage and --phase all"
        )
    if options.coating is not None and options.coating not in ("z", "y", "x", "z-", "y-", "x-"):
        raise InputError(
            f"--coating {options.coating}: give z, y or x, or z-, y-, x- (a file comes before "
            "--coating)"
        )
    return True


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Return a report as JSON prints it."""
    image = shared.load_exemplar(options.file, options)
    about = {"shape": list(image.shape), "spacing": list(image.spacing), "unit": image.unit}
    if options.bone:
        from trabecula.measure import bone_figures

        return {**about, "bone": bone_figures(image, phase=options.phase)}
    from trabecula.measure import coating

    axis = "zyx"[-image.ndim :].find(options.coating[0])
    if axis < 0:
        raise InputError(f"--coating {options.coating}: a picture has the axes y and x")
    side = -1 if options.coating.endswith("-") else 0
    found = coating(image, axis=axis, side=side, phase=options.phase)
    return {**about, "coating": found.to_json()}


def show(found: dict[str, Any]) -> None:
    """Print a report."""
    apart = ("bone", "coating")
    terminal.show_mapping({name: value for name, value in found.items() if name not in apart})
    print()
    if "bone" in found:
        from trabecula.measure.bone import BONE_POWERS

        unit = found["unit"]
        rows = [
            (name, terminal.brief(value), _unit(unit, BONE_POWERS[name]))
            for name, value in found["bone"].items()
        ]
        terminal.show_rows([("figure", "value", "unit"), *rows])
        return
    report = dict(found["coating"])
    window, sections = report.pop("window_21_cfr_888_3358"), report.pop("sections")
    terminal.show_mapping(report)
    print()
    cells = [
        (name, *(terminal.brief(one[key]) for key in ("mean", "sd", "n")))
        for name, one in sections.items()
    ]
    terminal.show_rows([("sections", "mean", "sd", "n"), *cells])
    print()
    verdicts = {True: "inside", False: "OUTSIDE", None: "not judged"}
    table: list[tuple[str, ...]] = [("21 CFR 888.3358", "value", "range", "unit", "")]
    for name, one in window.items():
        span = "-" if one["range"] is None else " to ".join(map(terminal.brief, one["range"]))
        cell = terminal.brief(one["value"])
        table.append((name, cell, span, one["unit"], verdicts[one["inside"]]))
    terminal.show_rows(table)


def _unit(unit: str, power: int) -> str:
    if power == 0:
        return ""
    words = unit if abs(power) == 1 else f"{unit}^{abs(power)}"
    return words if power > 0 else f"1/{words}"
