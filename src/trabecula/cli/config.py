"""`--config FILE`: options of a verb from a file, TOML or JSON; a recipe is one for `generate`,
`plan` and `fit`.

What the command line gives wins. The keys are the names of options, without their dashes, and those
of files and exemplars as `--help` shows them.
"""

from __future__ import annotations

import argparse
import difflib
import json
import tomllib
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from trabecula.core.errors import FileError, InputError

OPTION = "--config"
_OWN = ("help", "config")
_OF_RECIPES = ("generate", "plan", "fit")
_LARGEST = 1 << 24
"""Bytes of a file of options; recipes with many exemplars have some 100 kB."""


def config_path(words: Sequence[str]) -> str | None:
    """Return the file that a command line names, the last one; None where it names none."""
    found = None
    for word, after in zip(words, [*words[1:], None], strict=False):
        if word == OPTION and after is not None:
            found = after
        elif word.startswith(f"{OPTION}="):
            found = word.partition("=")[2]
    return found


def apply_config(
    parser: argparse.ArgumentParser,
    verb: str,
    words: Sequence[str],
    path: str,
    *,
    verbs: Collection[str],
) -> None:
    """Make the options in a file the defaults of a verb's parser.

    Parameters
    ----------
    parser : ArgumentParser
        That of the verb.
    verb : str
    words : sequence of str
        The command line after the verb: what excludes an option of the file drops it.
    path : str
        A file of TOML or JSON. A table named as the verb holds the verb's options.
    verbs : collection of str
        Every verb: tables named as another one are left out.

    Raises
    ------
    FileError
        The file cannot be read.
    InputError
        It has unknown keys, values that an option does not take, or a recipe that says more than
        options can.
    """
    found = _read(path)
    options = (
        _of_recipe(found, verb, path) if isinstance(found, list) else _of_verb(found, verb, verbs)
    )
    parsers = list(_parsers(parser, words))
    known = {name: (one, action) for one in parsers for name, action in _actions(one).items()}
    for key, value in options.items():
        name = str(key).replace("_", "-").lower()
        if name not in known:
            near = difflib.get_close_matches(name, known, n=1)
            hint = f"did you mean {near[0]!r}? " if near else ""
            raise InputError(f"{path}: unknown option {key!r} of {verb}: {hint}see --help")
        if isinstance(found, list) and _is_given(parser, words, name):
            continue
        owner, action = known[name]
        if not _is_excluded(owner, action, words):
            _set_default(owner, action, value, f"{path}: {key}")


def _read(path: str) -> Any:
    try:
        with Path(path).open("rb") as file:
            data = file.read(_LARGEST + 1)
        if len(data) > _LARGEST:
            raise InputError(
                f"{path} has more than {_LARGEST} bytes: no file of options is so large"
            )
        text = data.decode("utf-8-sig")
        found = json.loads(text) if text.lstrip()[:1] in ("{", "[") and _is_json(path) else None
        found = tomllib.loads(text) if found is None else found
    except OSError as error:
        raise FileError(f"{OPTION} {path}: {error.strerror}; name a file of options") from None
    except (UnicodeDecodeError, ValueError, RecursionError) as error:
        raise InputError(
            f"{OPTION} {path}: neither TOML nor JSON ({error}); write `name = value`, an option a "
            "line"
        ) from None
    if isinstance(found, Mapping) and isinstance(found.get("recipe"), list):
        found = found["recipe"]  # what `generate --json` printed
    return found


def _is_json(path: str) -> bool:
    return Path(path).suffix.lower() != ".toml"


def _of_verb(found: Mapping[str, Any], verb: str, verbs: Collection[str]) -> dict[str, Any]:
    """Return the options of a verb: those of its own table, before those of none."""
    shared = {
        key: value
        for key, value in found.items()
        if not (key in verbs and isinstance(value, Mapping))
    }
    own = found.get(verb)
    return shared | (dict(own) if isinstance(own, Mapping) else {})


