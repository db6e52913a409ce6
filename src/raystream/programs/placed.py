"""Hits of programs and filters in scenes with instances.

Kernels number the triangles of all instances, one instance after another. From such a number
programs get the triangle, its mesh and the instance, as results have them.
"""

from __future__ import annotations

from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from raystream.core.instanced_triangles import InstancedTriangles
from raystream.jit.constants import ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import load
from raystream.kernels.intervals import halvings_of, interval_of
from raystream.programs.float64_hits import (
    FLOAT64_OBJECT,
    Float64At,
    Float64Record,
    faces_ray,
)
from raystream.programs.hits import Hit, direction_at, faces_front
from raystream.programs.primitive_hits import OBJECT, ObjectRecord, PrimitivesAt, seen_from

_WORD, _LONG = np.uint64(4), np.uint64(8)
_TRIANGLE = np.uint64(36)

#: An instance: the address of its object's corners, or of its `ObjectRecord` where some objects
#: have spheres or height fields, or of its `Float64Record`; what is added to the object's prim_ids
#: of each part, see `InstancedTriangles.parts`; and the matrix that moves directions to object
#: space.
_PART = np.dtype([("object", "u8"), ("shifts", "i8", 3), ("linear", "f8", (3, 3))])
_PART_BYTES = np.uint64(_PART.itemsize)
_SHIFTS, _LINEAR = np.uint64(8), np.uint64(32)


class PlacedAt(NamedTuple):
    """Addresses of the triangles of instances; the caller keeps the arrays alive.

    Attributes
    ----------
    parts : uint64
        Address of a record for each instance.
    first_ids : uint64
        Address of `InstancedTriangles.first_ids`.
    instance_count, instance_halvings : uint64
        And the steps of the binary search for an instance.
    mesh_splits : uint64
        Address of `InstancedTriangles.mesh_splits`.
    mesh_count, mesh_halvings : uint64
        And the steps of the binary search for a mesh.
    """

    parts: np.uint64
    first_ids: np.uint64
    instance_count: np.uint64
    instance_halvings: np.uint64
    mesh_splits: np.uint64
    mesh_count: np.uint64
    mesh_halvings: np.uint64

    @classmethod
    def of(cls, triangles: InstancedTriangles) -> tuple[PlacedAt, tuple[Any, ...]]:
        """Addresses of triangles, and the arrays to keep alive."""
        known = _known.get(triangles)
        if known is None:
            known = _known[triangles] = cls._made(triangles)
        return known

    @classmethod
    def _made(cls, triangles: InstancedTriangles) -> tuple[PlacedAt, tuple[Any, ...]]:
        instances = triangles.instances
        held: Any
        is_wide = triangles.number_type is np.float64
        if is_wide or triangles.has_primitives:
            of: Any = Float64At.of if is_wide else PrimitivesAt.of_object
            held = [of(one) for one in triangles.objects]
            records = np.array([one for one, _ in held], FLOAT64_OBJECT if is_wide else OBJECT)
            places = records.ctypes.data + np.arange(len(held)) * records.itemsize
            held = held, records
        else:
            held = [one.object_corners() for one in triangles.objects]
            places = np.array([one.ctypes.data for one in held], np.uint64)
        parts = np.empty(len(instances), _PART)
        ids = instances.object_ids
        if len(ids):
            parts["object"] = places[ids]
            parts["shifts"] = (triangles.parts[:, :, 1] - triangles.parts[:, :, 0])[ids]
            parts["linear"] = instances.inverses[:, :, :3]
        numbers = (
            parts.ctypes.data,
            triangles.first_ids.ctypes.data,
            len(ids),
            halvings_of(len(ids)),
            triangles.mesh_splits.ctypes.data,
            len(triangles.mesh_splits) - 1,
            halvings_of(len(triangles.mesh_splits) - 1),
        )
        # Not the triangles themselves: they would keep each other's entry.
        kept = parts, triangles.first_ids, triangles.mesh_splits, held
        return cls(*np.array(numbers, np.uint64)), kept


_known: WeakKeyDictionary[InstancedTriangles, tuple[PlacedAt, tuple[Any, ...]]]
_known = WeakKeyDictionary()


@device
def _seen_triangle(at, number, u, v, direction):  # noqa: ARG001
    """See `primitive_hits.seen_from`; and the part of the object, which has no other."""
    corners = load(np.uint64, at) + np.uint64(number) * _TRIANGLE
    return number, faces_front(corners, direction), ZERO_U64


@device
def _seen_primitive(at, number, u, v, direction):
    held = ObjectRecord(load(np.uint64, at))
    prim_id, is_entering = seen_from(held, number, u, v, direction)
    own = np.uint64(prim_id)
    part = np.uint64(own >= held.first_field) + np.uint64(own >= held.first_sphere)
    return prim_id, is_entering, part


@device
def _seen_float64(at, number, u, v, direction):  # noqa: ARG001
    return number, faces_ray(Float64Record(load(np.uint64, at)), number, direction), ZERO_U64


def _hit_function(seen):
    """Make the function that makes a `Hit` of kernels' numbers; see `hits.hit_of`."""

    @device
    def hit_of(ray, t, u, v, number, rays, position, scene):
        # The instance, then the primitive in its object.
        instance = interval_of(
            scene.first_ids, scene.instance_count, scene.instance_halvings, np.int64(number)
        )
        index = np.int64(number) - load(np.int64, scene.first_ids + instance * _LONG)
        at = scene.parts + instance * _PART_BYTES
        direction = _moved(at + _LINEAR, direction_at(rays, position))
        own, is_entering, part = seen(at, np.int32(index), u, v, direction)
        prim_id = np.int32(load(np.int64, at + _SHIFTS + part * _LONG) + own)
        splits, mesh_count = scene.mesh_splits, scene.mesh_count
        mesh = interval_of(splits, mesh_count, scene.mesh_halvings, np.int64(prim_id))
        return Hit(np.int64(ray), t, u, v, prim_id, np.int32(mesh), is_entering, np.int32(instance))

    return hit_of


placed_hit_of = _hit_function(_seen_triangle)
placed_primitive_hit_of = _hit_function(_seen_primitive)
placed_float64_hit_of = _hit_function(_seen_float64)


@device
def _moved(matrix, direction):
    x, y, z = direction
    return (
        _row(matrix, x, y, z),
        _row(matrix + _LONG * np.uint64(3), x, y, z),
        _row(matrix + _LONG * np.uint64(6), x, y, z),
    )


@device
def _row(at, x, y, z):
    return (
        load(np.float64, at) * x
        + load(np.float64, at + _LONG) * y
        + load(np.float64, at + _LONG + _LONG) * z
    )


@device
def is_placed_skipped(skips, ray, hit):
    """Whether a ray skips the triangle of a hit in its instance; the skips are of pairs."""
    at = skips.prim_ids + ray * skips.width * _LONG
    end = at + skips.width * _LONG
    while at != end:
        if load(np.int32, at) == hit.prim_id:
            only = load(np.int32, at + _WORD)
            if only < np.int32(0) or only == hit.instance_id:
                return True
        at += _LONG
    return False
