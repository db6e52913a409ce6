"""Hits of programs and filters with precision="float64": t, u and v are float64."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from raystream.core.float64_triangles import Float64Triangles
from raystream.jit.constants import SHIFT_64, THREE_U64, TWO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import load
from raystream.jit.views import view
from raystream.kernels.intervals import halvings_of, interval_of
from raystream.programs.hits import Hit, direction_at, is_front

_LONG, _TWO_LONGS, _VECTOR = np.uint64(8), np.uint64(16), np.uint64(24)
_NO_INSTANCE = np.int32(0)


class Float64At(NamedTuple):
    """Addresses of triangles in float64; the caller keeps the arrays alive.

    Attributes
    ----------
    vertices, faces, mesh_splits : uint64
        Addresses of the arrays of `Float64Triangles`.
    mesh_count, halvings : uint64
        And the steps of the binary search for a mesh.
    """

    vertices: np.uint64
    faces: np.uint64
    mesh_splits: np.uint64
    mesh_count: np.uint64
    halvings: np.uint64

    @classmethod
    def of(cls, triangles: Float64Triangles) -> tuple[Float64At, tuple[Any, ...]]:
        """Addresses of triangles, and the arrays to keep alive."""
        kept = triangles.vertices, triangles.faces, triangles.mesh_splits
        count = len(triangles.mesh_splits) - 1
        places = (array.ctypes.data for array in kept)
        return cls(*np.array((*places, count, halvings_of(count)), np.uint64)), kept


#: `Float64At` in memory.
FLOAT64_OBJECT = np.dtype([(name, "u8") for name in Float64At._fields])
Float64Record = view(FLOAT64_OBJECT)


@device
def _corner(scene, prim_id, k):
    row = (np.uint64(prim_id) * THREE_U64 + k) << SHIFT_64
    at = scene.vertices + np.uint64(load(np.int64, scene.faces + row)) * _VECTOR
    return load(np.float64, at), load(np.float64, at + _LONG), load(np.float64, at + _TWO_LONGS)


@device
def faces_ray(scene, prim_id, direction):
    """Whether a ray of a direction comes from the front of a triangle."""
    zero, one = np.uint64(0), np.uint64(1)
    a, b = _corner(scene, prim_id, zero), _corner(scene, prim_id, one)
    return is_front(a, b, _corner(scene, prim_id, TWO_U64), direction)


@device
def float64_hit_of(ray, t, u, v, prim_id, rays, position, scene):
    """A `Hit` of a triangle; see `hits.hit_of` for the arguments."""
    mesh = interval_of(scene.mesh_splits, scene.mesh_count, scene.halvings, np.int64(prim_id))
    is_entering = faces_ray(scene, prim_id, direction_at(rays, position))
    return Hit(np.int64(ray), t, u, v, prim_id, np.int32(mesh), is_entering, _NO_INSTANCE)
