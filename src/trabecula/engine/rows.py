"""Rows of arrays, and blocks of rows, within kernels.

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


@inline
def add_scaled_row(row, factor, values):
    """Add a multiple of values to a row that has as many, or fewer."""
    for i in range(len(row)):
        row[i] += factor * values[i]


@inline
def copy_block(block, values):
    """Write values into a block (rows, n) that has as many rows, and as many of each, or fewer."""
    for j in range(len(block)):
        copy_row(block[j], values[j])


@inline
def add_block(block, values):
    """Add values to a block (rows, n) that has as many rows, and as many of each, or fewer."""
    for j in range(len(block)):
        add_row(block[j], values[j])
