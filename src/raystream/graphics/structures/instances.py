"""Objects and their instances as shaders read them: all trees in one array, and one of places."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.geometry.instances.structure import InstancedBvh, InstancedStructure
from raystream.graphics.instanced_rays import placed_rays, power_of
from raystream.graphics.structures.base import ShaderStructure, budget_for, numbers
from raystream.graphics.structures.bvh import leaf_blocks, most_steps, stack_size
from raystream.kernels.ray import SceneFrame
from raystream.structures.bvh.layout import BvhArrays
from raystream.structures.bvh.steps import stack_half

#: Words of a row of ``places``.
_ROW = 4

#: Bits below the first block in the link of a leaf, see `BvhArrays`.
_LEAF_SHIFT = 3

#: An instance: from world to object space, and numbers; see ``instances/object_ray.wgsl``.
_INSTANCE = np.dtype(
    [
        ("linear", "f8", (3, 3)),
        ("shift", "f8", 3),
        ("object_id", "u4"),
        ("first_id", "i4"),
        ("world", "i4"),
        ("unused", "u4"),
    ]
)

#: An object, likewise.
_OBJECT = np.dtype(
    [
        ("center", "f8", 3),
        ("scale_exponent", "i4"),
        ("max_coordinate", "f4"),
        ("low", "f4", 3),
        ("first", "i4"),
        ("high", "f4", 3),
        ("end", "i4"),
    ]
)

#: Files of scenes with instances.
_INSTEAD = {
    "ray_buffer.wgsl": "instances/ray_buffer.wgsl",
    "offer.wgsl": "instances/offer.wgsl",
    "bvh_root.wgsl": "instances/bvh_root.wgsl",
    "brute_rows.wgsl": "instances/brute_rows.wgsl",
}


def instanced_structure(structure: Any) -> ShaderStructure:
    """The structures of the objects, and the tree over the instances, as shaders read them."""
    made = _trees(structure) if structure.name == "bvh" else _lists(structure)
    return replace(made, rays=placed_rays(float(structure.view.far_unit)))


def _trees(bvh: InstancedBvh) -> ShaderStructure:
    trees: list[BvhArrays] = [one.tree for one in bvh.objects]  # type: ignore[attr-defined]
    top = _top(bvh)
    first_nodes = _firsts([len(top), *(len(one.nodes) for one in trees)])
    first_blocks = _firsts([0, *(len(one.leaves) for one in trees)])
    nodes = [top]
    for one, node, block in zip(trees, first_nodes[1:], first_blocks[1:], strict=False):
        nodes.append(_relinked(one.nodes, node, block << _LEAF_SHIFT))
    objects = _objects(bvh)
    lengths = np.array([len(one.nodes) for one in trees], np.int64)
    objects["first"] = np.where(lengths > 0, first_nodes[1:-1], -1)
    starts = bvh.trees.first_nodes
    roots = np.where(np.diff(starts) > 0, starts[:-1], -1).astype(np.int32)
    places, object_at, root_at = _places(_instances(bvh), objects, roots)
    counts = np.bincount(bvh.triangles.instances.object_ids, minlength=len(trees)).tolist()
    most = 12 * len(top) + sum(
        count * (1 + most_steps(one)) for count, one in zip(counts, trees, strict=True)
    )
    top_half = stack_half(BvhArrays(top.view(np.float32), np.empty((0, 40), np.float32)))
    half = max((one.stack_half for one in bvh.objects), default=0)  # type: ignore[attr-defined]
    return ShaderStructure(
        name="bvh",
        shader="bvh.wgsl",
        tree=numbers(object_at, root_at, len(roots)),
        arrays=(np.concatenate(nodes), _joined(leaf_blocks(one) for one in trees), places),
        budget=budget_for(most),
        sizes={"STACK_SIZE": stack_size(top_half + half)},
        instead=_INSTEAD,
    )


def _top(bvh: InstancedBvh) -> NDArray[np.uint32]:
    """The nodes of the trees over instances, with links to rows of all nodes and instances."""
    trees = bvh.trees
    counts = np.diff(trees.first_nodes)
    node = np.repeat(trees.first_nodes[:-1], counts)
    leaf = np.repeat(trees.first_leaves[:-1], counts)
    return _relinked(trees.nodes, node[:, None], leaf[:, None] << _LEAF_SHIFT)


def _relinked(nodes: NDArray[np.float32], node: Any, leaf: Any) -> NDArray[np.uint32]:
    """A copy of nodes whose links are to later rows: by `node`, and by `leaf` in a link's bits."""
    copied = BvhArrays(nodes.copy(), np.empty((0, 40), np.float32))
    links = copied.children
    links[:] = np.where(links > 0, links + node, np.where(links < 0, links - leaf, 0))
    return copied.nodes.view(np.uint32)


