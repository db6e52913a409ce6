"""The graph of sectors as kernels: set up, traverse, intersect, shade."""

from __future__ import annotations

import numpy as np

from raystream.jit.constants import ONE_U64, ZERO_U64
from raystream.jit.cpu import device
from raystream.kernels.leaf_block import BLOCK, block_ray, intersect_block
from raystream.kernels.search import is_full, is_over
from raystream.kernels.tally import LEAVES, LINK_NODES, STEPS, TESTS
from raystream.machines.records import (
    INTERSECTING,
    TRAVERSING,
    add_count,
    count_step,
    end_state,
    found_by,
    prepared_ray,
)
from raystream.machines.steps.base import Steps, resume_search, traversal_kernels
from raystream.structures.graph.steps import (
    clip_to_scene,
    exit_face,
    follow_link,
    sector_blocks,
    sector_ray,
    start_sector,
)
from raystream.structures.graph.structure import GraphStructure

#: The traversal state of a ray: its sector, entered at `t_in`; the end of its search; the next
#: block, and the number of triangles in it and those after it.
PLACE = np.dtype(
    [
        ("sector", np.uint64),
        ("t_in", np.float32),
        ("t_end", np.float32),
        ("block", np.uint64),
        ("left", np.uint32),
    ]
)

_LANES = np.uint64(4)


@device
def _leave_sector(tree, line, sector, t_end, search, wanted, query):
    """Leave a sector, unless the search is over: the next state, sector, and t there."""
    face = exit_face(line, sector)
    t_out = min(face.t, t_end)
    if t_out >= t_end or is_over(search, t_out):
        return end_state(search.hit_count, query), sector, t_out
    sector, node_count = follow_link(tree, line, face.link, t_out)
    add_count(query, wanted, LINK_NODES, node_count)
    return TRAVERSING, sector, t_out


def set_up(ray, wanted, tree, query, kernel):
    """Find the sector in which a ray begins."""
    count_step(query, wanted, kernel, STEPS, ZERO_U64)
    line = prepared_ray(ray, query)
    is_active, t_in, t_end = clip_to_scene(tree, line, ray.t_min, ray.t_max)
    state, sector = end_state(ZERO_U64, query), tree.rows
    if is_active:
        state = TRAVERSING
        sector, _ = start_sector(tree, sector_ray(line), line, t_in)
    place = sector, t_in, t_end, ZERO_U64, np.uint32(0)
    return (np.uint32(0), ray.t_max), place, state


def traverse(ray, wanted, found, place, tree, query, kernel):
    """Find the triangles of a ray's sector, or the next sector if it is empty."""
    line = sector_ray(prepared_ray(ray, query))
    sector, t_in, block, left = place.sector, place.t_in, place.block, np.uint64(place.left)
    search, state = resume_search(None, ray, wanted, found, query), TRAVERSING
    for _ in range(query.steps):
        count_step(query, wanted, kernel, STEPS, ONE_U64)
        block, end, left = sector_blocks(tree, sector)
        if block != end:
            add_count(query, wanted, LEAVES, ONE_U64)
            state = INTERSECTING
            break
        state, sector, t_in = _leave_sector(tree, line, sector, place.t_end, search, wanted, query)
        if state != TRAVERSING:
            break
    return (sector, t_in, place.t_end, block, np.uint32(left)), state


def intersect(ray, wanted, found, place, tree, query, kernel):
    """Test a block of up to four triangles; after the last one, leave the sector."""
    prepared = prepared_ray(ray, query)
    line, triangle_ray = sector_ray(prepared), block_ray(prepared)
    search = resume_search(query.hits, ray, wanted, found, query)
    sector, t_in, block, left = place.sector, place.t_in, place.block, np.uint64(place.left)
    t_out = min(exit_face(line, sector).t, place.t_end)
    state = INTERSECTING
    for _ in range(query.tests):
        count_step(query, wanted, kernel, TESTS, min(left, _LANES))
        search = intersect_block(block, triangle_ray, search, t_in, t_out)
        block += BLOCK
        left -= min(left, _LANES)
        if is_full(search):
            state = end_state(search.hit_count, query)
            break
        if left == ZERO_U64:
            state, sector, t_in = _leave_sector(
                tree, line, sector, place.t_end, search, wanted, query
            )
            break
    place = sector, t_in, place.t_end, block, np.uint32(left)
    return found_by(search), place, state


_KERNELS = traversal_kernels(set_up, traverse, intersect)


def steps(graph: GraphStructure) -> Steps:
    """The steps of a traversal of a graph."""
    return Steps(_KERNELS, PLACE, graph.view)
