"""`trabecula VERB ...`: parse, run, and turn errors into one line and exit status 2."""

from __future__ import annotations

import argparse
import difflib
import importlib
import os
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any, NoReturn

from trabecula.cli import terminal
from trabecula.cli.config import apply_config, config_path
from trabecula.cli.examples import ExamplesFormatter, epilog
from trabecula.core.errors import FileError, TrabeculaError, UnnamedVoidError

VERBS = {
    "demo": "run the main job on an embedded sample, start to end",
    "methods": "list the methods",
    "samples": "list the samples that the package makes, and where real scans are published",
    "models": "list the trained models that come with the package",
    "inspect": "report what a scan is, which method fits it, and what can be decided about it",
    "fit": "learn from an exemplar once, into a model's file",
    "generate": "make material from an exemplar, or with a model",
    "plan": "forecast the memory, disk and time of a generate",
    "measure": "measure every descriptor of a material",
    "network": "extract pores and throats, and write them for pore-network codes",
    "bodies": "measure grains, particles or cells: sizes, shapes, contacts, directions",
    "verify": "compare with an exemplar: figures against the exemplar's own spread",
    "field": "make or measure target fields, for --target NAME=FILE",
    "finish": "make it printable: prune, connect, smooth, thicken, remove floaters, fill pores",
    "check": "list what a printer would refuse or warn of",
    "export": "write surfaces (.stl .3mf .ply .obj) and volumes for other programs",
    "layers": "write what printers build layer by layer: pictures for jetting and light, contours",
    "view": "turn, cut, slice and shade in a browser; several side by side",
    "render": "render a still picture, or one that turns",
    "rerun": "make a file's voxels again from the recipe in it",
    "bench": "run the tables of speed and quality",
    "doctor": "report versions, extras, memory and folders, and check that voxels are the same",
    "completion": "print the script with which bash, zsh or fish completes a line",
}


_LONGEST = 1000  # characters of a complaint about arguments


class Parser(argparse.ArgumentParser):
    """An argument parser whose errors are one line with the nearest known word."""

    def error(self, message: str) -> NoReturn:
        """Say what is wrong in one line, and leave with status 2."""
        shown = message if len(message) <= _LONGEST else f"{message[:_LONGEST]}..."
        terminal.fail(f"{shown} (see {self.prog} --help)")
        raise SystemExit(2)

    # Here and not in `error`, since argparse would let the parser of all verbs complain, which
    # knows no verb's options.
    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse, and refuse what is left over, with the nearest option."""
        found, left_over = super().parse_known_args(args, namespace)
        if left_over:
            options = [option for action in self._actions for option in action.option_strings]
            unknown = next((word.split("=")[0] for word in left_over if word.startswith("-")), "")
            near = difflib.get_close_matches(unknown, options, n=1) if unknown else []
            hint = f"; did you mean {near[0]}?" if near else ""
            self.error(
                "unrecognized arguments: "
                f"{' '.join(word or repr(word) for word in left_over)}{hint}"
            )
        return found, left_over


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb and return the exit status."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    for stream in (sys.stdout, sys.stderr):
        # a path or a sign that the terminal cannot show is no reason to fail
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")
    try:
        return _run(words)
    except KeyboardInterrupt:
        terminal.fail("interrupted: nothing was written that is not whole")
        return 130
    except BrokenPipeError:
        # The reader went away (trabecula methods | head): not an error, but Python would complain
        # at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


def _run(words: list[str]) -> int:

    if words and not words[0].startswith("-") and words[0] not in VERBS:
        near = difflib.get_close_matches(words[0], VERBS, n=1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        terminal.fail(f"unknown verb {words[0]!r}: {hint}known are {', '.join(VERBS)}")
        return 2
    # Only the chosen verb is imported: help for all costs no more than their names.
    parser, chosen = _parser(words[0] if words and words[0] in VERBS else None)
    config = config_path(words[1:]) if chosen is not None else None
    if config is not None:
        try:
            apply_config(_verb_parser(parser, words[0]), words[0], words[1:], config, verbs=VERBS)
        except TrabeculaError as error:
            terminal.fail(str(error))
            return 2
    options = parser.parse_args(words)
    if chosen is None:
        parser.print_help()
        return 0
    shown = {name: _taken(options, name) for name in ("quiet", "verbose", "log")}
    _taken(options, "config")
    try:
        with terminal.messages_shown(**shown):
            return _attempt(chosen, options)
    except FileError as error:  # of the log: the verb's own are in `_attempt`
        terminal.fail(str(error))
        return 2


def _verb_parser(parser: argparse.ArgumentParser, verb: str) -> argparse.ArgumentParser:
    """Return the parser of one verb."""
    verbs = next(a for a in parser._actions if isinstance(a, argparse._SubParsersAction))
    return verbs.choices[verb]


def _taken(options: argparse.Namespace, name: str) -> Any:
    """Return an option that is no verb's own, and remove it from those."""
    value = getattr(options, name)
    delattr(options, name)
    return value


