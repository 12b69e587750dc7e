"""The exceptions by their public address: `from trabecula.errors import TrabeculaError`. They are
defined in `core.errors`.
"""

from trabecula.core.errors import (
    ClusterError,
    FileError,
    InputError,
    MemoryBudgetError,
    MissingExtraError,
    NotReproducedError,
    PluginError,
    RequestError,
    TrabeculaError,
    TrainingError,
    UnknownNameError,
)

__all__ = [
    "ClusterError",
    "FileError",
    "InputError",
    "MemoryBudgetError",
    "MissingExtraError",
    "NotReproducedError",
    "PluginError",
    "RequestError",
    "TrabeculaError",
    "TrainingError",
    "UnknownNameError",
]
