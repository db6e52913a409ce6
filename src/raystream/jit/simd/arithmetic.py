"""Operators of vectors, and elementwise functions that are exact or rounded once."""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core.errors import TypingError
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import intrinsic, lower_builtin

from raystream.jit.simd.nvvm import call_on_cuda, is_cuda
from raystream.jit.simd.types import (
    VECTORS,
    VectorType,
    broadcast,
    constant,
    llvm_type,
    mask_of,
    refuse,
)

_FLOATS = ("f32", "f64")
_INTEGERS = ("i32", "i64", "u32")
_NUMBERS = (*_FLOATS, *_INTEGERS)


def _operand(value: Any, vector: VectorType) -> bool:
    """Whether a value can be combined with a vector: the same type, or a number of its lanes' type.

    A number of another type is refused, so that no float64 slips into float32 arithmetic;
    integer literals are taken if they fit, with or without a sign.
    """
    if value == vector:
        return True
    if vector.kind in _INTEGERS and isinstance(value, types.IntegerLiteral):
        bits = int(vector.kind[1:])
        return bool(-(2 ** (bits - 1)) <= value.literal_value < 2**bits)
    return bool(value == vector.element)


def common(*args: Any) -> VectorType | None:
    """The common vector type of operands; None if they cannot be combined."""
    vector = next((type_ for type_ in args if isinstance(type_, VectorType)), None)
    return vector if vector and all(_operand(type_, vector) for type_ in args) else None


def one_lane(type_: Any) -> VectorType | None:
    """A vector type whose lanes are numbers of a type, or None."""
    return next((v for v in VECTORS.values() if type_ == v.element), None)


def as_vectors(
    context: Any, builder: Any, vector: VectorType, types_: Any, values: Any
) -> list[Any]:
    """Operands as LLVM vectors."""
    return [
        value
        if type_ == vector
        else broadcast(
            builder, context.cast(builder, value, type_, vector.element), vector.lane_count
        )
        for type_, value in zip(types_, values, strict=True)
    ]


def as_numbers(context: Any, builder: Any, number: Any, types_: Any, values: Any) -> list[Any]:
    """Numbers as LLVM values of one type."""
    pairs = zip(types_, values, strict=True)
    return [context.cast(builder, value, type_, number) for type_, value in pairs]


