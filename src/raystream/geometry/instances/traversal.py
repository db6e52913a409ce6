"""Traversal of instances by a single ray: a leaf continues the search in an object's structure.

The ray that an object is searched with is the world ray, moved to object space in float64 and then
made local as any ray of any scene is. So the hits in an instance are, bit for bit, those that a
tracer of the object alone finds for the moved ray. Distances need no conversion in world space,
as the moved direction is not normalised.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.core.rays import INVALID, VALID
from raystream.geometry.instances.records import TREE, InstanceRecord, ObjectRecord, TreeRecord
from raystream.geometry.primitives.traversal import RayScene, traverse_trees
from raystream.geometry.primitives.traversal import traverse_all as traverse_all_here
from raystream.geometry.spheres.sphere import exact_ray
from raystream.jit.constants import ONE_F64, ZERO_F64
from raystream.jit.cpu import device, device_call
from raystream.jit.simd import load
from raystream.kernels.hit_filter import may_enter
from raystream.kernels.queries import RaySearches, note_status, ray_filter, searches_of
from raystream.kernels.ray import WorldRay, largest, missing_ray, prepare_ray
from raystream.kernels.ray_source import in_object, load_ray, local_ray, read_ray
from raystream.kernels.search import (
    InstanceRay,
    begin_search,
    enter_instance,
    is_full,
    leave_instance,
)
from raystream.kernels.tally import tally_of
from raystream.structures.brute.traversal import traverse as traverse_brute
from raystream.structures.bvh.traversal import traverse as traverse_bvh
from raystream.structures.bvh.traversal import tree_traversal
from raystream.structures.bvh.walks.single import STACK_BYTES

__all__ = [
    "MOST_FAR",
    "STACK_BYTES",
    "TopAddresses",
    "instance_searches",
    "is_scalable",
    "load_scene_ray",
    "traverse_all",
    "traverse_all_primitives",
    "traverse_top",
    "traverse_top_primitives",
]

_STACK, _TREE = np.uint64(STACK_BYTES), np.uint64(TREE.itemsize)
_NONE, _, _TWO = np.arange(3, dtype=np.uint64)
_LEAF_SHIFT = np.int32(3)
_NO_ID = np.int32(0)

#: Directions must not be longer than this, or shorter than its inverse: moved to object space they
#: stay within float64.
MAX_LENGTH = 2.0**500

#: Padding of this many units of `kernels.ray.PAD` holds all of any local frame, whose coordinates
#: are below 2**40; and slab distances stay finite.
MOST_FAR = 2.0**60


#: A unit of `kernels.ray.PAD` in those of the padding of boxes in float64.
FAR_PADS = 2.0**29


class TopAddresses(NamedTuple):
    """The instances of a scene; the caller keeps the arrays alive.

    Attributes
    ----------
    trees : uint64
        Address of a `TreeRecord` for each world; at least one.
    shared : uint64
        Address of the tree of the instances in all worlds.
    leaves, objects : uint64
        Addresses of the first `InstanceRecord` and the first `ObjectRecord`.
    instance_count : uint64
        Instances that can be hit.
    worlds : uint64
        Address of the rays' worlds, int32; 0 if there are none.
    far_unit : float64
        The boxes' additional padding, as a fraction of the ray's largest world coordinate, in
        units of `kernels.ray.PAD`.
    """

    trees: np.uint64
    shared: np.uint64
    leaves: np.uint64
    objects: np.uint64
    instance_count: np.uint64
    worlds: np.uint64
    far_unit: np.float64


class InstanceContext(NamedTuple):
    """The instances that one ray may hit, with that ray in world space.

    Attributes
    ----------
    top : TopAddresses
    world : int32
        Of the ray; -1 meets the instances in all worlds only.
    ray : WorldRay
    is_valid : bool
        Whether it is traced at all.
    """

    top: TopAddresses
    world: np.int32
    ray: WorldRay
    is_valid: bool


class _RayTree(NamedTuple):
    """One of the trees that a ray traverses; by the names that `tree_traversal` reads."""

    nodes: np.uint64
    leaves: np.uint64
    objects: np.uint64
    ray: WorldRay


@device
def is_scalable(direction):
    """Whether a direction's length is within bounds."""
    return 1.0 / MAX_LENGTH <= largest(direction) <= MAX_LENGTH


@device
def _triangles_at(object_, instance, whole, ray):  # noqa: ARG001
    """What triangles are traversed as, with a ray: the object's addresses."""
    return object_


@device
def _primitives_at(object_, instance, whole, ray):
    """The object's primitives, with the ray in float64 in its space."""
    moved, offset = in_object(whole, instance), ray.t_offset / ray.t_scale
    return RayScene(object_, exact_ray(moved, offset, object_))


