"""What loops around programs need: decisions as numbers, and payload records without an owner."""

from __future__ import annotations

import enum
from collections.abc import Callable
from functools import cache
from typing import Any

import numba
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from raystream.jit.intrinsics import array_at
from raystream.jit.loops import fault

__all__ = ["accept_decision", "record_at", "row_of"]


@cache
def accept_decision(decisions: type[enum.IntEnum], takes_bool: bool) -> Callable[[Any], Any]:
    """Make a function that turns the result of a user's function into an int64.

    None becomes 0. Another result than a decision is an error when the loop is compiled.

    Parameters
    ----------
    decisions : type of IntEnum
    takes_bool : bool
        Whether it may be a boolean, which becomes 0 for true and the last decision for false.
    """

    @intrinsic
    def accepted(typing_context, result):
        given = result.type if isinstance(result, types.Optional) else result
        is_bool = isinstance(given, types.Boolean)
        is_decision = isinstance(given, types.IntEnumMember) and given.instance_class is decisions
        if not (is_decision or given == types.none or (is_bool and takes_bool)):
            names = ", ".join(decision.name for decision in decisions)
            wanted = f"True, False, {names}" if takes_bool else names
            raise fault(f"it returns {given}; expected one of {wanted}, or None")
        no_value = int(max(decisions))

        def generate(context, builder, signature, arguments):
            nothing = context.get_constant(types.int64, 0)
            if given == types.none:
                return nothing
            value, is_valid = arguments[0], None
            if isinstance(result, types.Optional):
                pair = context.make_helper(builder, result, value=value)
                value, is_valid = pair.data, pair.valid
            if is_bool:
                falsity = context.get_constant(types.int64, no_value)
                value = builder.select(cgutils.is_true(builder, value), nothing, falsity)
            else:
                value = context.cast(builder, value, given.dtype, types.int64)
            if is_valid is None:
                return value
            return builder.select(cgutils.as_bool_bit(builder, is_valid), value, nothing)

        return types.int64(result), generate

    return accepted


@intrinsic
def row_of(typing_context: Any, array: Any, row: Any) -> Any:
    """A row of an array of two dimensions, as an array of one.

    It has no owner, so that handing it on costs nothing: the caller keeps the memory alive.
    """
    if not isinstance(array, types.Array) or array.ndim != 2 or row != types.uint64:
        return None
    view = types.Array(array.dtype, 1, "C")

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        rows = context.make_array(array)(context, builder, arguments[0])
        offset = builder.mul(arguments[1], builder.extract_value(rows.strides, 0))
        start = builder.add(builder.ptrtoint(rows.data, offset.type), offset)
        width = builder.extract_value(rows.shape, 1)
        made = context.make_array(view)(context, builder)
        made.data = builder.inttoptr(start, made.data.type)
        made.shape = cgutils.pack_array(builder, [width])
        made.strides = cgutils.pack_array(builder, [rows.itemsize])
        made.itemsize, made.nitems = rows.itemsize, width
        for owner in ("meminfo", "parent"):
            setattr(made, owner, cgutils.get_null_value(getattr(made, owner).type))
        return made._getvalue()

    return view(array, row), generate


@cache
def record_at(dtype: Any, width: int) -> Callable[[Any, Any], Any]:
    """Make a function that reads where records lie: (address of the first one, which).

    It returns a record, to be changed in place, without an owner; see `row_of`.

    Parameters
    ----------
    dtype : dtype
        Of a record, or of its numbers if it has no fields.
    width : int
        Numbers of a record that has no fields: it becomes an array of so many.
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
