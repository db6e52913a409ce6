"""One ray through a graph from start to end: the steps of `steps`, fused."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import prefetch, scratch
from raystream.kernels.tally import LEAVES, LINK_NODES, STEPS, TESTS, add_to
from raystream.structures.bvh.block import lane_frame
from raystream.structures.bvh.wide import BLOCK
from raystream.structures.graph.steps import (
    GraphState,
    cross,
    enter,
    sector_blocks,
    sector_ray,
    start_sector_after,
    way_out,
)
from raystream.structures.kdtree.steps import intersect_block

__all__ = ["STACK_BYTES", "traverse"]

#: A graph needs no stack: the memory for one tells where the last ray began.
STACK_BYTES = 16

_NONE = np.uint64(0)
_ONE = np.uint64(1)
_LANES = np.uint64(4)
_LINE = np.uint64(64)


@device
def traverse(graph, ray, t_min, t_max, surfaces, keep, capacity, first, out, stack, seen, tally):
    """Visit the sectors along a ray; see `kernels.queries.ray_queries` for the arguments."""
    count, t_far = _NONE, t_max
    is_active, t_in, t_end = enter(graph, ray, t_min, t_max)
    if not is_active:
        return count
    line, frame, lanes = sector_ray(ray), lane_frame(ray), scratch(64)
    sector = start_sector_after(graph, line, ray, t_in, stack)
    while True:
        add_to(tally, STEPS, _ONE)
        way = way_out(line, sector)
        t_out = min(way.t, t_end)
        is_last = t_out >= t_end
        block, end, left = sector_blocks(graph, sector)
        # What comes next is asked for before the triangles are tested: memory is far.
        next_sector, node_count = sector, _NONE
        if block != end:
            prefetch(block)
            prefetch(block + _LINE)
            prefetch(block + _LINE + _LINE)
        if not is_last:
            next_sector, node_count = cross(graph, line, way.link, t_out)
            prefetch(next_sector)
        if block != end:
            add_to(tally, LEAVES, _ONE)
            state = GraphState(sector, t_in, t_out, way.link)
            while block != end:
                add_to(tally, TESTS, min(left, _LANES))
                count, t_far = intersect_block(
                    block, frame, state, t_far, surfaces, keep, count, capacity, first, out, lanes
                )
                if count == capacity and not keep:
                    return count
                block += BLOCK
                left -= min(left, _LANES)
        # Hits in sectors to come are not before this one's end.
        if is_last or (count == capacity and t_far < t_out):
            return count
        add_to(tally, LINK_NODES, node_count)
        sector, t_in = next_sector, t_out
