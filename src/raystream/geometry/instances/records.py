"""Objects and instances as kernels read them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.instanced_triangles import InstancedTriangles
from raystream.geometry.primitives.records import PrimitiveAddresses
from raystream.jit.views import view
from raystream.kernels.leaf_block import BLOCK_BYTES
from raystream.kernels.ray import SceneFrame
from raystream.structures.base import Structure

#: World to object space: ``linear @ point + shift``; the object, the number of its first triangle
#: in this instance, its world, 0 if there are none, and all bits of its masks. As long as a
#: block of triangles, so that traversals prefetch a leaf of either tree where it is.
_FIELDS: list[Any] = [
    ("linear", "f8", (3, 3)),
    ("shift", "f8", 3),
    ("object_id", "u4"),
    ("first_id", "i4"),
    ("world", "i4"),
    ("mask", "i4"),
]
_REST = BLOCK_BYTES - np.dtype(_FIELDS).itemsize
_INSTANCE = np.dtype([*_FIELDS, ("unused", f"V{_REST}")])
InstanceRecord = view(_INSTANCE)
INSTANCE_BYTES = _INSTANCE.itemsize

#: A tree over instances: addresses of its first node, 0 for an empty tree, and of the record of its
#: first leaf.
TREE = np.dtype([("nodes", "u8"), ("leaves", "u8")])
TreeRecord = view(TREE)

#: The arrays of an object's structure, 0 for those of another kind; and its `SceneFrame`. By these
#: names, a view serves as both.
OBJECT_ADDRESSES = ("nodes", "leaves", "references", "corners")
_TREES = (*OBJECT_ADDRESSES, "triangle_count")
_BESIDE = tuple(name for name in PrimitiveAddresses._fields if name not in _TREES)
_OBJECT = np.dtype(
    [
        *((name, "u8") for name in _TREES),
        ("center", "f8", 3),
        ("scale", "f8"),
        ("inverse_scale", "f8"),
        ("low", "f4", 3),
        ("high", "f4", 3),
        ("max_coordinate", "f4"),
        ("unused", "V4"),
        *((name, "u8") for name in _BESIDE),
    ]
)
ObjectRecord = view(_OBJECT)


def object_records(structures: Sequence[Structure]) -> NDArray[np.void]:
    """The records of objects; the caller keeps the structures alive."""
    records = np.zeros(len(structures), _OBJECT)
    for record, structure in zip(records, structures, strict=True):
        addresses = structure.view._asdict()
        for name in (*_TREES, *_BESIDE):
            record[name] = addresses.get(name, 0)
        for name, value in SceneFrame.of(structure.triangles)._asdict().items():
            record[name] = value
    return records


def instance_records(triangles: InstancedTriangles, order: NDArray[np.integer]) -> NDArray[np.void]:
    """The records of some instances, in an order."""
    records = np.zeros(len(order), _INSTANCE)
    instances = triangles.instances
    inverses = instances.inverses.reshape(-1, 12)[order].reshape(-1, 3, 4)
    # Faster than by fields.
    numbers = records.view(np.float64).reshape(len(order), INSTANCE_BYTES // 8)
    numbers[:, :9] = inverses[:, :, :3].reshape(-1, 9)
    numbers[:, 9:12] = inverses[:, :, 3]
    records["object_id"] = instances.object_ids[order]
    records["first_id"] = triangles.first_ids[order]
    records["mask"] = triangles.instance_masks.view(np.int32)[order]
    if instances.worlds is not None:
        records["world"] = instances.worlds[order]
    return records
