"""The contract that every method and every format keeps, as functions for the tests of anyone who
adds one: they raise `AssertionError` and need no test framework.
"""

from trabecula.testing.format import check_format
from trabecula.testing.method import METHOD_CHECKS, check_method
from trabecula.testing.method_case import Inapplicable, MethodCase

__all__ = ["METHOD_CHECKS", "Inapplicable", "MethodCase", "check_format", "check_method"]
