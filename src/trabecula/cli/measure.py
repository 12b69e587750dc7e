"""`trabecula measure FILE [--phase NAME|all] [--quick | --full] [--confidence [LEVEL]]
[--sizes HTML] [--drainage [AXIS]] [--bone | --coating [AXIS]] [--memory GIB] [--json]`.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from itertools import combinations
from typing import Any

from trabecula.cli import implants, terminal, two_fluids
from trabecula.cli import options as shared
from trabecula.cli.csv_tables import add_csv, check_csv, unit_of, write_figures
from trabecula.core.errors import InputError

EACH = ("phases", "pairs", "triples")
CURVES = ("two_point", "lineal_path", "cross_correlation")
"""What only JSON prints."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the file and the options for reading it."""
    parser.add_argument("file", metavar="FILE", help="volume or 2-D picture, or sample:NAME")
    parser.add_argument("--json", action="store_true", help="print as JSON, curves included")
    add_csv(parser)
    shared.add_phase(parser)
    shared.add_memory(parser, "a .zarr of labels that needs more is measured in slabs")
    shared.add_level(parser)
    _add_confidence(parser)
    two_fluids.add_arguments(parser)
    implants.add_arguments(parser)
    shared.add_reading(parser)


def _add_confidence(parser: argparse.ArgumentParser) -> None:
    """Add the intervals and their page."""
    group = parser.add_argument_group("how sure the figures are")
    group.add_argument(
        "--confidence",
        nargs="?",
        const="",
        metavar="LEVEL",
        help="95 %% intervals of the material's own figures, and the side of a scan that gives "
        "half-widths of 10, 5 and 1 %%; LEVEL is quick, default or full (default: that of the "
        "figures)",
    )
    group.add_argument(
        "--sizes",
        metavar="HTML",
        help="write a page of the intervals and of the spread over windows, by their size (implies "
        "--confidence)",
    )


def run(options: argparse.Namespace) -> int:
    """Print every descriptor, or those of one phase or of each."""
    check_csv(options.csv)
    if options.phase is not None and options.level == "full":
        raise InputError(
            "--full solves transport and stiffness of the whole material: leave out --full, or "
            "--phase"
        )
    if options.sizes is not None and options.confidence is None:
        options.confidence = ""
    if options.phase is not None and options.confidence is not None:
        raise InputError(
            "--confidence is of the solid and of every phase's fraction: leave out --phase"
        )
    two_fluids.check(options)
    show: Callable[[Any], None] = _show
    measured: Callable[[argparse.Namespace], dict[str, Any]] = _describe
    if implants.is_asked(options):
        show, measured = implants.show, implants.measure
    elif options.drainage is not None:
        show, measured = two_fluids.show, two_fluids.measure
    found = measured(options)
    write_figures(options.csv, found)
    if options.json:
        terminal.show_json(found)
    else:
        show(found)
    return 0


def _describe(options: argparse.Namespace) -> dict[str, Any]:
    """Measure the whole where it fits into memory, else slab by slab; of a crop of a larger volume
    read only that.
    """
    from trabecula.io.lazy import slabs_if_large
    from trabecula.measure.blockwise import describe_slabs, in_core_bytes

    volume = None
    if options.threshold in (None, "auto", "none"):
        given = {"memory": options.memory, **shared.reading(options)}
        volume = slabs_if_large(
            options.file, need=lambda shape: in_core_bytes(shape, options.level), **given
        )
    if volume is None:
        return _in_core(shared.load_exemplar(options.file, options), options)
    if options.crop:
        return _in_core(volume.centre(shared.box_of(options, options.file)), options)
    if options.confidence is not None:
        raise InputError(
            f"{options.file} does not fit into memory, and intervals need the whole of what is "
            "measured: give --crop N, or a coarser --level"
        )
    _check_phase(volume.phases, options.phase)
    found = describe_slabs(volume, memory=options.memory, level=options.level, box=options.box)
    return found if options.phase is None else _select(found, options.phase)


