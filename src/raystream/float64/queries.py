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
from raystream.float64.search import is_counted, no_hit, offer, within
from raystream.float64.traversal import STACK_BYTES, all_blocks, tree_blocks
from raystream.jit.cpu import device, kernel
from raystream.jit.simd import count_trailing_zeros, load, scratch
from raystream.kernels.ray_source import RaySource, load_direction, load_origin

__all__ = [
    "Float64Queries",
    "Float64Rows",
    "Float64Source",
    "brute_queries",
    "load_float64",
    "tree_queries",
    "tree_searches",
    "write_nearest",
]

_NONE = np.uint64(0)
_ONE = np.uint64(1)
_WORD = np.uint64(2)  # four bytes, as a shift
_DOUBLE = np.uint64(3)  # eight bytes, as a shift
_MISS = np.int32(-1)
_INVALID = np.uint8(RayStatus.INVALID)
_INF = np.float64(np.inf)
_ZERO = np.float64(0.0)
_LANES_BYTES = 64


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


class Float64Rows(NamedTuple):
    """Hits, a row each.

    Attributes
    ----------
    t, u, v : ndarray of shape (K,), float64
    prim_id : ndarray of shape (K,), int32
    """

    t: NDArray[np.float64]
    u: NDArray[np.float64]
    v: NDArray[np.float64]
    prim_id: NDArray[np.int32]

    @classmethod
    def empty(cls, count: int) -> Float64Rows:
        """Uninitialised rows."""
        return cls(np.empty(count), np.empty(count), np.empty(count), np.empty(count, np.int32))


class Float64Queries(NamedTuple):
    """Compiled loops over the rays begin to end.

    Each takes ``(begin, end, source, frame, tree, status, ...)``: an `Float64Source`, the
    `SceneFrame`, an `Float64Tree`, and an array of statuses, of which invalid ones are written.

    Attributes
    ----------
    first_hit : (..., rows)
        Writes a row of `Float64Rows` for each ray.
    any_hit : (..., seen)
        Writes an array of bool.
    count_hits : (..., surfaces, counts)
        Writes an array of int64.
    multi_hit : (..., surfaces, base, splits, rows)
        Writes the hits of ray base + k, in any order, to the rows splits[k] to splits[k + 1], which
        are as many.
    """

    first_hit: Callable[..., None]
    any_hit: Callable[..., None]
    count_hits: Callable[..., None]
    multi_hit: Callable[..., None]


@device
def load_float64(source, i, frame, status):
    """Ray i, prepared; its status is written if it is invalid."""
    t_min = source.t_min[i if len(source.t_min) > 1 else _NONE]
    t_max = source.t_max[i if len(source.t_max) > 1 else _NONE]
    origin, direction = load_origin(source.rays, i), load_direction(source.rays, i)
    ray = prepare_float64(origin, direction, t_min, t_max, frame)
    if ray.status == _INVALID:
        status[i] = _INVALID
    return ray


@device
def write_nearest(rows, i, best, ray):
    """Write the nearest hit of a ray, or a miss, to row i."""
    if best.place == _NONE:
        rows.t[i], rows.u[i], rows.v[i], rows.prim_id[i] = _INF, _ZERO, _ZERO, _MISS
        return
    _, t, u, v = resolve(ray.line, best.place, False)
    rows.t[i], rows.u[i], rows.v[i], rows.prim_id[i] = reported(t, ray), u, v, best.prim_id


@device
def _visit_nearest(block, ray, best, lanes):
    found, sure = test_block(block, ray.line, ray.line.t_min, best.high, lanes)
    while found != _NONE:
        lane = count_trailing_zeros(found)
        found &= found - _ONE
        low = load(np.float64, lanes + (lane << _DOUBLE))
        high = load(np.float64, lanes + HIGH + (lane << _DOUBLE))
        is_sure = (sure >> lane) & _ONE != _NONE
        prim_id = load(np.int32, block + PRIM_IDS + (lane << _WORD))
        best = offer(ray.line, best, low, high, is_sure, block + (lane << _DOUBLE), prim_id)
    return best, False


@device
def _far_of_nearest(ray, best):
    return min(ray.line.t_max, best.high)


@device
def _is_hit(ray, lane, sure, block, lanes, surfaces):
    """Whether a triangle that may be hit is hit within the interval."""
    low = load(np.float64, lanes + (lane << _DOUBLE))
    high = load(np.float64, lanes + HIGH + (lane << _DOUBLE))
    if (sure >> lane) & _ONE != _NONE and within(ray.line, low, high):
        return True
    return is_counted(ray.line, block + (lane << _DOUBLE), surfaces)


