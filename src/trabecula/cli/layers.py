"""`trabecula layers FILE --form polyjet|dlp|svg|cli --out FOLDER`, or with `--model NAME`."""

from __future__ import annotations

import argparse
from typing import Any

from trabecula.cli import options as shared
from trabecula.cli import terminal
from trabecula.core.errors import InputError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the volume, the form of the layers, and their pitch."""
    parser.add_argument(
        "file", nargs="?", metavar="FILE", help="volume of labels, in a unit of length; z is up"
    )
    parser.add_argument(
        "--form",
        default="polyjet",
        metavar="NAME",
        help="polyjet (default): a colour for each material; dlp: grey masks; svg or cli: contours",
    )
    parser.add_argument("--out", metavar="FOLDER", help="a new folder; of cli a file, .cli")
    parser.add_argument(
        "--pitch",
        nargs="+",
        metavar="MM",
        help="layer thickness, row and column pitch in millimetres, or one number (default: "
        "polyjet .027 .0847 .0423, dlp .05; of contours the voxels)",
    )
    parser.add_argument("--phase", help="phase that is printed (default: every phase but void)")
    group = parser.add_argument_group("materials of polyjet")
    group.add_argument(
        "--material",
        action="append",
        default=[],
        metavar="PHASE=NAME",
        help="material of a phase (default: named as the phase); repeatable",
    )
    group.add_argument(
        "--mix",
        action="append",
        default=[],
        metavar="PHASE=FIELD:FIRST:SECOND",
        help="a phase of droplets of two materials: FIELD is the share of the second, 0 to 1, over "
        "the whole part; repeatable",
    )
    group.add_argument("--drops", default="0", metavar="SEED", help="seed of the droplets")
    group = parser.add_argument_group("which layers")
    group.add_argument(
        "--only", metavar="FIRST:LAST", help="write these layers alone; LAST is not included"
    )
    group.add_argument("--dry-run", action="store_true", help="write none: print the plan")
    group = parser.add_argument_group("instead of FILE")
    group.add_argument(
        "--model", metavar="FILE|NAME", help="a model of unlimited material: nothing else is stored"
    )
    group.add_argument("--shape", nargs="+", metavar="N", help="voxels: one number, or z y x")
    group.add_argument("--seed", help="0 .. 2**63 - 1 (default 0)")
    parser.add_argument("--json", action="store_true", help="print as JSON")
    shared.add_memory(parser)
    shared.add_lengths(parser)


def run(options: argparse.Namespace) -> int:
    """Write the layers; print their number, size and materials."""
    from trabecula.io.lengths import with_lengths
    from trabecula.layers.write import plan_layers, write_layers

    volume = with_lengths(_volume(options), **shared.lengths(options))
    wanted: dict[str, Any] = {
        "form": options.form,
        "pitch": shared.numbers(options.pitch, name="--pitch") if options.pitch else None,
    }
    if not options.dry_run and options.out is None:
        raise InputError("the place of the layers is not given: add --out FOLDER, or --dry-run")
    if options.dry_run:
        stack = plan_layers(volume, **wanted)
    else:
        stack = write_layers(
            volume,
            options.out,
            **wanted,
            phase=options.phase,
            materials=dict(_pair(text, "--material") for text in options.material),
            mixtures=dict(_mixture(text) for text in options.mix),
            only=_range(options.only),
            seed=shared.integer(options.drops, name="--drops"),
            memory=options.memory,
        )
    if options.json:
        terminal.show_json(stack.to_json())
        return 0
    rows, columns = stack.shape
    size = " x ".join(f"{side:.4g}" for side in stack.size)
    pitch = " x ".join(f"{1000 * step:.4g}" for step in stack.pitch)
    print(
        f"{stack.layers} layers of {rows} x {columns}, pitch {pitch} um, part {size} mm (z, y, x)"
    )
    if not options.dry_run:
        print(f"{options.out}: {stack.written} written")
    for material, volume_mm3 in stack.materials.items():
        print(f"{material}: {volume_mm3:.4g} mm3")
    return 0


def _volume(options: argparse.Namespace) -> Any:
    """Return the volume: read, opened plane by plane where it is a store, or that of a model."""
    from trabecula.io.files import read
    from trabecula.io.lazy import open_slabs, volume_shape
    from trabecula.pipeline.layers import slabs_of_model
    from trabecula.synth.api.serialize import load_model

    if (options.file is None) == (options.model is None):
        raise InputError("give a FILE, or a --model with --shape; one of the two")
    if options.file is not None:
        stored = volume_shape(options.file) is not None
        return open_slabs(options.file) if stored else read(options.file)
    if options.shape is None:
        raise InputError("the size of the part is not given: add --shape N, or --shape Z Y X")
    sides = shared.integers(options.shape, name="--shape")
    shape = sides[0] if len(sides) == 1 else sides
    seed = shared.integer(options.seed or "0", name="--seed")
    return slabs_of_model(load_model(options.model), shape, seed=seed)


def _pair(text: str, option: str) -> tuple[str, str]:
    phase, equals, name = text.partition("=")
    if not (phase and equals and name):
        raise InputError(f"{option} {text}: write it as PHASE=NAME")
    return phase, name


def _mixture(text: str) -> tuple[str, tuple[Any, str, str]]:
    from trabecula.io.files import read

    phase, rest = _pair(text, "--mix")
    parts = rest.rsplit(":", 2)
    if len(parts) != 3 or not all(parts):
        raise InputError(f"--mix {text}: write it as PHASE=FIELD:FIRST:SECOND")
    return phase, (read(parts[0], kind="grey"), parts[1], parts[2])


def _range(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    first, colon, last = text.partition(":")
    if not colon:
        raise InputError(f"--only {text}: write it as FIRST:LAST")
    return shared.integer(first, name="--only"), shared.integer(last, name="--only")
