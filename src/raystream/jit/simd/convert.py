"""Conversions that keep the number of lanes, whatever it is."""

from __future__ import annotations

from typing import Any

from numba.extending import intrinsic

from raystream.jit.simd.types import VectorType, llvm_type, refuse, vector_type

__all__ = ["narrow", "widen"]


@intrinsic
def widen(typing_context: Any, x: Any) -> Any:
    """A float32 vector as float64."""
    if not isinstance(x, VectorType) or x.kind != "f32":
        refuse("widen", "a float32 vector", x)
    result = vector_type("f64", x.lane_count)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.fpext(arguments[0], llvm_type(result))

    return result(x), generate


@intrinsic
def narrow(typing_context: Any, x: Any) -> Any:
    """A float64 vector as float32, rounded to nearest."""
    if not isinstance(x, VectorType) or x.kind != "f64":
        refuse("narrow", "a float64 vector", x)
    result = vector_type("f32", x.lane_count)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.fptrunc(arguments[0], llvm_type(result))

    return result(x), generate
