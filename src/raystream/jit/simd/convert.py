"""Conversions of vectors that keep the number of lanes, and of numbers."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from raystream.jit.simd.types import VectorType, llvm_type, refuse, vector_type


@intrinsic
def widen(typing_context: Any, x: Any) -> Any:
    """A float32 vector or number as float64; a float64 number as it is."""
    if x == types.float64:
        return x(x), _same
    if x == types.float32:
        return types.float64(x), _cast
    if not isinstance(x, VectorType) or x.kind != "f32":
        refuse("widen", "a float32 vector, or a number", x)
    result = vector_type("f64", x.lane_count)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.fpext(arguments[0], llvm_type(result))

    return result(x), generate


@intrinsic
def narrow(typing_context: Any, x: Any) -> Any:
    """A float64 vector or number as float32, rounded to nearest."""
    if x == types.float64:
        return types.float32(x), _cast
    if not isinstance(x, VectorType) or x.kind != "f64":
        refuse("narrow", "a float64 vector or number", x)
    return _narrowed(x)


@intrinsic
def narrow_lanes(typing_context: Any, x: Any) -> Any:
    """A float64 vector as float32; a number as it is.

    For functions of vectors and numbers: float32 is twice as fast in vectors, and a number may
    stay exact.
    """
    if x in (types.float32, types.float64):
        return x(x), _same
    if not isinstance(x, VectorType) or x.kind != "f64":
        refuse("narrow_lanes", "a float64 vector, or a number", x)
    return _narrowed(x)


@intrinsic
def widen_number(typing_context: Any, x: Any) -> Any:
    """A float32 number as float64, a float64 number and a float32 vector as they are."""
    if x == types.float64 or (isinstance(x, VectorType) and x.kind == "f32"):
        return x(x), _same
    if x != types.float32:
        refuse("widen_number", "a number, or a float32 vector", x)
    return types.float64(x), _cast


def _narrowed(x: Any) -> Any:
    result = vector_type("f32", x.lane_count)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.fptrunc(arguments[0], llvm_type(result))

    return result(x), generate


@intrinsic
def as_float32(typing_context: Any, x: Any) -> Any:
    """A float or 32-bit integer, vector or number, as float32, rounded to nearest."""
    if isinstance(x, VectorType) and x.is_float:
        return (x(x), _same) if x.kind == "f32" else _narrowed(x)
    if isinstance(x, types.Float):
        return types.float32(x), _cast
    if isinstance(x, VectorType) and x.kind in ("i32", "u32"):
        result = vector_type("f32", x.lane_count)
        to, unsigned = llvm_type(result), x.kind == "u32"
    elif x in (types.int32, types.uint32):
        result, to, unsigned = types.float32, ir.FloatType(), x == types.uint32
    else:
        refuse("as_float32", "a vector or number of floats, int32 or uint32", x)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return (builder.uitofp if unsigned else builder.sitofp)(arguments[0], to)

    return result(x), generate


@intrinsic
def as_int32(typing_context: Any, x: Any) -> Any:
    """A vector or number as int32: floats towards zero, larger integers by their lower bits.

    NaN, and floats outside of int32, give undefined values.
    """
    if isinstance(x, VectorType) and x.kind != "mask":
        result: Any = vector_type("i32", x.lane_count)
        to, is_float = llvm_type(result), x.is_float
    elif isinstance(x, types.Float | types.Integer):
        result, to, is_float = types.int32, ir.IntType(32), isinstance(x, types.Float)
    else:
        refuse("as_int32", "a vector or number", x)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        (value,) = arguments
        return builder.fptosi(value, to) if is_float else _resized(builder, value, to)

    return result(x), generate


@intrinsic
def as_uint32(typing_context: Any, x: Any) -> Any:
    """The lower 32 bits of an integer vector or number, as uint32."""
    if isinstance(x, VectorType) and x.kind in ("i32", "u32", "i64"):
        result: Any = vector_type("u32", x.lane_count)
        to = llvm_type(result)
    elif isinstance(x, types.Integer):
        result, to = types.uint32, ir.IntType(32)
    else:
        refuse("as_uint32", "a vector or number of integers", x)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _resized(builder, arguments[0], to)

    return result(x), generate


def _resized(builder: Any, value: Any, to: Any) -> Any:
    """Integers of 32 bits with the same lower bits."""
    given = value.type.element if isinstance(value.type, ir.VectorType) else value.type
    if given.width == 32:
        return value
    return builder.trunc(value, to) if given.width > 32 else builder.zext(value, to)


def _same(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    return arguments[0]


def _cast(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    return context.cast(builder, arguments[0], signature.args[0], signature.return_type)
