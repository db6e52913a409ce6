"""The BVH as kernels: each ray has its own stack, which stays in memory between passes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.cpu import device
from raystream.kernels.leaf_block import BLOCK, block_ray, intersect_block, triangle_count
from raystream.kernels.search import LEAST_ROOM, SeenSet, clear_seen, is_full
from raystream.kernels.tally import LEAVES, STEPS, TESTS
from raystream.machines.records import RayState, end_of, ray_of, tick
from raystream.machines.steps.base import StepKernel, Steps, resumed, with_shade
from raystream.structures.bvh import steps as tree_steps
from raystream.structures.bvh.structure import BvhStructure

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
_INF = np.float32(np.inf)
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
def _seen_of(tree, wanted, query):
    """A ray's set of triangles: without places for one hit, which cannot be found twice."""
    room = _NONE if wanted.capacity == _ONE else tree.room
    return SeenSet(_stack_of(wanted, query) + tree.half + tree.half, room)


def set_up(ray, wanted, tree, query, kernel):
    """Put the root on the stack."""
    tick(query, wanted, kernel, STEPS, _NONE)
    stack = _stack_of(wanted, query)
    clear_seen(_seen_of(tree, wanted, query))
    top = tree_steps.begin(tree, ray.t_min, ray.t_max, stack, tree.half)
    state = _DONE if top == _NONE else _TRAVERSING
    return (np.uint32(0), ray.t_max), (np.uint32(top), _NONE, _NONE), state


def traverse(ray, wanted, found, place, tree, query, kernel):
    """Take a child from the stack: test the boxes of a node, or look at a leaf."""
    line, stack = block_ray(ray_of(ray, query)), _stack_of(wanted, query)
    top, block, end = np.uint64(place.top), place.block, place.end
    state = _TRAVERSING
    for _ in range(query.steps):
        has_entry, child, top = tree_steps.next_entry(stack, tree.half, top, found.t_far)
        if not has_entry:
            tick(query, wanted, kernel, STEPS, _NONE)
            state = end_of(np.uint64(found.count), query)
            break
        if tree_steps.is_leaf(child):
            tick(query, wanted, kernel, LEAVES, _ONE)
            block, end = tree_steps.leaf_blocks(tree, child)
            state = _INTERSECTING
            break
        tick(query, wanted, kernel, STEPS, _ONE)
        top = tree_steps.visit(tree, child, line, ray.t_min, found.t_far, stack, tree.half, top)
    return (np.uint32(top), block, end), state


@device
def _intersect(hits, ray, wanted, found, place, tree, query, kernel):
    line = block_ray(ray_of(ray, query))
    search = resumed(hits, ray, wanted, found, query, _seen_of(tree, wanted, query))
    block, state = place.block, _INTERSECTING
    for _ in range(query.tests):
        tick(query, wanted, kernel, TESTS, triangle_count(block))
        search = intersect_block(block, line, search, search.t_min, _INF)
        block += BLOCK
        if search.has_overflowed:
            state = _OVERFLOWN
            break
        if is_full(search):
            state = end_of(search.hit_count, query)
            break
        if block == place.end:
            state = _TRAVERSING
            break
    return (np.uint32(search.hit_count), search.t_far), (place.top, block, place.end), state


def intersect(ray, wanted, found, place, tree, query, kernel):
    """Test a block of up to four triangles."""
    if query.keep:
        return _intersect(query.hits, ray, wanted, found, place, tree, query, kernel)
    return _intersect(None, ray, wanted, found, place, tree, query, kernel)


_KERNELS = with_shade(
    StepKernel("set up", RayState.STARTING, device(set_up), ("found", "place")),
    StepKernel("traverse", RayState.TRAVERSING, device(traverse), ("place",), "steps"),
    StepKernel("intersect", RayState.INTERSECTING, device(intersect), ("found", "place"), "tests"),
)


def steps(bvh: BvhStructure) -> Steps:
    """The steps of a BVH's traversal, one ray at a time."""
    return _with_room(bvh, LEAST_ROOM if bvh.has_duplicates else _NONE)


def _with_room(bvh: BvhStructure, room: np.uint64) -> Steps:
    """The steps with so many places for the triangles that a ray has met."""
    half = bvh.stack_half
    table_bytes = (int(room) + 1) * 4 if room else 0
    stack_bytes = -(-(2 * half + table_bytes) // 64) * 64
    tree = _Tree(*bvh.arrays, np.uint64(half), room)
    grow = (lambda: _with_room(bvh, room * _MORE_ROOM)) if room else None
    return Steps(_KERNELS, PLACE, tree, stack_bytes, grow)
