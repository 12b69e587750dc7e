"""Models of an unlimited material: any box of it can be made alone, and agrees with every other
box, voxel for voxel.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, TypeGuard

import numpy as np

from trabecula.core.errors import InputError
from trabecula.core.recipe import Recipe
from trabecula.core.request import Request
from trabecula.engine.blocks import Box, part_bytes, slices_of
from trabecula.engine.memory import Plan
from trabecula.synth.api.model import Model, as_request

# voxels from the origin, so that every coordinate of a cell or voxel fits into 32 bits
_FARTHEST = 2**30


def makes_boxes(model: Model) -> TypeGuard[WindowModel]:
    """Tell whether a model makes any box of its material alone."""
    return model.capabilities.large == "box"


class WindowModel(Model):
    """A model that gives the hook `make_box` and gets the rest: volumes, windows, forms, streams.

    It may also override `box_memory`; `report_run`, for the recipe; and `_check_windows`, where
    some settings let no box be made alone (such a model gives `make` as well).

    Attributes
    ----------
    block : int
        Edge of the boxes that it makes with least work for their voxels; a multiple of 128.
    """

    block: ClassVar[int] = 128

    @abstractmethod
    def make_box(self, request: Request, box: Box) -> np.ndarray:
        """Return the values of a box (Z, Y, X), of a picture (Y, X), in an array that the caller
        may write into (hook); the request's mask is applied by the caller.
        """

    def box_memory(self, request: Request, shape: tuple[int, ...]) -> Mapping[str, int]:
        """Forecast the bytes that making a box of this shape takes beside its values, by purpose
        (hook; see `Model.memory`).
        """
        return {}

    def report_run(self) -> Mapping[str, Any]:
        """Return plain JSON for the recipe of every result (hook)."""
        return {}

    def window(
        self,
        shape: Request | int | Sequence[int],
        box: Sequence[Sequence[int]],
        *,
        seed: int | None = None,
        **parts: Any,
    ) -> np.ndarray:
        """Return the values of a box of the result of the same request to `generate`, or of the
        material around it.

        Parameters
        ----------
        shape : int, sequence of int, or Request
            As of `generate`; along an axis that is not periodic it does not matter.
        box : three pairs of int, of a picture two
            First voxel and the one after the last along z, y, x; negative ones are before the
            origin.
        seed, **parts :
            As of `generate`.

        Returns
        -------
        array of the box's size

        Raises
        ------
        RequestError
            The method cannot honour a part of the request.
        InputError
            An empty box, one beyond 2**30 voxels from the origin, or one that leaves the request's
            mask.

        Examples
        --------
        >>> import trabecula as tb
        >>> model = tb.method("noise", reach=8).fit(tb.crop(tb.sample("bone"), 24))
        >>> whole = model.generate(40, seed=1).values
        >>> part = model.window(40, ((10, 20), (0, 9), (30, 40)), seed=1)
        >>> bool((part == whole[10:20, 0:9, 30:40]).all())
        True
        """
        request = as_request(shape, seed, parts)
        self._check_request(request)
        return self.values_of(request, _as_box(box, request))

    def values_of(self, request: Request, box: Box) -> np.ndarray:
        """Return the values of a box of a checked request."""
        self._check_windows()
        values = self.make_box(request, box)
        if request.mask is not None:
            values[~request.mask[slices_of(box)]] = self.facts[0].empty_label
        return values

    def make(self, request: Request) -> tuple[np.ndarray, Mapping[str, Any]]:
        """Return the whole volume as one box, and the report."""
        whole = tuple((0, side) for side in request.shape)
        return self.values_of(request, whole), self.report_run()

    def memory(self, request: Request) -> Mapping[str, int]:
        """Forecast the bytes of the whole volume made as one box."""
        return {**self.box_memory(request, request.shape), **super().memory(request)}

    def plan_block(self, request: Request, side: int) -> Plan:
        """Forecast making a request in blocks of `side` voxels."""
        self._check_request(request)
        self._check_windows()
        shape = tuple(min(side, length) for length in request.shape)
        block, size = part_bytes(request.shape, shape, self.dtype), self.output_bytes(request)
        levels = size // 7  # an eighth, and an eighth of that, ...
        return Plan({**self.box_memory(request, shape), "block": block}, disk=size + levels)

    def recipe(
        self, request: Request, sha256: str, report: Mapping[str, Any] | None = None
    ) -> Recipe:
        """Return the recipe of a result whose voxels have this digest."""
        return super().recipe(request, sha256, self.report_run() if report is None else report)

    def _check_windows(self) -> None:
        """Raise where the settings let no box be made alone."""


def field_in(field: Any, box: Box) -> Any:
    """Return the part of a target's field in a box; a number, or None, as it is.

    Raises
    ------
    InputError
        The box leaves the field.
    """
    if not isinstance(field, np.ndarray):
        return field
    for (start, stop), side in zip(box, field.shape, strict=True):
        if start < 0 or stop > side:
            raise InputError(
                f"the box {box} leaves the target's field of shape {field.shape}: nothing says "
                "what it is there"
            )
    return field[slices_of(box)]


def _as_box(box: Sequence[Sequence[int]], request: Request) -> Box:
    """Check a box and return it as pairs of int."""
    axes = "zyx"[-len(request.shape) :]
    pairs = (
        f"{'three' if len(axes) == 3 else 'two'} pairs of whole numbers, along {', '.join(axes)}"
    )
    try:
        found = tuple((int(first), int(last)) for first, last in box)
        whole = [int(side) == side for pair in box for side in pair]
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"the box {box!r} is not made of {pairs}") from None
    if len(found) != len(axes) or not all(whole):
        raise InputError(f"the box {box!r} should have {pairs}")
    for (first, last), axis in zip(found, axes, strict=True):
        if first >= last:
            raise InputError(
                f"the box runs from {first} to {last} along {axis}, which holds no voxel"
            )
        if first < -_FARTHEST or last > _FARTHEST:
            raise InputError(
                f"the box runs from {first} to {last} along {axis}: farther than 2**30 "
                "voxels from the origin"
            )
    inside = all(
        first >= 0 and last <= side
        for (first, last), side in zip(found, request.shape, strict=True)
    )
    if request.mask is not None and not inside:
        raise InputError(
            f"the box {found} leaves the mask of shape {request.shape}: nothing says what is "
            "filled there"
        )
    return found
