"""Rays through instances of triangles in float64.

The ray is moved to object space in float64, as for objects in float32, and traced there as any ray
with precision="float64" is. So a hit's distance is the one that is exact for the moved ray: the
rounding of the move is all that an instance adds. Moved directions are not normalised, and the line
that an object is searched with is a power of two as long: distances are converted without rounding.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from raystream.core.rays import INVALID, VALID
from raystream.geometry.float64.queries import LANES_BYTES, take_hit
from raystream.geometry.float64.ray import prepare_float64
from raystream.geometry.float64.rows import (
    enter_float64,
    leave_float64,
    put_row,
    sort_rows,
)
from raystream.geometry.float64.traversal import (
    STACK_BYTES,
    Float64Tree,
    all_blocks,
    box_walk,
    tree_blocks,
)
from raystream.geometry.instances.records import InstanceRecord, ObjectRecord
from raystream.geometry.instances.traversal import (
    FAR_PADS,
    InstanceContext,
    is_scalable,
    top_traversal,
    whole_traversal,
    world_of,
)
from raystream.jit.constants import INF_F64, ONE_U64, ZERO_F64, ZERO_U64
from raystream.jit.cpu import device, device_call
from raystream.kernels.hit_filter import may_enter
from raystream.kernels.queries import RaySearches, note_status, ray_filter
from raystream.kernels.ray import SceneFrame, largest
from raystream.kernels.ray_source import in_object, read_float64_ray
from raystream.kernels.search import (
    InstanceRay,
    SearchGoal,
    begin_search,
    is_full,
    wants_any,
)
from raystream.kernels.tally import LEAVES, add_to, tally_of

#: Memory of a traversal of trees; and of one without.
MEMORY_BYTES = 2 * STACK_BYTES + LANES_BYTES

_LANES = np.uint64(LANES_BYTES)
_MISS, _FIRST = np.int32(-1), np.int32(0)


class _ObjectRay(NamedTuple):
    """A ray in object space, by the names that `kernels.search.enter_instance` reads."""

    t_min: np.float64
    t_max: np.float64
    t_scale: np.float64
    t_offset: np.float64


def _instance_search(blocks: Any) -> Any:
    """Make the search in one instance, given the traversal of its object."""
    walk = blocks(take_hit)

    @device_call
    def search_instance(tree, index, search, stack):
        instance = InstanceRecord(tree.leaves, index)
        if not may_enter(search.filter, instance.mask):
            return search
        object_ = ObjectRecord(tree.objects, np.uint64(instance.object_id))
        ray = prepare_float64(in_object(tree.ray, instance), object_)
        line, scale = ray.line, ray.half * ray.rest
        moved = _ObjectRay(line.t_min, line.t_max, scale, ZERO_F64)
        inner = enter_float64(search, moved, instance.first_id)
        if not (inner.t_min <= inner.t_far):
            return search
        own = Float64Tree(object_.nodes, object_.leaves, object_.block_count)
        inner = walk(own, (ray, stack, search.counters), inner, stack + _LANES, wants_any(inner))
        return leave_float64(search, inner)

    return search_instance


def _tree_traversal(search_leaf: Any) -> Any:
    """Make the traversal of a tree of boxes; as `structures.bvh.traversal.tree_traversal`."""

    @device
    def visit_leaf(tree, child, line, search, stack):
        add_to(search.counters, LEAVES, ONE_U64)
        search = search_leaf(tree, child, line, search, stack)
        return search, is_full(search)

    walk = box_walk(visit_leaf)

    def traverse(tree, ray, search, stack):
        return walk(tree, (ray, ZERO_U64, search.counters), search, stack, wants_any(search))

    return traverse


#: With trees, and without.
traverse_top_float64 = top_traversal(_instance_search(tree_blocks), _tree_traversal)
traverse_all_float64 = whole_traversal(_instance_search(all_blocks))


def float64_instance_searches(traverse: Any) -> RaySearches:
    """Make the searches of a ray with a traversal of instances; see `kernels.queries.searches`."""

    @device
    def search_ray(i, scene, goal, memory):
        top, frame = scene.arrays, scene.frame
        whole = read_float64_ray(scene.source, i)
        # Step 1: boxes are padded by what moving the ray to object space may round.
        far = top.far_unit * FAR_PADS * largest(whole.origin) * frame.scale
        most = np.float64(frame.max_coordinate) + far
        ray = prepare_float64(
            whole,
            SceneFrame(frame.center, frame.scale, frame.inverse_scale, frame.low, frame.high, most),
        )
        # Step 2: directions whose products leave float64 in object space are not traced.
        is_valid = ray.status == VALID and is_scalable(whole.direction)
        note_status(scene.status, i, VALID if is_valid else INVALID)
        own = InstanceRay(ray.half * ray.rest, ZERO_F64, _FIRST)
        t_max = ray.line.t_max if is_valid else -INF_F64
        tally, filter_ = tally_of(scene.tallies, i), ray_filter(scene.filter, i, own)
        search = begin_search(ray.line.t_min, t_max, goal, tally, filter_, own)
        context = InstanceContext(top, world_of(top, i), whole, is_valid)
        return traverse(context, ray, search, memory)

    @device
    def nearest(i, scene, hits, memory):
        search = search_ray(i, scene, SearchGoal(ONE_U64, hits, i, False), memory)
        if search.hit_count == ZERO_U64:
            put_row(hits, i, INF_F64, ZERO_F64, ZERO_F64, _MISS)
        return search.hit_count

    @device
    def count(i, scene, goal, memory):
        return search_ray(i, scene, goal, memory).hit_count

    @device
    def keep(i, scene, goal, sorts, memory):
        search = search_ray(i, scene, goal, memory)
        if sorts:
            sort_rows(goal.hits, goal.first_row, search.hit_count)
        return search.hit_count

    return RaySearches(nearest, count, keep, np.float64)