def _binary(
    function: Any,
    kinds: tuple[str, ...],
    generate: Callable[[Any, VectorType, Any, Any], Any],
    gives_mask: bool = False,
) -> None:
    """Define an operator for vectors of some kinds."""

    class Template(AbstractTemplate):
        def generic(self, args: Any, kws: Any) -> Any:
            if len(args) != 2 or not any(isinstance(type_, VectorType) for type_ in args):
                return None
            vector = common(*args)
            if vector is None:
                raise TypingError(
                    f"{function.__name__} of {args[0]} and {args[1]}: a vector goes with its own "
                    "type and with numbers of its lanes' type, such as float32(x)"
                )
            if vector.kind not in kinds:
                raise TypingError(f"{vector} has no {function.__name__}")
            return signature(mask_of(vector) if gives_mask else vector, *args)

    infer_global(function)(Template)

    def lower(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        vector = common(*signature.args)
        if vector is None:
            raise TypeError("no vector operand")
        x, y = as_vectors(context, builder, vector, signature.args, arguments)
        return generate(builder, vector, x, y)

    lower_builtin(function, VectorType, VectorType)(lower)
    for number in (types.Number, types.Boolean):
        lower_builtin(function, VectorType, number)(lower)
        lower_builtin(function, number, VectorType)(lower)


def _shift_right(builder: Any, vector: VectorType, x: Any, y: Any) -> Any:
    return builder.lshr(x, y) if vector.kind == "u32" else builder.ashr(x, y)


def _by_kind(float_name: str, integer_name: str) -> Callable[[Any, VectorType, Any, Any], Any]:
    def generate(builder: Any, vector: VectorType, x: Any, y: Any) -> Any:
        return getattr(builder, float_name if vector.is_float else integer_name)(x, y)

    return generate


def _integer(name: str) -> Callable[[Any, VectorType, Any, Any], Any]:
    return lambda builder, vector, x, y: getattr(builder, name)(x, y)


def _comparison(sign: str) -> Callable[[Any, VectorType, Any, Any], Any]:
    def generate(builder: Any, vector: VectorType, x: Any, y: Any) -> Any:
        if vector.kind == "u32":
            return builder.icmp_unsigned(sign, x, y)
        if not vector.is_float:
            return builder.icmp_signed(sign, x, y)
        # As in Python, a comparison with NaN is false, except that NaN != anything.
        if sign == "!=":
            return builder.fcmp_unordered(sign, x, y)
        return builder.fcmp_ordered(sign, x, y)

    return generate


for _functions, _kinds, _generate in (
    ((operator.add, operator.iadd), _NUMBERS, _by_kind("fadd", "add")),
    ((operator.sub, operator.isub), _NUMBERS, _by_kind("fsub", "sub")),
    ((operator.mul, operator.imul), _NUMBERS, _by_kind("fmul", "mul")),
    ((operator.truediv, operator.itruediv), _FLOATS, _by_kind("fdiv", "fdiv")),
    ((operator.and_, operator.iand), (*_INTEGERS, "mask"), _integer("and_")),
    ((operator.or_, operator.ior), (*_INTEGERS, "mask"), _integer("or_")),
    ((operator.xor, operator.ixor), (*_INTEGERS, "mask"), _integer("xor")),
    ((operator.lshift, operator.ilshift), _INTEGERS, _integer("shl")),
    ((operator.rshift, operator.irshift), _INTEGERS, _shift_right),
):
    for _function in _functions:
        _binary(_function, _kinds, _generate)
for _function, _sign in (
    (operator.lt, "<"),
    (operator.le, "<="),
    (operator.gt, ">"),
    (operator.ge, ">="),
    (operator.eq, "=="),
    (operator.ne, "!="),
):
    _binary(_function, _NUMBERS, _comparison(_sign), gives_mask=True)


def _unary(
    function: Any, kinds: tuple[str, ...], generate: Callable[[Any, VectorType, Any], Any]
) -> None:
    """Define an operator of one vector of some kinds."""

    class Template(AbstractTemplate):
        def generic(self, args: Any, kws: Any) -> Any:
            if len(args) != 1 or not isinstance(args[0], VectorType):
                return None
            if args[0].kind not in kinds:
                raise TypingError(f"{args[0]} has no {function.__name__}")
            return signature(args[0], args[0])

    infer_global(function)(Template)

    @lower_builtin(function, VectorType)
    def lower(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return generate(builder, signature.args[0], arguments[0])


def _negate(builder: Any, vector: VectorType, x: Any) -> Any:
    if vector.is_float and is_cuda(builder):  # whose compiler is of the time before that word
        return builder.fsub(constant(vector, -0.0), x)
    return builder.fneg(x) if vector.is_float else builder.neg(x)


_unary(operator.neg, _NUMBERS, _negate)
_unary(operator.invert, (*_INTEGERS, "mask"), lambda builder, vector, x: builder.not_(x))


def call_intrinsic(builder: Any, name: str, returns: Any, arguments: Any) -> Any:
    """Call an LLVM intrinsic; a name that LLVM does not know crashes the process.

    NVVM supports few of them: none of vectors, and some under names of its own.
    """
    if is_cuda(builder):
        return call_on_cuda(builder, name, returns, arguments)
    function = builder.module.globals.get(name)
    if function is None:
        kind = ir.FunctionType(returns, [argument.type for argument in arguments])
        function = ir.Function(builder.module, kind, name)
    return builder.call(function, arguments)


def _llvm_name(base: str, vector: VectorType) -> str:
    return f"llvm.{base}.v{vector.lane_count}{vector.kind}"


@intrinsic
def fma(typing_context: Any, x: Any, y: Any, z: Any) -> Any:
    """``x * y + z`` of float vectors or numbers of one type, rounded once (IEEE 754)."""
    given = (x, y, z)
    number = one_lane(x) if x == y == z else None
    if number is not None and number.is_float:
        result = llvm_type(number).element

        def generate_scalar(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return call_intrinsic(builder, f"llvm.fma.{number.kind}", result, arguments)

        return x(*given), generate_scalar
    vector = common(*given)
    if vector is None or not vector.is_float:
        wanted = "float vectors of one type and numbers of its lanes' type, or numbers of one type"
        refuse("fma", wanted, *given)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        values = as_vectors(context, builder, vector, signature.args, arguments)
        return call_intrinsic(builder, _llvm_name("fma", vector), llvm_type(vector), values)

    return vector(*given), generate


def wider(x: Any, y: Any) -> Any:
    """The common type of two numbers, float64 for two floats; None for other types."""
    if x == y and one_lane(x) is not None:
        return x
    floats = isinstance(x, types.Float) and isinstance(y, types.Float)
    return types.float64 if floats else None


def _choose(name: str, sign: str, x: Any, y: Any) -> Any:
    number = wider(x, y)
    vector = common(x, y) if number is None else one_lane(number)
    if vector is None or vector.kind == "mask":
        refuse(name, "vectors or numbers of one type, or one and a number of its lanes'", x, y)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        if number is None:
            a, b = as_vectors(context, builder, vector, signature.args, arguments)
        else:
            a, b = as_numbers(context, builder, number, signature.args, arguments)
        return builder.select(_comparison(sign)(builder, vector, a, b), a, b)

    return (number or vector)(x, y), generate


@intrinsic
def minimum(typing_context: Any, x: Any, y: Any) -> Any:
    """``x if x < y else y``, lane by lane: y where either is NaN; one instruction on x86."""
    return _choose("minimum", "<", x, y)


@intrinsic
def maximum(typing_context: Any, x: Any, y: Any) -> Any:
    """``x if x > y else y``, lane by lane: y where either is NaN; one instruction on x86."""
    return _choose("maximum", ">", x, y)


def _of_floats(function: str, name: str, x: Any) -> Any:
    """Call an LLVM function of a float vector or number."""
    vector = x if isinstance(x, VectorType) else one_lane(x)
    if vector is None or not vector.is_float:
        refuse(function, "a float vector or number", x)
    suffix = vector.kind if x != vector else f"v{vector.lane_count}{vector.kind}"

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        (value,) = arguments
        return call_intrinsic(builder, f"llvm.{name}.{suffix}", value.type, arguments)

    return x(x), generate


@intrinsic
def absolute(typing_context: Any, x: Any) -> Any:
    """Magnitude of a float vector's lanes, or of a float."""
    return _of_floats("absolute", "fabs", x)


@intrinsic
def square_root(typing_context: Any, x: Any) -> Any:
    """Square root of a float vector's lanes, or of a float, rounded to nearest; NaN below 0."""
    return _of_floats("square_root", "sqrt", x)


@intrinsic
def floor(typing_context: Any, x: Any) -> Any:
    """The largest integer not above a float, or above each lane of a float vector."""
    return _of_floats("floor", "floor", x)


@intrinsic
def copy_sign(typing_context: Any, x: Any, y: Any) -> Any:
    """The magnitudes of x with the signs of y (of -0 too), lane by lane, or of numbers."""
    vector = x if isinstance(x, VectorType) else one_lane(x)
    if vector is None or not vector.is_float or x != y:
        refuse("copy_sign", "two float vectors or numbers of one type", x, y)
    suffix = vector.kind if x != vector else f"v{vector.lane_count}{vector.kind}"

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kind = arguments[0].type
        return call_intrinsic(builder, f"llvm.copysign.{suffix}", kind, arguments)

    return x(x, y), generate
