"""Single machine operations that Python has no word for."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

__all__ = [
    "array_at",
    "bits_above",
    "corners_at",
    "high_product",
    "int32_at",
    "no_inline",
    "row_address",
    "sum_above",
]


@intrinsic
def no_inline(typing_context: Any) -> Any:
    """As the first statement of a function: LLVM must call it and never copy it into a caller.

    For long functions that are rarely needed in loops: copies of them cost compile time, and
    registers of the loop.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        builder.function.attributes.add("noinline")
        return context.get_dummy_value()

    return types.void(), generate


def array_at(context: Any, builder: Any, array: Any, at: Any, shape: list[Any]) -> Any:
    """Generate an array without an owner that begins at an address; lengths are LLVM's."""
    size = context.get_value_type(types.intp)
    ary = context.make_array(array)(context, builder)
    element = context.get_data_type(array.dtype)
    itemsize = context.get_abi_sizeof(element)
    strides = [size(itemsize)]
    for length in shape[:0:-1]:
        strides.insert(0, builder.mul(strides[0], length))
    item_count = shape[0]
    for length in shape[1:]:
        item_count = builder.mul(item_count, length)
    attributes = {
        "data": builder.inttoptr(at, element.as_pointer()),
        "shape": cgutils.pack_array(builder, shape),
        "strides": cgutils.pack_array(builder, strides),
        "itemsize": size(itemsize),
        "nitems": item_count,
        "meminfo": None,
        "parent": None,
    }
    for name, value in attributes.items():
        empty = value is None
        setattr(ary, name, cgutils.get_null_value(getattr(ary, name).type) if empty else value)
    return ary._getvalue()


@intrinsic
def corners_at(typing_context: Any, at: Any) -> Any:
    """An array of shape (?, 3, 3), float32, that begins at an address, to be read only.

    It has no owner, so that handing it on costs nothing: the caller keeps the memory alive.
    Its length is not known; nothing checks indices.
    """
    if at != types.uint64:
        return None
    array = types.Array(types.float32, 3, "C", readonly=True)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        size = context.get_value_type(types.intp)
        return array_at(context, builder, array, arguments[0], [size(0), size(3), size(3)])

    return array(at), generate


@intrinsic
def int32_at(typing_context: Any, at: Any, count: Any) -> Any:
    """An array of `count` int32 that begins at an address, without an owner; see `corners_at`."""
    if at != types.uint64 or count != types.uint64:
        return None
    array = types.Array(types.int32, 1, "C")

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return array_at(context, builder, array, arguments[0], [arguments[1]])

    return array(at, count), generate


@intrinsic
def row_address(typing_context: Any, array: Any, row: Any) -> Any:
    """Address of a row of an array of two dimensions; or None of None.

    Numba has no type for a function that returns a number or None, by its argument's type,
    but one that may be either whenever it runs, and that is slow.
    """
    if isinstance(array, types.NoneType):
        return types.none(array, row), lambda context, *_: context.get_dummy_value()
    if not isinstance(array, types.Array) or array.ndim != 2 or row != types.uint64:
        return None

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        rows = context.make_array(array)(context, builder, arguments[0])
        offset = builder.mul(arguments[1], builder.extract_value(rows.strides, 0))
        return builder.add(builder.ptrtoint(rows.data, offset.type), offset)

    return types.uint64(array, row), generate


@intrinsic
def high_product(typing_context: Any, a: Any, b: Any) -> Any:
    """The upper 64 bits of the product of two uint64 numbers."""
    if a != types.uint64 or b != types.uint64:
        return None

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        wide = ir.IntType(128)
        factors = [builder.zext(argument, wide) for argument in arguments]
        return builder.trunc(
            builder.lshr(builder.mul(*factors), ir.Constant(wide, 64)), ir.IntType(64)
        )

    return types.uint64(a, b), generate


def _reduce_above(at: Any, k: Any, counts_bits: bool) -> Any:
    """Add up those of 64 numbers at an address whose place is above k, or their bits."""
    if at != types.uint64 or k != types.uint64:
        return None
    number = ir.IntType(64)
    vector = ir.VectorType(number, 64)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        values = builder.load(builder.inttoptr(arguments[0], vector.as_pointer()))
        values.align = 8
        if counts_bits:
            count = cgutils.get_or_insert_function(
                builder.module, ir.FunctionType(vector, [vector]), "llvm.ctpop.v64i64"
            )
            values = builder.call(count, [values])
        one = builder.insert_element(
            ir.Constant(vector, None), arguments[1], ir.Constant(number, 0)
        )
        limits = builder.shuffle_vector(
            one, one, ir.Constant(ir.VectorType(ir.IntType(32), 64), None)
        )
        above = builder.icmp_unsigned(">", ir.Constant(vector, list(range(64))), limits)
        kept = builder.select(above, values, ir.Constant(vector, None))
        add = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(number, [vector]), "llvm.vector.reduce.add.v64i64"
        )
        return builder.call(add, [kept])

    return types.uint64(at, k), generate


@intrinsic
def sum_above(typing_context: Any, at: Any, k: Any) -> Any:
    """Sum of those of 64 uint64 at an address that come after number k of them.

    All are read, in vectors: there is no branch that the machine would have to foresee.
    """
    return _reduce_above(at, k, counts_bits=False)


@intrinsic
def bits_above(typing_context: Any, at: Any, k: Any) -> Any:
    """How many bits are set in those of 64 uint64 at an address that come after number k of them.

    All are read, as for `sum_above`.
    """
    return _reduce_above(at, k, counts_bits=True)
