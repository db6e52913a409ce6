"""The BVH as kernels: each ray has its own stack, which stays in memory between passes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import scratch
from raystream.kernels.queries import AGAIN
from raystream.kernels.seen import LEAST_ROOM, clear_room
from raystream.kernels.tally import LEAVES, STEPS, TESTS
from raystream.machines.records import RayState, end_of, ray_of, tick
from raystream.machines.steps.base import StepKernel, Steps, with_shade
from raystream.structures.bvh import Bvh
from raystream.structures.bvh import steps as search
from raystream.structures.bvh.block import lane_frame
from raystream.structures.bvh.wide import BLOCK

__all__ = ["steps"]

#: Where a ray's search is: the bytes on its stack, and the blocks of its leaf that are still to
#: be tested.
PLACE = np.dtype([("top", np.uint32), ("block", np.uint64), ("end", np.uint64)])

_DONE = np.uint8(RayState.DONE)
_TRAVERSING = np.uint8(RayState.TRAVERSING)
_INTERSECTING = np.uint8(RayState.INTERSECTING)
_OVERFLOWN = np.uint8(RayState.OVERFLOWN)
_NONE = np.uint64(0)
_ONE = np.uint64(1)
_MORE_ROOM = np.uint64(8)


class _Tree(NamedTuple):
    """A tree by address; bytes of a half of a stack; places of a ray's set of triangles."""

    nodes: np.uint64
    leaves: np.uint64
    half: np.uint64
    room: np.uint64


@device
def _stack_of(wanted, query):
    return query.stacks + np.uint64(wanted.number) * query.stack_bytes


@device
def _room_of(tree, wanted):
    """Places of a ray's set of triangles: one hit alone cannot be found twice."""
    return _NONE if wanted.capacity == _ONE else tree.room


def set_up(ray, wanted, tree, query, kernel):
    """Put the root on the stack."""
    tick(query, wanted, kernel, STEPS, _NONE)
    stack = _stack_of(wanted, query)
    room = _room_of(tree, wanted)
    if room != _NONE:
        clear_room(stack + tree.half + tree.half, room)
    top = search.begin(tree, ray.t_min, ray.t_max, stack, tree.half)
    state = _DONE if top == _NONE else _TRAVERSING
    return (np.uint32(0), ray.t_max), (np.uint32(top), _NONE, _NONE), state


def traverse(ray, wanted, found, place, tree, query, kernel):
    """Take a child from the stack: test the boxes of a node, or look at a leaf."""
    frame, stack = lane_frame(ray_of(ray, query)), _stack_of(wanted, query)
    top, block, end = np.uint64(place.top), place.block, place.end
    state = _TRAVERSING
    for _ in range(query.steps):
        has_entry, child, top = search.next_entry(stack, tree.half, top, found.t_far)
        if not has_entry:
            tick(query, wanted, kernel, STEPS, _NONE)
            state = end_of(np.uint64(found.count), query)
            break
        if search.is_leaf(child):
            tick(query, wanted, kernel, LEAVES, _ONE)
            block, end = search.leaf_blocks(tree, child)
            state = _INTERSECTING
            break
        tick(query, wanted, kernel, STEPS, _ONE)
        top = search.visit(tree, child, frame, ray.t_min, found.t_far, stack, tree.half, top)
    return (np.uint32(top), block, end), state


def intersect(ray, wanted, found, place, tree, query, kernel):
    """Test a block of up to four triangles."""
    frame, lanes = lane_frame(ray_of(ray, query)), scratch(64)
    table = _stack_of(wanted, query) + tree.half + tree.half
    block, count, t_far = place.block, np.uint64(found.count), found.t_far
    state = _INTERSECTING
    for _ in range(query.tests):
        tick(query, wanted, kernel, TESTS, search.triangle_count(block))
        count, t_far = search.intersect_block(
            block,
            frame,
            ray.t_min,
            t_far,
            query.surfaces,
            query.keep,
            count,
            wanted.capacity,
            wanted.first,
            query.hits,
            table,
            _room_of(tree, wanted),
            lanes,
        )
        block += BLOCK
        if count == AGAIN:
            state = _OVERFLOWN
            break
        if search.is_over(count, wanted.capacity, query.keep):
            state = end_of(count, query)
            break
        if block == place.end:
            state = _TRAVERSING
            break
    return (np.uint32(count), t_far), (place.top, block, place.end), state


_KERNELS = with_shade(
    StepKernel("set up", RayState.STARTING, device(set_up), ("found", "place")),
    StepKernel("traverse", RayState.TRAVERSING, device(traverse), ("place",), "steps"),
    StepKernel("intersect", RayState.INTERSECTING, device(intersect), ("found", "place"), "tests"),
)


def steps(bvh: Bvh) -> Steps:
    """The steps of a BVH's traversal, one ray at a time."""
    return _with_room(bvh, LEAST_ROOM if bvh.lists_twice else _NONE)


def _with_room(bvh: Bvh, room: np.uint64) -> Steps:
    """The steps with so many places for the triangles that a ray has met."""
    half = bvh.stack_half
    table_bytes = (int(room) + 1) * 4 if room else 0
    stack_bytes = -(-(2 * half + table_bytes) // 64) * 64
    tree = _Tree(*bvh.arrays, np.uint64(half), room)
    grow = (lambda: _with_room(bvh, room * _MORE_ROOM)) if room else None
    return Steps(_KERNELS, PLACE, tree, stack_bytes, grow)
