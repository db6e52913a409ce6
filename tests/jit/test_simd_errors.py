"""Unsupported operations on vectors are typing errors that say why."""

from __future__ import annotations

import numba
import numpy as np
import pytest
from numba.core.errors import TypingError

from raystream.jit import simd

TO_NARROW = simd.permutation(0, 1, 0, 7)
NAMES = {
    **{name: getattr(simd, name) for name in simd.__all__},
    "np": np,
    "numba": numba,
    "narrower": TO_NARROW,
    "SIZE": 16,
    "HUGE": 2**40,
}

MIXED = "a vector goes with its own type"
ERRORS = {
    # operators
    "x + 1.0": f"add of f32x8 and float64: {MIXED}",
    "1.0 / x": f"truediv of float64 and f32x8: {MIXED}",
    "x + 1": f"add of f32x8 and .*: {MIXED}",
    "x + f32x4(number)": f"add of f32x8 and f32x4: {MIXED}",
    "x - f64x8(number)": f"sub of f32x8 and f64x8: {MIXED}",
    "x * i32x8(2)": f"mul of f32x8 and i32x8: {MIXED}",
    "x == f32x4(number)": f"eq of f32x8 and f32x4: {MIXED}",
    "x < 0.0": f"lt of f32x8 and float64: {MIXED}",
    "x + array": f"add of f32x8 and array.*: {MIXED}",
    "i32x8(2) + count": f"add of i32x8 and int64: {MIXED}",
    "i32x8(2) + HUGE": f"add of i32x8 and Literal.*: {MIXED}",
    "i32x8(2) * 4294967296": f"mul of i32x8 and Literal.*: {MIXED}",
    "i64x8(2) + np.uint64(count)": f"add of i64x8 and uint64: {MIXED}",
    "(x < x) & x": f"and_ of mask8 and f32x8: {MIXED}",
    "(x < x) & count": f"and_ of mask8 and int64: {MIXED}",
    "x & x": "f32x8 has no and_",
    "i32x8(2) / i32x8(2)": "i32x8 has no truediv",
    "(x < x) + (x < x)": "mask8 has no add",
    "(x < x) == (x < x)": "mask8 has no eq",
    "-(x < x)": "mask8 has no neg",
    "~x": "f32x8 has no invert",
    "x // x": "floordiv",
    "x ** 2": "pow",
    "min(x, x)": "min",
    "abs(x)": "abs",
    "np.sqrt(x)": "sqrt",
    # in a place for something else
    "1 if x else 2": "truth",
    "1 if x < x else 2": "truth",
    "x < x < x": "truth",
    "not x": "not_",
    "x[0]": "getitem",
    "len(x)": "len",
    "x.size": "attribute 'size' of type f32x8",
    # making vectors
    "f32x8(x < x)": r"f32x8 takes a number .* \(select takes masks\), not mask8",
    "mask8(x)": "mask8 takes a number or a mask of 8 lanes, not f32x8",
    "f32x8(f32x4(number))": "f32x8 takes vectors of 8 lanes, not f32x4",
    "f32x8(1j)": "f32x8 takes a number .*, not complex128",
    "f32x8(array)": "f32x8 takes a number .*, not array",
    "f32x8(number, number)": "f32x8",
    "f32x8()": "f32x8",
    # functions
    "fma(x, 1.0, x)": "fma takes float vectors of one type .*, not f32x8, float64, f32x8",
    "fma(1.0, number, 1.0)": "fma takes float vectors",
    "fma(1, 1, 1)": "fma takes float vectors",
    "fma(i32x8(1), i32x8(1), i32x8(1))": "fma takes float vectors",
    "minimum(x, 1.0)": "minimum takes vectors or numbers of one type",
    "maximum(x < x, x < x)": "maximum takes vectors or numbers of one type",
    "absolute(i32x8(1))": "absolute takes a float vector or number, not i32x8",
    "copy_sign(x, number)": "copy_sign takes two float vectors or numbers of one type",
    "select(x, x, x)": "select takes a mask and two operands of as many lanes",
    "select(mask4(True), x, x)": "select takes a mask and two operands of as many lanes",
    "select(x < x, x, 1.0)": "select takes a mask and two operands of as many lanes",
    "select(x < x, number, number)": "select takes a mask and two operands",
    "mask_bits(x)": "mask_bits takes a mask, not f32x8",
    "any_lane(x)": "any_lane takes a mask, not f32x8",
    "all_lanes(True)": "all_lanes takes a mask, not bool",
    "lanes_from_bits(f32x8, count)": "lanes_from_bits takes a mask type, not",
    "lanes_from_bits(8, count)": "lanes_from_bits takes a mask type and an integer",
    "lanes_from_bits(mask8, number)": "lanes_from_bits takes a mask type and an integer",
    "count_trailing_zeros(count)": "count_trailing_zeros takes a uint64, not int64",
    "popcount(count)": "popcount takes a uint64, not int64",
    "lane(x, number)": "lane takes a vector and an integer, not f32x8, float32",
    "lane(number, 0)": "lane takes a vector and an integer",
    "compress(mask4(True), x)": "compress takes a mask and a vector of as many lanes",
    "compress(x < x, x < x)": "compress takes a mask and a vector of as many lanes",
    "permute(x, i64x8(0))": "permute takes as many integers, of the same size",
    "permute(x < x, i32x8(0))": "permute takes a vector of numbers, not mask8",
    "narrower(f32x4(number))": "permutation takes a vector of more than 7 lanes, not f32x4",
    "narrower(number)": "permutation takes a vector of more than 7 lanes, not float32",
    "reduce_min(x < x)": "reduce_min takes a vector of numbers, not mask8",
    "reduce_max(number)": "reduce_max takes a vector of numbers, not float32",
    "float_as_bits(i32x8(1))": "float_as_bits takes floats of 32 or 64 bits, not i32x8",
    "bits_as_float(number)": "bits_as_float takes integers of 32 or 64 bits, not float32",
    "widen(f64x8(1))": "widen takes a float32 vector, or a number, not f64x8",
    "narrow(x)": "narrow takes a float64 vector or number, not f32x8",
    # memory
    "address(number)": "address takes an array, not float32",
    "load(f32x8, array)": "load takes a uint64 as address, not array",
    "load(f32x8, count)": "load takes a uint64 as address, not int64",
    "load(f32x8, address(array) + 4 * count)": "load takes a uint64 as address, not int64",
    "load(f32x8, 64)": "load takes a uint64 as address",
    "load(mask8, address(array))": r"load takes a vector or number type, not class\(mask8\)",
    "load(np.complex64, address(array))": "load takes a vector or number type, not class",
    "load(np.float16, address(array))": "load takes a vector or number type, not class",
    "load(numba.boolean, address(array))": "load takes a vector or number type, not class",
    "load(x, address(array))": "load takes a vector or number type, not f32x8",
    "load(8, address(array))": "load takes a vector or number type",
    "store(array, x)": "store takes a uint64 as address, not array",
    "store(count, x)": "store takes a uint64 as address, not int64",
    "store(address(array), x < x)": "store takes a vector or number, not mask8",
    "store(address(array), 1j)": "store takes a vector or number, not complex128",
    "store(address(array), (x, x))": r"store takes a vector or number, not UniTuple",
    "store(address(array), True)": "store takes a vector or number, not bool",
    "prefetch(count)": "prefetch takes a uint64 as address, not int64",
    "scratch(count)": "scratch takes a constant number of bytes, at least 1, not int64",
    "scratch(SIZE * count)": "scratch takes a constant number of bytes, at least 1, not int64",
    "scratch(16.0)": "scratch takes a constant number of bytes, at least 1, not float64",
    "scratch(0)": "scratch takes a constant number of bytes, at least 1",
    "scratch(-64)": "scratch takes a constant number of bytes, at least 1",
}


def compiled(code):
    names = dict(NAMES)
    exec(f"def run(array, number, count):\n    x = f32x8(number)\n    {code}", names)
    signature = numba.types.void(numba.float32[::1], numba.float32, numba.int64)
    return numba.njit(signature)(names["run"])


@pytest.mark.parametrize("code", ERRORS)
def test_wrong_types(code):
    with pytest.raises(TypingError, match=ERRORS[code]):
        compiled(f"_ = {code}")


def test_a_variable_has_one_type():
    with pytest.raises(TypingError, match="Cannot unify"):
        compiled(
            "total = 0\n    for i in range(count):\n        total = x\n    any_lane(total < x)"
        )


def test_vectors_do_not_leave_kernels():
    with pytest.raises(TypeError, match="cannot convert native f32x8 to Python object"):
        numba.njit(lambda number: simd.f32x8(number))(1.0)


@pytest.mark.parametrize("code", ["scratch(SIZE)", "x + np.float32(2)", "i32x8(1) + 4294967295"])
def test_right_types(code):
    compiled(f"_ = {code}")
