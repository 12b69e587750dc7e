"""The exceptions of the package: a small tree, each also the builtin that a caller would expect.

A message says what was given, what is needed, and what to do. Whatever is *not* a `TrabeculaError`
and reaches the user is a bug.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial


class TrabeculaError(Exception):
    """Root of everything this package raises on purpose."""


class InputError(TrabeculaError, ValueError):
    """A value, array or image that cannot be used as given."""


class RequestError(InputError):
    """A request that the chosen method cannot honour."""


class UnknownNameError(InputError):
    """A method, option, sample, phase or format that does not exist."""


class UnnamedVoidError(InputError):
    """An image of which no phase is named void, where pores and solid must be distinguished.

    Parameters
    ----------
    phases : sequence of str
        The names that the image has.
    phase_helps : bool
        Whether it is enough to say which phase is meant.

    Attributes
    ----------
    what : str
        What is missing, without the advice: what helps has other names in Python and on the command
        line.
    """

    def __init__(self, phases: Sequence[str], *, phase_helps: bool = True) -> None:
        self.what = f"no phase of {', '.join(phases)} is named void, so it is open what is solid"
        advice = ", or give the phase where a function takes one (phase=...)" if phase_helps else ""
        super().__init__(f"{self.what}: name one of them void (phases=... of the image){advice}")
        self.phases, self.phase_helps = tuple(phases), phase_helps

    # Workers send their errors: this class is made again there from the names, not from the
    # message.
    def __reduce__(self) -> tuple[Callable[..., UnnamedVoidError], tuple[object, ...]]:
        return partial(UnnamedVoidError, phase_helps=self.phase_helps), (self.phases,)


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


class PluginError(TrabeculaError, ImportError):
    """A method of another package that cannot be loaded."""


class NotReproducedError(TrabeculaError, RuntimeError):
    """A recipe that was run again and gave other voxels."""


class TrainingError(TrabeculaError, RuntimeError):
    """A training that diverged or collapsed, and did so again from its last good state."""
