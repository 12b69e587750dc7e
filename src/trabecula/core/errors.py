"""The exceptions of the package: a small tree, each also the builtin that a caller would expect.

A message says what was given, what is needed, and what to do. Whatever is *not* a `TrabeculaError` and reaches the
user is a bug.
"""

from __future__ import annotations


class TrabeculaError(Exception):
    """Root of everything this package raises on purpose."""


class InputError(TrabeculaError, ValueError):
    """A value, array or image that cannot be used as given."""


class RequestError(InputError):
    """A request that the chosen method cannot honour."""


class UnknownNameError(InputError):
    """A method, option, sample, phase or format that does not exist."""


class FileError(TrabeculaError, OSError):
    """A file that is missing, damaged, unreadable or cannot be written."""

    # OSError.__str__ would print only errno and strerror, which these messages do not use.
    def __str__(self) -> str:
        return str(self.args[0]) if self.args else ""


class ClusterError(TrabeculaError, ConnectionError):
    """Workers or a scheduler that do not answer, or that cannot do what this process does."""

    def __str__(self) -> str:
        return str(self.args[0]) if self.args else ""


class MemoryBudgetError(TrabeculaError, MemoryError):
    """A run whose forecast exceeds the memory it may use. Raised before anything is allocated."""


class MissingExtraError(TrabeculaError, ImportError):
    """An optional package that a feature needs and that is not installed."""


class NotReproducedError(TrabeculaError, RuntimeError):
    """A recipe that was run again and gave other voxels."""


class TrainingError(TrabeculaError, RuntimeError):
    """A training that diverged or collapsed, and did so again from its last good state."""