def _in_core(image: Any, options: argparse.Namespace) -> dict[str, Any]:
    from trabecula.core.image import check_labels
    from trabecula.measure import describe, describe_phases

    shared.note_trends([image], what="it")
    if options.phase is None:
        found = describe(image, level=options.level, box=options.box)
        return found if options.confidence is None else found | _confidence(image, options)
    check_labels(image)
    _check_phase(image.phases, options.phase)
    found = describe_phases(
        image, level=options.level, phase=None if options.phase == "all" else options.phase
    )
    return {"shape": list(image.shape), "spacing": list(image.spacing), "unit": image.unit, **found}


def _confidence(image: Any, options: argparse.Namespace) -> dict[str, Any]:
    """Find the intervals; write their page where one is named."""
    from trabecula.measure.confidence import confidence

    level = options.confidence or options.level
    intervals = confidence(image, level=level, box=options.box)
    if options.sizes is not None:
        from trabecula.report.page import write_page
        from trabecula.report.size_page import size_page

        write_page(size_page(image, intervals, level=level), options.sizes)
    return {"confidence": {name: interval.to_json() for name, interval in intervals.items()}}


def _check_phase(phases: Sequence[str], name: str | None) -> None:
    from trabecula.core.checks import check_name

    if name is not None:
        check_name(name, (*phases, "all"), name="phase")


def _select(found: Mapping[str, Any], phase: str) -> dict[str, Any]:
    """Select from the result of `describe_slabs` what is of one phase, or of any."""
    kept = {name: found[name] for name in ("shape", "spacing", "unit", "notes", *EACH)}
    if phase == "all":
        return kept
    pairs = {"-".join(pair) for pair in combinations(found["fractions"], 2) if phase in pair}
    kept["phases"] = {phase: found["phases"][phase]}
    kept["pairs"] = {name: value for name, value in found["pairs"].items() if name in pairs}
    return {**kept, "triples": {}}


def _show(found: Mapping[str, Any]) -> None:
    """Print a line a figure, and below them intervals, and a table with a column for every
    phase.
    """
    apart = (*EACH, "confidence")
    terminal.show_mapping(
        {name: value for name, value in found.items() if name not in apart}, units=True
    )
    if "confidence" in found:
        _show_intervals(found["confidence"], found["unit"])
    columns = found.get("phases")
    if not columns:
        return
    rows: dict[str, dict[str, Any]] = {}
    for phase, figures in columns.items():
        for name, value in figures.items():
            if name == "percolates":
                rows.setdefault(name, {})[phase] = [
                    axis for axis, through in value.items() if through
                ]
            elif name not in CURVES:
                for axis, part in value.items() if isinstance(value, Mapping) else (("", value),):
                    rows.setdefault(f"{name} {axis}".strip(), {})[phase] = part

    def with_unit(name: str) -> str:
        unit = unit_of(name.split()[0], found.get("unit"))
        return f"{name} ({unit})" if unit else name

    print()
    terminal.show_rows(
        [
            ("each phase", *columns),
            *(
                (with_unit(name), *(terminal.brief(cells.get(phase)) for phase in columns))
                for name, cells in rows.items()
            ),
        ]
    )
    for kind in ("pairs", "triples"):
        numbers = {
            name: {key: value for key, value in figures.items() if key not in CURVES}
            for name, figures in (found[kind] or {}).items()
        }
        if numbers:
            print()
            keys = list(next(iter(numbers.values())))
            terminal.show_rows(
                [
                    (kind, *keys),
                    *(
                        (name, *(terminal.brief(figures[key]) for key in keys))
                        for name, figures in numbers.items()
                    ),
                ]
            )


def _show_intervals(intervals: Mapping[str, Mapping[str, Any]], unit: str) -> None:
    """Print a line an interval, and notes where there is none."""
    share = next(iter(intervals.values()))["coverage"] if intervals else 0.95
    widths = ("0.1", "0.05", "0.01")
    rows = [
        (
            f"{share:.0%} interval",
            "from",
            "to",
            "+-",
            *(f"{float(one):.0%}: {unit}" for one in widths),
        )
    ]
    for name, one in intervals.items():
        relative = "-" if one["relative"] is None else f"{one['relative']:.1%}"
        ends = (terminal.brief(one["low"]), terminal.brief(one["high"]))
        sides = (terminal.brief(one["side_for"][width]) for width in widths)
        rows.append((name, *ends, relative, *sides))
    print()
    terminal.show_rows(rows)
    for name, one in intervals.items():
        if one["note"]:
            print(f"{name}: {one['note']}")