def _attempt(chosen: Callable[[argparse.Namespace], int], options: argparse.Namespace) -> int:
    """Run a verb; what it cannot do is an error in one line."""
    begun = time.monotonic()
    try:
        status = chosen(options)
        terminal.note_end(time.monotonic() - begun)
        return status
    except UnnamedVoidError as error:
        terminal.fail(f"{error.what}: {_void_advice(options, error.phase_helps)}")
    except TrabeculaError as error:
        terminal.fail(str(error))
    except MemoryError:
        terminal.fail(f"out of memory: {_smaller(options)}")
    except BrokenPipeError:
        raise
    except OSError as error:
        # The machine's word on a path (a name too long, a device gone): the user's to mend as much
        # as a missing file.
        terminal.fail(
            f"{error.filename or 'input or output'}: {error.strerror or error}; check the path and "
            "the device"
        )
    return 2


def _void_advice(options: argparse.Namespace, phase_helps: bool) -> str:
    """Return advice on an image without a void, by the options that the verb has."""
    ways = ["give the phase (--phase NAME)"] if phase_helps and hasattr(options, "phase") else []
    if hasattr(options, "phases"):
        ways.append("name one of them void (--phases NAME ...)")
    return ", or ".join(ways or ["write the file with one of its phases named void"])


def _smaller(options: argparse.Namespace) -> str:
    """Return advice for a run out of memory, by the options that the verb has."""
    if hasattr(options, "shape"):
        return "ask for a smaller --shape, or see trabecula plan"
    if hasattr(options, "crop"):
        return "keep a smaller box (--crop N), or take a coarser level of a .zarr (--level 1)"
    return "give a smaller volume, such as a coarser level of a .zarr"


def whole_parser() -> Parser:
    """Return the parser of all verbs with all their options, which takes longer than one's."""
    return _parser(*VERBS)[0]


def _parser(*chosen_verbs: str | None):
    """Return the parser, with the options of the verbs that are named, and what the last runs."""
    from trabecula import __version__

    parser = Parser(
        prog="trabecula",
        description="Porous and heterogeneous materials by example.",
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"trabecula {__version__}")
    verbs = parser.add_subparsers(metavar="VERB", parser_class=Parser)
    chosen = None
    for name, summary in VERBS.items():
        sub = verbs.add_parser(
            name,
            help=summary,
            description=summary[0].upper() + summary[1:] + ".",
            epilog=epilog(name),
            formatter_class=ExamplesFormatter,
            allow_abbrev=False,
        )
        if name in chosen_verbs:
            module = importlib.import_module(f"trabecula.cli.{name}")
            module.add_arguments(sub)
            _add_messages(sub)
            chosen = module.run
    return parser, chosen


def _add_messages(parser: argparse.ArgumentParser, *, inner: bool = False) -> None:
    """Add the options of what is shown, to the kinds of a verb as well (`inner`), whose defaults
    must not replace what was given before the kind.
    """
    group = parser.add_argument_group("messages")
    default: Any = argparse.SUPPRESS if inner else None
    either = group.add_mutually_exclusive_group()
    either.add_argument(
        "--quiet", action="store_true", default=default, help="errors alone: no notices, no bars"
    )
    either.add_argument(
        "--verbose",
        action="store_true",
        default=default,
        help="a line for every stage as it ends, with its time",
    )
    group.add_argument(
        "--log",
        metavar="FILE",
        default=default,
        help="append these lines, with the date, to FILE, also those that --quiet leaves out",
    )
    group.add_argument(
        "--config",
        metavar="FILE",
        default=default,
        help="take options from FILE, TOML or JSON, by their names; what is given here wins",
    )
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for kind in action.choices.values():
                _add_messages(kind, inner=True)


if __name__ == "__main__":
    sys.exit(main())
