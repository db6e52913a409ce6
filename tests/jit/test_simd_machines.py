"""The same kernel for machines with registers of other widths, and for another family.

A kernel of many operations runs in child processes that compile for older processors than this
one, and must give the same bits there. For AArch64 it is compiled only.
"""

from __future__ import annotations

import os
import platform
import re
import subprocess
import sys

import llvmlite.binding as llvm
import numba
import numpy as np
import pytest

from raystream.jit.simd import (
    absolute,
    address,
    any_lane,
    compress,
    copy_sign,
    count_trailing_zeros,
    f32x8,
    f32x16,
    f64x8,
    f64x16,
    float_as_bits,
    fma,
    i32x8,
    lane,
    load,
    mask_bits,
    maximum,
    minimum,
    narrow,
    permutation,
    permute,
    popcount,
    reduce_max,
    reduce_min,
    scratch,
    select,
    store,
    widen,
)

IS_X86 = platform.machine().lower() in ("x86_64", "amd64")
REVERSE = permutation(7, 6, 5, 4, 3, 2, 1, 0)


def run(a, b, out, wide):
    """Do many operations on rows of eight lanes, and some on the widest types."""
    buffer = scratch(64)
    for i in range(len(a)):
        x, y = load(f32x8, address(a[i])), load(f32x8, address(b[i]))
        row = address(out[i])
        step = np.uint64(32)
        store(row, x + y)
        store(row + step, fma(x, y, -x) / y)
        store(row + step * np.uint64(2), narrow(widen(x) * widen(y) - f64x8(0.1)))
        store(row + step * np.uint64(3), minimum(x, copy_sign(maximum(y, x), y)))
        near = x < absolute(y)
        store(row + step * np.uint64(4), select(near, x * y + x, y - x))
        store(buffer, f32x8(0))
        bits = mask_bits(near)
        if any_lane(near):
            store(buffer, select(x < x - x, x, compress(near, x)))
            bits += count_trailing_zeros(bits) + popcount(bits) * np.uint64(1000)
        for k in range(popcount(mask_bits(near))):
            place = np.uint64(4 * k)
            store(row + step * np.uint64(5) + place, load(np.float32, buffer + place))
        places = i32x8(bits) ^ (float_as_bits(x) >> 7)
        store(row + step * np.uint64(6), permute(REVERSE(x), places))
        store(row + step * np.uint64(7), i32x8(x * np.float32(1000)) * places)
    for i in range(0, a.size, 16):
        at = np.uint64(4 * i)
        x, y = load(f32x16, address(a) + at), load(f32x16, address(b) + at)
        z = fma(f64x16(x), f64x16(y), f64x16(y))
        packed = compress(z > f64x16(x), z)
        for k in range(popcount(mask_bits(z > f64x16(x)))):
            wide[i + k] = lane(packed, k)
        wide[i] += float(reduce_min(x)) + reduce_max(z)


def result():
    """The bytes that the kernel writes, and which vector registers its machine code uses."""
    kernel = numba.njit(error_model="numpy", fastmath=False)(run)
    rng = np.random.default_rng(8)
    a = rng.normal(size=(64, 8)).astype(np.float32)
    b = rng.normal(size=(64, 8)).astype(np.float32)
    out, wide = np.zeros((64, 64), np.float32), np.zeros(512)
    kernel(a, b, out, wide)
    (assembly,) = kernel.inspect_asm().values()
    registers = sorted(set(re.findall(r"%([xyz]mm)\d", assembly)))
    return (out.tobytes() + wide.tobytes()).hex(), " ".join(registers)


@pytest.fixture(scope="module")
def here():
    return result()


def can_run(machine):
    needed = {"generic": (), "haswell": ("avx2", "bmi", "bmi2", "fma", "lzcnt", "movbe")}[machine]
    return all(llvm.get_host_cpu_features().get(feature) for feature in needed)


@pytest.mark.parametrize(("machine", "widest"), [("generic", "xmm"), ("haswell", "ymm")])
def test_bits_do_not_depend_on_the_width_of_registers(here, machine, widest):
    if not can_run(machine):
        pytest.skip(f"this processor does not run code for {machine}")
    changes = {"NUMBA_CPU_NAME": machine, "NUMBA_CPU_FEATURES": ""}
    child = subprocess.run(
        [sys.executable, __file__],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path)), **changes},
        check=True,
        capture_output=True,
        text=True,
    )
    there, registers = child.stdout.splitlines()
    assert there == here[0]
    if IS_X86:
        assert registers.split()[-1] == widest


@pytest.fixture(scope="module")
def instructions():
    """The kernel in LLVM's language, without the part that Python calls."""
    rows, wide = numba.float32[:, ::1], numba.float64[::1]
    options = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    kernel = numba.njit(numba.void(rows, rows, rows, wide), error_model="numpy", **options)(run)
    (code,) = kernel.inspect_llvm().values()
    return code


def test_instructions_are_generic(instructions):
    assert "llvm.fma.v8f32" in instructions
    assert not re.findall(r"llvm\.(?:x86|aarch64)[\w.]*", instructions)


def test_neon_instructions(instructions):
    """Eight lanes are two registers of four, and fma is one instruction for each."""
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    try:
        target = llvm.Target.from_triple("aarch64-linux-gnu")
    except RuntimeError:
        pytest.skip("this LLVM does not compile for AArch64")
    machine = target.create_target_machine(opt=3)
    code = re.sub(r'target triple = ".*"', 'target triple = "aarch64-linux-gnu"', instructions)
    code = re.sub(r'target datalayout = ".*"', f'target datalayout = "{machine.target_data}"', code)
    module = llvm.parse_assembly(code)
    module.verify()
    assembly = machine.emit_assembly(module)
    for wanted in ("fadd", "fmul", "fdiv", "fmla", "fabs", "fcmgt", "fcvtzs", "mul"):
        assert re.search(rf"\b{wanted}\s+v\d+\.4s", assembly), wanted
    for wanted in ("fmla", "fadd", "fcvtn", "fcvtl"):
        assert re.search(rf"\b{wanted}\s+v\d+\.(2d|2s)", assembly), wanted
    assert "fmaf" not in assembly  # not a function's call


if __name__ == "__main__":
    print(*result(), sep="\n")  # noqa: T201