@device
def _visit_any(block, ray, count, lanes):
    found, sure = test_block(block, ray.line, ray.line.t_min, ray.line.t_max, lanes)
    while found != _NONE:
        lane = count_trailing_zeros(found)
        found &= found - _ONE
        if _is_hit(ray, lane, sure, block, lanes, False):
            return _ONE, True
    return count, False


@device
def _far_of_all(ray, search):
    return ray.line.t_max


class _Counted(NamedTuple):
    total: np.uint64
    surfaces: bool


@device
def _visit_count(block, ray, search, lanes):
    found, sure = test_block(block, ray.line, ray.line.t_min, ray.line.t_max, lanes)
    count = search.total
    while found != _NONE:
        lane = count_trailing_zeros(found)
        found &= found - _ONE
        if _is_hit(ray, lane, sure, block, lanes, search.surfaces):
            count += _ONE
    return _Counted(count, search.surfaces), False


class _Filled(NamedTuple):
    row: np.uint64
    end: np.uint64
    surfaces: bool
    rows: Float64Rows


@device
def _visit_fill(block, ray, search, lanes):
    found, _ = test_block(block, ray.line, ray.line.t_min, ray.line.t_max, lanes)
    row, rows = search.row, search.rows
    while found != _NONE:
        lane = count_trailing_zeros(found)
        found &= found - _ONE
        is_hit, t, u, v = resolve(ray.line, block + (lane << _DOUBLE), search.surfaces)
        if is_hit and t >= ray.line.t_min and t <= ray.line.t_max and row < search.end:
            prim_id = load(np.int32, block + PRIM_IDS + (lane << _WORD))
            rows.t[row], rows.u[row], rows.v[row] = reported(t, ray), u, v
            rows.prim_id[row] = prim_id
            row += _ONE
    return _Filled(row, search.end, search.surfaces, rows), False


class Searches(NamedTuple):
    """The searches of a single ray for the nearest and for any hit; see `float64.traversal`."""

    nearest: Callable[..., Any]
    anything: Callable[..., Any]


def _searches(blocks: Callable[..., Any]) -> Searches:
    return Searches(blocks(_visit_nearest, _far_of_nearest), blocks(_visit_any, _far_of_all))


#: The searches of a wide tree.
tree_searches = _searches(tree_blocks)


def _queries(blocks: Callable[..., Any]) -> Float64Queries:
    """The loops with a traversal; see `float64.traversal`."""
    nearest, anything = _searches(blocks)
    counted = blocks(_visit_count, _far_of_all)
    filled = blocks(_visit_fill, _far_of_all)

    @kernel
    def first_hit(begin, end, source, frame, tree, status, rows):
        stack, lanes = scratch(STACK_BYTES), scratch(_LANES_BYTES)
        for i in range(np.uint64(begin), np.uint64(end)):
            ray = load_float64(source, i, frame, status)
            best = nearest(tree, ray, no_hit(), stack, lanes, False)
            write_nearest(rows, i, best, ray)

    @kernel
    def any_hit(begin, end, source, frame, tree, status, seen):
        stack, lanes = scratch(STACK_BYTES), scratch(_LANES_BYTES)
        for i in range(np.uint64(begin), np.uint64(end)):
            ray = load_float64(source, i, frame, status)
            seen[i] = anything(tree, ray, _NONE, stack, lanes, True) != _NONE

    @kernel
    def count_hits(begin, end, source, frame, tree, status, surfaces, counts):
        stack, lanes = scratch(STACK_BYTES), scratch(_LANES_BYTES)
        for i in range(np.uint64(begin), np.uint64(end)):
            ray = load_float64(source, i, frame, status)
            search = counted(tree, ray, _Counted(_NONE, surfaces), stack, lanes, False)
            counts[i] = np.int64(search.total)

    @kernel
    def multi_hit(begin, end, source, frame, tree, status, surfaces, base, splits, rows):
        stack, lanes = scratch(STACK_BYTES), scratch(_LANES_BYTES)
        for i in range(np.uint64(begin), np.uint64(end)):
            k = i - np.uint64(base)
            first, last = np.uint64(splits[k]), np.uint64(splits[k + _ONE])
            if first != last:
                ray = load_float64(source, i, frame, status)
                search = _Filled(first, last, surfaces, rows)
                filled(tree, ray, search, stack, lanes, False)

    return Float64Queries(first_hit, any_hit, count_hits, multi_hit)


#: Of a wide tree, and of all triangles.
tree_queries = _queries(tree_blocks)
brute_queries = _queries(all_blocks)
