"""Operations on lanes and masks: selection, counts, permutations, reductions and bit casts."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from raystream.jit.simd.arithmetic import (
    as_numbers,
    as_vectors,
    call_intrinsic,
    common,
    wider,
)
from raystream.jit.simd.nvvm import is_cuda
from raystream.jit.simd.types import (
    VectorClass,
    VectorType,
    broadcast,
    constant,
    llvm_type,
    mask_of,
    refuse,
    vector_type,
)

_I32 = ir.IntType(32)
_I64 = ir.IntType(64)

#: Widest vector, in bits, for LLVM's compress intrinsic. LLVM 22 splits vectors wider than a
#: register incorrectly: it stores the upper part's lanes, which can start anywhere, as if they were
#: aligned, and the process crashes. So it is used only where it is one instruction, with AVX-512.
_WIDEST_COMPRESS = 512


def _is_mask(type_: Any) -> bool:
    return isinstance(type_, VectorType) and type_.kind == "mask"


def _part(builder: Any, value: Any, first: int, count: int) -> Any:
    """Lanes of an LLVM vector, beginning with a first one."""
    lanes = ir.Constant(ir.VectorType(_I32, count), list(range(first, first + count)))
    return builder.shuffle_vector(value, ir.Constant(value.type, ir.Undefined), lanes)


def _bits(builder: Any, mask: Any) -> Any:
    """A mask as an LLVM integer with one bit per lane."""
    return builder.bitcast(mask, ir.IntType(mask.type.count))


def _choose_number(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    number, types_ = signature.return_type, signature.args[1:]
    a, b = as_numbers(context, builder, number, types_, arguments[1:])
    return builder.select(arguments[0], a, b)


@intrinsic
def select(typing_context: Any, mask: Any, x: Any, y: Any) -> Any:
    """Lanes of x where the mask is set, of y elsewhere; a bool selects all of x or y."""
    number = wider(x, y)
    if mask == types.boolean and number is not None:
        return number(mask, x, y), _choose_number
    vector = common(x, y)
    if vector is None or mask not in (mask_of(vector), types.boolean):
        refuse("select", "a mask and two operands of as many lanes", mask, x, y)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        a, b = as_vectors(context, builder, vector, signature.args[1:], arguments[1:])
        return builder.select(arguments[0], a, b)

    return vector(mask, x, y), generate


@intrinsic
def mask_bits(typing_context: Any, mask: Any) -> Any:
    """A mask as a uint64 number: bit i is lane i."""
    if not _is_mask(mask):
        refuse("mask_bits", "a mask", mask)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.zext(_bits(builder, arguments[0]), _I64)

    return types.uint64(mask), generate


@intrinsic
def lanes_from_bits(typing_context: Any, mask_class: Any, bits: Any) -> Any:
    """The mask of a type whose lane i is bit i of an integer."""
    if not isinstance(mask_class, VectorClass) or not isinstance(bits, types.Integer):
        refuse("lanes_from_bits", "a mask type and an integer", mask_class, bits)
    mask = mask_class.instance_type
    if mask.kind != "mask":
        refuse("lanes_from_bits", "a mask type", mask_class)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        whole = context.cast(builder, arguments[1], bits, types.uint64)
        return builder.bitcast(builder.trunc(whole, ir.IntType(mask.lane_count)), llvm_type(mask))

    return mask(mask_class, bits), generate


@intrinsic
def any_lane(typing_context: Any, mask: Any) -> Any:
    """Whether any lane of a mask is set; a bool is returned as it is."""
    if mask == types.boolean:
        return mask(mask), lambda context, builder, signature, arguments: arguments[0]
    if not _is_mask(mask):
        refuse("any_lane", "a mask", mask)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        bits = _bits(builder, arguments[0])
        return builder.icmp_unsigned("!=", bits, ir.Constant(bits.type, 0))

    return types.boolean(mask), generate


@intrinsic
def all_lanes(typing_context: Any, mask: Any) -> Any:
    """Whether every lane of a mask is set."""
    if not _is_mask(mask):
        refuse("all_lanes", "a mask", mask)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        bits = _bits(builder, arguments[0])
        return builder.icmp_unsigned("==", bits, ir.Constant(bits.type, -1))

    return types.boolean(mask), generate


@intrinsic
def count_trailing_zeros(typing_context: Any, bits: Any) -> Any:
    """Index of the lowest set bit of a uint64; undefined for 0."""
    if bits != types.uint64:
        refuse("count_trailing_zeros", "a uint64", bits)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        zero_is_undefined = ir.Constant(ir.IntType(1), 1)
        return call_intrinsic(builder, "llvm.cttz.i64", _I64, [arguments[0], zero_is_undefined])

    return types.uint64(bits), generate


@intrinsic
def popcount(typing_context: Any, bits: Any) -> Any:
    """Number of bits of a uint64 that are set."""
    if bits != types.uint64:
        refuse("popcount", "a uint64", bits)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return call_intrinsic(builder, "llvm.ctpop.i64", _I64, arguments)

    return types.uint64(bits), generate


@intrinsic
def lane_numbers(typing_context: Any, class_: Any) -> Any:
    """The vector 0, 1, 2 ... of an integer type."""
    vector = class_.instance_type if isinstance(class_, VectorClass) else None
    if vector is None or vector.is_float or vector.kind == "mask":
        refuse("lane_numbers", "a vector type of integers", class_)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return constant(vector, list(range(vector.lane_count)))

    return vector(class_), generate


@intrinsic
def prefix_counts(typing_context: Any, mask: Any) -> Any:
    """For each lane, the number of set lanes before it: an int32 vector."""
    if not _is_mask(mask):
        refuse("prefix_counts", "a mask", mask)
    result = vector_type("i32", mask.lane_count)
    lower = constant(result, [2**i - 1 for i in range(mask.lane_count)])

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        bits = builder.zext(_bits(builder, arguments[0]), _I32)
        before = builder.and_(broadcast(builder, bits, mask.lane_count), lower)
        name = f"llvm.ctpop.v{mask.lane_count}i32"
        return call_intrinsic(builder, name, llvm_type(result), [before])

    return result(mask), generate


@intrinsic
def lane(typing_context: Any, x: Any, index: Any) -> Any:
    """One lane of a vector; undefined if the index is out of range."""
    if not isinstance(x, VectorType) or not isinstance(index, types.Integer):
        refuse("lane", "a vector and an integer", x, index)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.extract_element(*arguments)

    return x.element(x, index), generate


@intrinsic
def compress(typing_context: Any, mask: Any, x: Any) -> Any:
    """The lanes of x where the mask is set, moved to the front; the others are undefined."""
    if not isinstance(x, VectorType) or x.kind == "mask" or mask != mask_of(x):
        refuse("compress", "a mask and a vector of as many lanes", mask, x)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        whole = int(x.element.bitwidth) * x.lane_count <= _WIDEST_COMPRESS
        if whole and not is_cuda(builder) and "+avx512vl" in str(context.codegen().magic_tuple()):
            return _compress(builder, *arguments)
        return _compress_in_memory(builder, *arguments)

    return x(mask, x), generate


def _compress(builder: Any, mask: Any, value: Any) -> Any:
    element = {"float": "f32", "double": "f64"}.get(str(value.type.element))
    name = f"llvm.experimental.vector.compress.v{value.type.count}{element or value.type.element}"
    undefined = ir.Constant(value.type, ir.Undefined)
    return call_intrinsic(builder, name, value.type, [value, mask, undefined])


def _compress_in_memory(builder: Any, mask: Any, value: Any) -> Any:
    """Store each lane after the set lanes before it, and load the vector."""
    element = value.type.element
    with builder.goto_entry_block():
        memory = builder.alloca(ir.ArrayType(element, value.type.count))
    start = builder.bitcast(memory, element.as_pointer())
    written = ir.Constant(_I64, 0)
    for i in range(value.type.count):
        place = ir.Constant(_I32, i)
        builder.store(builder.extract_element(value, place), builder.gep(start, [written]))
        is_set = builder.zext(builder.extract_element(mask, place), _I64)
        written = builder.add(written, is_set)
    result = builder.load(builder.bitcast(memory, value.type.as_pointer()))
    result.align = 4
    return result


def permutation(*sources: int) -> Any:
    """Make a function that permutes a vector: lane i of the result is lane sources[i].

    Fewer sources than lanes give a narrower vector, more give a wider one.

    Raises
    ------
    ValueError
        If the sources are not 2, 4, 8 or 16 numbers from 0.
    """
    if len(sources) not in (2, 4, 8, 16) or min(sources) < 0:
        raise ValueError(f"a permutation has 2, 4, 8 or 16 sources from 0, not {sources}")

    @intrinsic
    def permute_lanes(typing_context: Any, x: Any) -> Any:
        """Permute a vector."""
        if not isinstance(x, VectorType) or max(sources) >= x.lane_count:
            refuse("permutation", f"a vector of more than {max(sources)} lanes", x)
        result = vector_type(x.kind, len(sources))

        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            undefined = ir.Constant(llvm_type(x), ir.Undefined)
            lanes = ir.Constant(ir.VectorType(_I32, len(sources)), list(sources))
            return builder.shuffle_vector(arguments[0], undefined, lanes)

        return result(x), generate

    return permute_lanes


@intrinsic
def permute(typing_context: Any, x: Any, sources: Any) -> Any:
    """The vector whose lane i is lane sources[i] of x; sources modulo the number of lanes.

    Written lane by lane: LLVM has no instruction for it, but makes one of this where the
    machine has it (AVX2, AVX-512), and goes through memory elsewhere.
    """
    if not isinstance(x, VectorType) or x.kind == "mask":
        refuse("permute", "a vector of numbers", x)
    if sources != vector_type("i" + x.kind[1:], x.lane_count):
        refuse("permute", "as many integers, of the same size, as lane numbers", x, sources)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        vector, indices = arguments
        indices = builder.and_(indices, constant(sources, x.lane_count - 1))
        result = ir.Constant(llvm_type(x), ir.Undefined)
        for i in range(x.lane_count):
            place = ir.Constant(_I32, i)
            value = builder.extract_element(vector, builder.extract_element(indices, place))
            result = builder.insert_element(result, value, place)
        return result

    return x(x, sources), generate


def _reduce(name: str, sign: str, x: Any) -> Any:
    """Reduce a vector by combining its halves until one lane is left."""
    if not isinstance(x, VectorType) or x.kind == "mask":
        refuse(name, "a vector of numbers", x)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        value, count = arguments[0], x.lane_count
        compare = builder.fcmp_ordered if x.is_float else builder.icmp_signed
        while count > 1:
            count //= 2
            low, high = (_part(builder, value, first, count) for first in (0, count))
            value = builder.select(compare(sign, low, high), low, high)
        return builder.extract_element(value, ir.Constant(_I32, 0))

    return x.element(x), generate


@intrinsic
def reduce_min(typing_context: Any, x: Any) -> Any:
    """The smallest lane of a vector without NaN."""
    return _reduce("reduce_min", "<", x)


@intrinsic
def reduce_max(typing_context: Any, x: Any) -> Any:
    """The largest lane of a vector without NaN."""
    return _reduce("reduce_max", ">", x)


_TWINS = {"f32": "i32", "i32": "f32", "f64": "i64", "i64": "f64"}
_SCALAR_TWINS = {
    types.float32: (types.int32, ir.IntType(32)),
    types.int32: (types.float32, ir.FloatType()),
    types.float64: (types.int64, ir.IntType(64)),
    types.int64: (types.float64, ir.DoubleType()),
}


def _reinterpret(name: str, x: Any, to_float: bool) -> Any:
    if isinstance(x, VectorType) and x.kind != "mask" and x.is_float != to_float:
        result = vector_type(_TWINS[x.kind], x.lane_count)
        target = llvm_type(result)
    elif x in _SCALAR_TWINS and isinstance(x, types.Float) != to_float:
        result, target = _SCALAR_TWINS[x]
    else:
        wanted = "integers" if to_float else "floats"
        refuse(name, f"{wanted} of 32 or 64 bits", x)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.bitcast(arguments[0], target)

    return result(x), generate


@intrinsic
def float_as_bits(typing_context: Any, x: Any) -> Any:
    """The bits of a float or float vector as integers.

    Non-negative numbers have the order of their bits.
    """
    return _reinterpret("float_as_bits", x, to_float=False)


@intrinsic
def bits_as_float(typing_context: Any, x: Any) -> Any:
    """The float or float vector with these bits."""
    return _reinterpret("bits_as_float", x, to_float=True)
