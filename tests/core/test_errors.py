"""The tree of errors: each is also the builtin that a caller would expect, and prints its message
alone.
"""

import pytest

from trabecula import errors
from trabecula.core.optional import need

BUILTINS = {
    "InputError": ValueError,
    "RequestError": ValueError,
    "UnknownNameError": ValueError,
    "FileError": OSError,
    "MemoryBudgetError": MemoryError,
    "MissingExtraError": ImportError,
    "PluginError": ImportError,
    "NotReproducedError": RuntimeError,
    "TrainingError": RuntimeError,
    "ClusterError": ConnectionError,
}


def test_every_error_is_covered():
    assert set(errors.__all__) == {*BUILTINS, "TrabeculaError"}


@pytest.mark.parametrize(("name", "builtin"), BUILTINS.items())
def test_each_is_also_a_builtin_and_prints_its_message(name, builtin):
    kind = getattr(errors, name)
    assert issubclass(kind, errors.TrabeculaError) and issubclass(kind, builtin)
    assert str(kind("give less")) == "give less"


def test_a_missing_package_names_its_extra():
    assert need("json", extra="learn", purpose="reading").loads("1") == 1
    with pytest.raises(
        errors.MissingExtraError,
        match=r"training needs no_such_package, .*pip install 'trabecula\[learn\]'",
    ):
        need("no_such_package", extra="learn", purpose="training")
