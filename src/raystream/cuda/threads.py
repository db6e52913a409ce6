"""What a CUDA thread does for one ray: the CPU's device functions, compiled unchanged.

A thread takes its ray as the caller gave it, turns it into a local one, searches, and writes world
distances: one kernel a query.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from raystream.core.rays import RayStatus
from raystream.jit.cpu import device, kernel
from raystream.jit.cuda import RangeKernel
from raystream.jit.simd import load, scratch, store
from raystream.kernels.collect import HitAddresses, sort_hits
from raystream.kernels.local_ray import world_t
from raystream.kernels.ray import set_up
from raystream.kernels.ray_source import load_ray
from raystream.kernels.search import begin_search
from raystream.kernels.seen import SeenSet, clear_seen
from raystream.kernels.tally import ROW, SHADINGS, add_to

__all__ = ["RETRY", "SeenTables", "ThreadQueries", "thread_queries"]

_NONE = np.uint64(0)
_ONE = np.uint64(1)
_WORD = np.uint64(2)  # a number's four bytes, as a shift
_LONG = np.uint64(3)  # one of eight
_INF = np.float32(np.inf)
_ZERO = np.float32(0.0)
_MISS = np.int32(-1)
_VALID = np.uint8(RayStatus.VALID)

#: A count that says: the table of triangles seen was too small for this ray.
RETRY = -1


class SeenTables(NamedTuple):
    """Memory for the triangles that each ray has met, where a structure lists them twice.

    Attributes
    ----------
    memory : uint64
        Address of the first thread's table.
    room : uint64
        Places of a table, a power of two; 0 for structures that list no triangle twice. A table
        has one number more.
    """

    memory: np.uint64
    room: np.uint64


class ThreadQueries(NamedTuple):
    """Kernels over rays; `thread_queries` makes them for a structure."""

    first_hit: RangeKernel
    any_hit: RangeKernel
    count_hits: RangeKernel
    multi_hit: RangeKernel


@device
def _tally_at(tallies, i):
    """The tally of ray i, or None if `tallies` is None."""
    if tallies is None:
        return None
    return tallies + i * ROW


@device
def _seen_of(tables, i):
    """Thread i's own set of triangles, empty."""
    size = (tables.room + _ONE) << _WORD
    seen = SeenSet(tables.memory + size * i, tables.room)
    clear_seen(seen)
    return seen


@device
def _no_set(_tables, _i):
    return None


@device
def _set_up(ray, frame):
    return set_up(ray.ox, ray.oy, ray.oz, ray.dx, ray.dy, ray.dz, frame.extreme)


def thread_queries(
    traverse: Callable[..., Any],
    stack_bytes: int,
    launcher: Callable[[Callable[..., Any]], RangeKernel] = RangeKernel,
    *,
    lists_twice: bool = False,
) -> ThreadQueries:
    """Make the kernels of a structure.

    Parameters
    ----------
    traverse : device function
        See `kernels.queries.ray_queries`.
    stack_bytes : int
        Of the memory that it is given.
    launcher : callable
        `RangeKernel` or `PersistentKernel`.
    lists_twice : bool
        See `kernels.queries.ray_queries`.

    Returns
    -------
    ThreadQueries
        Each for ``(source, frame, tree, tallies, ...)``: rays of the caller's, the scene's frame,
        the structure's arrays, and the address of tallies or None.
    """
    seen_of = _seen_of if lists_twice else _no_set

    @kernel
    def first_hit(i, source, frame, tree, tallies, out):
        stack = scratch(stack_bytes)
        store(stack, _NONE)
        ray = load_ray(source, i, frame)
        if ray.status != _VALID:
            store(out.status + i, ray.status)
        to = HitAddresses(out.t, out.u, out.v, out.prim_id)
        tally = _tally_at(tallies, i)
        search = begin_search(ray.t_min, ray.t_max, _ONE, to, i, False, None, tally)
        search = traverse(tree, _set_up(ray, frame), search, stack)
        add_to(tally, SHADINGS, search.count)
        at = i << _WORD
        if search.count == _NONE:
            store(out.t + at, _INF)
            store(out.u + at, _ZERO)
            store(out.v + at, _ZERO)
            store(out.prim_id + at, _MISS)
        else:
            t = load(np.float32, out.t + at)
            store(out.t + at, world_t(t, ray.factor, ray.offset))

    @kernel
    def any_hit(i, source, frame, tree, tallies, out):
        stack = scratch(stack_bytes)
        store(stack, _NONE)
        ray = load_ray(source, i, frame)
        if ray.status != _VALID:
            store(out.status + i, ray.status)
        tally = _tally_at(tallies, i)
        search = begin_search(ray.t_min, ray.t_max, _ONE, None, _NONE, False, None, tally)
        search = traverse(tree, _set_up(ray, frame), search, stack)
        add_to(tally, SHADINGS, search.count)
        store(out.seen + i, np.uint8(search.count != _NONE))

    @kernel
    def count_hits(i, source, frame, tree, tallies, tables, surfaces, limit, status, counts):
        stack = scratch(stack_bytes)
        store(stack, _NONE)
        ray = load_ray(source, i, frame)
        if ray.status != _VALID:
            store(status + i, ray.status)
        seen, tally = seen_of(tables, i), _tally_at(tallies, i)
        search = begin_search(ray.t_min, ray.t_max, limit, None, _NONE, surfaces, seen, tally)
        search = traverse(tree, _set_up(ray, frame), search, stack)
        count = np.int64(RETRY) if search.has_overflowed else np.int64(search.count)
        store(counts + (i << _LONG), count)

    @kernel
    def multi_hit(i, source, frame, tree, tallies, tables, surfaces, splits, out, found):
        first = np.uint64(load(np.int64, splits + (i << _LONG)))
        capacity = np.uint64(load(np.int64, splits + ((i + _ONE) << _LONG))) - first
        store(found + (i << _LONG), np.int64(0))
        if capacity == _NONE:
            return
        stack = scratch(stack_bytes)
        store(stack, _NONE)
        ray = load_ray(source, i, frame)
        seen, tally = seen_of(tables, i), _tally_at(tallies, i)
        search = begin_search(ray.t_min, ray.t_max, capacity, out, first, surfaces, seen, tally)
        search = traverse(tree, _set_up(ray, frame), search, stack)
        if search.has_overflowed:
            store(found + (i << _LONG), np.int64(RETRY))
            return
        store(found + (i << _LONG), np.int64(search.count))
        add_to(tally, SHADINGS, search.count)
        sort_hits(out, first, search.count)
        for row in range(first, first + search.count):
            at = out.t + (row << _WORD)
            store(at, world_t(load(np.float32, at), ray.factor, ray.offset))

    return ThreadQueries(
        launcher(first_hit), launcher(any_hit), launcher(count_hits), launcher(multi_hit)
    )
