"""Vectors for kernels: a few lanes in one register, with ordinary operators.

Inside a kernel::

    a = load(f32x8, address(array))  # eight numbers from memory
    b = fma(a, f32x8(half), a) * a  # arithmetic, lane by lane
    near = a < b  # a mask: one bit per lane
    if any_lane(near):
        store(address(out), select(near, a, b))

Vector types are `f32x4`, `f32x8`, `f32x16` and likewise ``f64``, ``i32`` and ``i64``; masks are
`mask4`, `mask8` and `mask16`. Everything becomes generic LLVM vector instructions: the compiler
splits types wider than the machine's registers, so kernels run on SSE, AVX2, AVX-512 and NEON
alike, with the same bits. No operation is inexact, fused or reordered unless documented: there are
no fast-math flags.
"""

from raystream.jit.simd.arithmetic import (
    absolute,
    copy_sign,
    floor,
    fma,
    maximum,
    minimum,
    square_root,
)
from raystream.jit.simd.convert import (
    as_float32,
    as_int32,
    as_uint32,
    narrow,
    narrow_lanes,
    widen,
    widen_number,
)
from raystream.jit.simd.elementary import (
    exponential,
    logarithm,
    next_float_up,
    power,
    sincos_turns,
)
from raystream.jit.simd.gathers import gather, scatter
from raystream.jit.simd.interleaved import (
    load_triples,
    store_records,
    store_triples,
)
from raystream.jit.simd.lanes import (
    all_lanes,
    any_lane,
    bits_as_float,
    compress,
    count_trailing_zeros,
    float_as_bits,
    lane,
    lane_numbers,
    lanes_from_bits,
    mask_bits,
    permutation,
    permute,
    popcount,
    prefix_counts,
    reduce_max,
    reduce_min,
    select,
)
from raystream.jit.simd.memory import (
    address,
    load,
    load_constant,
    prefetch,
    scratch,
    store,
    store_nontemporal,
)
from raystream.jit.simd.single_lane import lane_count, single_lane
from raystream.jit.simd.types import (
    VectorType,
    f32x4,
    f32x8,
    f32x16,
    f64x4,
    f64x8,
    f64x16,
    i32x4,
    i32x8,
    i32x16,
    i64x4,
    i64x8,
    i64x16,
    mask4,
    mask8,
    mask16,
    u32x4,
    u32x8,
    u32x16,
)

__all__ = [
    "VectorType",
    "absolute",
    "address",
    "all_lanes",
    "any_lane",
    "as_float32",
    "as_int32",
    "as_uint32",
    "bits_as_float",
    "compress",
    "copy_sign",
    "count_trailing_zeros",
    "exponential",
    "f32x4",
    "f32x8",
    "f32x16",
    "f64x4",
    "f64x8",
    "f64x16",
    "float_as_bits",
    "floor",
    "fma",
    "gather",
    "i32x4",
    "i32x8",
    "i32x16",
    "i64x4",
    "i64x8",
    "i64x16",
    "lane",
    "lane_count",
    "lane_numbers",
    "lanes_from_bits",
    "load",
    "load_constant",
    "load_triples",
    "logarithm",
    "mask4",
    "mask8",
    "mask16",
    "mask_bits",
    "maximum",
    "minimum",
    "narrow",
    "narrow_lanes",
    "next_float_up",
    "permutation",
    "permute",
    "popcount",
    "power",
    "prefetch",
    "prefix_counts",
    "reduce_max",
    "reduce_min",
    "scatter",
    "scratch",
    "select",
    "sincos_turns",
    "single_lane",
    "square_root",
    "store",
    "store_nontemporal",
    "store_records",
    "store_triples",
    "u32x4",
    "u32x8",
    "u32x16",
    "widen",
    "widen_number",
]
