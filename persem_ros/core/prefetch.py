"""Asking for a record before it is needed, so that its loads wait side by side."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic


@intrinsic      # type: ignore[untyped-decorator]
def prefetch(typing_context: Any, records: Any, row: Any, offset: Any) -> Any:
    """
    Have the cache line fetched that holds byte *offset* of records[row], for kernels.

    A load that misses the caches keeps a core from going on a few dozen instructions later; what
    is asked for in this way does not. It is a hint: a row that is not there does no harm.

    """
    if not (isinstance(records, types.Array) and isinstance(records.dtype, types.Record)):
        return None
    return types.void(records, types.int64, types.int64), _prefetch


def _prefetch(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    """Write the instruction llvm.prefetch: to write to, and to keep in all caches."""
    kind, number = signature.args[0], ir.IntType(32)
    records = context.make_array(kind)(context, builder, arguments[0])
    byte = ir.IntType(8).as_pointer()
    size = ir.Constant(ir.IntType(64), kind.dtype.size)     # a record's, bytes
    place = builder.gep(builder.bitcast(records.data, byte),
                        [builder.add(builder.mul(arguments[1], size), arguments[2])])
    call = builder.module.declare_intrinsic('llvm.prefetch', [byte], ir.FunctionType(
        ir.VoidType(), [byte, number, number, number]))
    builder.call(call, [place, ir.Constant(number, 1), ir.Constant(number, 3),
                        ir.Constant(number, 1)])
    return context.get_dummy_value()
