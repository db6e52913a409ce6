"""The searches of single rays in float64, with any traversal."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from raystream.geometry.float64.block import HIGH, PRIM_IDS, span_of, test_block
from raystream.geometry.float64.exact import solve_exactly
from raystream.geometry.float64.ray import prepare_float64, reported
from raystream.geometry.float64.rows import keep_row, put_row, row_t, sort_rows
from raystream.geometry.float64.search import exists, no_hit, offer
from raystream.geometry.float64.traversal import STACK_BYTES, tree_blocks
from raystream.jit.constants import INF_F64, ONE_U64, SHIFT_32, SHIFT_64, ZERO_F64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import count_trailing_zeros, load, store
from raystream.kernels.hits import HitAddresses
from raystream.kernels.queries import RaySearches, note_status
from raystream.kernels.ray_source import loader, read_float64_ray

_MISS = np.int32(-1)

#: Bytes that `test_block` writes, and those of a search.
LANES_BYTES = 64
MEMORY_BYTES = STACK_BYTES + LANES_BYTES


#: ``load_float64(source, i, frame)``: ray i of a `RaySource` with limits in float64.
load_float64 = loader(read_float64_ray, prepare_float64)


@device
def _load_ray(i, scene):
    """Ray i of a `RayScene`, prepared; its status is written."""
    ray = load_float64(scene.source, i, scene.frame)
    note_status(scene.status, i, ray.status)
    return ray


@device
def write_nearest(to, i, best, ray):
    """Write the nearest hit of a ray, or a miss, to row i; `to` has the names of `HitAddresses`."""
    if best.triangle == ZERO_U64:
        put_row(to, i, INF_F64, ZERO_F64, ZERO_F64, _MISS)
        return
    _, t, u, v = solve_exactly(ray.line, best.triangle, False)
    put_row(to, i, reported(t, ray), u, v, best.prim_id)


def _visit_with(take: Callable[..., Any], far_of: Callable[..., Any]) -> tuple[Any, Any]:
    """Make the arguments of `geometry.float64.traversal` of what is done with each hit.

    ``take(search, ray, span, triangle, prim_id)`` offers a triangle that may be hit, with its
    distance's interval as of `span_of`.
    """

    @device
    def visit(block, ray, search, lanes):
        found, sure = test_block(block, ray.line, ray.line.t_min, far_of(ray, search), lanes)
        while found != ZERO_U64:
            lane = count_trailing_zeros(found)
            found &= found - ONE_U64
            prim_id = load(np.int32, block + PRIM_IDS + (lane << SHIFT_32))
            span, triangle = span_of(lanes, HIGH, lane, sure), block + (lane << SHIFT_64)
            search, is_over = take(search, ray, span, triangle, prim_id)
            if is_over:
                return search, True
        return search, False

    return visit, far_of


@device
def _take_nearest(best, ray, span, triangle, prim_id):
    return offer(ray.line, best, span, triangle, prim_id), False


@device
def _far_of_nearest(ray, best):
    return min(ray.line.t_max, best.high)


class _Counting(NamedTuple):
    total: np.uint64
    limit: np.uint64
    surfaces: bool


@device
def _take_count(search, ray, span, triangle, prim_id):
    total, limit, surfaces = search
    total += np.uint64(exists(ray.line, span, triangle, surfaces))
    return _Counting(total, limit, surfaces), total == limit


@device
def _far_of_all(ray, search):
    return ray.line.t_max


class _Keeping(NamedTuple):
    kept: np.uint64
    far: np.float64
    capacity: np.uint64
    rows: HitAddresses
    first: np.uint64
    surfaces: bool


@device
def _take_kept(search, ray, span, triangle, prim_id):
    count, far, capacity, rows, first, surfaces = search
    is_hit, t, u, v = solve_exactly(ray.line, triangle, surfaces)
    if is_hit and t >= ray.line.t_min and t <= far:
        count, far = keep_row(rows, first, count, capacity, t, u, v, prim_id, far)
    return _Keeping(count, far, capacity, rows, first, surfaces), False


@device
def _far_of_kept(ray, search):
    return search.far


class LineSearches(NamedTuple):
    """The searches of a single ray with a traversal.

    Each takes ``(tree, ray, ..., memory)``: a `Float64Tree`, a `Float64Ray`, and two addresses, of
    `STACK_BYTES` and of `LANES_BYTES`.

    Attributes
    ----------
    nearest : device function
        ``nearest(tree, ray, memory)`` returns the `search.Nearest`.
    count : device function
        ``count(tree, ray, limit, surfaces, memory)`` returns the number of hits, up to the limit.
    keep : device function
        ``keep(tree, ray, capacity, rows, first, surfaces, memory)`` writes the nearest hits to the
        rows of `HitAddresses` from `first` on, sorted, and returns their number.
    """

    nearest: Callable[..., Any]
    count: Callable[..., Any]
    keep: Callable[..., Any]


@cache
def _line_searches(blocks: Callable[..., Any]) -> LineSearches:
    """Make the searches of a traversal; see `geometry.float64.traversal`."""
    walk_nearest = blocks(*_visit_with(_take_nearest, _far_of_nearest))
    walk_count = blocks(*_visit_with(_take_count, _far_of_all))
    walk_keep = blocks(*_visit_with(_take_kept, _far_of_kept))

    @device
    def nearest(tree, ray, memory):
        return walk_nearest(tree, ray, no_hit(), memory[0], memory[1], False)

    @device
    def count(tree, ray, limit, surfaces, memory):
        search, wants_any = _Counting(ZERO_U64, limit, surfaces), limit == ONE_U64
        return walk_count(tree, ray, search, memory[0], memory[1], wants_any).total

    @device
    def keep(tree, ray, capacity, rows, first, surfaces, memory):
        search = _Keeping(ZERO_U64, ray.line.t_max, capacity, rows, first, surfaces)
        kept = walk_keep(tree, ray, search, memory[0], memory[1], False).kept
        sort_rows(rows, first, kept)
        # Distances in lengths of the given direction, last: they may underflow to equal ones.
        for row in range(first, first + kept):
            store(rows.t + (row << SHIFT_64), reported(row_t(rows, row), ray))
        return kept

    return LineSearches(nearest, count, keep)


#: The searches of a wide tree.
tree_searches = _line_searches(tree_blocks)


@device
def _parts(memory):
    """The stack and the lanes in the working memory of a ray."""
    return memory + np.uint64(LANES_BYTES), memory


def float64_searches(blocks: Callable[..., Any]) -> RaySearches:
    """Make the `RaySearches` of a traversal; see `geometry.float64.traversal`."""
    nearest_of, count_of, keep_of = _line_searches(blocks)

    @device
    def nearest(i, scene, hits, memory):
        ray = _load_ray(i, scene)
        best = nearest_of(scene.arrays, ray, _parts(memory))
        write_nearest(hits, i, best, ray)
        return np.uint64(best.triangle != ZERO_U64)

    @device
    def count(i, scene, goal, memory):
        own = scene.arrays, _load_ray(i, scene)
        return count_of(*own, goal.capacity, goal.surfaces, _parts(memory))

    @device
    def keep(i, scene, goal, sorts, memory):
        own, rows = (scene.arrays, _load_ray(i, scene)), (goal.hits, goal.first_row)
        return keep_of(*own, goal.capacity, *rows, goal.surfaces, _parts(memory))

    return RaySearches(nearest, count, keep, np.float64)
