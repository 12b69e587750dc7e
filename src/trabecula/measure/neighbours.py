"""Neighbours of a voxel where some axes repeat."""

from trabecula.engine.compile import inline


@inline
def place_along(place, side, wraps):
    """Return a place along an axis, taken back into a periodic one; -1 beyond any other face."""
    if 0 <= place < side:
        return place
    return place % side if wraps else -1


@inline
def voxel_at(z, y, x, shape, wraps):
    """Return the flat index of a voxel, taken back along periodic axes; -1 beyond other faces."""
    k = place_along(z, shape[0], wraps[0])
    j = place_along(y, shape[1], wraps[1])
    i = place_along(x, shape[2], wraps[2])
    return (k * shape[1] + j) * shape[2] + i if k >= 0 and j >= 0 and i >= 0 else -1
