"""Every check of the contract for every method: the suite loops over the registry and over
`trabecula.testing`. A new method is tested by being there.
"""

import importlib.util

import pytest

from trabecula.synth.api.registry import methods
from trabecula.testing import METHOD_CHECKS, Inapplicable, MethodCase

NEEDS = {"learn": "torch"}
"""A module that tells whether an extra is installed."""


@pytest.fixture(scope="module", params=sorted(methods()))
def case(request):
    for extra in methods()[request.param].extras:
        if importlib.util.find_spec(NEEDS[extra]) is None:
            pytest.skip(f"{request.param} needs the extra {extra!r}, which is not installed")
    return MethodCase(request.param)


@pytest.mark.parametrize("check", METHOD_CHECKS)
def test_the_contract(case, check):
    try:
        METHOD_CHECKS[check](case)
    except Inapplicable as reason:
        pytest.skip(str(reason))
