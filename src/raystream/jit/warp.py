"""Votes: what the threads of a warp tell each other, in one instruction.

The same words for the CPU and for CUDA. On the CPU a thread is alone: a warp of one.
"""

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

#: Of the four kinds of vote that NVVM has: the one whose result is who said yes.
_BALLOT = 3


@intrinsic
def active_mask(typing_context: Any) -> Any:
    """The threads of the warp that are here: a bit for each, uint32."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        if not is_cuda(builder):
            return ir.Constant(_I32, 1)
        kind = ir.FunctionType(_I32, [])
        return builder.call(ir.InlineAsm(kind, "activemask.b32 $0;", "=r", side_effect=True), [])

    return types.uint32(), generate


@intrinsic
def ballot(typing_context: Any, voters: Any, says_yes: Any) -> Any:
    """Which of some threads say yes: a bit for each, uint32.

    `voters` is what `active_mask` returned. All of these threads have to come here, however often
    they vote: who returns before the others leaves them waiting.
    """
    if voters != types.uint32 or says_yes != types.boolean:
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

    return types.uint32(voters, says_yes), generate
