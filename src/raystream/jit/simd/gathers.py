"""Gather and scatter: one element of an array per lane, at any indices."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from raystream.jit.simd.memory import pointer_to
from raystream.jit.simd.nvvm import is_cuda
from raystream.jit.simd.types import (
    ELEMENTS,
    VectorType,
    llvm_type,
    mask_of,
    refuse,
    vector_type,
)

_I32 = ir.IntType(32)
_I64 = ir.IntType(64)


def _kind_of(number: Any) -> str | None:
    return next((kind for kind, (type_, _) in ELEMENTS.items() if type_ == number), None)


def _places(builder: Any, base: Any, element: Any, index: VectorType, indices: Any) -> Any:
    """LLVM vector of pointers to elements."""
    wide = ir.VectorType(_I64, index.lane_count)
    if index.kind == "u32":
        indices = builder.zext(indices, wide)
    elif index.kind == "i32":
        indices = builder.sext(indices, wide)
    # llvmlite supports this instruction with a single index: set the vector of indices afterwards.
    places = builder.gep(pointer_to(builder, base, element), [ir.Constant(_I64, 0)])
    places.indices = [indices]
    places.operands[1] = indices
    places.type = ir.VectorType(element.as_pointer(), index.lane_count)
    return places


def _is_index(index: Any) -> bool:
    return isinstance(index, VectorType) and index.kind in ("i32", "i64", "u32")


@intrinsic
def gather(typing_context: Any, type_: Any, base: Any, index: Any) -> Any:
    """Read elements of an array, given the address of its first one and their indices.

    ``gather(np.float32, base, index)`` with an index of 16 lanes is an `f32x16`; a number as
    index gives a number. All lanes are read, so each must lie in the array.
    """
    number: Any = type_.instance_type if isinstance(type_, types.NumberClass) else None
    kind = _kind_of(number)
    if kind is None or kind == "mask":
        refuse("gather", "a number type", type_)
    if base != types.uint64:
        refuse("gather", "a uint64 as address", base)
    if isinstance(index, types.Integer):
        return number(type_, base, index), _load_one
    if not _is_index(index):
        refuse("gather", "integers as positions", index)
    result = vector_type(kind, index.lane_count)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        element = ELEMENTS[kind][1]
        if _one_by_one(builder, index):
            return _load_lanes(builder, arguments[1], result, index, arguments[2])
        places = _places(builder, arguments[1], element, index, arguments[2])
        all_set = ir.Constant(llvm_type(mask_of(index)), [True] * index.lane_count)
        nothing = ir.Constant(llvm_type(result), ir.Undefined)
        size = ir.Constant(_I32, number.bitwidth // 8)
        name = f"llvm.masked.gather.v{index.lane_count}{_suffix(kind)}.v{index.lane_count}p0"
        return _call(builder, name, llvm_type(result), [places, size, all_set, nothing])

    return result(type_, base, index), generate


@intrinsic
def scatter(typing_context: Any, base: Any, index: Any, value: Any, mask: Any) -> Any:
    """Write lanes of a vector, or a number, to elements of an array.

    Parameters
    ----------
    base : uint64
        Address of the array's first element.
    index : vector of integers, or an integer
        Indices. Of lanes with the same index the last is written.
    value : vector or number
    mask : mask or bool
        Which lanes are written.
    """
    if base != types.uint64:
        refuse("scatter", "a uint64 as address", base)
    if isinstance(index, types.Integer) and mask == types.boolean:
        if _kind_of(value) is None:
            refuse("scatter", "a number", value)
        return types.void(base, index, value, mask), _store_one
    if not _is_index(index) or not isinstance(value, VectorType):
        refuse("scatter", "integers as positions of a vector's lanes", index, value)
    if mask != mask_of(value) or index.lane_count != value.lane_count:
        refuse("scatter", "as many positions and a mask of as many lanes", index, value, mask)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        element = ELEMENTS[value.kind][1]
        if _one_by_one(builder, index):
            _store_lanes(builder, arguments[0], value, index, arguments[1:])
            return context.get_dummy_value()
        places = _places(builder, arguments[0], element, index, arguments[1])
        size = ir.Constant(_I32, value.element.bitwidth // 8)
        lanes = value.lane_count
        name = f"llvm.masked.scatter.v{lanes}{_suffix(value.kind)}.v{lanes}p0"
        _call(builder, name, ir.VoidType(), [arguments[2], places, size, arguments[3]])
        return context.get_dummy_value()

    return types.void(base, index, value, mask), generate


def _one_by_one(builder: Any, index: VectorType) -> bool:
    """Whether lanes are read or written one at a time: NVVM has no instruction for vectors."""
    return index.lane_count == 1 or is_cuda(builder)


def _lane_places(builder: Any, base: Any, vector: VectorType, index: VectorType, given: Any) -> Any:
    """The number of each lane, and a pointer to its element."""
    first = pointer_to(builder, base, ELEMENTS[vector.kind][1])
    widened = builder.zext if index.kind == "u32" else builder.sext
    for k in range(index.lane_count):
        lane = ir.Constant(_I32, k)
        at = builder.extract_element(given, lane)
        yield lane, builder.gep(first, [at if index.kind == "i64" else widened(at, _I64)])


def _load_lanes(
    builder: Any, base: Any, vector: VectorType, index: VectorType, indices: Any
) -> Any:
    result = ir.Constant(llvm_type(vector), ir.Undefined)
    for lane, place in _lane_places(builder, base, vector, index, indices):
        loaded = builder.load(place)
        loaded.align = vector.element.bitwidth // 8
        result = builder.insert_element(result, loaded, lane)
    return result


def _store_lanes(
    builder: Any, base: Any, vector: VectorType, index: VectorType, arguments: Any
) -> None:
    indices, values, mask = arguments
    for lane, place in _lane_places(builder, base, vector, index, indices):
        with builder.if_then(builder.extract_element(mask, lane)):
            stored = builder.store(builder.extract_element(values, lane), place)
            stored.align = vector.element.bitwidth // 8


def _suffix(kind: str) -> str:
    return "i32" if kind == "u32" else kind


def _call(builder: Any, name: str, returns: Any, arguments: Any) -> Any:
    function = builder.module.globals.get(name)
    if function is None:
        kind = ir.FunctionType(returns, [argument.type for argument in arguments])
        function = ir.Function(builder.module, kind, name)
    return builder.call(function, arguments)


def _place(context: Any, builder: Any, base: Any, element: Any, type_: Any, index: Any) -> Any:
    at = context.cast(builder, index, type_, types.int64)
    return builder.gep(pointer_to(builder, base, element), [at])


def _load_one(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    element = context.get_data_type(signature.return_type)
    place = _place(context, builder, arguments[1], element, signature.args[2], arguments[2])
    value = builder.load(place)
    value.align = signature.return_type.bitwidth // 8
    return value


def _store_one(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    base, index, value, mask = arguments
    number = signature.args[2]
    with builder.if_then(mask):
        element = context.get_data_type(number)
        place = _place(context, builder, base, element, signature.args[1], index)
        builder.store(value, place).align = number.bitwidth // 8
    return context.get_dummy_value()
