"""Text of results in a terminal: every field, numbers short, and of large arrays the shape and the
range alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, Field, fields
from typing import Any

import numpy as np

_WRITTEN_OUT = 36
"""Numbers up to which an array is written out: a 6x6 stiffness is."""


def brief(result: Any) -> str:
    """Return the `repr` of a dataclass: the fields that are not at their default, none of them
    long.

    Examples
    --------
    >>> import numpy as np
    >>> from trabecula.core.request import Request
    >>> Request(9, mask=np.ones((9, 9, 9), bool))
    Request(shape=(9, 9, 9), mask=<array 9x9x9 bool>)
    """
    shown = [
        f"{one.name}={short(getattr(result, one.name))}"
        for one in fields(result)
        if one.repr and _is_set(result, one)
    ]
    if any("\n" in text for text in shown):
        return (
            f"{type(result).__name__}(\n  "
            + ",\n  ".join(text.replace("\n", "\n  ") for text in shown)
            + ",\n)"
        )
    return f"{type(result).__name__}({', '.join(shown)})"


def _is_set(result: Any, one: Field[Any]) -> bool:
    default = one.default if one.default_factory is MISSING else one.default_factory()
    value = getattr(result, one.name)
    return not (
        type(value) is type(default) and not isinstance(value, np.ndarray) and value == default
    )


def short(value: Any) -> str:
    """Return a value as `brief` shows it."""
    if isinstance(value, np.ndarray):
        return _array(value)
    if isinstance(value, (float, np.floating)):
        return f"{value:.6g}"
    if isinstance(value, np.generic):
        return str(value.item())
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{name!r}: {short(one)}" for name, one in value.items()) + "}"
    if isinstance(value, tuple) and not hasattr(value, "_fields"):
        return "(" + ", ".join(map(short, value)) + ("," if len(value) == 1 else "") + ")"
    return repr(value)


def _array(values: np.ndarray) -> str:
    if values.size <= _WRITTEN_OUT:
        text = np.array2string(values, precision=4, suppress_small=False, max_line_width=110)
        return "\n" + text if "\n" in text else text
    ranged = values.dtype.kind in "iuf"
    span = f", {short(values.min())} .. {short(values.max())}" if ranged else ""
    return f"<array {'x'.join(map(str, values.shape))} {values.dtype}{span}>"
