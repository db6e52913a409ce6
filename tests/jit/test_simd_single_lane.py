"""Functions of 16 lanes compiled for one: the bits of each lane, and the functions they call."""

from __future__ import annotations

import numpy as np
import pytest

from raystream.jit.cpu import device, kernel
from raystream.jit.simd import f32x16, f64x16, lane_count, load, single_lane, store
from raystream.jit.simd.types import VECTORS
from raystream.rendering.sampling import warp
from raystream.rendering.shading import discrete_distribution, rows
from raystream.rendering.shading.discrete_distribution import sample_discrete_lanes

LANES = 16
RANDOM = np.random.default_rng(3)

f32x1, f64x1 = VECTORS["f32", 1], VECTORS["f64", 1]
_one = single_lane(sample_discrete_lanes)


@kernel
def choose(ends, count, number, out):
    index, share, within = sample_discrete_lanes(ends, count, load(f64x16, number))
    store(out, index)
    store(out + np.uint64(64), share)
    store(out + np.uint64(192), within)


@kernel
def choose_one(ends, count, number, out, i):
    index, share, within = _one(ends, count, load(f64x1, number + np.uint64(8) * i))
    store(out + np.uint64(4) * i, index)
    store(out + np.uint64(64) + np.uint64(8) * i, share)
    store(out + np.uint64(192) + np.uint64(4) * i, within)


def test_each_lane_has_its_bits():
    ends = np.cumsum(RANDOM.random(7))
    ends /= ends[-1]
    numbers = RANDOM.random(LANES)
    wide, narrow = np.zeros(256, np.uint8), np.zeros(256, np.uint8)
    places = [np.uint64(array.ctypes.data) for array in (ends, numbers, wide, narrow)]
    choose(places[0], np.uint64(7), places[1], places[2])
    for i in range(LANES):
        choose_one(places[0], np.uint64(7), places[1], places[3], np.uint64(i))
    assert wide.tolist() == narrow.tolist()
    assert wide[:64].view(np.int32).tolist() == np.searchsorted(ends, numbers, "right").tolist()


def test_functions_of_whatever_comes_stay():
    assert single_lane(warp.disk) is warp.disk
    assert (
        single_lane(discrete_distribution.sample_discrete) is discrete_distribution.sample_discrete
    )


@device
def _calls():
    return lane_count(f32x16(np.float32(0.0)))


@kernel
def lanes_of_both(out):
    out[0], out[1] = _calls(), lane_count(f32x1(np.float32(0.0)))


def test_lanes_are_counted():
    out = np.zeros(2, np.int64)
    lanes_of_both(out)
    assert out.tolist() == [16, 1]


def test_only_raystream_s_own_functions_are_changed():
    # These are the test's, of which the sources' hash knows nothing.
    assert single_lane(_calls) is _calls


def test_one_is_called_instead_of_another():
    made = single_lane(rows.append_numbers, rows.SINGLE_ROWS)
    wanted = rows.SINGLE_ROWS[rows.append_numbers].py_func
    assert made.py_func.__code__ is wanted.__code__
    assert made.py_func.__qualname__ == f"{wanted.__qualname__}_of_one_lane"
    assert made.py_func.__globals__["i32x16"] == VECTORS["i32", 1]
    assert rows.i32x16.lane_count == LANES  # the module's own
    assert made.targetoptions == rows.append_numbers.targetoptions


def test_what_it_refuses():
    with pytest.raises(TypeError, match="function: expected a compiled one, got function"):
        single_lane(_calls.py_func)