def _lists(brute: InstancedStructure) -> ShaderStructure:
    triangles = brute.triangles
    ids = [one.triangles.prim_ids for one in brute.objects]
    splits = _firsts([len(one) for one in ids])
    objects = _objects(brute)
    objects["first"], objects["end"] = splits[:-1], splits[1:]
    placed = _instances(brute)
    # Lists have the prim_ids of the scene.
    placed["first_id"] -= triangles.first_prims[placed["object_id"]].astype(np.int32)
    places, object_at, _ = _places(placed, objects, np.zeros(0, np.int32))
    firsts = triangles.first_prims[:-1]
    rows = _joined(one + first for one, first in zip(ids, firsts, strict=True))
    counts = np.bincount(triangles.instances.object_ids, minlength=len(ids)).tolist()
    most = sum(count * (1 + len(one)) for count, one in zip(counts, ids, strict=True))
    return ShaderStructure(
        name="brute",
        shader="brute.wgsl",
        tree=numbers(object_at, len(placed)),
        arrays=(rows.astype(np.uint32), triangles.object_corners(), places),
        budget=budget_for(most),
        instead=_INSTEAD,
    )


def _instances(structure: InstancedStructure) -> NDArray[np.void]:
    """The records of the instances, in the order of the tree's leaves."""
    leaves = structure.arrays["leaves"]
    records = np.zeros(len(leaves), _INSTANCE)
    for name in ("linear", "shift", "object_id", "first_id", "world"):
        records[name] = leaves[name]
    return records


def _objects(structure: InstancedStructure) -> NDArray[np.void]:
    """The records of the objects, without their first and last rows."""
    records = np.zeros(len(structure.objects), _OBJECT)
    for record, one in zip(records, structure.objects, strict=True):
        frame = SceneFrame.of(one.triangles)
        for name in ("center", "max_coordinate", "low", "high"):
            record[name] = getattr(frame, name)
        record["scale_exponent"] = power_of(frame.scale)
    return records


def _places(
    placed: NDArray[np.void], objects: NDArray[np.void], roots: NDArray[np.int32]
) -> tuple[NDArray[np.uint32], int, int]:
    """Instances, objects and roots one after another, in rows; and where the last two begin."""
    padded = np.concatenate([roots, np.zeros(-len(roots) % _ROW, np.int32)])
    parts = [np.ascontiguousarray(one).view(np.uint32) for one in (placed, objects, padded)]
    rows = _firsts([len(one) // _ROW for one in parts])
    return np.concatenate(parts), rows[1], rows[2]


def _firsts(counts: Sequence[int]) -> list[int]:
    """Where parts of these lengths begin, one after another; and the end."""
    return np.concatenate([[0], np.cumsum(counts, dtype=np.int64)]).astype(np.int64).tolist()


def _joined(arrays: Any) -> NDArray[Any]:
    parts = list(arrays)
    return np.concatenate(parts) if parts else np.empty(0, np.uint32)
