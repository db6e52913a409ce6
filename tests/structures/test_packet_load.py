"""Loading rays 16 at a time."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from raystream.core.rays import RayBatch
from raystream.jit.cpu import kernel
from raystream.jit.simd import address, f32x16, narrow, store
from raystream.kernels.ray_source import RaySource
from raystream.structures.bvh.packets.load import read_lanes
from raystream.structures.bvh.packets.rays import GROUPS, PacketOrder, group_rows


@kernel
def _load_the_first(source, order, out):
    total = np.uint64(0)
    for g in range(GROUPS):
        _, count = group_rows(order, np.uint64(0), g)
        if count == np.uint64(0):
            continue
        rays = read_lanes(source, np.uint64(0), f32x16, np.float32)
        store(address(out), narrow(rays.origin[0]))
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


@pytest.mark.parametrize("kernel", ["packet", "groups"])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_columns_of_records(dtype, kernel):
    """Vectors that are not adjacent are read where they are, in either order."""
    scene = rs.load("spheres")
    tracer = rs.Tracer(scene, kernel=kernel)
    origins, directions = scene.camera.rays(70, 50)
    records = np.full((50, 70, 9), np.nan, dtype)
    records[..., 1:4], records[..., 5:8] = origins, directions
    for rows in (records, records.reshape(-1, 9), records.reshape(-1, 9)[::-1]):
        columns = rows[..., 1:4], rows[..., 5:8]
        hits = tracer.first_hit(*columns)
        expected = tracer.first_hit(*map(np.ascontiguousarray, columns))
        assert hits.is_hit.any()
        for name in ("t", "u", "v", "prim_id", "status"):
            assert getattr(hits, name).tobytes() == getattr(expected, name).tobytes(), name
