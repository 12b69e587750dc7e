"""What is left to do when all pieces are laid: islands are painted over, and marks become labels."""

from __future__ import annotations

import numpy as np

from trabecula.engine.compile import kernel
from trabecula.engine.parallel import for_slabs, sum_slabs
from trabecula.synth.quilt.connectivity import Bodies
from trabecula.synth.quilt.struts import Struts
from trabecula.synth.quilt.voxel_codes import FIXED, OUT


def painted_over(canvas: np.ndarray, bodies: Bodies, struts: Struts, island: int) -> int:
    """Make islands of solid void, and void that is closed in the solid that there is most of;
    returns their voxels.

    Parameters
    ----------
    canvas : (Z, Y, X) uint8
        Is written into.
    bodies
    struts : Struts
        Of the labels that are laid.
    island : int
        Voxels of an island at most.
    """
    islands, classes = bodies.islands(island), bodies.classes

    def paint(first: int, last: int) -> int:
        return int(
            _paint_over(
                canvas[first:last],
                bodies.of[first:last],
                islands,
                classes,
                struts.void,
                struts.solid,
            )
        )

    return sum_slabs(paint, len(canvas))


def unmark(canvas: np.ndarray, void: int) -> None:
    """Make labels of what is on a canvas; outside there is void."""

    def clear(first: int, last: int) -> None:
        _unmark(canvas[first:last], void)

    for_slabs(clear, len(canvas))


@kernel
def _paint_over(canvas, of, islands, classes, void, solid):
    painted = 0
    for z in range(canvas.shape[0]):
        for y in range(canvas.shape[1]):
            for x in range(canvas.shape[2]):
                value = canvas[z, y, x]
                if value < FIXED and classes[value] > 0 and islands[of[z, y, x]]:
                    canvas[z, y, x] = solid if value == void else void
                    painted += 1
    return painted


@kernel
def _unmark(canvas, void):
    for z in range(canvas.shape[0]):
        for y in range(canvas.shape[1]):
            for x in range(canvas.shape[2]):
                value = canvas[z, y, x]
                canvas[z, y, x] = void if value == OUT else value & (FIXED - 1)
