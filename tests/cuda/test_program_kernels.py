"""Compilation of users' functions for CUDA, and their PTX; needs no device."""

from __future__ import annotations

import math
import re

import numba
import numpy as np
import pytest

from extras import need

need("numba_cuda")

from raystream.jit.cuda import CAPABILITIES, is_simulated
from raystream.jit.cuda.arguments import flat
from raystream.streams import device

if is_simulated():
    pytest.skip("the simulator has no compiler", allow_module_level=True)

from raystream.cuda.precompile import program_kernels, shared_kernels
from raystream.cuda.programs import reason_against
from raystream.cuda.programs.device_program import DeviceProgram
from raystream.cuda.programs.records import aligned_dtype, is_aligned

PACKED = np.dtype([("flag", "i1"), ("at", "f4", (3,)), ("last", [("t", "f8"), ("mesh", "i2")])])
SHARED = np.dtype({"names": ["a", "b"], "formats": ["f8", "i4"], "offsets": [0, 4], "itemsize": 12})


@device
def helper(x):
    return x * x + 1.0


@numba.njit
def own_options(x):
    return 1.0 / x


def nest(hit, payload):
    payload.flag += 1
    payload.at[hit.prim_id % 3] += hit.u
    payload.last.t = max(payload.last.t, hit.t)
    payload.last.mesh = hit.mesh_id


def first(hit, payload):
    payload.a = hit.t


def turn(hit, payload):
    payload[0] = payload[0] * 1j + hit.t


def roots(hit):
    return helper(math.sqrt(hit.t)) > abs(math.floor(hit.u)) and not math.isnan(hit.v)


def within(hit):
    return (1.0, 2.0)[hit.prim_id & 1] < hit.t


def beyond(hit):
    return (1.0, 2.0)[hit.prim_id] < hit.t


def sine(hit):
    return math.sin(hit.t) > 0.0


def squared(hit):
    return hit.t**2 > 1.0


def rest(hit):
    return hit.t % 2.0 > 1.0


def raises(hit):
    if hit.t < 0.0:
        raise ValueError
    return True


def prints(hit):
    print(hit.t)  # noqa: T201
    return True


def allocates(hit):
    return np.zeros(3)[0] < hit.t


def divides(hit):
    return own_options(hit.t) > 1.0


def compiled_of(program):
    return program.kernel.compiled(program.typical(), CAPABILITIES[0])


@pytest.mark.parametrize(
    ("function", "options"),
    [
        (nest, {"goal": "trace", "record": (aligned_dtype(PACKED), 1)}),
        (turn, {"goal": "trace", "record": (np.dtype("c16"), 2)}),
        (roots, {"goal": "first"}),
        (within, {"goal": "keep", "skips": True}),
    ],
)
def test_programs_compile(function, options):
    program = DeviceProgram(function, **options)
    assert program.reason_against(CAPABILITIES[0]) is None
    compiled = compiled_of(program)
    assert f".target sm_{CAPABILITIES[0][0]}{CAPABILITIES[0][1]}" in compiled.ptx
    body = compiled.ptx[compiled.ptx.index(".visible .entry") :]
    assert len(re.findall(r"\.param \.\w+", body[: body.index("{")])) == 1 + len(
        list(flat(program.typical()))
    )
    assert not re.search(r"\bfma\.|\.(ftz|approx|full)\b|\.extern \.func", compiled.ptx)


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (beyond, "it may raise an exception"),
        (raises, "it may raise an exception"),
        (sine, "it calls sinf"),
        (squared, "it calls pow"),
        (rest, "it takes a remainder of floats"),
        (prints, "it calls vprintf"),
        (allocates, "CUDA's compiler does not support it: .*zeros"),
        (divides, "own_options was compiled with options of its own"),
    ],
)
def test_others_stay_with_the_processor(function, message):
    assert re.match(message, reason_against(function))


def test_records_whose_fields_share_bytes_stay_with_the_processor():
    for dtype in (SHARED, np.dtype([("shared", SHARED), ("a", "f8")])):
        assert "not aligned" in reason_against(first, dtype)
    assert reason_against(nest, np.zeros((2, 3), PACKED)) is None
    assert reason_against(turn, np.zeros((2, 3), complex)) is None
    assert is_aligned(aligned_dtype(PACKED))
    assert not is_aligned(PACKED)


def test_the_larger_of_two_numbers_is_the_processors():
    """CUDA's own prefers a number to a NaN."""

    def larger(hit, payload):
        payload[0] = max(payload[0], hit.t)

    program = DeviceProgram(larger, "trace", record=(np.dtype("f4"), 1))
    ptx = compiled_of(program).ptx
    assert "setp.gt.f32" in ptx
    assert not re.search(r"\bmax\.", ptx)


def below(limit):
    return lambda hit: hit.prim_id < limit


def test_functions_have_files_of_their_own(tmp_path, monkeypatch):
    """Cached code is keyed by the function's body and its global numbers."""
    from raystream.jit.cuda import ptx_cache

    monkeypatch.setattr(ptx_cache, "kernel_folder", lambda: tmp_path)
    texts = set()
    for limit in (1, 2, 1):
        texts.add(compiled_of(DeviceProgram(below(limit), "count")).ptx)
    assert len(texts) == len(list(tmp_path.iterdir())) == 2


KERNELS = program_kernels() | shared_kernels("programs")


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(one, marks=[pytest.mark.exhaustive] * (one not in ("trace", "want_room")))
        for one in KERNELS
    ],
)
def test_every_kernel_of_programs_compiles(name):
    made, arguments = KERNELS[name]
    ptx = made.compiled(arguments, CAPABILITIES[0]).ptx
    assert "fma.rn.f64" not in ptx
    assert ".extern .func" not in ptx
