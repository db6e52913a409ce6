"""Surfaces are counted right where rays are aimed at trouble: a million rays, layer on layer."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from conftest import EVERY_QUERY, TRACERS
from meshes import icosphere
from watertight import RAYS

#: Rays of each kind for those that test every triangle; see also benchmarks/watertight.py.
FEWER = {"brute": 2_000, "brute, multipass": 500, "grid, one cell": 2_000}


def ray_count(name):
    """A million in all for the default options; benchmarks use as many for all options."""
    if name == "bvh":
        return 1_000_000 // 3
    if name.startswith("bvh") and "multipass" not in name:
        return 100_000
    return FEWER.get(name, 1_000 if "multipass" in name else 20_000)


@pytest.mark.slow
@pytest.mark.parametrize("name", EVERY_QUERY)
def test_a_sphere_is_crossed_twice(name):
    """Rays through vertices and midpoints: exactly twice. In the planes of faces: 0 or 2."""
    vertices, faces = icosphere(5)
    vertices = np.float32(vertices)
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces), **TRACERS[name])
    for make in RAYS.values():
        origins, directions, allowed = make(vertices, faces, ray_count(name))
        counts = tracer.count_hits(origins, directions, crossings="surfaces")
        assert set(np.unique(counts)) <= set(allowed)


def test_fifty_layers_a_millionth_apart(make_tracer_anywhere):
    corners = np.zeros((50, 3, 3))
    corners[:, 1, 0] = corners[:, 2, 1] = 1.0
    corners[:, :, 2] = 1e-6 * np.arange(50)[:, None]
    tracer = make_tracer_anywhere(
        rs.Scene.from_arrays(corners.reshape(-1, 3), np.arange(150).reshape(-1, 3))
    )
    origins = [[0.25, 0.25, -1e-5], [0.25, 0.25, 1e-4]]
    many = tracer.multi_hit(origins, [[0, 0, 1.0], [0, 0, -1.0]])
    assert many.prim_id.tolist() == [*range(50), *reversed(range(50))]
    assert (np.diff(many.t.reshape(2, 50)) > 0).all()
    assert (tracer.count_hits(origins, [0, 0, 1.0], crossings="surfaces") == [50, 0]).all()


@pytest.mark.parametrize("name", EVERY_QUERY)
def test_coplanar_duplicates_all_come_back_in_order(name):
    count = 2_000 if "multipass" in name else 20_000  # a pass is one triangle for the grid
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    scene = rs.Scene.from_arrays(vertices, np.broadcast_to([0, 1, 2], (count, 3)))
    tracer = rs.Tracer(scene, **TRACERS[name])
    many = tracer.multi_hit([[0.25, 0.25, 2], [0.7, 0.7, 1]], [0, 0, -1.0])
    assert many.ray_splits.tolist() == [0, count, count]
    np.testing.assert_array_equal(many.prim_id, np.arange(count))
    assert (many.t == 2.0).all()
    assert tracer.count_hits([0.25, 0.25, 2], [0, 0, -1.0]) == count
