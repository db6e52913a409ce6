"""Loads and stores of interleaved records: one vector for each field of adjacent records."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from raystream.jit.simd.memory import pointer_to
from raystream.jit.simd.types import ELEMENTS, VectorClass, VectorType, refuse

_I32 = ir.IntType(32)


def _shuffle(builder: Any, a: Any, b: Any, lanes: list[int]) -> Any:
    places = ir.Constant(ir.VectorType(_I32, len(lanes)), lanes)
    return builder.shuffle_vector(a, b, places)


def _is_power_of_two(number: int) -> bool:
    return number >= 1 and number & (number - 1) == 0


@intrinsic
def store_records(typing_context: Any, at: Any, numbers: Any) -> Any:
    """Write adjacent records, one per lane, given a tuple of a vector per field.

    The tuple's length is a power of two.
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


@intrinsic
def load_triples(typing_context: Any, type_: Any, at: Any) -> Any:
    """Read as many adjacent (x, y, z) triples as a vector type has lanes; returns (xs, ys, zs)."""
    if not isinstance(type_, VectorClass) or at != types.uint64:
        return None
    vector = type_.instance_type
    if vector.kind == "mask":
        return None
    count = vector.lane_count
    result = types.UniTuple(vector, 3)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        wide = ir.VectorType(ELEMENTS[vector.kind][1], 3 * count)
        value = builder.load(pointer_to(builder, arguments[1], wide))
        value.align = int(vector.element.bitwidth) // 8
        undefined = ir.Constant(wide, ir.Undefined)
        axes = [
            _shuffle(builder, value, undefined, [3 * i + axis for i in range(count)])
            for axis in range(3)
        ]
        return cgutils.pack_array(builder, axes)

    return result(type_, at), generate


@intrinsic
def store_triples(typing_context: Any, at: Any, x: Any, y: Any, z: Any) -> Any:
    """Write as many adjacent (x, y, z) triples as three vectors have lanes."""
    if not isinstance(x, VectorType) or not x == y == z or at != types.uint64:
        return None
    if x.kind == "mask":
        return None
    count = x.lane_count

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        xs, ys, zs = arguments[1:]
        undefined = ir.Constant(xs.type, ir.Undefined)
        two = _shuffle(builder, xs, ys, list(range(2 * count)))
        rest = _shuffle(builder, zs, undefined, list(range(2 * count)))
        lanes = [axis * count + i for i in range(count) for axis in range(3)]
        wide = _shuffle(builder, two, rest, lanes)
        pointer = pointer_to(builder, arguments[0], wide.type)
        builder.store(wide, pointer).align = int(x.element.bitwidth) // 8
        return context.get_dummy_value()

    return types.void(at, x, y, z), generate
