"""Hits of programs and filters in scenes with spheres, height fields or shapes.

Kernels give a sphere two numbers: where a ray enters it, and where it leaves; and a shape one for
each crossing.
"""

from __future__ import annotations

from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from raystream.core.primitives import Primitives
from raystream.geometry.primitives.records import shape_records
from raystream.jit.constants import BYTES_32, ONE_U64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import load
from raystream.jit.views import view
from raystream.kernels.intervals import halvings_of, interval_of
from raystream.kernels.shapes import ShapeRecord, enters
from raystream.programs.hits import (
    Hit,
    direction_at,
    faces_front,
    is_front,
)

_TRIANGLE = np.uint64(36)
_NO_INSTANCE = np.int32(0)

#: A height field: addresses of the arrays of `LocalField`; the cells of a row, and
#: `HeightField.is_upward`.
_FIELD = np.dtype([(name, "u8") for name in ("heights", "x", "y", "columns", "is_upward")])
_Field = view(_FIELD)


class PrimitivesAt(NamedTuple):
    """Addresses of primitives; the caller keeps the arrays alive.

    Attributes
    ----------
    corners : uint64
        Address of the corners of the meshes' triangles.
    fields, first_fields : uint64
        Addresses of a record for each height field, and of `Primitives.first_fields`.
    field_count, field_halvings : uint64
        And the steps of the binary search for a field.
    first_field, first_sphere, first_crossing : uint64
        The numbers of the first triangle of a field, of the first sphere, and of the first shape.
    shapes, first_shape, crossings : uint64
        Address of the records of the shapes by their prim_ids, which begin at `first_shape`; and
        the numbers that each has.
    mesh_splits : uint64
        Address of `Primitives.mesh_splits`.
    mesh_count, mesh_halvings : uint64
        And the steps of the binary search for a mesh.
    """

    corners: np.uint64
    fields: np.uint64
    first_fields: np.uint64
    field_count: np.uint64
    field_halvings: np.uint64
    first_field: np.uint64
    first_sphere: np.uint64
    first_crossing: np.uint64
    shapes: np.uint64
    first_shape: np.uint64
    crossings: np.uint64
    mesh_splits: np.uint64
    mesh_count: np.uint64
    mesh_halvings: np.uint64

    @classmethod
    def of(cls, primitives: Primitives) -> tuple[PrimitivesAt, tuple[Any, ...]]:
        """Addresses of primitives, and the arrays to keep alive."""
        known = _known.get(primitives)
        if known is None:
            known = _known[primitives] = cls._made(primitives)
        return known

    @classmethod
    def of_object(cls, store: Any) -> tuple[PrimitivesAt, tuple[Any, ...]]:
        """Addresses of primitives, or of triangles alone, whose meshes are left out."""
        if store.has_primitives:
            return cls.of(store)
        corners, count = store.corners, len(store)
        nothing_else = (count, count, count, 0, count, 1, 0, 0, 0)
        numbers = corners.ctypes.data, 0, 0, 0, 0, *nothing_else
        return cls(*np.array(numbers, np.uint64)), (corners,)

    @classmethod
    def _made(cls, primitives: Primitives) -> tuple[PrimitivesAt, tuple[Any, ...]]:
        corners, firsts = primitives.object_corners(), primitives.first_fields
        local, splits = primitives.local_fields, primitives.mesh_splits
        places = [[one.ctypes.data for one in (own.heights, own.x, own.y)] for own in local]
        given = zip(places, primitives.fields, strict=True)
        rows = [(*at, len(field.x) - 1, field.is_upward) for at, field in given]
        records, shapes = np.array(rows, _FIELD), shape_records(primitives)
        numbers = (
            corners.ctypes.data,
            records.ctypes.data,
            firsts.ctypes.data,
            len(records),
            halvings_of(len(records)),
            firsts[0],
            firsts[-1],
            primitives.first_crossing,
            shapes.ctypes.data,
            primitives.first_shapes[0],
            primitives.crossings,
            splits.ctypes.data,
            len(splits) - 1,
            halvings_of(len(splits) - 1),
        )
        kept = corners, records, firsts, local, splits, shapes
        return cls(*np.array(numbers, np.uint64)), kept


#: `PrimitivesAt` in memory.
OBJECT = np.dtype([(name, "u8") for name in PrimitivesAt._fields])
ObjectRecord = view(OBJECT)

_known: WeakKeyDictionary[Primitives, tuple[PrimitivesAt, tuple[Any, ...]]]
_known = WeakKeyDictionary()


@device
def _sample(field, row, column):
    """A corner of cells, local frame; see `core.height_field.HeightField.corners_of`."""
    at = (row * (field.columns + ONE_U64) + column) * BYTES_32
    return (
        np.float64(load(np.float32, field.x + column * BYTES_32)),
        np.float64(load(np.float32, field.y + row * BYTES_32)),
        np.float64(load(np.float32, field.heights + at)),
    )


@device
def _field_faces_front(scene, number, direction):
    """Whether a direction comes from the front of a triangle of a height field."""
    firsts = scene.first_fields
    k = interval_of(firsts, scene.field_count, scene.field_halvings, np.int64(number))
    field = _Field(scene.fields, k)
    own = np.uint64(np.int64(number) - load(np.int64, firsts + (k << np.uint64(3))))
    cell, half = own >> ONE_U64, own & ONE_U64
    row, column = cell // field.columns, cell % field.columns
    below, right = row + ONE_U64, column + ONE_U64
    second, third = _sample(field, row + half, right), _sample(field, below, right - half)
    if field.is_upward == ZERO_U64:
        second, third = third, second
    return is_front(_sample(field, row, column), second, third, direction)


@device
def seen_from(scene, number, u, v, direction):
    """The prim_id of a number, and whether a ray of a direction comes from the front there."""
    prim_id = number
    if np.uint64(number) < scene.first_field:
        is_entering = faces_front(scene.corners + np.uint64(number) * _TRIANGLE, direction)
    elif np.uint64(number) < scene.first_sphere:
        is_entering = _field_faces_front(scene, number, direction)
    elif np.uint64(number) >= scene.first_crossing:
        row = (np.uint64(number) - scene.first_crossing) // scene.crossings
        prim_id = np.int32(scene.first_shape + row)
        is_entering = enters(ShapeRecord(scene.shapes, row), u, v, direction)
    else:
        of_sphere = np.uint64(number) - scene.first_sphere
        prim_id = np.int32(scene.first_sphere + (of_sphere >> ONE_U64))
        is_entering = of_sphere & ONE_U64 == ZERO_U64
    return prim_id, is_entering


@device
def primitive_hit_of(ray, t, u, v, number, rays, position, scene):
    """A `Hit` of the primitive of this number; see `hits.hit_of` for the arguments."""
    prim_id, is_entering = seen_from(scene, number, u, v, direction_at(rays, position))
    mesh = interval_of(scene.mesh_splits, scene.mesh_count, scene.mesh_halvings, np.int64(prim_id))
    return Hit(np.int64(ray), t, u, v, prim_id, np.int32(mesh), is_entering, _NO_INSTANCE)
