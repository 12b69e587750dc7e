"""Every check of the contract for every method: the suite loops over the registry and over
`trabecula.testing`. A new method is tested by being there.
"""

import functools
import importlib.util

import pytest

from trabecula.synth.api.registry import methods
from trabecula.testing import METHOD_CHECKS, Inapplicable, MethodCase

NEEDS = {"learn": "torch"}
"""A module that tells whether an extra is installed."""

CHEAP = {"lattice"}
"""Methods for which `make test` makes every check."""

SHARED = {
    "parts": {"gan", "quilt", "texture"},
    "threads": {"mrf", "quilt", "texture"},
    "slabs": {"kopf", "quilt", "sliced", "texture"},
    "presets": {"kopf", "quilt"},
    "blocks": {"bubbles", "quilt", "texture"},
    "resume": {"bubbles", "kopf", "quilt", "sliced", "texture"},
    "recipe": {"chen", "gan", "mrf", "quilt"},
    "model file": {"chen", "gan", "kopf", "quilt", "sliced", "texture"},
    "old processor": set(),
    "exemplar unchanged": {"kopf", "mrf", "quilt", "sliced", "texture"},
    "memory forecast": {"texture"},
    "memory-mapped forecast": {"quilt", "texture"},
    "learning forecast": {"kopf", "texture"},
    "target fraction": {"chen", "gan", "kopf", "quilt", "sliced", "texture"},
    "target field": {"kopf", "quilt", "texture"},
    "refused targets": {"chen", "gan", "kopf", "mrf", "quilt", "sliced", "texture"},
}
"""Checks that `make test` makes for `CHEAP` methods and these, and `make test-all` for all but
those of `SLOW`. Each method takes part in some of them, and each has a method of windows or of
memory-mapped arrays.
"""

SLOW = {
    "old processor": {
        *("bubbles", "chen", "fibres", "kopf", "mrf", "noise", "packing", "quilt", "sliced"),
        *("tessellation", "texture"),
    },
    "presets": {"bubbles", "gan", "mrf"},
    "memory forecast": {"chen", "mrf", "sliced"},
    "memory-mapped forecast": {"chen", "mrf", "sliced"},
    "learning forecast": {"bubbles"},
    "parts": {"kopf", "mrf", "sliced"},
    "threads": {"bubbles"},
}
"""Checks that take many seconds, as those that compile all kernels of a method anew: other methods
make them, these in `make test-slow`.
"""


def _cases():
    cases = []
    for name in sorted(methods()):
        for check in METHOD_CHECKS:
            quick = name in CHEAP | SHARED.get(check, {name})
            marks = [] if quick else [pytest.mark.whole]
            marks += [pytest.mark.slow] if name in SLOW.get(check, ()) else []
            cases.append(pytest.param(name, check, marks=marks))
    return cases


@functools.cache
def _case_of(name):
    """Return the case of a method, with a model and a result that its checks share."""
    return MethodCase(name)


@pytest.mark.parametrize(("name", "check"), _cases())
def test_the_contract(name, check):
    for extra in methods()[name].extras:
        if importlib.util.find_spec(NEEDS[extra]) is None:
            pytest.skip(f"{name} needs the extra {extra!r}, which is not installed")
    try:
        METHOD_CHECKS[check](_case_of(name))
    except Inapplicable as reason:
        pytest.skip(str(reason))


def test_checks_that_are_shared_out_have_their_names():
    assert set(SHARED) <= set(METHOD_CHECKS)
    assert CHEAP.union(*SHARED.values()) <= set(methods())
