"""The BVH as kernels: each ray's stack stays in memory between passes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.constants import INF_F32, ONE_U64
from raystream.kernels.leaf_block import BLOCK, PRIM_IDS, block_ray, intersect_block, triangle_count
from raystream.kernels.search import is_full, wants_any
from raystream.kernels.tally import LEAVES, STEPS, TESTS
from raystream.machines.records import (
    INTERSECTING,
    TRAVERSING,
    count_step,
    end_state,
    found_by,
    prepared_ray,
    stack_of,
)
from raystream.machines.steps.base import Steps, resume_search, traversal_kernels
from raystream.structures.bvh import steps as tree_steps
from raystream.structures.bvh.structure import BvhStructure

#: The traversal state of a ray: the bytes on its stack, and the blocks of its leaf that are still
#: to be tested.
PLACE = np.dtype([("top", np.uint32), ("block", np.uint64), ("end", np.uint64)])

_NONE = np.uint64(0)


class _Tree(NamedTuple):
    """A tree by address; bytes of half a stack."""

    nodes: np.uint64
    leaves: np.uint64
    half: np.uint64


def set_up(ray, wanted, tree, query, kernel):
    """Put the root on the stack."""
    count_step(query, wanted, kernel, STEPS, _NONE)
    stack = stack_of(wanted, query)
    top = tree_steps.begin(tree, ray.t_min, ray.t_max, stack, tree.half)
    state = end_state(_NONE, query) if top == _NONE else TRAVERSING
    return (np.uint32(0), ray.t_max), (np.uint32(top), _NONE, _NONE), state


def traverse(ray, wanted, found, place, tree, query, kernel):
    """Pop a child from the stack: test the boxes of a node, or find the blocks of a leaf."""
    line, stack = block_ray(prepared_ray(ray, query)), stack_of(wanted, query)
    search = resume_search(query.hits, ray, wanted, found, query)
    is_any = wants_any(search)
    top, block, end = np.uint64(place.top), place.block, place.end
    state = TRAVERSING
    for _ in range(query.steps):
        has_entry, child, top = tree_steps.next_entry(stack, tree.half, top, found.t_far)
        if not has_entry:
            count_step(query, wanted, kernel, STEPS, _NONE)
            state = end_state(np.uint64(found.count), query)
            break
        if tree_steps.is_leaf(child):
            count_step(query, wanted, kernel, LEAVES, ONE_U64)
            block, end = tree_steps.leaf_blocks(tree, child)
            state = INTERSECTING
            break
        count_step(query, wanted, kernel, STEPS, ONE_U64)
        top = tree_steps.visit(
            tree, child, line, ray.t_min, found.t_far, is_any, stack, tree.half, top
        )
    return (np.uint32(top), block, end), state


def intersect(ray, wanted, found, place, query, kernel):
    """Test a block of up to four triangles."""
    line = block_ray(prepared_ray(ray, query))
    search = resume_search(query.hits, ray, wanted, found, query)
    block, state = place.block, INTERSECTING
    for _ in range(query.tests):
        count_step(query, wanted, kernel, TESTS, triangle_count(block + PRIM_IDS))
        search = intersect_block(block, line, search, search.t_min, INF_F32)
        block += BLOCK
        if is_full(search):
            state = end_state(search.hit_count, query)
            break
        if block == place.end:
            state = TRAVERSING
            break
    return found_by(search), (place.top, block, place.end), state


_KERNELS = traversal_kernels(set_up, traverse, intersect)


def steps(bvh: BvhStructure) -> Steps:
    """The steps of a BVH's traversal, one ray at a time."""
    half = bvh.stack_half
    return Steps(_KERNELS, PLACE, _Tree(bvh.view.nodes, bvh.view.leaves, np.uint64(half)), 2 * half)
