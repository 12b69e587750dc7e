"""`trabecula finish FILE --connect ... --out FILE`."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from trabecula.cli import options as shared
from trabecula.cli import terminal
from trabecula.core.errors import InputError, MemoryBudgetError, TrabeculaError
from trabecula.core.progress import notify

if TYPE_CHECKING:
    from trabecula.finish.operations import Option

_SCAN = {
    "blur": "sigma of the point-spread function, voxels (default: as of --like, else 0.8)",
    "cupping": "share by which values fall on the axis z, beam hardening (default: as of --like, "
    "else 0)",
    "rings": "standard deviation of rings about that axis, grey levels (default: as of --like, "
    "else 0)",
}
"""Settings of `--scan`."""

Step = tuple[str, dict[str, Any]]
"""Name of an operation and its settings."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the file and the operations of the table."""
    from trabecula.finish import OPERATIONS

    parser.add_argument("file", metavar="FILE", help="volume of labels")
    parser.add_argument("--out", required=True, metavar="FILE", help="volume to write")
    group = parser.add_argument_group("what to do, in this order whatever the order of the words")
    for operation in OPERATIONS.values():
        _add_option(group, operation.option)
    parser.add_argument(
        "--for",
        dest="printer",
        metavar="PRINTER",
        help="sls, sla, fdm or slm: what its limits ask for (connect, thicken to its wall, drain "
        "by holes that it can clear), where the options do not say otherwise; then what check "
        "finds is printed",
    )
    parser.add_argument(
        "--like", metavar="EXEMPLAR", help="for --prune: the exemplar, whose free ends are no fault"
    )
    parser.add_argument("--phase", help="phase that is finished (default: every phase but void)")
    parser.add_argument(
        "--mask",
        metavar="FILE",
        help=f"for {_flags_with_mask()}: the form that the volume fills, a surface or a volume "
        "(default: what its recipe names)",
    )
    parser.add_argument(
        "--periodic",
        nargs="*",
        metavar="AXIS",
        help="the volume repeats along z, y, x (no word: all of them), and so does what is done",
    )
    for operation in OPERATIONS.values():
        if operation.more:
            group = parser.add_argument_group(f"for {operation.option.flag}")
            for option in operation.more:
                _add_option(group, option)
    group = parser.add_argument_group("as scanned: after all else")
    group.add_argument(
        "--scan",
        action="store_true",
        help="write the grey scan of the labels that a scanner would give: partial volume, blur, "
        "noise; --like SCAN: as that real grey scan",
    )
    group.add_argument("--seed", metavar="N", help="of the noise (default 0)")
    for name, text in _SCAN.items():
        group.add_argument(f"--{name}", metavar="V", help=text)
    shared.add_lengths(parser)
    group = parser.add_argument_group("large volumes")
    shared.add_memory(
        group,
        "of a .zarr that needs more --connect, --floaters and --fill go slab by slab, into a .zarr",
    )
    group.add_argument(
        "--scratch", metavar="DIR", help="folder for the scratch files (default: that of --out)"
    )
    group.add_argument(
        "--level",
        type=int,
        default=0,
        metavar="N",
        help="coarser level of a .zarr to finish (default 0)",
    )


def _flags_with_mask() -> str:
    """Return the options of the operations that take a form, as a text."""
    from trabecula.finish import OPERATIONS

    flags = [one.option.flag for one in OPERATIONS.values() if "mask" in one.inputs]
    return f"{', '.join(flags[:-1])} and {flags[-1]}"


def _takes_mask(options: argparse.Namespace) -> bool:
    """Return whether an operation was chosen that takes a form."""
    from trabecula.finish import OPERATIONS

    return any(
        "mask" in operation.inputs and getattr(options, operation.option.name)
        for operation in OPERATIONS.values()
    )


def _add_option(group: argparse._ArgumentGroup, option: Option) -> None:
    """Add an option of an operation: a switch, or one with a value."""
    if option.setting is None:
        group.add_argument(option.flag, action="store_true", help=option.help)
    else:
        group.add_argument(option.flag, metavar=option.metavar, help=option.help)


