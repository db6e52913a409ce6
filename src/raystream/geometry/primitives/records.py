"""Spheres, height fields and shapes as kernels read them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.height_field import HeightField, LocalField
from raystream.core.primitives import Primitives
from raystream.core.spheres import Spheres
from raystream.geometry.fields.levels import LEVEL, Levels
from raystream.jit.views import view
from raystream.kernels.shapes import SHAPE

SPHERES_PER_BLOCK = 4

#: Four spheres, world space; the numbers are those of the hits where a ray enters, see
#: `core.primitives`. Unused lanes have NaN. And the same with a lane index.
#: As long as a block of triangles, so that leaves are found and prefetched like theirs.
_NUMBERS = [("numbers", "i4", (SPHERES_PER_BLOCK, 1)), ("unused", "V16")]
_PLACES = [(name, "f8") for name in ("x", "y", "z", "radius")]
_BLOCK = np.dtype([*((*place, SPHERES_PER_BLOCK) for place in _PLACES), *_NUMBERS])
SphereBlock = view(_BLOCK)
SphereBlockLanes = view([*((*place, (SPHERES_PER_BLOCK, 1)) for place in _PLACES), *_NUMBERS])

LevelRecord = view(LEVEL)

#: A height field: addresses of the arrays of `LocalField` and of `Levels`; then counts, the number
#: of the first triangle, and 1 where the triangles' fronts are up in the order a, c, b, or x or y
#: decreases.
FIELD_ADDRESSES = ("heights", "x", "y", "ranges", "levels")
FIELD = np.dtype(
    [
        *((name, "u8") for name in FIELD_ADDRESSES),
        ("level_count", "u8"),
        ("width", "u8"),
        ("columns", "u8"),
        ("rows", "u8"),
        ("first_id", "i4"),
        ("turns", "i4"),
        ("x_falls", "i4"),
        ("y_falls", "i4"),
    ]
)
FieldRecord = view(FIELD)


class PrimitiveAddresses(NamedTuple):
    """The primitives of a scene; the caller keeps the arrays alive. 0 for empty ones.

    Attributes
    ----------
    nodes, leaves : uint64
        The triangles' `TreeAddresses`.
    references, corners, triangle_count : uint64
        The triangles' `BruteAddresses`.
    field_nodes, fields, field_count : uint64
        Addresses of the root of the height fields' tree, whose leaves are one each, and of the
        first `FieldRecord`.
    sphere_nodes, sphere_blocks, block_count : uint64
        Addresses of the root of the spheres' tree and of the first `SphereBlock`.
    shape_nodes, shapes, shape_count : uint64
        Addresses of the root of the shapes' tree, whose leaves are one each, and of the first
        `kernels.shapes.ShapeRecord`.
    """

    nodes: np.uint64
    leaves: np.uint64
    references: np.uint64
    corners: np.uint64
    triangle_count: np.uint64
    field_nodes: np.uint64
    fields: np.uint64
    field_count: np.uint64
    sphere_nodes: np.uint64
    sphere_blocks: np.uint64
    block_count: np.uint64
    shape_nodes: np.uint64
    shapes: np.uint64
    shape_count: np.uint64


def sphere_blocks(spheres: Spheres, rows: NDArray[np.int32], first: int) -> NDArray[np.void]:
    """The blocks of spheres.

    Parameters
    ----------
    spheres : Spheres
    rows : ndarray of shape (B, 4), int32
        The spheres of each block; -1 for an unused lane.
    first : int
        The first sphere's first number.
    """
    blocks = np.zeros(len(rows), _BLOCK)
    used = rows >= 0
    for axis, name in enumerate("xyz"):
        blocks[name] = np.where(used, spheres.centers[rows, axis], np.nan)
    blocks["radius"] = np.where(used, spheres.radii[rows], np.nan)
    blocks["numbers"] = np.where(used, first + 2 * rows, -1)[:, :, None]
    return blocks


def field_records(
    fields: Sequence[HeightField],
    local: Sequence[LocalField],
    levels: Sequence[Levels],
    first_ids: NDArray[np.int64],
    rows: Sequence[int],
) -> NDArray[np.void]:
    """The records of height fields, in the order of `rows`; the caller keeps the arrays alive."""
    records = np.zeros(len(rows), FIELD)
    for record, k in zip(records, rows, strict=True):
        field, arrays, tree = fields[k], local[k], levels[k]
        record["heights"], record["x"] = arrays.heights.ctypes.data, arrays.x.ctypes.data
        record["y"], record["ranges"] = arrays.y.ctypes.data, tree.ranges.ctypes.data
        record["levels"], record["level_count"] = tree.levels.ctypes.data, len(tree.levels)
        record["width"] = len(field.x)
        record["columns"], record["rows"] = len(field.x) - 1, len(field.y) - 1
        record["first_id"], record["turns"] = first_ids[k], not field.is_upward
        record["x_falls"] = field.x[1] < field.x[0]
        record["y_falls"] = field.y[1] < field.y[0]
    return records


def shape_records(primitives: Primitives) -> NDArray[np.void]:
    """The records of shapes, by their prim_ids; the caller keeps the primitives alive."""
    made = [one.functions.records_of(one.records, one.bounds) for one in primitives.shapes]
    records = np.concatenate([np.zeros(0, SHAPE), *made])
    firsts = primitives.crossings * np.arange(len(records))
    records["number"] = primitives.first_crossing + firsts
    return records


def shape_leaves(primitives: Primitives, rows: NDArray[np.int32]) -> NDArray[np.void]:
    """Those of `rows`, with the parameters beside them if there is room: one cache miss less."""
    records = shape_records(primitives)[rows]
    place = SHAPE.fields["inline"][1]  # type: ignore[index]
    room = records.view(np.uint8).reshape(-1, SHAPE.itemsize)[:, place:]
    firsts = primitives.first_shapes - primitives.first_shapes[0]
    for own, first in zip(primitives.shapes, firsts.tolist(), strict=False):
        size = own.records.itemsize
        at = np.flatnonzero((rows >= first) & (rows < first + len(own)))
        if size <= room.shape[1] and len(at):
            given = own.records.view(np.uint8).reshape(-1, size)
            room[at, :size] = given[rows[at] - first]
            records["record"][at] = records.ctypes.data + at * SHAPE.itemsize + place
    return records
