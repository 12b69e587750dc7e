"""`trabecula fit EXEMPLAR [--method NAME] --out MODEL [--set KEY=VALUE] [--minutes M] [--device D]
[--run FOLDER]`.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from trabecula.cli import options as shared
from trabecula.cli import terminal
from trabecula.cli.method_choice import check_fits, method_for, tried
from trabecula.core.errors import FileError, InputError

_SHORT = ("minutes", "device", "run")
"""Options that are settings, of the methods that have them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the exemplars, the settings and the model's file."""
    parser.add_argument(
        "exemplars", nargs="+", metavar="EXEMPLAR", help="scan to learn from, or sample:NAME"
    )
    parser.add_argument("--method", help="see trabecula methods (default: what inspect recommends)")
    parser.add_argument(
        "--out", required=True, metavar="MODEL", help="file to write, for generate --model"
    )
    shared.add_settings(parser)
    shared.add_effort(parser)
    parser.add_argument(
        "--minutes", type=float, metavar="M", help="time to learn for, where the method takes any"
    )
    parser.add_argument("--device", help="cpu, cuda or auto, where the method can use either")
    parser.add_argument(
        "--run",
        metavar="FOLDER",
        help="where the method leaves figures, pictures and states of the training",
    )
    shared.add_memory(parser)
    shared.add_threads(parser)
    parser.add_argument("--json", action="store_true", help="print what was learned as JSON")
    shared.add_reading(parser)


def run(options: argparse.Namespace) -> int:
    """Learn, and write the model."""
    from trabecula.engine.parallel import thread_count, threads
    from trabecula.synth.api.registry import method

    chosen, recommended = None, ""
    if options.method is None:
        _check_no_short(options)
        shared.preset_and_settings(options)
    else:
        preset, settings = _preset_and_settings(options)
        chosen = method(options.method, preset=preset, **settings)
    _check_place(options.out)
    with threads(options.threads if options.threads is not None else thread_count()):
        exemplars = [shared.load_exemplar(source, options) for source in options.exemplars]
        if chosen is None:
            chosen, recommended = method_for(exemplars, options)
        else:
            check_fits(chosen, exemplars)
        if options.effort is not None:
            chosen = tried(chosen, exemplars, options)
        model = chosen.fit(exemplars if len(exemplars) > 1 else exemplars[0], memory=options.memory)
        if recommended:
            terminal.note(recommended)
        shared.note_trends(exemplars)
        path = model.save(options.out)
    if options.json:
        found = {
            "out": str(path),
            "sha256": model.sha256,
            "bytes": path.stat().st_size,
            "history": dict(model.history),
        }
        terminal.show_json(found)
    else:
        print(
            f"{path}: a model of {chosen.capabilities.name}, {path.stat().st_size:,} bytes\nsha256 "
            f"{model.sha256}"
        )
    return 0


def _check_place(out: str) -> None:
    """Raise before any work is done where the model cannot be written."""
    from trabecula.pipeline.outputs import check_folder

    if Path(out).is_dir():
        raise FileError(f"cannot write {out}: a folder of that name is there; choose another name")
    check_folder(out)


def _check_no_short(options: argparse.Namespace) -> None:
    """Raise where an option of some methods is given and no method is."""
    for name in _SHORT:
        if getattr(options, name) is not None:
            raise InputError(
                f"--{name} {getattr(options, name)}: is a setting of methods that train; name one, "
                "as --method gan"
            )


def _preset_and_settings(options: argparse.Namespace) -> tuple[str | None, dict[str, Any]]:
    """Return the preset and the settings, given by --set or by an option of their own."""
    from trabecula.synth.api.registry import method

    preset, found = shared.preset_and_settings(options)
    known = vars(method(options.method, preset=preset).config)
    for name in _SHORT:
        value = getattr(options, name)
        if value is None:
            continue
        if name in found:
            raise InputError(f"--{name} and --set {name}: give one of them")
        if name not in known:
            raise InputError(
                f"--{name} {value}: method {options.method!r} has no such setting; leave it out"
            )
        found[name] = value
    return preset, found
