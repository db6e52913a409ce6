"""The searches of single rays in float64, with any traversal."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from raystream.geometry.float64.exact import solve_exactly
from raystream.geometry.float64.filters import Float64Filter, filter_of, kept_span
from raystream.geometry.float64.ray import prepare_float64, reported
from raystream.geometry.float64.rows import offer_row, put_row, sort_rows, tell_float64_row
from raystream.geometry.float64.search import exists, no_hit, offer
from raystream.geometry.float64.traversal import STACK_BYTES
from raystream.jit.constants import INF_F64, ZERO_F64, ZERO_U64
from raystream.jit.cpu import device
from raystream.kernels.queries import RaySearches, note_status
from raystream.kernels.ray_source import loader, read_float64_ray
from raystream.kernels.search import begin_search, is_full, wants_any
from raystream.kernels.tally import tally_of

_MISS = np.int32(-1)

#: Bytes that `block.block_test` writes, and those of a search.
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
def write_nearest(to, i, best, line, lengths):
    """Write the nearest hit of a ray, or a miss, to row i of `HitAddresses`.

    `lengths` has the names of `ray.Lengths`.
    """
    if best.triangle == ZERO_U64:
        put_row(to, i, INF_F64, ZERO_F64, ZERO_F64, _MISS)
        return
    _, t, u, v = solve_exactly(line, best.triangle, False)
    put_row(to, i, reported(t, lengths), u, v, best.prim_id)


class FilteredSearch(NamedTuple):
    """A ray's search so far, and its filter.

    Attributes
    ----------
    found : Nearest or kernels.search.Search
    filter : Float64Filter or None
    t_far : float64
        Hits beyond are not wanted.
    """

    found: Any
    filter: Float64Filter | None
    t_far: np.float64


@device
def _with_filter(found, filter_):
    return FilteredSearch(found, filter_, found.t_far)


@device
def _take_nearest(search, line, span, triangle, prim_id):
    best, own = search.found, search.filter
    is_kept, span = kept_span(own, line, span, triangle, prim_id, False)
    if is_kept:
        best = offer(line, best, span, triangle, prim_id)
    return _with_filter(best, own), False


@device
def _take_hit(search, line, span, triangle, prim_id):
    found, own = search.found, search.filter
    goal = found.goal
    is_kept, span = kept_span(own, line, span, triangle, prim_id, goal.surfaces)
    if is_kept:
        found = _offer_to(goal.hits, found, line, span, triangle, prim_id)
    return _with_filter(found, own), is_full(found)


@device
def _offer_to(hits, search, line, span, triangle, prim_id):
    """Count a hit, or keep it if it is among the nearest, in a `kernels.search.Search`."""
    t = u = v = ZERO_F64
    if hits is None:
        is_hit = exists(line, span, triangle, search.goal.surfaces)
    else:
        is_hit, t, u, v = _solve(search, line, triangle)
    return offer_row(search, t, u, v, prim_id) if is_hit else search


@device
def _solve(search, line, triangle):
    is_hit, t, u, v = solve_exactly(line, triangle, search.goal.surfaces)
    return is_hit and t >= search.t_min and t <= search.t_far, t, u, v


@device
def _offer_to_filter(filter_, search, line, span, triangle, prim_id):
    if filter_ is None:
        return _offer_to(search.goal.hits, search, line, span, triangle, prim_id)
    # Functions read the digits of hits that are only counted, too.
    is_hit, t, u, v = _solve(search, line, triangle)
    return offer_row(search, t, u, v, prim_id) if is_hit else search


@device
def take_hit(search, line, span, triangle, prim_id):
    """Offer a triangle that a ray may hit to a `kernels.search.Search`, which asks its filter."""
    search = _offer_to_filter(search.filter, search, line, span, triangle, prim_id)
    return search, is_full(search)


def float64_searches(blocks: Callable[..., Any]) -> RaySearches:
    """Make the `RaySearches` of a traversal; see `geometry.float64.traversal`."""
    walk_nearest, walk_hits = blocks(_take_nearest), blocks(_take_hit)

    @device
    def nearest(i, scene, hits, memory):
        ray, stack = _load_ray(i, scene), memory + np.uint64(LANES_BYTES)
        search = _with_filter(no_hit(ray.line.t_max), filter_of(scene.filter, i, ray))
        line = ray, memory, tally_of(scene.tallies, i)
        best = walk_nearest(scene.arrays, line, search, stack, False).found
        write_nearest(hits, i, best, ray.line, ray)
        return np.uint64(best.triangle != ZERO_U64)

    @device
    def search_ray(i, scene, goal, memory):
        ray, stack = _load_ray(i, scene), memory + np.uint64(LANES_BYTES)
        found = begin_search(ray.line.t_min, ray.line.t_max, goal, None, None, None)
        search = _with_filter(found, filter_of(scene.filter, i, ray))
        line = ray, memory, tally_of(scene.tallies, i)
        search = walk_hits(scene.arrays, line, search, stack, wants_any(found))
        return search.found, ray

    @device
    def count(i, scene, goal, memory):
        search, _ = search_ray(i, scene, goal, memory)
        return search.hit_count

    @device
    def keep(i, scene, goal, sorts, memory):
        search, ray = search_ray(i, scene, goal, memory)
        sort_rows(goal.hits, goal.first_row, search.hit_count)
        # Distances in lengths of the given direction, last: they may underflow to equal ones.
        for row in range(goal.first_row, goal.first_row + search.hit_count):
            tell_float64_row(goal.hits.t, row, ray)
        return search.hit_count

    return RaySearches(nearest, count, keep, np.float64)
