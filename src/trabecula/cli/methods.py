"""`trabecula methods [NAME]`."""

from __future__ import annotations

import argparse
import dataclasses
import json
import textwrap
from typing import Any

from trabecula.cli import terminal

_WIDTH = 92


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add a name, and the form of the output."""
    parser.add_argument(
        "name", nargs="?", metavar="NAME", help="list the settings and presets of this method"
    )
    parser.add_argument("--json", action="store_true", help="print as JSON")


def run(options: argparse.Namespace) -> int:
    """List the methods that the registry finds, or the settings of one."""
    from trabecula.core.checks import check_name
    from trabecula.synth.api.registry import methods

    found = methods()
    if options.name is not None:
        check_name(options.name, found, name="method")
        _show_method(found[options.name], as_json=options.json)
    elif options.json:
        terminal.show_json({name: _facts(spec) for name, spec in found.items()})
    else:
        terminal.show_rows([(name, spec.summary, spec.paper) for name, spec in found.items()])
    return 0


def _facts(spec: Any) -> dict[str, Any]:
    return {
        "summary": spec.summary,
        "paper": spec.paper,
        "exemplar": spec.exemplar,
        "alone": spec.alone,
        "kinds": spec.kinds,
        "scaling": spec.scaling,
    }


def _show_method(spec: Any, *, as_json: bool) -> None:
    """Print every setting with unit, range, default, meaning and the presets' values."""
    from trabecula.synth.api.settings import preset_settings, settings_of

    settings, presets = settings_of(spec), preset_settings(spec)
    if as_json:
        rows = {
            one.name: {
                "unit": one.unit,
                "range": one.allowed,
                "required": one.default is dataclasses.MISSING,
                "default": None if one.default is dataclasses.MISSING else one.default,
                "presets": one.presets,
                "meaning": one.meaning,
            }
            for one in settings
        }
        terminal.show_json(
            {"name": spec.name, **_facts(spec), "presets": presets, "settings": rows}
        )
        return
    print(f"{spec.name}: {spec.summary} ({spec.paper})")
    if presets:
        print(f"presets (--preset NAME): {', '.join(presets)}")
    print("settings (--set NAME=VALUE):" if settings else "settings: none")
    for one in settings:
        facts = [one.unit, one.allowed]
        given = one.default is not dataclasses.MISSING
        facts.append(f"default {_word(one.default)}" if given else "required")
        facts += [f"{name} {_word(value)}" for name, value in one.presets.items()]
        print(f"\n{one.name}: {'; '.join(fact for fact in facts if fact)}")
        if one.meaning:
            print(textwrap.fill(one.meaning, _WIDTH, initial_indent="  ", subsequent_indent="  "))


def _word(value: Any) -> str:
    """Spell a value as --set takes it."""
    return (value or '""') if isinstance(value, str) else json.dumps(value, default=str)
