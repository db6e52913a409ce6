"""The queries of single rays in float64, as loops over rays, with any traversal."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.rays import RayStatus
from raystream.float64.block import HIGH, PRIM_IDS, test_block
from raystream.float64.exact import resolve
from raystream.float64.ray import prepare_float64, reported
from raystream.float64.rows import keep_row, put_row, row_t, sort_rows
from raystream.float64.search import is_counted, no_hit, offer, within
from raystream.float64.traversal import STACK_BYTES, all_blocks, tree_blocks
from raystream.jit.constants import ONE_U64, SHIFT_32, SHIFT_64, ZERO_U64
from raystream.jit.cpu import device, kernel
from raystream.jit.simd import count_trailing_zeros, load, scratch, store
from raystream.kernels.hits import HitAddresses, hit_addresses
from raystream.kernels.ray_source import RaySource, load_direction, load_origin

_MISS = np.int32(-1)
_INVALID = np.uint8(RayStatus.INVALID)
_INF = np.float64(np.inf)
_ZERO = np.float64(0.0)

#: Bytes that `test_block` writes.
LANES_BYTES = 64


class Float64Source(NamedTuple):
    """The rays of a batch.

    Attributes
    ----------
    rays : RaySource
        Its limits are rounded to float32, outward.
    t_min, t_max : ndarray of shape (N,) or (1,), float64
    """

    rays: RaySource
    t_min: NDArray[np.float64]
    t_max: NDArray[np.float64]


class Float64Queries(NamedTuple):
    """Compiled loops over the rays begin to end.

    Each takes ``(begin, end, source, frame, tree, status, ...)``: a `Float64Source`, the
    `SceneFrame`, a `Float64Tree`, and an array of statuses, of which invalid ones are written.

    Attributes
    ----------
    first_hit : (..., rows)
        Writes a row of `HitArrays` for each ray.
    any_hit : (..., seen)
        Writes an array of bool.
    count_hits : (..., surfaces, limit, counts)
        Writes an array of int64: the number of hits, up to the limit.
    multi_hit : (..., surfaces, splits, rows)
        Writes the nearest splits[i + 1] - splits[i] hits of ray i, sorted, from row splits[i] on.
    """

    first_hit: Callable[..., None]
    any_hit: Callable[..., None]
    count_hits: Callable[..., None]
    multi_hit: Callable[..., None]


@device
def load_float64(source, i, frame, status):
    """Ray i, prepared; its status is written if it is invalid."""
    t_min = source.t_min[i if len(source.t_min) > 1 else ZERO_U64]
    t_max = source.t_max[i if len(source.t_max) > 1 else ZERO_U64]
    origin, direction = load_origin(source.rays, i), load_direction(source.rays, i)
    ray = prepare_float64(origin, direction, t_min, t_max, frame)
    if ray.status == _INVALID:
        status[i] = _INVALID
    return ray


@device
def write_nearest(to, i, best, ray):
    """Write the nearest hit of a ray, or a miss, to row i; `to` has the names of `HitAddresses`."""
    if best.place == ZERO_U64:
        put_row(to, i, _INF, _ZERO, _ZERO, _MISS)
        return
    _, t, u, v = resolve(ray.line, best.place, False)
    put_row(to, i, reported(t, ray), u, v, best.prim_id)


@device
def _visit_nearest(block, ray, best, lanes):
    found, sure = test_block(block, ray.line, ray.line.t_min, best.high, lanes)
    while found != ZERO_U64:
        lane = count_trailing_zeros(found)
        found &= found - ONE_U64
        low = load(np.float64, lanes + (lane << SHIFT_64))
        high = load(np.float64, lanes + HIGH + (lane << SHIFT_64))
        is_sure = (sure >> lane) & ONE_U64 != ZERO_U64
        prim_id = load(np.int32, block + PRIM_IDS + (lane << SHIFT_32))
        best = offer(ray.line, best, low, high, is_sure, block + (lane << SHIFT_64), prim_id)
    return best, False


@device
def _far_of_nearest(ray, best):
    return min(ray.line.t_max, best.high)


@device
def _is_hit(ray, lane, sure, block, lanes, surfaces):
    """Whether a triangle that may be hit is hit within the interval."""
    low = load(np.float64, lanes + (lane << SHIFT_64))
    high = load(np.float64, lanes + HIGH + (lane << SHIFT_64))
    if (sure >> lane) & ONE_U64 != ZERO_U64 and within(ray.line, low, high):
        return True
    return is_counted(ray.line, block + (lane << SHIFT_64), surfaces)


@device
def _visit_any(block, ray, count, lanes):
    found, sure = test_block(block, ray.line, ray.line.t_min, ray.line.t_max, lanes)
    while found != ZERO_U64:
        lane = count_trailing_zeros(found)
        found &= found - ONE_U64
        if _is_hit(ray, lane, sure, block, lanes, False):
            return ONE_U64, True
    return count, False


@device
def _far_of_all(ray, search):
    return ray.line.t_max


class _Counting(NamedTuple):
    total: np.uint64
    limit: np.uint64
    surfaces: bool


@device
def _visit_count(block, ray, search, lanes):
    found, sure = test_block(block, ray.line, ray.line.t_min, ray.line.t_max, lanes)
    total, limit, surfaces = search
    while found != ZERO_U64:
        lane = count_trailing_zeros(found)
        found &= found - ONE_U64
        if _is_hit(ray, lane, sure, block, lanes, surfaces):
            total += ONE_U64
            if total == limit:
                return _Counting(total, limit, surfaces), True
    return _Counting(total, limit, surfaces), False


class _Keeping(NamedTuple):
    kept: np.uint64
    far: np.float64
    capacity: np.uint64
    rows: HitAddresses
    first: np.uint64
    surfaces: bool


@device
def _visit_keep(block, ray, search, lanes):
    count, far, capacity, rows, first, surfaces = search
    found, _ = test_block(block, ray.line, ray.line.t_min, far, lanes)
    while found != ZERO_U64:
        lane = count_trailing_zeros(found)
        found &= found - ONE_U64
        is_hit, t, u, v = resolve(ray.line, block + (lane << SHIFT_64), surfaces)
        if is_hit and t >= ray.line.t_min and t <= far:
            prim_id = load(np.int32, block + PRIM_IDS + (lane << SHIFT_32))
            count, far = keep_row(rows, first, count, capacity, t, u, v, prim_id, far)
    return _Keeping(count, far, capacity, rows, first, surfaces), False


@device
def _far_of_kept(ray, search):
    return search.far


class Searches(NamedTuple):
    """The searches of a single ray with a traversal.

    Each takes ``(tree, ray, ..., memory)``: a `Float64Tree`, a `Float64Ray`, and two addresses, of
    `STACK_BYTES` and of `LANES_BYTES`.

    Attributes
    ----------
    nearest : device function
        ``nearest(tree, ray, memory)`` returns the `search.Nearest`.
    anything : device function
        ``anything(tree, ray, memory)``: whether there is a hit.
    count : device function
        ``count(tree, ray, limit, surfaces, memory)`` returns the number of hits, up to the limit.
    keep : device function
        ``keep(tree, ray, capacity, rows, first, surfaces, memory)`` writes the nearest hits to the
        rows of `HitAddresses` from `first` on, sorted, and returns their number.
    """

    nearest: Callable[..., Any]
    anything: Callable[..., Any]
    count: Callable[..., Any]
    keep: Callable[..., Any]


def _searches(blocks: Callable[..., Any]) -> Searches:
    """Make the searches of a traversal; see `float64.traversal`."""
    walk_nearest = blocks(_visit_nearest, _far_of_nearest)
    walk_any = blocks(_visit_any, _far_of_all)
    walk_count = blocks(_visit_count, _far_of_all)
    walk_keep = blocks(_visit_keep, _far_of_kept)

    @device
    def nearest(tree, ray, memory):
        return walk_nearest(tree, ray, no_hit(), memory[0], memory[1], False)

    @device
    def anything(tree, ray, memory):
        return walk_any(tree, ray, ZERO_U64, memory[0], memory[1], True) != ZERO_U64

    @device
    def count(tree, ray, limit, surfaces, memory):
        search = _Counting(ZERO_U64, limit, surfaces)
        return walk_count(tree, ray, search, memory[0], memory[1], False).total

    @device
    def keep(tree, ray, capacity, rows, first, surfaces, memory):
        search = _Keeping(ZERO_U64, ray.line.t_max, capacity, rows, first, surfaces)
        kept = walk_keep(tree, ray, search, memory[0], memory[1], False).kept
        sort_rows(rows, first, kept)
        # Distances in lengths of the given direction, last: they may underflow to equal ones.
        for row in range(first, first + kept):
            store(rows.t + (row << SHIFT_64), reported(row_t(rows, row), ray))
        return kept

    return Searches(nearest, anything, count, keep)


#: The searches of a wide tree, and of all triangles.
tree_searches = _searches(tree_blocks)
brute_searches = _searches(all_blocks)


def _queries(searches: Searches) -> Float64Queries:
    """The loops of searches."""
    nearest, anything, count, keep = searches

    @kernel
    def first_hit(begin, end, source, frame, tree, status, rows):
        memory, to = (scratch(STACK_BYTES), scratch(LANES_BYTES)), hit_addresses(rows)
        for i in range(np.uint64(begin), np.uint64(end)):
            ray = load_float64(source, i, frame, status)
            write_nearest(to, i, nearest(tree, ray, memory), ray)

    @kernel
    def any_hit(begin, end, source, frame, tree, status, seen):
        memory = scratch(STACK_BYTES), scratch(LANES_BYTES)
        for i in range(np.uint64(begin), np.uint64(end)):
            seen[i] = anything(tree, load_float64(source, i, frame, status), memory)

    @kernel
    def count_hits(begin, end, source, frame, tree, status, surfaces, limit, counts):
        memory = scratch(STACK_BYTES), scratch(LANES_BYTES)
        for i in range(np.uint64(begin), np.uint64(end)):
            ray = load_float64(source, i, frame, status)
            counts[i] = np.int64(count(tree, ray, limit, surfaces, memory))

    @kernel
    def multi_hit(begin, end, source, frame, tree, status, surfaces, splits, rows):
        memory, to = (scratch(STACK_BYTES), scratch(LANES_BYTES)), hit_addresses(rows)
        for i in range(np.uint64(begin), np.uint64(end)):
            first = np.uint64(splits[i])
            capacity = np.uint64(splits[i + ONE_U64]) - first
            if capacity != ZERO_U64:
                ray = load_float64(source, i, frame, status)
                keep(tree, ray, capacity, to, first, surfaces, memory)

    return Float64Queries(first_hit, any_hit, count_hits, multi_hit)


tree_queries = _queries(tree_searches)
brute_queries = _queries(brute_searches)
