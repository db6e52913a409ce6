"""Atomic operations on memory shared by threads, for the CPU and CUDA."""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from raystream.jit.cpu import device
from raystream.jit.simd.memory import load, pointer_to
from raystream.jit.simd.nvvm import is_cuda

_I32 = ir.IntType(32)
_I64 = ir.IntType(64)


def _call(builder: Any, name: str, returns: Any, *arguments: Any) -> Any:
    kind = ir.FunctionType(returns, [one.type for one in arguments])
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, name), list(arguments))


@intrinsic
def atomic_add_aggregated(typing_context: Any, at: Any, amount: Any) -> Any:
    """Atomically add to the uint32 at an address; returns nothing.

    On CUDA one thread adds for all threads of its warp that add to the same address at once:
    these must add the same number.
    """
    if at != types.uint64 or amount != types.uint32:
        return None

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        address, number = arguments
        place = pointer_to(builder, address, _I32)
        if not is_cuda(builder):
            builder.atomic_rmw("add", place, number, "monotonic")
            return context.get_dummy_value()
        # Opportunistic aggregation: the active threads, and those with the same address.
        here = ir.InlineAsm(ir.FunctionType(_I32, []), "activemask.b32 $0;", "=r", side_effect=True)
        mask = builder.call(here, [])
        alike = _call(builder, "llvm.nvvm.match.any.sync.i64", _I32, mask, address)
        first = _call(builder, "llvm.cttz.i32", _I32, alike, ir.Constant(ir.IntType(1), 1))
        lane = _call(builder, "llvm.nvvm.read.ptx.sreg.laneid", _I32)
        count = _call(builder, "llvm.ctpop.i32", _I32, alike)
        with builder.if_then(builder.icmp_unsigned("==", lane, first)):
            builder.atomic_rmw("add", place, builder.mul(number, count), "monotonic")
        return context.get_dummy_value()

    return types.void(at, amount), generate


@intrinsic
def _keep_greatest(typing_context: Any, at: Any, number: Any) -> Any:
    if at != types.uint64 or number != types.uint32:
        return None

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        place = pointer_to(builder, arguments[0], _I32)
        builder.atomic_rmw("umax", place, arguments[1], "monotonic")
        return context.get_dummy_value()

    return types.void(at, number), generate


@device
def atomic_max(at, number):
    """Atomically replace the uint32 at an address by the maximum of it and a number."""
    # The value only grows: a plain load tells most threads that they need not write.
    if load(np.uint32, at) < number:
        _keep_greatest(at, number)


@intrinsic
def compare_and_swap(typing_context: Any, at: Any, expected: Any, number: Any) -> Any:
    """Atomically replace the uint32 at an address if it is `expected`; returns the old value."""
    if at != types.uint64 or expected != types.uint32 or number != types.uint32:
        return None

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        place = pointer_to(builder, arguments[0], _I32)
        swapped = builder.cmpxchg(place, arguments[1], arguments[2], "monotonic", "monotonic")
        return builder.extract_value(swapped, 0)

    return types.uint32(at, expected, number), generate
