"""Memory that several threads write to: counting in it, and the order in which writes are seen.

The same words for the CPU and for CUDA: kernels that use them run on both.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from raystream.jit.simd.cuda_names import is_cuda
from raystream.jit.simd.memory import pointer_to

__all__ = ["add_atomically", "fence"]


@intrinsic
def add_atomically(typing_context: Any, at: Any, amount: Any) -> Any:
    """Add to the uint32 at an address, in one step for all threads; returns what was there."""
    if at != types.uint64 or amount != types.uint32:
        return None

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pointer = pointer_to(builder, arguments[0], ir.IntType(32))
        return builder.atomic_rmw("add", pointer, arguments[1], "monotonic")

    return types.uint32(at, amount), generate


@intrinsic
def fence(typing_context: Any) -> Any:
    """Whatever this thread wrote before is seen by all before what it writes after."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        if is_cuda(builder):
            name = "llvm.nvvm.membar.gl"
            function = builder.module.globals.get(name) or ir.Function(
                builder.module, ir.FunctionType(ir.VoidType(), []), name
            )
            builder.call(function, [])
        else:
            builder.fence("seq_cst")
        return context.get_dummy_value()

    return types.void(), generate