def run(options: argparse.Namespace) -> int:
    """Run the operations that were chosen, each on the result of the one before."""
    from trabecula.finish import OPERATIONS
    from trabecula.pipeline.outputs import check_target

    if options.like is not None and not (options.prune or options.scan):
        raise InputError(
            "--like is the exemplar for --prune, or the scan for --scan: give one of these as well"
        )
    if options.like is not None and options.prune and options.scan:
        raise InputError(
            "--like is for --prune or for --scan: finish first, then --scan the result"
        )
    for name in ("seed", *_SCAN):
        if getattr(options, name) is not None and not options.scan:
            raise InputError(f"--{name} is for --scan: give --scan as well")
    if options.mask is not None and not _takes_mask(options):
        raise InputError(f"--mask is the form for {_flags_with_mask()}: give one of them as well")
    if options.crust is not None and options.fill:
        raise InputError(
            "--fill would fill the whole form, which --crust closes: leave one of them out"
        )
    for operation in OPERATIONS.values():
        flag, chosen = operation.option.flag, getattr(options, operation.option.name)
        for option in operation.more:
            if getattr(options, option.name) is not None and not chosen:
                raise InputError(f"{option.flag} is for {flag}: give {flag} as well")
    if options.printer is not None:
        _fit_printer(options)
    steps = list(_steps(options))
    if not steps and not options.scan:
        every = [operation.option for operation in OPERATIONS.values()]
        words = ", ".join(" ".join(filter(None, (one.flag, one.metavar))) for one in every)
        raise InputError(f"nothing to do: give --connect, or another of {words}")
    check_target(options.out, resumes=True)
    text, done = (
        _in_slabs(steps, options) if _is_too_large(steps, options) else _in_core(steps, options)
    )
    print(f"{options.out}: {text}")
    if len(done) == 1:
        terminal.show_mapping(done[0]["report"])
    else:
        terminal.show_mapping(
            {
                f"{step['operation']}.{name}": value
                for step in done
                for name, value in step["report"].items()
            }
        )
    if options.printer is not None:
        _show_check(options)
    return 0


def _fit_printer(options: argparse.Namespace) -> None:
    """Choose the operations that a printer's limits ask for, where the options do not."""
    from trabecula.finish.printers import printer_of
    from trabecula.io.files import read
    from trabecula.io.lazy import open_slabs, volume_shape
    from trabecula.io.units import NO_LENGTH, to_metres

    printer = printer_of(options.printer, {})
    unit = options.unit
    if unit is None:
        stored = volume_shape(options.file, level=options.level) is not None
        unit = (open_slabs if stored else read)(options.file, level=options.level).unit
    if unit == NO_LENGTH:
        raise InputError(
            "--for needs the size of the part, which its file does not state: give --spacing and "
            "--unit"
        )
    millimetre = 0.001 / to_metres(unit)
    options.connect = True
    if options.thicken is None:
        options.thicken = f"{printer.wall * millimetre:.9g}"
    if options.drain is None and not options.fill and printer.passage is not None:
        options.drain = f"{printer.passage * millimetre:.9g}"


def _show_check(options: argparse.Namespace) -> None:
    """Print what a printer would still refuse or warn of."""
    from trabecula.finish.printing import print_check
    from trabecula.io.files import read

    found = print_check(
        read(options.out), printer=options.printer, phase=options.phase, memory=options.memory
    )
    print(found.to_table())


def _in_core(steps: Sequence[Step], options: argparse.Namespace) -> tuple[str, Sequence[Any]]:
    """Finish the whole in memory; return the result in a line, and the steps of its recipe."""
    from trabecula.finish import OPERATIONS
    from trabecula.io.files import read, write
    from trabecula.io.lengths import with_lengths
    from trabecula.pipeline.inputs import load_like

    given = shared.lengths(options)
    scale = given.pop("scale")
    part = with_lengths(read(options.file, level=options.level), **given)
    images: dict[str, Any] = {}
    if options.like is not None and not options.scan:
        images["exemplar"] = with_lengths(load_like(options.like, part), scale=scale)
    form = _form(part, options)
    if form is not None:
        images["mask"] = form
    part = with_lengths(part, scale=scale)
    periodic = _periodic(part, options)
    for name, settings in steps:
        inputs = {key: images[key] for key in OPERATIONS[name].inputs if key in images}
        if any(periodic) and "periodic" in OPERATIONS[name].complete({}):
            inputs["periodic"] = periodic
        part = OPERATIONS[name](part, phase=options.phase, **settings, **inputs)
    count = len(steps)
    if options.scan:
        part, count = _scan(part, options), count + 1
    write(part, options.out)
    return repr(part), part.recipe.steps[-count:]


def _scan(part: Any, options: argparse.Namespace) -> Any:
    """Return the grey scan of labels, as --like and the settings say."""
    from trabecula.finish import scan
    from trabecula.pipeline.inputs import load

    settings: dict[str, Any] = {
        name: shared.numbers([word], name=f"--{name}")[0]
        for name in _SCAN
        if (word := getattr(options, name)) is not None
    }
    if options.like is not None:
        settings["like"] = load(options.like, threshold="none")
    seed = 0 if options.seed is None else shared.integer(options.seed, name="--seed")
    return scan(part, seed=seed, **settings)


