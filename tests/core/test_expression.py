"""Formulas of a user: what they compute, and that nothing but formulas is let in."""

import math
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trabecula.core.expression import FUNCTIONS, Expression, expressions
from trabecula.errors import InputError, TrabeculaError, UnknownNameError

NAMES = ("x", "y", "X")


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("0.3 + 0.2 * x / X", 0.3 + 0.2 * 3 / 10),
        ("2 ** -x", 0.125),
        ("-x ** 2", -9),
        ("1 if x < y else 2", 1),
        ("1 if 0 < x < 2 else 2", 2),
        ("1 if x > 2 and not y > 5 or X < 1 else 0", 1),
        ("clip(x, 0, 1) + max(x, y) - min(x, y)", 1 + 4 - 3),
        ("hypot(x, y)", 5),
        ("atan2(1, 1) * 4 / pi", 1),
        (
            "sin(pi / 2) + cos(0) + exp(0) + log(e) + sqrt(4) + abs(-1) + floor(1.5) + tanh(0) + "
            "tan(0)",
            8,
        ),
        ("7 % 4", 3),
        ("2 if x == 3 and y != 3 else 0", 2),
        (" 1e-3", 1e-3),
    ],
)
def test_a_formula_has_the_value_of_school(text, value):
    assert float(Expression(text, NAMES)(x=3.0, y=4.0, X=10.0)) == pytest.approx(value)


def test_arrays_broadcast_and_names_are_told():
    parsed = Expression("x + 2 * y", NAMES)
    assert parsed.names == {"x", "y"}
    found = parsed(x=np.arange(3)[:, None], y=np.arange(2))
    assert np.array_equal(found, np.arange(3)[:, None] + 2 * np.arange(2))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("__import__('os').system('true')", "calls something else"),
        ("x.__class__", "Attribute"),
        ("().__class__", "Attribute"),
        ("[1, 2]", "List"),
        ("x[0]", "Subscript"),
        ("(lambda: 1)()", "calls something else"),
        ("lambda: 1", "Lambda"),
        ("[i for i in x]", "ListComp"),
        ("(x := 1)", "NamedExpr"),
        ("f'{x}'", "JoinedStr"),
        ("'text'", "only numbers"),
        ("True", "only numbers"),
        ("1j", "only numbers"),
        ("None", "only numbers"),
        ("sin(x, y)", "takes 1 values"),
        ("clip(x, a=0, b=1)", "plain function"),
        ("max(*x)", "takes 2 values"),
        ("min(*x, y)", "Starred"),
        ("x @ y", "MatMult"),
        ("x // y", "FloorDiv"),
        ("x is y", "Is"),
        ("1 +", "cannot be read"),
        ("x; y", "cannot be read"),
        ("", "give text"),
        (None, "give text"),
        ("1 + " * 900 + "1", "characters"),
        ("+".join(["x"] * 300), "parts"),
        ("(" * 300 + "1" + ")" * 300, "cannot be read"),
    ],
)
def test_what_is_no_formula_is_refused(text, words):
    with pytest.raises(InputError, match=words):
        Expression(text, NAMES)


@pytest.mark.parametrize(
    ("text", "near"),
    [("xx + 1", "'x'"), ("sine(x)", "'sin'"), ("sqt(x)", "'sqrt'"), ("z", "known are")],
)
def test_unknown_names_are_told(text, near):
    with pytest.raises(UnknownNameError, match=near):
        Expression(text, NAMES)


def test_no_number_is_too_large_to_be_refused_quickly():
    assert not math.isfinite(float(Expression("9 ** 9 ** 9 ** 9", ())()))
    assert math.isnan(float(Expression("0 / 0 + x", ("x",))(x=1.0)))


@pytest.mark.whole
@given(st.text(max_size=40) | st.text("x +-*/().,<>[]{}1:='\"", max_size=30))
def test_any_text_is_a_formula_or_refused(text):
    with suppress(TrabeculaError):
        Expression(text, NAMES)(x=1.0, y=2.0, X=3.0)


def test_several_formulas_are_the_parts_of_a_vector():
    parts = expressions("-y, x, max(x, 2)", NAMES, count=3)
    assert [float(part(x=1.0, y=5.0)) for part in parts] == [-5, 1, 2]
    with pytest.raises(InputError, match="has 2 parts: give 3"):
        expressions("x, y", NAMES, count=3)


def test_every_function_takes_as_many_values_as_it_says():
    for name, (_, count) in FUNCTIONS.items():
        assert np.isfinite(Expression(f"{name}({', '.join(['0.5'] * count)})", ())()), name
