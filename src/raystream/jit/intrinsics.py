"""Intrinsics: single machine operations that Python cannot express."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numba
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.cpu import CPUContext
from numba.extending import intrinsic


@intrinsic
def no_inline(typing_context: Any) -> Any:
    """As the first statement of a function: LLVM must not inline it.

    For long functions that loops rarely call: inlined copies cost compile time, and registers of
    the loop.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        builder.function.attributes.add("noinline")
        return context.get_dummy_value()

    return types.void(), generate


def array_at(context: Any, builder: Any, array: Any, at: Any, shape: list[Any]) -> Any:
    """Generate an array at an address, without an owner; lengths are LLVM values."""
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
    """A read-only array of shape (?, 3, 3), float32, at an address.

    It has no owner, so that passing it costs nothing: the caller keeps the memory alive.
    Its length is unknown and indices are not checked.
    """
    if at != types.uint64:
        return None
    array = types.Array(types.float32, 3, "C", readonly=True)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        size = context.get_value_type(types.intp)
        return array_at(context, builder, array, arguments[0], [size(0), size(3), size(3)])

    return array(at), generate


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
    """Sum those of 64 uint64 at an address whose index is above k, or their popcounts."""
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
    """Sum of those of 64 uint64 at an address whose index is above k.

    All are read, as vectors: there is no branch to mispredict.
    """
    return _reduce_above(at, k, counts_bits=False)


@intrinsic
def bits_above(typing_context: Any, at: Any, k: Any) -> Any:
    """Population count of those of 64 uint64 at an address whose index is above k.

    All are read, as for `sum_above`.
    """
    return _reduce_above(at, k, counts_bits=True)


@intrinsic
def row_of(typing_context: Any, array: Any, row: Any) -> Any:
    """A row of a two-dimensional array, as a one-dimensional array without an owner.

    The caller keeps the memory alive.
    """
    if not isinstance(array, types.Array) or array.ndim != 2 or row != types.uint64:
        return None
    view = types.Array(array.dtype, 1, "C")

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        rows = context.make_array(array)(context, builder, arguments[0])
        offset = builder.mul(arguments[1], builder.extract_value(rows.strides, 0))
        start = builder.add(builder.ptrtoint(rows.data, offset.type), offset)
        width = builder.extract_value(rows.shape, 1)
        return array_at(context, builder, view, start, [width])

    return view(array, row), generate


@cache
def record_at(dtype: Any, width: int) -> Callable[[Any, Any], Any]:
    """Make a function (address, index) that gives a record of an array at an address.

    The record may be changed in place and has no owner; see `row_of`.

    Parameters
    ----------
    dtype : dtype
        Of a record, or of its elements if it has no fields.
    width : int
        Elements of a record without fields, which becomes an array of this length.
    """
    element = numba.from_dtype(dtype)
    is_record = isinstance(element, types.Record)
    made = element if is_record else types.Array(element, 1, "C")
    byte_count = dtype.itemsize * (1 if is_record else width)

    @intrinsic
    def read(typing_context, first, row):
        def generate(context, builder, signature, arguments):
            number = ir.IntType(64)
            offset = builder.mul(arguments[1], number(byte_count))
            at = builder.add(arguments[0], offset)
            if is_record:
                return builder.inttoptr(at, context.get_value_type(made))
            size = context.get_value_type(types.intp)
            return array_at(context, builder, made, at, [size(width)])

        return made(first, row), generate

    return read


@intrinsic
def call_filter(typing_context: Any, function: Any, arguments: Any) -> Any:
    """Call a function compiled by Numba at an address.

    Parameters
    ----------
    function : uint64
        The address of its code, which returns a uint64.
    arguments : tuple
        Its arguments. The first one is an address: a number there, a uint64, becomes 1 if the
        function raises.

    Returns
    -------
    uint64
        The result; any number if it raises.
    """
    if function != types.uint64 or not isinstance(arguments, types.BaseTuple):
        return None

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        if not isinstance(context, CPUContext):  # devices refuse scenes that have such functions
            return context.get_constant(types.uint64, 0)
        convention, of = context.call_conv, list(arguments.types)
        type_ = convention.get_function_type(types.uint64, of)
        called = builder.inttoptr(given[0], type_.as_pointer())
        result = cgutils.alloca_once(builder, type_.args[0].pointee)
        exception = cgutils.alloca_once(builder, type_.args[1].pointee)
        values = cgutils.unpack_tuple(builder, given[1])
        packed = context.get_arg_packer(of).as_arguments(builder, values)
        code = builder.call(called, [result, exception, *packed])
        raised = builder.icmp_signed("!=", code, ir.Constant(code.type, 0))
        with builder.if_then(raised, likely=False):
            number = ir.IntType(64)
            builder.store(number(1), builder.inttoptr(values[0], number.as_pointer()))
        return builder.load(result)

    return types.uint64(function, arguments), generate