def _periodic(part: Any, options: argparse.Namespace) -> tuple[bool, ...]:
    """Return the axes that are periodic; report where the recipe names some and no option does."""
    from trabecula.finish import periodic_axes

    if options.periodic is None and any(periodic_axes(part.recipe)):
        notify(
            f"{options.file} repeats beyond its faces, which its recipe names: --periodic finishes "
            "it so that it still does, else it is finished as one part"
        )
    return shared.periodic(options.periodic)[3 - part.ndim :]


def _form(part: Any, options: argparse.Namespace) -> Any:
    """Return the form that a volume fills: as given, or as its recipe names it and its file is
    there; else None.
    """
    from trabecula.engine.storage import location_of
    from trabecula.finish import mask_steps
    from trabecula.pipeline.inputs import load_mask
    from trabecula.pipeline.replay import form_of

    if not _takes_mask(options) or options.level:
        return None if options.mask is None else load_mask(options.mask, part, shape=part.shape)
    folder = location_of(options.file).folder
    if options.mask is not None:
        known = mask_steps(part.recipe) is not None
        return (
            form_of(part.recipe, folder=folder, mask=options.mask)
            if known
            else load_mask(options.mask, part, shape=part.shape)
        )
    try:
        form = form_of(part.recipe, folder=folder)
    except TrabeculaError as error:
        notify(f"the form that {options.file} fills is not known ({error}): give it with --mask")
        return None
    if form is not None:
        notify(
            f"{options.file} fills a form, which its recipe names: nothing is added outside of "
            "it, and free ends are counted per volume of it"
        )
    return form


def _is_too_large(steps: Sequence[Step], options: argparse.Namespace) -> bool:
    """Return whether a store is too large to be finished as a whole.

    Raises
    ------
    MemoryBudgetError
        It does not, and one of the steps needs it so, or what is written.
    """
    from trabecula.engine.memory import available_memory, format_bytes
    from trabecula.finish import OPERATIONS
    from trabecula.finish.slabs import in_core_bytes
    from trabecula.io.lazy import volume_shape

    shape = volume_shape(options.file, level=options.level)
    names = [name for name, _ in steps]
    budget = available_memory() if options.memory is None else options.memory
    if shape is None or options.scan or in_core_bytes(shape, names) <= budget:
        return False
    operations = [OPERATIONS[name] for name in names]
    whole = [one.option.flag for one in operations if one.in_place is None]
    need = format_bytes(in_core_bytes(shape, names))
    why = f"{options.file} needs {need} as a whole, {format_bytes(budget)} may be used"
    if whole:
        raise MemoryBudgetError(
            f"{why}, and {', '.join(whole)} cannot go slab by slab as --connect, --floaters and "
            "--fill can: leave it out, finish a coarser level (--level 1), or raise --memory"
        )
    if not options.out.lower().endswith(".zarr"):
        raise MemoryBudgetError(
            f"{why}: write a .zarr, into which it goes slab by slab, or raise --memory"
        )
    return True


def _in_slabs(steps: Sequence[Step], options: argparse.Namespace) -> tuple[str, Sequence[Any]]:
    """Finish a store into a store; return the result in a line, and the steps of its recipe."""
    from trabecula.finish import mask_steps
    from trabecula.finish.slabs import finish_slabs
    from trabecula.io.lazy import open_slabs
    from trabecula.io.lengths import with_lengths

    notify(f"{options.file} does not fit into memory as a whole: it is finished slab by slab")
    for flag, value in (("--mask", options.mask), ("--periodic", options.periodic)):
        if value is not None:
            raise InputError(
                f"{flag} needs the whole volume in memory: leave it out, or raise --memory"
            )
    given = shared.lengths(options)
    scale = given.pop("scale")
    volume = with_lengths(
        with_lengths(open_slabs(options.file, level=options.level), **given), scale=scale
    )
    if mask_steps(volume.recipe) is not None:
        notify(
            "slab by slab joins are not kept inside of the form that it fills: raise --memory "
            "where they should be"
        )
    chosen = [(name, {"phase": options.phase, **settings}) for name, settings in steps]
    recipe = finish_slabs(
        volume, options.out, chosen, memory=options.memory, folder=options.scratch
    )
    return repr(volume), recipe.steps[-len(steps) :]


def _steps(options: argparse.Namespace) -> Iterator[Step]:
    """Yield the operations that were chosen, in the order of the table."""
    from trabecula.finish import OPERATIONS

    for operation in OPERATIONS.values():
        if getattr(options, operation.option.name) in (None, False):
            continue
        settings = {}
        for option in (operation.option, *operation.more):
            word = getattr(options, option.name)
            if option.setting is not None and word is not None:
                settings[option.setting] = _number(word, option)
        yield operation.name, settings


def _number(word: str, option: Option) -> float:
    """Return the value of an option."""
    if option.whole:
        return shared.integer(word, name=option.flag)
    return shared.numbers([word], name=option.flag)[0]
