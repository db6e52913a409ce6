"""Loading rays 16 at a time."""

from __future__ import annotations

import numpy as np

from raystream.core.rays import RayBatch
from raystream.jit.cpu import kernel
from raystream.jit.simd import address, narrow, store
from raystream.kernels.ray_source import RaySource
from raystream.structures.bvh.packet_load import load_origins
from raystream.structures.bvh.packet_rays import GROUPS, PacketOrder, group_rows


@kernel
def _load_the_first(source, order, out):
    total = np.uint64(0)
    for g in range(GROUPS):
        _, count = group_rows(order, np.uint64(0), g)
        if count == np.uint64(0):
            continue
        x, _, _ = load_origins(source, np.uint64(0))
        store(address(out), narrow(x))
        total += count
    return total


def test_the_first_rays_of_a_batch():
    """LLVM once took the offset of the first ray, 0, for a null pointer, and dropped the loop."""
    origins = np.arange(48, dtype=np.float32).reshape(16, 3)
    batch = RayBatch(origins, np.ones((16, 3), np.float32))
    source, kept = RaySource.of(batch.origins, batch.directions, batch.limits, True)
    out = np.zeros(16, np.float32)
    assert _load_the_first(source, PacketOrder.of((16,)), out) == 16
    assert out.tolist() == origins[:, 0].tolist()
    del kept
