"""The graph of sectors as kernels: set up, traverse, intersect, shade."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device
from raystream.kernels.leaf_block import BLOCK, block_ray, intersect_block
from raystream.kernels.search import is_full, is_over
from raystream.kernels.tally import LEAVES, LINK_NODES, STEPS, TESTS
from raystream.machines.records import RayState, end_of, note, ray_of, tick
from raystream.machines.steps.base import StepKernel, Steps, resumed, with_shade
from raystream.structures.graph.steps import (
    clip_to_scene,
    exit_face,
    follow_link,
    sector_blocks,
    sector_ray,
    start_sector,
)
from raystream.structures.graph.structure import GraphStructure

__all__ = ["steps"]

#: Where a ray is: its sector, which it is in from `t_in`, and where its search ends; the block
#: that is next, and how many triangles it and those after it hold.
PLACE = np.dtype(
    [
        ("sector", np.uint64),
        ("t_in", np.float32),
        ("t_end", np.float32),
        ("block", np.uint64),
        ("left", np.uint32),
    ]
)

_DONE = np.uint8(RayState.DONE)
_TRAVERSING = np.uint8(RayState.TRAVERSING)
_INTERSECTING = np.uint8(RayState.INTERSECTING)
_NONE = np.uint64(0)
_ONE = np.uint64(1)
_LANES = np.uint64(4)


@device
def _go_on(tree, line, sector, t_end, search, wanted, query):
    """Leave a sector, unless nothing more is wanted: next state, sector, and t there."""
    face = exit_face(line, sector)
    t_out = min(face.t, t_end)
    if t_out >= t_end or is_over(search, t_out):
        return end_of(search.hit_count, query), sector, t_out
    sector, node_count = follow_link(tree, line, face.link, t_out)
    note(query, wanted, LINK_NODES, node_count)
    return _TRAVERSING, sector, t_out


def set_up(ray, wanted, tree, query, kernel):
    """Find the sector in which a ray begins."""
    tick(query, wanted, kernel, STEPS, _NONE)
    line = ray_of(ray, query)
    is_active, t_in, t_end = clip_to_scene(tree, line, ray.t_min, ray.t_max)
    state, sector = _DONE, tree.rows
    if is_active:
        state = _TRAVERSING
        sector, _ = start_sector(tree, sector_ray(line), line, t_in)
    place = sector, t_in, t_end, _NONE, np.uint32(0)
    return (np.uint32(0), ray.t_max), place, state


def traverse(ray, wanted, found, place, tree, query, kernel):
    """Look at the sector that a ray is in; go on to the next one if it is empty."""
    line = sector_ray(ray_of(ray, query))
    sector, t_in, block, left = place.sector, place.t_in, place.block, np.uint64(place.left)
    search, state = resumed(None, ray, wanted, found, query, None), _TRAVERSING
    for _ in range(query.steps):
        tick(query, wanted, kernel, STEPS, _ONE)
        block, end, left = sector_blocks(tree, sector)
        if block != end:
            note(query, wanted, LEAVES, _ONE)
            state = _INTERSECTING
            break
        state, sector, t_in = _go_on(tree, line, sector, place.t_end, search, wanted, query)
        if state != _TRAVERSING:
            break
    return (sector, t_in, place.t_end, block, np.uint32(left)), state


@device
def _intersect(hits, ray, wanted, found, place, tree, query, kernel):
    prepared = ray_of(ray, query)
    line, triangle_ray = sector_ray(prepared), block_ray(prepared)
    search = resumed(hits, ray, wanted, found, query, None)
    sector, t_in, block, left = place.sector, place.t_in, place.block, np.uint64(place.left)
    t_out = min(exit_face(line, sector).t, place.t_end)
    state = _INTERSECTING
    for _ in range(query.tests):
        tick(query, wanted, kernel, TESTS, min(left, _LANES))
        search = intersect_block(block, triangle_ray, search, t_in, t_out)
        block += BLOCK
        left -= min(left, _LANES)
        if is_full(search):
            state = end_of(search.hit_count, query)
            break
        if left == _NONE:
            state, sector, t_in = _go_on(tree, line, sector, place.t_end, search, wanted, query)
            break
    place = sector, t_in, place.t_end, block, np.uint32(left)
    return (np.uint32(search.hit_count), search.t_far), place, state


def intersect(ray, wanted, found, place, tree, query, kernel):
    """Test a block of up to four triangles; go on to the next sector after the last."""
    if query.keep:
        return _intersect(query.hits, ray, wanted, found, place, tree, query, kernel)
    return _intersect(None, ray, wanted, found, place, tree, query, kernel)


_KERNELS = with_shade(
    StepKernel("set up", RayState.STARTING, device(set_up), ("found", "place")),
    StepKernel("traverse", RayState.TRAVERSING, device(traverse), ("place",), "steps"),
    StepKernel("intersect", RayState.INTERSECTING, device(intersect), ("found", "place"), "tests"),
)


def steps(graph: GraphStructure) -> Steps:
    """The steps of a graph's traversal."""
    return Steps(_KERNELS, PLACE, graph.arrays)
