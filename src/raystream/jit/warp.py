"""Warp votes, for CUDA and the CPU, where a warp is one thread."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from raystream.jit.simd.nvvm import is_cuda

__all__ = ["active_mask", "ballot"]

_I32 = ir.IntType(32)
_I1 = ir.IntType(1)

#: NVVM's number of the vote that returns a mask.
_BALLOT = 3


@intrinsic
def active_mask(typing_context: Any) -> Any:
    """Mask of the warp's active threads, uint32."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        if not is_cuda(builder):
            return ir.Constant(_I32, 1)
        kind = ir.FunctionType(_I32, [])
        return builder.call(ir.InlineAsm(kind, "activemask.b32 $0;", "=r", side_effect=True), [])

    return types.uint32(), generate


@intrinsic
def ballot(typing_context: Any, voters: Any, predicate: Any) -> Any:
    """Mask of the threads among `voters` whose predicate is true, uint32.

    `voters` is a mask from `active_mask`. All of these threads must call it equally often: a
    thread that returns early leaves the others waiting.
    """
    if voters != types.uint32 or predicate != types.boolean:
        return None

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        mask, flag = arguments
        if flag.type != _I1:
            flag = builder.trunc(flag, _I1)
        if not is_cuda(builder):
            return builder.zext(flag, _I32)
        result = ir.LiteralStructType([_I32, _I1])
        kind = ir.FunctionType(result, [_I32, _I32, _I1])
        vote = cgutils.get_or_insert_function(builder.module, kind, "llvm.nvvm.vote.sync")
        said = builder.call(vote, [mask, ir.Constant(_I32, _BALLOT), flag])
        return builder.extract_value(said, 0)

    return types.uint32(voters, predicate), generate
