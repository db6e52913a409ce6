"""Graph traversal: the walk through the sectors along a ray, the fused `steps`."""

from __future__ import annotations

import numpy as np

from raystream.jit.constants import NULL, ONE_U64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import prefetch, store
from raystream.kernels.leaf_block import block_ray, search_blocks
from raystream.kernels.search import is_full, is_over
from raystream.kernels.tally import LEAVES, LINK_NODES, STEPS, add_to
from raystream.structures.graph.steps import (
    clip_to_scene,
    exit_face,
    follow_link,
    near_sector,
    sector_blocks,
    sector_number,
    sector_ray,
)

#: A graph needs no stack: its memory caches the start of the previous ray.
STACK_BYTES = 16

_LINE = np.uint64(64)
_INDEX = np.uint64(2)  # a number's four bytes, as a shift


@device
def _note_end(graph, search, sector):
    """Write the sector of a first hit: that in which its search ends."""
    if graph.ends != NULL and search.hit_count != ZERO_U64:
        store(graph.ends + (search.goal.first_row << _INDEX), sector_number(graph, sector))


@device
def traverse(graph, ray, search, stack):
    """Visit the sectors along a ray; see `kernels.queries.ray_queries` for the arguments."""
    is_active, t_in, t_end = clip_to_scene(graph, ray, search.t_min, search.t_far)
    if not is_active:
        return search
    line, triangle_ray = sector_ray(ray), block_ray(ray)
    sector = near_sector(graph, line, ray, t_in, search.goal.first_row, stack)
    while True:
        add_to(search.counters, STEPS, ONE_U64)
        face = exit_face(line, sector)
        t_out = min(face.t, t_end)
        is_last = t_out >= t_end
        block, end, _ = sector_blocks(graph, sector)
        # Prefetch the blocks and the next sector before testing triangles.
        next_sector, node_count = sector, ZERO_U64
        if block != end:
            prefetch(block)
            prefetch(block + _LINE)
            prefetch(block + _LINE + _LINE)
        if not is_last:
            next_sector, node_count = follow_link(graph, line, face.link, t_out)
            prefetch(next_sector)
        if block != end:
            add_to(search.counters, LEAVES, ONE_U64)
            search = search_blocks(block, end, triangle_ray, search, t_in, t_out)
            if is_full(search):
                return search
        if is_last or is_over(search, t_out):
            _note_end(graph, search, sector)
            return search
        add_to(search.counters, LINK_NODES, node_count)
        sector, t_in = next_sector, t_out
