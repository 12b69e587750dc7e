"""The settings of a method as tables: fields of its config, and the texts below them."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import re
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from trabecula.synth.api.capabilities import Capabilities
from trabecula.synth.api.registry import method_class

_BOUND = r"(?:half their width|\([^)]+\)|-?[\w.]*\w(?:e-\d+)?|-?\d+e-\d+)(?:(?: - |\*\*| / )\w+)*"
_RANGE = re.compile(rf"({_BOUND}) \.\. ({_BOUND})")
_OPEN = re.compile(r"(?<=, )above 0(?: and below 1)?|at least \d+(?: voxels)?", re.IGNORECASE)
_WORD = re.compile(r'"([^"\s]+)"')
_CLAUSE = re.compile(r"(?<!\.)\. |; ")  # the sign of a range ends none
_UNITS = (
    (re.compile(r"in units of L"), "L"),
    (re.compile(r"in the (?:image's unit|unit of the voxels)"), "unit of the image"),
    (re.compile(r"(?:^|, |in )voxels(?= of the|,| at)", re.IGNORECASE), "voxels"),
    (re.compile(r"(?:^|, |in )pixels(?= of the|,| at)", re.IGNORECASE), "pixels"),
    (re.compile(r" minutes by the clock"), "minutes"),
)


@dataclass(frozen=True)
class Setting:
    """One setting of a method."""

    name: str
    default: Any
    """Its value where nothing is given; `dataclasses.MISSING` where one has to be given."""

    meaning: str
    """The text below the field, in one line."""

    presets: dict[str, Any]
    """Its value in every preset that changes it."""

    @property
    def unit(self) -> str:
        """Return the unit of a length or time as the meaning states it; empty of pure numbers."""
        first = _CLAUSE.split(self.meaning)[0]
        return next((unit for pattern, unit in _UNITS if pattern.search(first)), "")

    @property
    def allowed(self) -> str:
        """Return the range or the words that the meaning names; empty where it names none."""
        if self.meaning.startswith("Whether "):
            return "true, false"
        found = _RANGE.search(self.meaning) or _OPEN.search(self.meaning)
        if found:
            each = "each " if self.meaning[: found.start()].endswith("each ") else ""
            off = "0, " if self.default == 0 and found[0][0] not in "0-a" else ""
            return each + off + found[0][0].lower() + found[0][1:]
        words = dict.fromkeys(_WORD.findall(self.meaning))
        named = self.default is None or isinstance(self.default, str)
        return ", ".join(words) if named and len(words) > 1 else ""


def settings_of(capabilities: Capabilities) -> list[Setting]:
    """List the settings of a method, in the order of its config.

    Raises
    ------
    PluginError
        The method cannot be imported.
    """
    config: Any = method_class(capabilities).config_type
    meanings = _texts_below_fields(config)
    presets = preset_settings(capabilities)
    return [
        Setting(
            field.name,
            _default(field),
            " ".join(meanings.get(field.name, "").split()),
            {name: given[field.name] for name, given in presets.items() if field.name in given},
        )
        for field in dataclasses.fields(config)
    ]


def preset_settings(capabilities: Capabilities) -> dict[str, dict[str, Any]]:
    """Return the settings of every preset of a method, by the preset's name."""
    config: Any = method_class(capabilities).config_type
    return {name: dict(config.preset(name)) for name in capabilities.presets}


def _default(field: dataclasses.Field) -> Any:
    if field.default_factory is not dataclasses.MISSING:
        return field.default_factory()
    return field.default


def _texts_below_fields(config: type) -> dict[str, str]:
    """Return the text below every field; none where the source is not there."""
    inherited = [
        _texts_below_fields(base) for base in config.__bases__ if dataclasses.is_dataclass(base)
    ]
    try:
        tree = ast.parse(inspect.cleandoc("\n" + inspect.getsource(config)))
    except (OSError, SyntaxError):
        return {}
    body = next(node.body for node in ast.walk(tree) if isinstance(node, ast.ClassDef))
    own = {
        field.target.id: inspect.cleandoc(str(below.value.value))
        for field, below in pairwise(body)
        if isinstance(field, ast.AnnAssign)
        and isinstance(field.target, ast.Name)
        and isinstance(below, ast.Expr)
        and isinstance(below.value, ast.Constant)
    }
    return {name: text for texts in (*inherited, own) for name, text in texts.items()}
