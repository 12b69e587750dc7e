"""Rows of arrays within kernels.

For `row[:] = values` Numba compiles a comparison of shapes with the text of its error into every
kernel: one to two seconds each. These are plain loops.
"""

from __future__ import annotations

from trabecula.engine.compile import inline


@inline
def copy_row(row, values):
    """Write values into a row that has as many, or fewer."""
    for i in range(len(row)):
        row[i] = values[i]


@inline
def add_row(row, values):
    """Add values to a row that has as many, or fewer."""
    for i in range(len(row)):
        row[i] += values[i]
