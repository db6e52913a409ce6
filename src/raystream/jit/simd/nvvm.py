"""LLVM's intrinsics in NVVM, CUDA's compiler: for numbers only, and some under other names."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from llvmlite import ir

#: Intrinsics that NVVM lacks, and their names in CUDA's library of device functions.
_LIBRARY = {
    "llvm.copysign.f32": "__nv_copysignf",
    "llvm.copysign.f64": "__nv_copysign",
    "llvm.fabs.f32": "__nv_fabsf",
    "llvm.fabs.f64": "__nv_fabs",
    "llvm.floor.f32": "__nv_floorf",
    "llvm.floor.f64": "__nv_floor",
    "llvm.sqrt.f32": "__nv_fsqrt_rn",
    "llvm.sqrt.f64": "__nv_dsqrt_rn",
}


def is_cuda(builder: Any) -> bool:
    """Whether code is generated for CUDA."""
    return str(builder.module.triple).startswith("nvptx")


def call_on_cuda(builder: Any, name: str, returns: Any, arguments: Sequence[Any]) -> Any:
    """Call an LLVM intrinsic of numbers, or of vectors lane by lane.

    Parameters
    ----------
    builder : IRBuilder
    name : str
        LLVM's name, such as ``llvm.fma.v8f32``.
    returns : Type
        A number or a vector.
    arguments : sequence of Value
        Numbers, or vectors with as many lanes; numbers are broadcast.
    """
    if not isinstance(returns, ir.VectorType):
        name = _LIBRARY.get(name, name)
        kind = ir.FunctionType(returns, [argument.type for argument in arguments])
        function = builder.module.globals.get(name)
        return builder.call(function or ir.Function(builder.module, kind, name), arguments)
    base, _, suffix = name.rpartition(".v")
    of_lanes = f"{base}.{suffix.lstrip('0123456789')}"
    result = ir.Constant(returns, ir.Undefined)
    for lane in range(returns.count):
        place = ir.Constant(ir.IntType(32), lane)
        numbers = [
            builder.extract_element(one, place) if isinstance(one.type, ir.VectorType) else one
            for one in arguments
        ]
        value = call_on_cuda(builder, of_lanes, returns.element, numbers)
        result = builder.insert_element(result, value, place)
    return result
