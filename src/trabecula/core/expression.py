"""Formulas of a user, such as "0.3 + 0.2 * sin(2 * pi * x / X)": parsed here, never handed to
Python.

Only what is named in this module is understood: numbers, given names, arithmetic, comparisons, a
choice and a few functions. Everything is computed in NumPy's floats, so that no formula can ask for
a number of a million digits.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Collection, Mapping
from typing import Any

import numpy as np

from trabecula.core.checks import check_name, quote
from trabecula.core.errors import InputError

CONSTANTS = {"pi": math.pi, "e": math.e}
FUNCTIONS: dict[str, tuple[Callable[..., Any], int]] = {
    "abs": (np.abs, 1),
    "sqrt": (np.sqrt, 1),
    "exp": (np.exp, 1),
    "log": (np.log, 1),
    "sin": (np.sin, 1),
    "cos": (np.cos, 1),
    "tan": (np.tan, 1),
    "tanh": (np.tanh, 1),
    "floor": (np.floor, 1),
    "atan2": (np.arctan2, 2),
    "hypot": (np.hypot, 2),
    "min": (np.minimum, 2),
    "max": (np.maximum, 2),
    "clip": (np.clip, 3),
}
"""Functions by name, each with how many values it takes."""

_LONGEST, _MOST_PARTS = 2000, 400
_OPERATORS: dict[type, Callable[..., Any]] = {
    ast.Add: np.add,
    ast.Sub: np.subtract,
    ast.Mult: np.multiply,
    ast.Div: np.divide,
    ast.Mod: np.mod,
    ast.Pow: np.power,
    ast.UAdd: np.positive,
    ast.USub: np.negative,
    ast.Lt: np.less,
    ast.LtE: np.less_equal,
    ast.Gt: np.greater,
    ast.GtE: np.greater_equal,
    ast.Eq: np.equal,
    ast.NotEq: np.not_equal,
    ast.And: np.logical_and,
    ast.Or: np.logical_or,
    ast.Not: np.logical_not,
}


class Expression:
    """A formula in named values.

    Parameters
    ----------
    text : str
        Numbers, the given names, pi and e; + - * / % **, comparisons, `and`, `or`, `not`, `A if
        CONDITION else B`, and the `FUNCTIONS`. At most 2000 characters.
    names : collection of str
        What the formula may speak of.

    Raises
    ------
    InputError
        It cannot be read, or holds something else.
    UnknownNameError
        A name or a function that there is not.

    Examples
    --------
    >>> half = Expression("0.2 if x < X / 2 else 0.6", ("x", "X"))
    >>> half(x=np.array([1.0, 9.0]), X=10.0)
    array([0.2, 0.6])
    """

    def __init__(self, text: str, names: Collection[str]) -> None:
        self.text = text
        self._tree = _tree_of(text)
        _check_part(self._tree, tuple(names), text)
        self.names = frozenset(
            part.id for part in ast.walk(self._tree) if isinstance(part, ast.Name)
        ) & set(names)

    def __call__(self, **values: Any) -> np.ndarray:
        """Return the formula's value in float64; where it has none (0 / 0) it is NaN."""
        known: dict[str, Any] = {**CONSTANTS, **values}
        with np.errstate(all="ignore"):
            return np.asarray(_value(self._tree, known), np.float64)


def expressions(text: str, names: Collection[str], *, count: int) -> list[Expression]:
    """Read `count` formulas, separated by commas outside brackets: the components of a vector
    field.

    Raises
    ------
    InputError
        Another number of formulas; as `Expression`.

    Examples
    --------
    >>> [float(part(x=2.0)) for part in expressions("x, max(x, 3)", ("x",), count=2)]
    [2.0, 3.0]
    """
    tree = _tree_of(text)
    parts = list(tree.elts) if isinstance(tree, ast.Tuple) else [tree]
    if len(parts) != count:
        raise InputError(
            f"the formula {text!r} has {len(parts)} parts: give {count}, separated by commas"
        )
    return [Expression(ast.unparse(part), names) for part in parts]


