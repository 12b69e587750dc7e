"""The history of an image: a list of steps, each plain JSON, from the first file read to the last
operation.

The recipe travels in every file written. A step names its verb and every parameter with its value,
so that replaying the steps gives the same voxels; `sha256` is the digest of the voxels after the
step. The method's step holds the recipes of its exemplars.
"""

from __future__ import annotations

import copy
import hashlib
import json
import platform
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from trabecula.core.errors import InputError

_NAMED = ("method", "operation", "source", "name")
"""Parameters by which a step is known beside its verb."""


@dataclass(frozen=True)
class Recipe:
    """An immutable list of steps; empty where nothing is known."""

    steps: tuple[Mapping[str, Any], ...] = ()

    def then(self, verb: str, values: np.ndarray, /, **parameters: Any) -> Recipe:
        """Return this recipe with one more step, whose result is `values`."""
        return self.then_digest(verb, digest(values), **parameters)

    def then_digest(self, verb: str, sha256: str, /, **parameters: Any) -> Recipe:
        """Return this recipe with one more step, for a result of known digest."""
        step = {"verb": verb, **_plain(parameters), "sha256": sha256, "versions": versions()}
        return Recipe((*self.steps, step))

    def to_json(self) -> list[dict[str, Any]]:
        """Return the steps as plain JSON."""
        return [copy.deepcopy(dict(step)) for step in self.steps]

    @classmethod
    def from_json(cls, steps: Any) -> Recipe:
        """Return the recipe that `to_json` gave; `None` means an empty one."""
        if steps is None:
            return cls()
        if not isinstance(steps, list) or not all(
            isinstance(step, dict) and "verb" in step for step in steps
        ):
            raise InputError(
                "the recipe is damaged: it should be a list of steps, each with a verb"
            )
        return cls(tuple(copy.deepcopy(steps)))

    def __repr__(self) -> str:
        done = [
            f"{step['verb']} {next((step[key] for key in _NAMED if step.get(key)), '')}".strip()
            for step in self.steps
        ]
        return f"<Recipe: {', '.join(done) or 'nothing known'}>"

    def __bool__(self) -> bool:
        return bool(self.steps)


def digest(values: np.ndarray) -> str:
    """Return the SHA-256 of type, shape and voxels, the same in memory and in every format that
    keeps the type.
    """
    return digest_of(values.dtype, values.shape, [values])


def digest_of(dtype: np.dtype, shape: Sequence[int], slabs: Iterable[np.ndarray]) -> str:
    """Return the digest of an array of which not all is in memory: slabs along the first axis, in
    their order.
    """
    if dtype.kind not in "biuf":
        raise InputError(f"values of {dtype} are no voxels: give numbers")
    little = dtype.newbyteorder("<")
    digester = hashlib.sha256(f"{little.str.lstrip('<=|')}{tuple(shape)}".encode())
    for slab in slabs:
        array = np.ascontiguousarray(slab, dtype=little)
        digester.update(array.data if array.ndim else array.tobytes())
    return digester.hexdigest()


def versions() -> dict[str, str]:
    """Return the versions that a result may depend on."""
    from trabecula import __version__

    return {"trabecula": __version__, "numpy": np.__version__, "python": platform.python_version()}


def _plain(value: Any) -> Any:
    """Return `value` as JSON would give it back, or raise: a recipe that cannot be written is no
    recipe.
    """
    return json.loads(json.dumps(value, default=_scalar, allow_nan=False))


def _scalar(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, Recipe):
        return value.to_json()
    raise TypeError(f"{type(value).__name__} does not belong in a recipe")
