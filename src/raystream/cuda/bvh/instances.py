"""Instances on the GPU: one loop through the tree over them and the trees of their objects.

Where a ray enters an instance, a mark on the stack says to continue outside when all
within has been visited. So the threads of a warp visit nodes together, be it those of the tree over
the instances or of an object, and there is one stack.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.cuda.bvh import binary, points
from raystream.cuda.bvh.kernels import LaidOut, with_arrays
from raystream.cuda.bvh.triangles import search_triangles
from raystream.cuda.bvh.walk import DONE, ENTRY, NEXT, ROOT, ray_traversal
from raystream.geometry.instances.nearest import ADJACENT, offer_placed, trees_search
from raystream.geometry.instances.records import TREE, InstanceRecord, ObjectRecord, TreeRecord
from raystream.geometry.instances.structure import InstancedBvh
from raystream.jit.constants import NULL, TWO_U64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import store
from raystream.jit.views import view
from raystream.kernels.hit_filter import may_enter
from raystream.kernels.ray import Ray, WorldRay, prepare_ray
from raystream.kernels.ray_source import local_ray
from raystream.kernels.search import enter_instance, is_full
from raystream.structures.bvh.layout import CHILDREN_AT, WIDTH

#: The mark on the stack: no leaf has this link.
_LEAVE = np.int32(-(2**31))

_LEAF_SHIFT = np.int32(3)
_NO_ID = np.int32(0)

_LIMITS = [("t_min", "f4"), ("t_max", "f4")]
_WORLD = np.dtype([("origin", "f8", 3), ("direction", "f8", 3), *_LIMITS])

#: A ray while it is inside an instance: the tree and the ray outside, and there the interval and
#: distances of its search, by the names of a `LocalRay`; and the ray in the world.
_OUTSIDE = np.dtype(
    [
        *((name, "u8") for name in ("nodes", "leaves", "objects")),
        ("world", _WORLD),
        ("t_scale", "f8"),
        ("t_offset", "f8"),
        ("axes", "u8", 3),
        ("numbers", "f4", 18),
        *_LIMITS,
    ]
)
_Outside = view(_OUTSIDE)
_MEMORY = np.uint64(_OUTSIDE.itemsize)

#: Bytes of a search's memory: this, the stacks of two trees, and a mark.
stack_bytes = _OUTSIDE.itemsize + 2 * binary.STACK_BYTES + 8


class _Place(NamedTuple):
    """Where a ray is: in the tree over the instances, or in that of an object.

    Attributes
    ----------
    nodes, leaves : uint64
        Of this tree.
    is_inside : bool
        Whether it is an object's.
    outside : uint64
        Address of an `_Outside`.
    """

    nodes: np.uint64
    leaves: np.uint64
    is_inside: bool
    outside: np.uint64


@device
def _at_leaf(place, ray, search, link, stack, top):
    """Test the triangles of an object, enter an instance, or leave it; see `binary_walk`."""
    outside = _Outside(place.outside)
    if link == _LEAVE:
        # The scene is entered as an instance would be: what is left of its interval is the same.
        search = enter_instance(search, outside, _NO_ID)
        ray = Ray(*outside.axes, *outside.numbers)
        place = _Place(outside.nodes, outside.leaves, False, place.outside)
    elif place.is_inside:
        search, is_over = search_triangles(place, link, ray, search, stack)
        if is_over:
            return place, ray, search, DONE, top
    else:
        instance = InstanceRecord(place.leaves, np.uint64(np.int32(~link) >> _LEAF_SHIFT))
        object_ = ObjectRecord(outside.objects, np.uint64(instance.object_id))
        world = outside.world
        whole = WorldRay(world.origin, world.direction, world.t_min, world.t_max)
        one = local_ray(whole, object_, instance)
        inner = enter_instance(search, one, instance.first_id)
        is_held = object_.nodes != NULL and may_enter(search.filter, instance.mask)
        if is_held and inner.t_min <= inner.t_far:
            store(top, _LEAVE)
            ray = prepare_ray(one.origin, one.direction, object_.max_coordinate)
            place = _Place(object_.nodes, object_.leaves, True, place.outside)
            return place, ray, inner, ROOT, top + ENTRY
    return place, ray, search, NEXT, top


_traverse_tree = ray_traversal(_at_leaf)


@device
def traverse(scene, ray, search, stack):
    """Search the instances of the ray's world, then those of all worlds."""
    top, whole, outside = scene.top, scene.ray, _Outside(stack)
    outside.objects = top.objects
    world = outside.world
    world.origin, world.direction = whole.origin, whole.direction
    world.t_min, world.t_max = whole.t_min, whole.t_max
    outside.t_scale, outside.t_offset = search.instance.t_scale, search.instance.t_offset
    outside.axes, outside.numbers = ray[:3], ray[3:]
    outside.t_min, outside.t_max = search.t_min, search.t_far
    for k in range(TWO_U64):
        if k == ZERO_U64 and scene.world < _NO_ID:
            continue
        tree = TreeRecord(top.shared)
        if k == ZERO_U64:
            tree = TreeRecord(top.trees, np.uint64(scene.world))
        outside.nodes, outside.leaves = tree.nodes, tree.leaves
        place = _Place(tree.nodes, tree.leaves, False, stack)
        search = _traverse_tree(place, ray, search, stack + _MEMORY)
        if is_full(search):
            break
    return search


point_search = trees_search(
    points.triangle_leaf(offer_placed), ADJACENT, points.nearest_walk, points.STACK_BYTES
)


def lay_out(structure: InstancedBvh) -> LaidOut:
    """Convert the trees over the instances; see `bvh.kernels.LAYOUTS`."""
    first, memory = structure.trees.first_nodes, structure.arrays
    # The trees are a row of them: links become those of one tree, and back.
    nodes = memory["nodes"].copy()
    begins = np.repeat(first[:-1], np.diff(first))[:, None]
    _add(nodes[:, CHILDREN_AT // 4 :][:, :WIDTH], begins)
    made = binary.unfold(nodes)
    starts = made.firsts[first]
    _add(made.nodes.reshape(-1, 2, 8)[:, :, 6], -np.repeat(starts[:-1], np.diff(starts))[:, None])
    trees = memory["trees"].copy()
    has_nodes = trees["nodes"] != 0
    places = made.nodes.ctypes.data + starts[:-1] * made.nodes.strides[0]
    trees["nodes"] = np.where(has_nodes, places, 0)
    laid = with_arrays(structure, {"nodes": made.nodes, "trees": trees})
    shared = np.uint64(trees.ctypes.data + trees.nbytes - TREE.itemsize)

    def objects():
        return [one for held in structure.objects for one in binary.unfold(*held.tree)[:2]]

    return laid._replace(tree=laid.tree._replace(shared=shared), nested=objects)


def _add(links, first):
    """Add a number to links to nodes, in place."""
    links = links.view(np.int32)
    links += np.where(links > 0, first, 0).astype(np.int32)
