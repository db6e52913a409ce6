"""Loads and stores by address.

Addresses are uint64 numbers: no bounds, strides or wrap-around of negative indices are
compiled in, and nothing is checked. Loops over nodes and leaves use them; code that runs
once per batch uses arrays. An address keeps no array alive.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from raystream.jit.simd.nvvm import is_cuda
from raystream.jit.simd.types import VectorClass, VectorType, llvm_type, refuse

_I32 = ir.IntType(32)
_I64 = ir.IntType(64)

#: Alignment of stack memory: a cache line, and the widest vector.
_SCRATCH_ALIGNMENT = 64

#: NVVM's address space of global memory.
_GLOBAL = 1


#: Storable numbers: those with as many bits in memory as in a register.
_NUMBERS = (
    *(types.float32, types.float64),
    *(types.int8, types.int16, types.int32, types.int64),
    *(types.uint8, types.uint16, types.uint32, types.uint64),
)


def pointer_to(builder: Any, address: Any, target: Any) -> Any:
    """An LLVM pointer to an address."""
    # LLVM splits sums when it compiles a function, and may take the offset for the pointer: if
    # that is zero in a caller, it would conclude that null is read and that the statement is
    # unreachable. (llvmlite does not know the attribute, LLVM does.)
    if not is_cuda(builder):  # NVVM has neither
        set.add(builder.function.attributes, "null_pointer_is_valid")
    return builder.inttoptr(address, target.as_pointer())


def _memory_type(context: Any, type_: Any) -> Any:
    return llvm_type(type_) if isinstance(type_, VectorType) else context.get_data_type(type_)


def _alignment(type_: Any) -> int:
    """Bytes of a number, or of one lane of a vector."""
    number = type_.element if isinstance(type_, VectorType) else type_
    return int(number.bitwidth) // 8


@intrinsic
def address(typing_context: Any, array: Any) -> Any:
    """Address of an array's first element."""
    if not isinstance(array, types.Array):
        refuse("address", "an array", array)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(array)(context, builder, arguments[0]).data
        return builder.ptrtoint(data, _I64)

    return types.uint64(array), generate


def _storable(type_: Any) -> bool:
    if isinstance(type_, VectorType):
        return type_.kind != "mask"
    return type_ in _NUMBERS


@intrinsic
def load(typing_context: Any, type_: Any, at: Any) -> Any:
    """Read a number or vector of a type at an address; lanes must be aligned, vectors need not."""
    loaded = type_.instance_type if isinstance(type_, VectorClass | types.NumberClass) else None
    if loaded is None or not _storable(loaded):
        refuse("load", "a vector or number type", type_)
    if at != types.uint64:
        refuse("load", "a uint64 as address", at)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        target = _memory_type(context, loaded)
        value = builder.load(pointer_to(builder, arguments[1], target))
        value.align = _alignment(loaded)
        return value

    return loaded(type_, at), generate


@intrinsic
def load_constant(typing_context: Any, type_: Any, at: Any) -> Any:
    """Read a vector at an aligned address that nothing writes while the kernel runs.

    The address must be a multiple of the vector's size. On CUDA it is a read through the
    non-coherent cache, one instruction per 16 bytes.
    """
    loaded = type_.instance_type if isinstance(type_, VectorClass) else None
    if loaded is None or not _storable(loaded):
        refuse("load_constant", "a vector type", type_)
    if at != types.uint64:
        refuse("load_constant", "a uint64 as address", at)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        target = llvm_type(loaded)
        if is_cuda(builder):
            value = builder.load(builder.inttoptr(arguments[1], target.as_pointer(_GLOBAL)))
            value.set_metadata("invariant.load", builder.module.add_metadata([]))
        else:
            value = builder.load(pointer_to(builder, arguments[1], target))
        value.align = _alignment(loaded) * loaded.lane_count
        return value

    return loaded(type_, at), generate


@intrinsic
def store(typing_context: Any, at: Any, value: Any) -> Any:
    """Write a number or vector to an address; lanes must be aligned, vectors need not."""
    if at != types.uint64:
        refuse("store", "a uint64 as address", at)
    if not _storable(value):
        refuse("store", "a vector or number", value)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        target = _memory_type(context, value)
        written = builder.store(arguments[1], pointer_to(builder, arguments[0], target))
        written.align = _alignment(value)
        return context.get_dummy_value()

    return types.void(at, value), generate


@intrinsic
def store_nontemporal(typing_context: Any, at: Any, value: Any) -> Any:
    """Write a vector past the caches, if nothing will read it soon.

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


def _hidden(builder: Any, address: Any) -> Any:
    """The same address, whose origin the compiler cannot trace.

    CUDA's compiler tracks addresses of local memory through integers, incorrectly: it removed the
    taken side of a branch on a stored value, in the graph's queries for 7.5 to 9.0.
    """
    kind = ir.FunctionType(_I64, [_I64])
    return builder.asm(kind, "mov.u64 $0, $1;", "=l,l", [address], False)


@intrinsic(prefer_literal=True)
def scratch(typing_context: Any, size: Any) -> Any:
    """Address of `size` bytes on the stack, aligned to 64, valid until the function returns.

    `size` must be a constant: a number or a global name. Each execution of the line gives the
    same bytes.
    """
    if not isinstance(size, types.IntegerLiteral) or size.literal_value < 1:
        refuse("scratch", "a constant number of bytes, at least 1", size)
    byte_count = size.literal_value

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        with builder.goto_entry_block():
            memory = builder.alloca(ir.ArrayType(ir.IntType(8), byte_count))
            memory.align = _SCRATCH_ALIGNMENT
        made = builder.ptrtoint(memory, _I64)
        return _hidden(builder, made) if is_cuda(builder) else made

    return types.uint64(size), generate


@intrinsic
def prefetch(typing_context: Any, at: Any) -> Any:
    """Prefetch the cache line at an address, which may be any: it is never an error.

    Does nothing on CUDA, where other threads run while one waits.
    """
    if at != types.uint64:
        refuse("prefetch", "a uint64 as address", at)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        if is_cuda(builder):
            return context.get_dummy_value()
        byte_pointer = ir.IntType(8).as_pointer()
        kind = ir.FunctionType(ir.VoidType(), [byte_pointer, _I32, _I32, _I32])
        name = "llvm.prefetch.p0"
        function = builder.module.globals.get(name) or ir.Function(builder.module, kind, name)
        read, keep, data = (ir.Constant(_I32, number) for number in (0, 3, 1))
        builder.call(function, [pointer_to(builder, arguments[0], ir.IntType(8)), read, keep, data])
        return context.get_dummy_value()

    return types.void(at), generate