def _tree_of(text: str) -> ast.expr:
    if not isinstance(text, str) or not text.strip():
        raise InputError(f"the formula is {quote(text)}: give text such as '0.3 + 0.2 * z / Z'")
    if len(text) > _LONGEST:
        raise InputError(f"the formula has {len(text)} characters: give at most {_LONGEST}")
    try:
        return ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise InputError(
            f"the formula {text!r} cannot be read ({getattr(error, 'msg', error)}): write such as "
            "'0.3 + 0.2 * z / Z'"
        ) from None


def _check_part(tree: ast.expr, names: tuple[str, ...], text: str) -> None:
    """Check the whole tree: anything not named here is refused, reached or not."""
    parts = list(ast.walk(tree))
    if len(parts) > _MOST_PARTS:
        raise InputError(f"the formula has {len(parts)} parts: give at most {_MOST_PARTS}")
    called = {id(part.func) for part in parts if isinstance(part, ast.Call)}
    for part in parts:
        if isinstance(part, ast.Call):
            _check_call(part, text)
        elif isinstance(part, ast.Name):
            if id(part) not in called:
                check_name(part.id, (*names, *CONSTANTS), name="name in a formula")
        elif isinstance(part, ast.Constant):
            if isinstance(part.value, bool) or not isinstance(part.value, (int, float)):
                raise InputError(
                    f"the formula {text!r} holds {part.value!r}: only numbers and names are "
                    "understood"
                )
        elif not isinstance(
            part,
            (*_OPERATORS, ast.BinOp, ast.UnaryOp, ast.BoolOp, ast.Compare, ast.IfExp, ast.Load),
        ):
            what = type(part).__name__
            raise InputError(
                f"the formula {text!r} holds a {what}: only arithmetic, comparisons and functions "
                "are understood"
            )


def _check_call(part: ast.Call, text: str) -> None:
    if not isinstance(part.func, ast.Name) or part.keywords:
        raise InputError(
            f"the formula {text!r} calls something else than a plain function: known are "
            f"{', '.join(FUNCTIONS)}"
        )
    check_name(part.func.id, FUNCTIONS, name="function in a formula")
    takes = FUNCTIONS[part.func.id][1]
    if len(part.args) != takes:
        raise InputError(
            f"{part.func.id} takes {takes} values, the formula {text!r} gives {len(part.args)}"
        )


def _value(part: ast.expr, known: Mapping[str, Any]) -> Any:
    if isinstance(part, ast.Constant):
        return np.float64(part.value)  # type: ignore[arg-type]  # checked to be a number
    if isinstance(part, ast.Name):
        return known[part.id]
    if isinstance(part, ast.Call):
        assert isinstance(part.func, ast.Name)  # checked when it was read
        return FUNCTIONS[part.func.id][0](*(_value(argument, known) for argument in part.args))
    if isinstance(part, ast.BinOp):
        return _OPERATORS[type(part.op)](_value(part.left, known), _value(part.right, known))
    if isinstance(part, ast.UnaryOp):
        return _OPERATORS[type(part.op)](_value(part.operand, known))
    if isinstance(part, ast.IfExp):
        return np.where(
            _value(part.test, known), _value(part.body, known), _value(part.orelse, known)
        )
    if isinstance(part, ast.BoolOp):
        found = _value(part.values[0], known)
        for other in part.values[1:]:
            found = _OPERATORS[type(part.op)](found, _value(other, known))
        return found
    assert isinstance(part, ast.Compare)  # nothing else passes the check
    found, left = True, _value(part.left, known)
    for operator, other in zip(part.ops, part.comparators, strict=True):
        right = _value(other, known)
        found = np.logical_and(found, _OPERATORS[type(operator)](left, right))
        left = right
    return found
