"""`trabecula completion bash|zsh|fish`."""

from __future__ import annotations

import argparse
from collections.abc import Iterator

SHELLS = ("bash", "zsh", "fish")

_FILES = ("FILE", "FILE|NAME", "EXEMPLAR", "SCAN", "MODEL", "HTML", "OUT")
_FOLDERS = ("DIR", "FOLDER")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the shell."""
    parser.add_argument("shell", choices=SHELLS, help="shell that reads the script")


def run(options: argparse.Namespace) -> int:
    """Print the script."""
    print(script(options.shell))
    return 0


def script(shell: str) -> str:
    """Return the script with which a shell completes verbs, options, methods and files.

    Raises
    ------
    MissingExtraError
        shtab is not installed.
    """
    from trabecula.core.optional import need

    shtab = need("shtab", extra="completion", purpose="completion in a shell")
    from trabecula.cli.main import whole_parser
    from trabecula.synth.api.registry import methods

    parser = whole_parser()
    for action in _actions(parser):
        if action.metavar in _FILES:
            action.complete = shtab.FILE  # type: ignore[attr-defined]
        elif action.metavar in _FOLDERS:
            action.complete = shtab.DIRECTORY  # type: ignore[attr-defined]
        elif "--method" in action.option_strings:
            action.choices = list(methods())
    return str(shtab.complete(parser, shell)).rstrip()


def _actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """Yield every argument of a parser and of those below it."""
    for action in parser._actions:
        yield action
        if isinstance(action, argparse._SubParsersAction):
            for inner in action.choices.values():
                yield from _actions(inner)
