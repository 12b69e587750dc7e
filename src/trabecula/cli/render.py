"""`trabecula render FILE --out still.png`."""

from __future__ import annotations

import argparse
from math import prod
from typing import Any

from trabecula.cli import options as shared
from trabecula.cli import view_input
from trabecula.core.errors import InputError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the file, the picture and the look."""
    parser.add_argument("file", metavar="FILE", help="volume, or sample:NAME")
    parser.add_argument(
        "--out",
        required=True,
        metavar="FILE",
        help="picture to write (.png; with --turntable .gif)",
    )
    parser.add_argument(
        "--look",
        default="bone",
        help="bone, foam, bread, sponge, stone, cheese, copper, ceramic, rock, glass, wax, clay or "
        "a .toml file with parameters of your own",
    )
    parser.add_argument(
        "--quality",
        default="quick",
        help="quick (default), or traced in perspective on a ground: draft or fine",
    )
    _add_traced(parser)
    parser.add_argument(
        "--phase", nargs="+", metavar="NAME", help="phases to draw (default: all but void)"
    )
    parser.add_argument(
        "--form",
        metavar="FILE",
        help="labels that say where a colour volume is material (default: the mask it was made in)",
    )
    parser.add_argument(
        "--up", default="z", metavar="AXIS", help="axis that points up: z (default), y, x, -z, ..."
    )
    parser.add_argument(
        "--size",
        nargs=2,
        default=["800", "600"],
        metavar=("W", "H"),
        help="pixels (default 800 600)",
    )
    parser.add_argument(
        "--cut",
        nargs="+",
        default=["corner"],
        metavar="WORD",
        help="corner (default), none, x=0.5 (y, z: a share of the axis), plane=AZ,EL,0.5 (degrees, "
        "share); several together",
    )
    parser.add_argument(
        "--camera",
        nargs=2,
        default=["32", "26"],
        metavar=("AZ", "EL"),
        help="degrees around and above",
    )
    parser.add_argument(
        "--turntable", metavar="N", help="a moving picture of N stills all round (.gif)"
    )
    parser.add_argument(
        "--field",
        metavar="FILE",
        help="colour what is drawn by a field of its shape (trabecula field), with a legend",
    )
    parser.add_argument(
        "--limits",
        nargs=2,
        metavar=("LOW", "HIGH"),
        help="values of the field's first and last colour (default: its 1st and 99th percentile)",
    )
    view_input.add_memory(parser)
    shared.add_reading(parser)


def _add_traced(parser: argparse.ArgumentParser) -> None:
    for name, default, what in (
        ("samples", None, "paths a pixel (default: 4 of draft, 16 of fine)"),
        ("lens", "22", "angle of view, degrees (default 22; 0: parallel rays)"),
        (
            "aperture",
            "0",
            "diameter of the lens, of the longest edge",
        ),
        ("focus", "0.3", "what is sharp, 0 (the nearest) .. 1 (default 0.3)"),
        ("exposure", "0", "stops: each doubles the light (default 0)"),
    ):
        parser.add_argument(f"--{name}", default=default, metavar="N", help=f"traced: {what}")
    parser.add_argument(
        "--no-ground", action="store_true", help="traced: no ground below the material"
    )


def run(options: argparse.Namespace) -> int:
    """Render and write."""
    from trabecula.pipeline.outputs import check_folder, check_target
    from trabecula.view.scene import forecast
    from trabecula.view.still import render, turntable
    from trabecula.view.trace.photograph import forecast_traced

    frames = (
        None if options.turntable is None else shared.integer(options.turntable, name="--turntable")
    )
    if frames is None:
        check_target(options.out)
    else:
        check_folder(options.out)
    size = shared.integers(options.size, name="--size")
    azimuth, elevation = shared.numbers(options.camera, name="--camera")
    picture = (size[0], size[1])
    plan = forecast if options.quality == "quick" else forecast_traced
    image = view_input.load_for_view(
        options.file,
        options,
        need=lambda shape, itemsize: plan(shape, picture).peak + itemsize * prod(shape),
    )
    wanted: dict[str, Any] = {
        "look": options.look,
        "size": picture,
        "cut": options.cut[0] if len(options.cut) == 1 else options.cut,
        "camera": (azimuth, elevation),
    }
    if frames is not None and options.quality != "quick":
        raise InputError("--turntable is of quick stills: leave --quality out")
    if options.field is not None:
        from trabecula.pipeline.inputs import load

        if frames is not None:
            raise InputError("--field colours a still: leave --turntable out")
        wanted["field"] = load(options.field, threshold="none")
    if options.limits is not None:
        low, high = shared.numbers(options.limits, name="--limits")
        wanted["limits"] = (low, high)
    if frames is None:
        render(image, options.out, **wanted, **_still_settings(options))
    else:
        turntable(image, options.out, frames=frames, **wanted)
    print(f"{options.out}: {size[0]} x {size[1]} pixels" + (f", {frames} frames" if frames else ""))
    return 0


def _still_settings(options: argparse.Namespace) -> dict[str, Any]:
    """Return the settings of stills alone."""
    wanted: dict[str, Any] = {
        "quality": options.quality,
        "up": options.up,
        "phase": options.phase,
        "ground": not options.no_ground,
    }
    if options.samples is not None:
        wanted["samples"] = shared.integer(options.samples, name="--samples")
    for name in ("lens", "aperture", "focus", "exposure"):
        (wanted[name],) = shared.numbers([getattr(options, name)], name=f"--{name}")
    if options.form is not None:
        from trabecula.pipeline.inputs import load

        wanted["form"] = load(options.form, threshold="auto")
    return wanted