def _instance_search(traverse, scene_at=_triangles_at):
    """Make the search in one instance, for objects with structures of one kind."""

    def search_instance(tree, index, search, stack):
        instance = InstanceRecord(tree.leaves, index)
        if not may_enter(search.filter, instance.mask):
            return search
        object_ = ObjectRecord(tree.objects, np.uint64(instance.object_id))
        ray = local_ray(tree.ray, object_, instance)
        inner = enter_instance(search, ray, instance.first_id)
        if not (inner.t_min <= inner.t_far):
            return search
        local = prepare_ray(ray.origin, ray.direction, object_.max_coordinate)
        scene = scene_at(object_, instance, tree.ray, ray)
        return leave_instance(search, traverse(scene, local, inner, stack))

    return search_instance


def top_traversal(search_instance, make_traversal=tree_traversal):
    """Make the traversal of the trees over instances, given the search in one of them.

    `make_traversal` makes that of a tree, see `structures.bvh.traversal.tree_traversal`.
    """

    @device
    def search_leaf(tree, child, line, search, stack):  # noqa: ARG001
        index = np.uint64(np.int32(~child) >> _LEAF_SHIFT)
        return search_instance(tree, index, search, stack + _STACK)

    traverse_tree = device(make_traversal(search_leaf))

    @device
    def traverse(scene, ray, search, stack):
        """Search the instances of BVHs: those of the ray's world, then those of all worlds."""
        top = scene.top
        for k in range(_TWO):
            if k == _NONE and scene.world < _NO_ID:
                continue
            at = top.trees + np.uint64(scene.world) * _TREE if k == _NONE else top.shared
            tree = TreeRecord(at)
            one = _RayTree(tree.nodes, tree.leaves, top.objects, scene.ray)
            search = traverse_tree(one, ray, search, stack)
            if is_full(search):
                break
        return search

    return traverse


def whole_traversal(search_instance):
    """Make the search of all instances, without a tree, given the search in one of them."""

    @device
    def traverse(scene, ray, search, stack):  # noqa: ARG001
        """Search all instances of the ray's world, by brute force."""
        if scene.is_valid:
            top = scene.top
            tree = _RayTree(_NONE, top.leaves, top.objects, scene.ray)
            for index in range(top.instance_count):
                world = InstanceRecord(top.leaves, index).world
                if world == scene.world or world < _NO_ID:
                    search = search_instance(tree, index, search, stack)
                    if is_full(search):
                        break
        return search

    return traverse


def _searches(triangles, primitives):
    """The searches in an instance of triangles, and in one of primitives of any kind."""
    return (
        device_call(_instance_search(triangles)),
        device_call(_instance_search(primitives, _primitives_at)),
    )


#: With trees over triangles, and over primitives; and without trees.
traverse_top, traverse_top_primitives = map(top_traversal, _searches(traverse_bvh, traverse_trees))
traverse_all, traverse_all_primitives = map(
    whole_traversal, _searches(traverse_brute, traverse_all_here)
)


@device
def load_scene_ray(source, i, top, frame):
    """Load a ray among the boxes of a scene's instances.

    Parameters
    ----------
    source : RaySource
    i : uint64
    top : TopAddresses
    frame : SceneFrame
        Of the boxes.

    Returns
    -------
    ray : LocalRay
        With an empty interval if it is not valid.
    most : float32
        For `prepare_ray`: the largest coordinate, and the boxes' additional padding.
    whole : WorldRay
    """
    whole, ray = read_ray(source, i), load_ray(source, i, frame)
    is_valid = ray.status == VALID and is_scalable(whole.direction)
    reach = largest(whole.origin) * frame.scale
    far = np.float32(min(top.far_unit * reach, MOST_FAR))
    if not is_valid:
        ray = missing_ray(INVALID)
    return ray, frame.max_coordinate + far, whole


@device
def world_of(top, i):
    """The world of ray i; 0 if there are none."""
    return _NO_ID if top.worlds == _NONE else load(np.int32, top.worlds + (i << _TWO))


def instance_searches(traverse) -> RaySearches:
    """Make the searches of a ray with a traversal of instances; see `kernels.queries.searches`."""

    @device
    def search_ray(i, scene, goal, memory):
        top = scene.arrays
        ray, most, whole = load_scene_ray(scene.source, i, top, scene.frame)
        note_status(scene.status, i, ray.status)
        local = prepare_ray(ray.origin, ray.direction, most)
        instance = InstanceRay(ray.t_scale, ray.t_offset, _NO_ID)
        tally, filter_ = tally_of(scene.tallies, i), ray_filter(scene.filter, i, ray)
        search = begin_search(ray.t_min, ray.t_max, goal, tally, filter_, instance)
        context = InstanceContext(top, world_of(top, i), whole, ray.status == VALID)
        # Distances are those of world space already.
        return traverse(context, local, search, memory), InstanceRay(ONE_F64, ZERO_F64, _NO_ID)

    return searches_of(search_ray)
