"""Options that several verbs share, and their conversions."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable, Sequence
from typing import Any

from trabecula.core.errors import InputError


def add_reading(parser: argparse.ArgumentParser) -> None:
    """Add the options for reading an exemplar."""
    group = parser.add_argument_group("how the exemplar is read")
    group.add_argument(
        "--kind", metavar="KIND", help="labels, grey or colour (default: as the file says)"
    )
    group.add_argument(
        "--spacing", nargs="+", metavar="S", help="edge of a voxel: one number, or z y x"
    )
    group.add_argument("--unit", help="unit of the spacing: um, mm, ...")
    group.add_argument(
        "--phases", nargs="+", metavar="NAME", help="names of the labels, darkest first"
    )
    group.add_argument(
        "--threshold",
        metavar="T",
        help="of a grey scan: a number, LOW,HIGH, otsu, dual, auto (default), or none",
    )
    group.add_argument(
        "--crop",
        nargs="+",
        metavar="N",
        help="keep a central box of the exemplar; auto: cut off margins without material",
    )
    group.add_argument(
        "--dataset",
        metavar="NAME",
        help="of a file with several arrays (HDF5, .vti, .vtu, DICOM series): the name of one",
    )
    group.add_argument(
        "--level",
        dest="halvings",
        type=int,
        metavar="N",
        help="of a .zarr with coarser levels: 0 the finest (default; of what is shown the finest "
        "that fits), each further one of "
        "half the voxels along an axis",
    )


def add_lengths(parser: argparse.ArgumentParser, *, spacing: bool = True) -> None:
    """Add the lengths of the result; without `spacing` only their factor."""
    group = parser.add_argument_group("lengths")
    if spacing:
        group.add_argument(
            "--spacing",
            nargs="+",
            metavar="S",
            help="edge of a voxel, where the file states none: one number, or z y x",
        )
        group.add_argument("--unit", help="unit of the spacing: um, mm, ...")
    group.add_argument(
        "--scale", metavar="F", help="factor on all lengths: 10 makes the part ten times as large"
    )


def lengths(options: argparse.Namespace) -> dict[str, Any]:
    """Return spacing, unit and scale as `with_lengths` takes them."""
    spacing = numbers(options.spacing, name="--spacing") if options.spacing else None
    return {"spacing": spacing, "unit": options.unit, "scale": scale_factor(options)}


def scale_factor(options: argparse.Namespace) -> float | None:
    """Return the factor of --scale, where it is given."""
    return None if options.scale is None else numbers([options.scale], name="--scale")[0]


def add_memory(parser: Any, more: str = "") -> None:
    """Add the memory budget, with `more` on what happens beyond it."""
    parser.add_argument(
        "--memory",
        type=gibibytes,
        metavar="GIB",
        help="memory that may be used (default: what is available)" + (more and f"; {more}"),
    )


def add_threads(parser: argparse.ArgumentParser) -> None:
    """Add the number of threads."""
    parser.add_argument("--threads", type=int, metavar="N", help="threads (default: every core)")


def add_settings(parser: argparse.ArgumentParser) -> None:
    """Add the settings of a method."""
    parser.add_argument("--preset", help="ready settings of the method")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="a setting of the method; repeatable",
    )


def add_effort(parser: argparse.ArgumentParser) -> None:
    """Add the effort of trials."""
    parser.add_argument(
        "--effort",
        metavar="N",
        help="2 or 3: try other settings of the method first, and other methods where none is "
        "named, and keep what has the fewest figures out of band (default 1: no trial)",
    )


def add_parts(parser: argparse.ArgumentParser) -> None:
    """Add the parts of a request besides its shape: a form, periodic axes, a measured part."""
    group = parser.add_argument_group("forms, tiles and measured parts")
    group.add_argument(
        "--mask",
        metavar="FILE",
        help="form to fill: a surface (.stl .ply .obj .3mf; scaled to --shape) or a volume",
    )
    group.add_argument(
        "--mask-scale",
        metavar="S",
        help="factor on a surface's lengths, which are in its unit or the exemplar's",
    )
    group.add_argument(
        "--periodic",
        nargs="*",
        metavar="AXIS",
        help="repeat without a seam along z, y, x (no word: all of them)",
    )
    group.add_argument(
        "--fixed",
        metavar="FILE",
        help="scan or picture (a slice) whose voxels are kept and continued",
    )
    group.add_argument(
        "--known", metavar="FILE", help="volume: where --fixed was measured (void: to be made)"
    )
    group.add_argument(
        "--at",
        nargs=3,
        metavar=("Z", "Y", "X"),
        help="corner of --fixed in --shape; all around it is made",
    )
    group.add_argument(
        "--view",
        metavar="PLANE",
        help="of a picture that is --fixed: axes along its rows and columns, yx (default), zx, zy, "
        "xy, xz or yz",
    )
    group.add_argument(
        "--coarse",
        metavar="FILE",
        help="low-resolution scan (labels, or grey: partial volumes) that the result is to be when "
        "it is down-sampled; the exemplar is a picture at the result's resolution",
    )
    group.add_argument(
        "--like",
        metavar="RELATIVE",
        help="3-D scan of a similar material, or sample:NAME: what the picture that is the "
        "exemplar does not show (joins, loops, thickness in space) is taken from it",
    )
    group.add_argument(
        "--target",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="descriptor that the result is to have: porosity=0.25, volume_fraction=FILE (a field "
        "of the result's shape), orientation=Z,Y,X (or a .npy file of vectors, or a structure), "
        "size=1.5 (or a field), by quilt apparent_stiffness:z=FILE (of windows), or one property "
        "that is met by changing porosity: permeability=2e-6, stiffness:z=0.05, ... (the image's "
        "unit)",
    )


def periodic(words: list[str] | None) -> tuple[bool, ...]:
    """Return for each axis if it repeats: none where the option is not given, all where it has no
    word.
    """
    if words is None:
        return (False,) * 3
    named = set("".join(words).lower()) if words else set("zyx")
    if not named <= set("zyx"):
        raise InputError(
            f"--periodic {' '.join(words)}: name axes among z, y, x (a file comes before "
            "--periodic)"
        )
    return tuple(axis in named for axis in "zyx")


def load_parts(
    options: argparse.Namespace,
    exemplars: list[Any],
    shape: tuple[int, ...] | None,
    voxels: Callable[[], tuple[float, ...]],
) -> dict[str, Any]:
    """Load mask, fixed, known, coarse, like and target of a request from their files; `voxels`
    gives the edges of the result's. Where a coarse scan alone says the shape, that is returned as
    "shape".
    """
    from trabecula.pipeline.inputs import (
        load_coarse,
        load_fixed,
        load_mask,
        load_relative,
        refined_shape,
    )

    found: dict[str, Any] = {"target": load_targets(options.target)}
    exemplar = exemplars[0]
    spacing = None if options.mask is None and options.fixed is None else voxels()
    scale = (
        None
        if options.mask_scale is None
        else numbers([options.mask_scale], name="--mask-scale")[0]
    )
    if options.mask is not None:
        found["mask"] = load_mask(options.mask, exemplar, shape=shape, scale=scale, spacing=spacing)
        shape = found["mask"].shape if shape is None else shape
    elif scale is not None:
        raise InputError("--mask-scale without --mask: give the surface that is scaled")
    if options.fixed is not None:
        corner = None if options.at is None else integers(options.at, name="--at")
        where = {
            "shape": shape,
            "corner": corner,
            "known": options.known,
            "view": options.view or "yx",
        }
        found["fixed"], found["known"] = load_fixed(
            options.fixed, exemplar, spacing=spacing, **where
        )
    elif options.known is not None or options.at is not None or options.view is not None:
        raise InputError(
            "--known, --at and --view say where --fixed lies: give --fixed FILE as well"
        )
    if options.coarse is not None:
        found["coarse"] = load_coarse(options.coarse, exemplar)
        if shape is None:
            found["shape"] = refined_shape(found["coarse"], voxels(), exemplar.unit)
    if options.like is not None:
        found["like"] = load_relative(options.like, exemplar)
    return found


def load_targets(pairs: list[str]) -> dict[str, Any]:
    """Load the targets of `NAME=VALUE` words; a value is a number or the file of a field."""
    from trabecula.pipeline.inputs import load

    found: dict[str, Any] = {}
    for pair in pairs:
        name, sign, value = pair.partition("=")
        if not (name and sign and value):
            raise InputError(
                f"--target {pair}: write --target porosity=0.25, or --target porosity=FILE"
            )
        if name in found:
            raise InputError(f"--target {name} is given twice: give one")
        if name == "orientation":
            found[name] = _load_orientation(value)
            continue
        try:
            found[name] = float(value)
        except ValueError:
            found[name] = load(value, threshold="none")
    return found


def _load_orientation(value: str) -> Any:
    """Load a direction: three numbers z,y,x, a .npy file of vectors, or a structure whose principal
    fabric direction is meant.
    """
    from pathlib import Path

    from trabecula.fields import read_directions
    from trabecula.measure import fabric
    from trabecula.pipeline.inputs import load

    try:
        return [float(word) for word in value.split(",")]
    except ValueError:
        if Path(value).suffix == ".npy":
            return read_directions(value)
        return fabric(load(value, threshold="auto")).directions[0].tolist()


def note_directions(values: Any, mask: Any, *, degrees: float = 45.0) -> dict[str, int]:
    """Say where a field of directions has poles and jumps, and return their numbers."""
    from trabecula.cli import terminal
    from trabecula.core.directions import find_jumps, list_places

    poles, jumps = ~values.any(axis=-1), find_jumps(values, mask, degrees=degrees)
    if mask is not None:
        poles &= mask
    if poles.any():
        terminal.note(f"no direction at {poles.sum()} voxels{list_places(poles)}")
    if jumps.any():
        terminal.note(
            f"the direction turns by more than {degrees:g} degrees from voxel to voxel at "
            f"{jumps.sum()} of {jumps.size}{list_places(jumps)}: material there follows neither"
        )
    return {"poles": int(poles.sum()), "jumps": int(jumps.sum())}


def add_level(parser: argparse.ArgumentParser) -> None:
    """Add the extent of the measurement."""
    group = parser.add_argument_group("how much is measured")
    levels = group.add_mutually_exclusive_group()
    levels.add_argument(
        "--quick",
        dest="level",
        action="store_const",
        const="quick",
        help="seconds: counts and correlations only",
    )
    levels.add_argument(
        "--full",
        dest="level",
        action="store_const",
        const="full",
        help="minutes: transport and stiffness as well",
    )
    group.add_argument(
        "--box", type=int, metavar="N", help="with --full: solve in a centre box of N voxels a side"
    )
    parser.set_defaults(level="default")


def add_phase(parser: argparse.ArgumentParser) -> None:
    """Add the choice of one phase, or of each of them."""
    parser.add_argument(
        "--phase",
        metavar="NAME",
        help="measure this phase for itself, or all: every phase, the contacts of pairs, "
        "triple-phase lines "
        "(default: the solid, every phase but void, and then all)",
    )


def load_exemplar(source: str, options: argparse.Namespace) -> Any:
    """Load an exemplar by the options; a grey one is segmented."""
    from trabecula.pipeline.inputs import load

    return load(
        source, crop=crop_of(options), threshold=threshold(options.threshold), **reading(options)
    )


def note_trends(images: Sequence[Any], *, what: str = "the exemplar") -> None:
    """Say in a line of every image that is not stationary what changes in it, and what to do."""
    from trabecula.cli import terminal
    from trabecula.report.trend_text import trend_note

    for number, image in enumerate(images, start=1):
        line = trend_note(image)
        if line is not None:
            terminal.note(f"{what}{'' if len(images) == 1 else f' {number}'} is {line}")


def crop_of(options: argparse.Namespace) -> list[int] | str | None:
    """Return the size of the box that is kept, or "auto"."""
    if not options.crop:
        return None
    return "auto" if options.crop == ["auto"] else integers(options.crop, name="--crop")


def box_of(options: argparse.Namespace, file: str) -> list[int]:
    """Return the size of the box that is kept, of a volume of which nothing else is read.

    Raises
    ------
    InputError
        "auto", for which all of it would have to be read.
    """
    sides = crop_of(options)
    if isinstance(sides, list):
        return sides
    raise InputError(
        f"--crop auto looks at all of {file}, which does not fit into memory: give the sides of a "
        "box"
    )


def reading(options: argparse.Namespace) -> dict[str, Any]:
    """Return the options for reading a file that were given."""
    given = {
        "kind": options.kind,
        "unit": options.unit,
        "phases": options.phases,
        "level": options.halvings or None,
        "dataset": options.dataset,
    }
    found = {name: value for name, value in given.items() if value is not None}
    if options.spacing:
        found["spacing"] = numbers(options.spacing, name="--spacing")
    return found


def threshold(text: str | None) -> Any:
    """Parse a number, a pair, or the name of a way to find it; `auto` without any."""
    if text is None:
        return "auto"
    try:
        found = [float(part) for part in text.split(",")]
    except ValueError:
        return text
    return found[0] if len(found) == 1 else found


def numbers(words: list[str], *, name: str) -> list[float]:
    """Parse words as floats."""
    try:
        return [float(word) for word in words]
    except ValueError:
        raise InputError(
            f"{name} {' '.join(words)}: give numbers (a file comes before {name})"
        ) from None


def number(word: str, *, name: str) -> float:
    """Parse a word as a float; its range is checked where it is used."""
    try:
        return float(word)
    except ValueError:
        raise InputError(f"{name} {word}: give one number") from None


def integer(word: str, *, name: str) -> int:
    """Parse a word as an integer; its range is checked where it is used."""
    try:
        return int(word)
    except ValueError:
        raise InputError(f"{name} {word}: give one whole number") from None


def gibibytes(word: str) -> int:
    """Parse a number of GiB as bytes, as a type of argparse."""
    try:
        count = float(word) * 2**30
    except ValueError:
        count = math.nan
    if not (math.isfinite(count) and count > 0):
        raise argparse.ArgumentTypeError(f"{word!r} should be a number of GiB above 0")
    return int(count)


def integers(words: list[str], *, name: str) -> list[int]:
    """Parse words as integers; the values are checked where they are used."""
    try:
        return [int(word) for word in words]
    except ValueError:
        raise InputError(
            f"{name} {' '.join(words)}: give one whole number or three (a file comes before {name})"
        ) from None


def preset_and_settings(options: argparse.Namespace) -> tuple[str | None, dict[str, Any]]:
    """Return the preset, given as --preset NAME or as --set preset=NAME, and the settings."""
    found = settings(options.set)
    named = found.pop("preset", options.preset)
    if options.preset not in (None, named):
        raise InputError(f"--preset {options.preset} and --set preset={named}: give one of them")
    return named, found


def settings(pairs: list[str]) -> dict[str, Any]:
    """Parse `key=value` words; a value is JSON where it is valid (0.5, true, [4,6]), else text."""
    found: dict[str, Any] = {}
    for pair in pairs:
        name, sign, value = pair.partition("=")
        if not sign or not name:
            raise InputError(f"--set {pair}: write --set name=value")
        try:
            found[name] = json.loads(value, parse_float=_finite, parse_constant=_finite)
        except InputError:
            raise
        except (ValueError, RecursionError):
            found[name] = value
    return found


def _finite(text: str) -> float:
    """Parse a finite number of JSON."""
    if not math.isfinite(float(text)):
        raise InputError(f"--set: {text} is not a finite number")
    return float(text)
