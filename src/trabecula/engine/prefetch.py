"""Rows that are read soon, asked for within kernels: places at random in a large table come from
the memory, which gives many at once where it is asked early.
"""

from __future__ import annotations

import numpy as np
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic, overload


def fetch_row(table: np.ndarray, row: int) -> None:
    """Ask for the beginning of a row of a contiguous table (N, D), whose number is not checked.
    Nothing is done where kernels are not compiled.
    """


@overload(fetch_row)
def _fetch_row(table, row):  # type: ignore[no-untyped-def]
    def compiled(table, row):  # type: ignore[no-untyped-def]
        _prefetch(table, np.intp(row) * table.shape[1])

    return compiled


@intrinsic
def _prefetch(typing_context, table, place):  # type: ignore[no-untyped-def]
    """Compile to the instruction of the processor, for reading, into all caches."""

    def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        array = context.make_array(signature.args[0])(context, builder, arguments[0])
        byte = ir.IntType(8).as_pointer()
        address = builder.bitcast(builder.gep(array.data, [arguments[1]]), byte)
        number = ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [byte, number, number, number])
        ask = builder.module.declare_intrinsic("llvm.prefetch", [byte], kind)
        builder.call(ask, [address, number(0), number(3), number(1)])
        return context.get_dummy_value()

    return types.void(table, types.intp), generate