def _of_recipe(steps: Sequence[Any], verb: str, path: str) -> dict[str, Any]:
    """Return the options that a recipe's first step stands for."""
    if verb not in _OF_RECIPES:
        raise InputError(
            f"{path} is a recipe, whose first step is for {', '.join(_OF_RECIPES)}: rerun repeats "
            "all of them"
        )
    made = next((s for s in steps if isinstance(s, Mapping) and s.get("verb") == "generate"), None)
    if made is None or not made.get("method"):
        raise InputError(f"{path}: the recipe has no step that a method made")
    request = dict(made.get("request") or {})
    found: dict[str, Any] = {
        "method": made["method"],
        "set": {k: v for k, v in dict(made.get("settings") or {}).items() if v is not None},
    }
    if verb != "fit":
        found |= {"shape": request.get("shape"), "seed": request.get("seed", 0)}
        axes = [a for a, on in zip("zyx", request.get("periodic") or (), strict=False) if on]
        found |= {"periodic": axes} if axes else {}
        more = sorted(key for key in request if key not in ("shape", "seed", "periodic"))
        if more:
            raise InputError(
                f"{path}: the recipe's request has {', '.join(more)}, which no option file holds: "
                "use rerun, or write the options as TOML"
            )
    found["exemplar"] = [_source(recipe, path) for recipe in made.get("exemplars") or ()]
    sizes = {tuple(step["size"]) for one in made.get("exemplars") or () for step in one[1:]}
    if len(sizes) == 1:
        found["crop"] = list(sizes.pop())
    return {key: value for key, value in found.items() if value not in (None, [])}


def _source(steps: Sequence[Mapping[str, Any]], path: str) -> str:
    """Return the exemplar that a recipe starts from, read as it is or cropped."""
    if steps and all(step.get("verb") == "crop" for step in steps[1:]) and len(steps) <= 2:
        first = steps[0]
        if first.get("verb") == "sample":
            return f"sample:{first['name']}"
        if first.get("verb") == "read" and first.get("source"):
            return str(first["source"])
    raise InputError(
        f"{path}: the recipe's exemplar was prepared in several steps: use rerun, or write the "
        "options as TOML"
    )


def _parsers(
    parser: argparse.ArgumentParser, words: Sequence[str]
) -> Iterator[argparse.ArgumentParser]:
    """Yield the parser, and that of the kind that the command line names."""
    yield parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            kind = next((word for word in words if word in action.choices), None)
            if kind is not None:
                yield action.choices[kind]


def _actions(parser: argparse.ArgumentParser) -> dict[str, argparse.Action]:
    """Map the names that a file may use to the options of a parser; files and exemplars come
    before options of the same name.
    """
    found: dict[str, argparse.Action] = {}
    for action in sorted(parser._actions, key=lambda one: not one.option_strings):
        if action.dest in _OWN or isinstance(action, argparse._SubParsersAction):
            continue
        names = [o.lstrip("-") for o in action.option_strings if o.startswith("--")]
        words = action.metavar if isinstance(action.metavar, str) else ""
        names = names or [action.dest.replace("_", "-"), words.lower()]
        found |= {name: action for name in names if name}
    return found


def _is_given(parser: argparse.ArgumentParser, words: Sequence[str], name: str) -> bool:
    """Return whether the command line says where else the material comes from."""
    return name in ("exemplar", "method", "set") and any(
        w.split("=")[0] == "--model" for w in words
    )


def _is_excluded(
    parser: argparse.ArgumentParser, action: argparse.Action, words: Sequence[str]
) -> bool:
    """Return whether the command line has an option that excludes this one."""
    given = {word.split("=")[0] for word in words}
    return any(
        action in group._group_actions and given & set(other.option_strings)
        for group in parser._mutually_exclusive_groups
        for other in group._group_actions
    )


def _set_default(
    parser: argparse.ArgumentParser, action: argparse.Action, value: Any, place: str
) -> None:
    """Make a value the default of an option, converted as on the command line."""
    if action.nargs == 0:
        if not isinstance(value, bool):
            raise InputError(f"{place} is a switch: write true or false")
        if value:
            parser.set_defaults(**{action.dest: action.const})
        return
    if isinstance(action, argparse._AppendAction) and isinstance(value, Mapping):
        value = [f"{key}={_spell(part)}" for key, part in value.items()]
    words = [_spell(part) for part in (value if isinstance(value, list) else [value])]
    several = action.nargs in ("+", "*") or isinstance(action.nargs, int)
    several = several or isinstance(action, argparse._AppendAction)
    if not several and len(words) != 1:
        raise InputError(f"{place} takes one value, not {len(words)}")
    try:
        values = [parser._get_value(action, word) for word in words]
        for one in values:
            parser._check_value(action, one)
    except argparse.ArgumentError as error:
        raise InputError(f"{place}: {error.message}") from None
    parser.set_defaults(**{action.dest: values if several else values[0]})
    if not action.option_strings:
        action.nargs = "*" if several else "?"
    action.required = False


def _spell(value: Any) -> str:
    """Write a value as on the command line."""
    if isinstance(value, str):
        return value
    try:
        return json.dumps(value, allow_nan=False, separators=(",", ":"))
    except (TypeError, ValueError):
        return str(value)
