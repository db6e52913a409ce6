"""Records: a few adjacent numbers of each of many things, as one vector for each number."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from raystream.jit.simd.memory import pointer_to
from raystream.jit.simd.types import ELEMENTS, VectorClass, VectorType, refuse

__all__ = ["load_records", "store_records"]

_I32 = ir.IntType(32)


def _shuffle(builder: Any, a: Any, b: Any, lanes: list[int]) -> Any:
    places = ir.Constant(ir.VectorType(_I32, len(lanes)), lanes)
    return builder.shuffle_vector(a, b, places)


def _is_power_of_two(number: int) -> bool:
    return number >= 1 and number & (number - 1) == 0


@intrinsic(prefer_literal=True)
def load_records(typing_context: Any, type_: Any, size: Any, at: Any) -> Any:
    """Read as many records as a vector type has lanes; returns a vector for each number.

    `size` is how many numbers a record has, a constant power of two: 2, 4, 8 or 16.
    """
    vector = type_.instance_type if isinstance(type_, VectorClass) else None
    if vector is None or vector.kind == "mask":
        refuse("load_records", "a vector type", type_)
    if not isinstance(size, types.IntegerLiteral) or not _is_power_of_two(size.literal_value):
        refuse("load_records", "a constant power of two", size)
    count, lanes = size.literal_value, vector.lane_count
    result = types.UniTuple(vector, count)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        element = ELEMENTS[vector.kind][1]
        pointer = pointer_to(builder, arguments[2], ir.VectorType(element, lanes))
        parts = []
        for k in range(count):
            part = builder.load(builder.gep(pointer, [ir.Constant(_I32, k)]))
            part.align = int(vector.element.bitwidth) // 8
            parts.append(part)
        # Each round parts even from odd places; after all of them, a vector has one number.
        even = [2 * k for k in range(lanes)]
        odd = [2 * k + 1 for k in range(lanes)]
        rounds = count.bit_length() - 1
        for _ in range(rounds):
            pairs = list(zip(parts[::2], parts[1::2], strict=True))
            parts = [_shuffle(builder, a, b, even) for a, b in pairs]
            parts += [_shuffle(builder, a, b, odd) for a, b in pairs]
        return cgutils.pack_array(builder, parts)

    return result(type_, size, at), generate


@intrinsic
def store_records(typing_context: Any, at: Any, numbers: Any) -> Any:
    """Write records, one for each lane, given a tuple of a vector for each of their numbers.

    The tuple's length is a power of two, as `load_records` has it.
    """
    if at != types.uint64:
        refuse("store_records", "a uint64 as address", at)
    vector = numbers.dtype if isinstance(numbers, types.UniTuple) else None
    if not isinstance(vector, VectorType) or vector.kind == "mask":
        refuse("store_records", "a tuple of vectors of one type", numbers)
    if not _is_power_of_two(numbers.count):
        refuse("store_records", "a power of two of vectors", numbers)
    count, lanes = numbers.count, vector.lane_count

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        parts = cgutils.unpack_tuple(builder, arguments[1], count)
        low = [k // 2 + k % 2 * lanes for k in range(lanes)]
        high = [lanes // 2 + k for k in low]
        rounds = count.bit_length() - 1
        for _ in range(rounds):
            half = count // 2
            pairs = list(zip(parts[:half], parts[half:], strict=True))
            parts = [_shuffle(builder, a, b, places) for a, b in pairs for places in (low, high)]
        element = ELEMENTS[vector.kind][1]
        pointer = pointer_to(builder, arguments[0], ir.VectorType(element, lanes))
        for k, part in enumerate(parts):
            written = builder.store(part, builder.gep(pointer, [ir.Constant(_I32, k)]))
            written.align = int(vector.element.bitwidth) // 8
        return context.get_dummy_value()

    return types.void(at, numbers), generate
