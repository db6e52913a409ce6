"""Points and directions: adjacent (x, y, z) triples as one vector for each axis."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from raystream.jit.simd.memory import pointer_to
from raystream.jit.simd.types import ELEMENTS, VectorClass, VectorType, llvm_type

__all__ = ["load_triples", "store_nontemporal", "store_triples"]


@intrinsic
def load_triples(typing_context: Any, type_: Any, at: Any) -> Any:
    """Read as many (x, y, z) triples as a vector type has lanes; returns (xs, ys, zs)."""
    if not isinstance(type_, VectorClass) or at != types.uint64:
        return None
    vector = type_.instance_type
    if vector.kind == "mask":
        return None
    count = vector.lane_count
    result = types.UniTuple(vector, 3)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        i32 = ir.IntType(32)
        wide = ir.VectorType(ELEMENTS[vector.kind][1], 3 * count)
        value = builder.load(pointer_to(builder, arguments[1], wide))
        value.align = int(vector.element.bitwidth) // 8
        undefined = ir.Constant(wide, ir.Undefined)
        axes = []
        for axis in range(3):
            lanes = ir.Constant(ir.VectorType(i32, count), [3 * i + axis for i in range(count)])
            axes.append(builder.shuffle_vector(value, undefined, lanes))
        assert axes[0].type == llvm_type(vector)
        return cgutils.pack_array(builder, axes)

    return result(type_, at), generate


@intrinsic
def store_triples(typing_context: Any, at: Any, x: Any, y: Any, z: Any) -> Any:
    """Write as many (x, y, z) triples as three vectors have lanes, one after the other."""
    if not isinstance(x, VectorType) or not x == y == z or at != types.uint64:
        return None
    if x.kind == "mask":
        return None
    count = x.lane_count

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        i32, element = ir.IntType(32), ELEMENTS[x.kind][1]

        def shuffled(a: Any, b: Any, lanes: list[int]) -> Any:
            places = ir.Constant(ir.VectorType(i32, len(lanes)), lanes)
            return builder.shuffle_vector(a, b, places)

        xs, ys, zs = arguments[1:]
        undefined = ir.Constant(xs.type, ir.Undefined)
        two = shuffled(xs, ys, list(range(2 * count)))
        rest = shuffled(zs, undefined, list(range(2 * count)))
        lanes = [axis * count + i for i in range(count) for axis in range(3)]
        wide = shuffled(two, rest, lanes)
        pointer = pointer_to(builder, arguments[0], ir.VectorType(element, 3 * count))
        builder.store(wide, pointer).align = int(x.element.bitwidth) // 8
        return context.get_dummy_value()

    return types.void(at, x, y, z), generate


@intrinsic
def store_nontemporal(typing_context: Any, at: Any, value: Any) -> Any:
    """Write a vector that nothing will read soon, without fetching its cache line first.

    The address must be a multiple of the vector's size.
    """
    if not isinstance(value, VectorType) or value.kind == "mask" or at != types.uint64:
        return None

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pointer = pointer_to(builder, arguments[0], llvm_type(value))
        written = builder.store(arguments[1], pointer)
        written.align = int(value.element.bitwidth) // 8 * value.lane_count
        one = ir.Constant(ir.IntType(32), 1)
        written.set_metadata("nontemporal", builder.module.add_metadata([one]))
        return context.get_dummy_value()

    return types.void(at, value), generate
