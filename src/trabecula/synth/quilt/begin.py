"""What a run begins with: where its boxes lie, and what there is from the start."""

from __future__ import annotations

import numpy as np

from trabecula.core.request import Request
from trabecula.synth.quilt.learnt import Learnt
from trabecula.synth.quilt.marks import EMPTY, FIXED, OUT
from trabecula.synth.quilt.windows import Frame, anchored


def frame_for(learnt: Learnt, request: Request) -> Frame:
    """Where boxes lie: from the first voxel; where only a part is made, from that part on, its surroundings overlapped."""
    shape = deep_shape(request)
    wraps = (False,) * (3 - len(request.periodic)) + tuple(request.periodic)
    start: tuple[int, ...] = (0, 0, 0)
    if request.fixed is not None or request.mask is not None:
        to_make = np.ones(shape, np.bool_) if request.mask is None else request.mask.reshape(shape).copy()
        if request.known is not None:
            to_make &= ~request.known.reshape(shape)
        start = anchored(shape, to_make, learnt.step, learnt.overlap if request.fixed is not None else 0)
    return Frame(shape, wraps, learnt.box, learnt.step, start)


def deep_shape(request: Request) -> tuple[int, int, int]:
    """The request's shape with one layer along z for a picture."""
    shape = (1,) * (3 - len(request.shape)) + tuple(request.shape)
    return (shape[0], shape[1], shape[2])


def canvas_for(shape: tuple[int, ...], request: Request) -> np.ndarray:
    """What there is from the start: measured voxels, and nothing outside the form."""
    canvas = np.full(shape, EMPTY, np.uint8)
    if request.fixed is not None and request.known is not None:
        known = request.known.reshape(shape)
        np.copyto(canvas, request.fixed.values.reshape(shape) + np.uint8(FIXED), where=known)
    if request.mask is not None:
        canvas[~request.mask.reshape(shape)] = OUT
    return canvas
