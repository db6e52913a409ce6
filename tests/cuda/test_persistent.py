"""Persistent threads fetch every index of a range exactly once."""

from __future__ import annotations

import numpy as np
import pytest

from extras import need

need("numba_cuda")

from raystream.jit.cpu import kernel
from raystream.jit.cuda import CAPABILITIES, PersistentKernel, is_simulated
from raystream.jit.simd import load, store


@kernel
def _add(i, to, more):
    at = to + np.uint64(4) * i
    store(at, np.int32(load(np.int32, at) + more))


@pytest.mark.parametrize("count", [0, 1, 32, 64, 65, 200])
def test_each_number_is_fetched_once(gpu, count):
    out = gpu.upload("out", np.arange(256, dtype=np.int32))
    made = PersistentKernel(_add)
    for more in (1000, 2000):  # each launch begins at 0
        made.launch(gpu, count, (out.address, np.int32(more)))
    gpu.wait()
    expected = np.arange(256)
    expected[:count] += 3000
    np.testing.assert_array_equal(out.host(), expected)


@pytest.mark.skipif(is_simulated(), reason="the simulator has no compiler")
def test_a_warp_fetches_by_one_atomic_operation():
    compiled = PersistentKernel(_add).compiled((np.uint64(0), np.int32(0)), CAPABILITIES[0])
    assert compiled.ptx.count("atom.") == 1
    assert "bar.sync" in compiled.ptx or "barrier.sync" in compiled.ptx
    assert compiled.ptx.count(".shared") >= 1
    # How many, the counter as an array, and the arguments.
    text = compiled.ptx[compiled.ptx.index(f".visible .entry {compiled.entry}") :]
    assert text[: text.index("{")].count(".param") == 1 + 7 + 2
