"""Asking for records before they are needed, so that their loads wait side by side."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic


def _prefetch(typing_context: Any, records: Any, row: Any, offset: Any) -> Any:
    """
    Have the cache line fetched that holds byte *offset* of records[row]: prefetch(), for kernels.

    A load that misses the caches stops a core some dozens of instructions later; what is asked
    for in this way does not. It is a hint: a row that is not there does no harm. records is an
    array (n,) of records in one piece; row and offset are int64.

    """
    if not (isinstance(records, types.Array) and isinstance(records.dtype, types.Record)
            and (records.ndim, records.layout) == (1, 'C')):
        return None     # numba says that there is no such function
    return types.void(records, types.int64, types.int64), _instruction


def _instruction(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    """Write llvm.prefetch of data: to write to (1), to keep in all caches (3)."""
    kind, number = signature.args[0], ir.IntType(32)
    records = context.make_array(kind)(context, builder, arguments[0])
    byte = ir.IntType(8).as_pointer()
    size = ir.Constant(ir.IntType(64), kind.dtype.size)     # a record's, bytes
    place = builder.gep(builder.bitcast(records.data, byte),
                        [builder.add(builder.mul(arguments[1], size), arguments[2])])
    prefetch_line = builder.module.declare_intrinsic('llvm.prefetch', [byte], ir.FunctionType(
        ir.VoidType(), [byte, number, number, number]))
    builder.call(prefetch_line, [place, *(ir.Constant(number, n) for n in (1, 3, 1))])
    return context.get_dummy_value()


prefetch: Any = intrinsic(_prefetch)
