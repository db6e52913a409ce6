"""Scenes and walks shared by the tests of walks."""

from __future__ import annotations

from functools import cache

import raystream as rs
from meshes import dented_sphere
from raystream_lab.walks import record

#: One of each traversal whose steps are recorded with places.
PLACED = {
    "grid": {"structure": "grid", "resolution": (7, 5, 6)},
    "grid, two levels": {"structure": "grid", "resolution": (2, 3, 2), "levels": 2},
    "kdtree, stack": {"structure": "kdtree"},
    "kdtree, restart": {"structure": "kdtree", "traversal": "restart"},
    "kdtree, backtrack": {"structure": "kdtree", "traversal": "backtrack", "layout": "foley"},
}


@cache
def scene_and_rays():
    """A closed mesh of 320 triangles, and rays of a image: some miss all of it."""
    scene = rs.Scene.from_arrays(*dented_sphere(2))
    origins, directions = scene.camera_for(1.2).rays(24, 20)
    return scene, {"origins": origins, "directions": directions}


@cache
def tracer_of(name, counters=True):
    scene, _ = scene_and_rays()
    return rs.Tracer(scene, **PLACED.get(name, {"structure": name}), counters=counters)


@cache
def walks_of(name, any_hit=False, visits=True):
    _, rays = scene_and_rays()
    return record(tracer_of(name), **rays, any_hit=any_hit, visits=visits)
