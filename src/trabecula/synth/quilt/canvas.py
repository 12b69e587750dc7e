"""What a run begins with: where its boxes lie, and what there is from the start."""

from __future__ import annotations

import numpy as np

from trabecula.core.request import Request
from trabecula.engine import memmap
from trabecula.engine.parallel import for_slabs
from trabecula.synth.quilt.patch_library import Learnt
from trabecula.synth.quilt.voxel_codes import EMPTY, FIXED, OUT
from trabecula.synth.quilt.windows import Frame, anchored


def frame_for(learnt: Learnt, request: Request) -> Frame:
    """Where boxes lie: from the first voxel; where only a part is made, from that part on, its
    surroundings overlapped.
    """
    shape = deep_shape(request)
    wraps = (False,) * (3 - len(request.periodic)) + tuple(request.periodic)
    start: tuple[int, ...] = (0, 0, 0)
    if request.fixed is not None or request.mask is not None:
        lead = learnt.overlap if request.fixed is not None else 0
        start = anchored(shape, _to_make(shape, request), learnt.step, lead)
    return Frame(shape, wraps, learnt.box, learnt.step, start)


def deep_shape(request: Request) -> tuple[int, int, int]:
    """The request's shape with one layer along z for a picture."""
    shape = (1,) * (3 - len(request.shape)) + tuple(request.shape)
    return (shape[0], shape[1], shape[2])


def canvas_for(shape: tuple[int, ...], request: Request) -> np.ndarray:
    """What there is from the start: measured voxels, and nothing outside the form."""
    canvas = memmap.empty(shape, np.uint8)
    mask, known = (
        None if part is None else part.reshape(shape) for part in (request.mask, request.known)
    )
    fixed = None if request.fixed is None else request.fixed.values.reshape(shape)

    def fill(first: int, last: int) -> None:
        part, here = canvas[first:last], slice(first, last)
        part[...] = EMPTY
        if fixed is not None and known is not None:
            np.add(fixed[here], np.uint8(FIXED), out=part, where=known[here])
        if mask is not None:
            np.copyto(part, np.uint8(OUT), where=~mask[here])

    for_slabs(fill, shape[0])
    return canvas


def _to_make(shape: tuple[int, ...], request: Request) -> list[np.ndarray]:
    """Along every axis, (side,) bool: which layers have a voxel to make."""
    mask, known = (
        None if part is None else part.reshape(shape) for part in (request.mask, request.known)
    )
    along = [np.zeros(side, np.bool_) for side in shape]
    for z in range(shape[0]):
        plane = np.ones(shape[1:], np.bool_) if mask is None else mask[z]
        if known is not None:
            plane = plane & ~known[z]
        along[0][z] = plane.any()
        along[1] |= plane.any(axis=1)
        along[2] |= plane.any(axis=0)
    return along
