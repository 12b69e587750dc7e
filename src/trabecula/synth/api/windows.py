"""Models of an unlimited material: any box of it can be made alone, and agrees with every other
box, voxel for voxel.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from trabecula.core.errors import InputError
from trabecula.core.recipe import Recipe
from trabecula.core.request import Request
from trabecula.engine.blocks import Box, part_bytes, slices_of
from trabecula.engine.memory import Plan
from trabecula.synth.api.method import Model, as_request

# voxels from the origin, so that every coordinate of a cell or voxel fits into 32 bits
_FARTHEST = 2**30


class WindowModel(Model):
    """A model that fills in `make_box` and `_plan_box`, and gets the rest: whole volumes, windows,
    forms, streams.

    Attributes
    ----------
    block : int
        Edge of the boxes that it makes with least work for what it keeps, voxels; a multiple of
        128.
    """

    block: ClassVar[int] = 128

    def window(
        self,
        shape: Request | int | Sequence[int],
        box: Sequence[Sequence[int]],
        *,
        seed: int | None = None,
        **parts: Any,
    ) -> np.ndarray:
        """The values of a box of what `generate` would make of the same request, or of what lies
        beyond it.

        Parameters
        ----------
        shape : int, sequence of int, or Request
            As of `generate`; along an axis that is not periodic it does not matter.
        box : three pairs of int, of a picture two
            First voxel and the one after the last along z, y, x; negative ones lie before the
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
        """The values of a box of a request that has been checked."""
        self._check_windows()
        values = self.make_box(request, box)
        if request.mask is not None:
            phases = self.facts[0].phases
            values[~request.mask[slices_of(box)]] = phases.index("void") if "void" in phases else 0
        return values

    def plan_block(self, request: Request, side: int) -> Plan:
        """Forecast of making the request in blocks of `side` voxels."""
        self._check_request(request)
        self._check_windows()
        shape = tuple(min(side, length) for length in request.shape)
        block = part_bytes(request.shape, shape, self.dtype)
        levels = self._size(request) // 7  # an eighth, and an eighth of that, ...
        return Plan(
            {**self._plan_box(request, shape), "block": block}, disk=self._size(request) + levels
        )

    def recipe(
        self, request: Request, sha256: str, report: Mapping[str, Any] | None = None
    ) -> Recipe:
        """The recipe of a result whose voxels have this digest."""
        return super().recipe(request, sha256, self._report() if report is None else report)

    def make(self, request: Request) -> tuple[np.ndarray, Mapping[str, Any]]:
        return self.values_of(request, tuple((0, side) for side in request.shape)), self._report()

    def _report(self) -> Mapping[str, Any]:
        """What else there is to tell of how the values come to be (plain JSON)."""
        return {}

    def _plan(self, request: Request) -> Plan:
        size = self._size(request)
        return Plan({**self._plan_box(request, request.shape), "output": size}, disk=size)

    def _size(self, request: Request) -> int:
        return self.dtype.itemsize * int(np.prod(request.shape, dtype=np.int64))

    def _check_windows(self) -> None:
        """Raise where the settings let no box be made alone; such a model fills in `make` as well."""

    @abstractmethod
    def make_box(self, request: Request, box: Box) -> np.ndarray:
        """The values of a box, (Z, Y, X), the caller's to write into; the mask is not looked at."""

    @abstractmethod
    def _plan_box(self, request: Request, shape: tuple[int, ...]) -> Mapping[str, int]:
        """Bytes that making a box of this shape takes beside its values; with "interpreter and
        kernels" and "exemplar".
        """


def _as_box(box: Sequence[Sequence[int]], request: Request) -> Box:
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
                f"the box runs from {first} to {last} along {axis}: farther than 2**30 voxels from the origin"
            )
    inside = all(
        first >= 0 and last <= side
        for (first, last), side in zip(found, request.shape, strict=True)
    )
    if request.mask is not None and not inside:
        raise InputError(
            f"the box {found} leaves the mask of shape {request.shape}: nothing says what is filled there"
        )
    return found
