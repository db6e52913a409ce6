"""Results of users' functions: checked when a loop around them is compiled."""

from __future__ import annotations

import enum
from collections.abc import Callable
from functools import cache
from typing import Any

from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from raystream.jit.user_loops import fault

#: A dtype's name, or a tuple of such: a vector, the fields of a record, several records.
Shape = str | tuple[Any, ...]


@cache
def accept(shape: Shape, place: str) -> Callable[[Any], Any]:
    """Make a function that accepts the result of a user's function other than None.

    At compile time it checks the result's type, as NumPy does for an assignment with casting
    "same_kind", except that any integer may become any other.

    Parameters
    ----------
    shape : str or tuple
        Required type of the result.
    place : str
        Destination of the result, for the error.
    """

    @intrinsic
    def accepted(typing_context, result):
        given = result.type if isinstance(result, types.Optional) else result
        if given == types.none:
            raise fault(f"it never returns a record for {place}, only None")
        _check(given, shape, place)

        def generate(context, builder, signature, arguments):
            if isinstance(result, types.Optional):
                return context.cast(builder, arguments[0], result, given)
            return arguments[0]

        return given(result), generate

    return accepted


def _check(given: Any, shape: Shape, place: str) -> None:
    if isinstance(shape, tuple):
        if not isinstance(given, types.BaseTuple):
            raise fault(f"it returns {given}, and {place} takes a tuple of {len(shape)}")
        if len(given) != len(shape):
            raise fault(
                f"it returns a tuple of {len(given)}, and {place} takes a tuple of {len(shape)}"
            )
        for part, expected in zip(given.types, shape, strict=True):
            _check(part, expected, place)
        return
    if not _fits(given, shape):
        raise fault(f"it returns {given}, and {place} takes {shape}")


def _fits(given: Any, dtype: str) -> bool:
    """Whether a value may be stored as a dtype."""
    if isinstance(given, types.Boolean):
        return True
    kinds: tuple[Any, ...] = ()
    if dtype.startswith(("int", "uint")):
        kinds = (types.Integer,)
    elif dtype.startswith("float"):
        kinds = (types.Integer, types.Float)
    elif dtype.startswith("complex"):
        kinds = (types.Number,)
    return isinstance(given, kinds)


@cache
def accept_decision(decisions: type[enum.IntEnum], takes_bool: bool) -> Callable[[Any], Any]:
    """Make a function that converts a user's decision to int64.

    None becomes 0. Results of other types are an error at compile time.

    Parameters
    ----------
    decisions : type of IntEnum
    takes_bool : bool
        Whether booleans are accepted: true becomes 0, and false the largest decision.
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
