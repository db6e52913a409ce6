"""The queries as loops over rays, around any structure's traversal.

The threads of CUDA (`cuda.query_kernels`) are made of the same functions for a ray: `Searches`, and
those that write its results.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from raystream.core.query import Kind, Query
from raystream.core.rays import RayStatus
from raystream.jit.constants import ONE_U64, SHIFT_32, ZERO_U64
from raystream.jit.cpu import device, kernel
from raystream.jit.simd import load, scratch, store
from raystream.kernels.hit_filter import HitFilter, RayFilter
from raystream.kernels.hits import HitAddresses, Sink, hit_addresses
from raystream.kernels.ray import SceneFrame, prepare_ray, world_t
from raystream.kernels.ray_source import RaySource, ResultAddresses, load_ray, local_ray
from raystream.kernels.search import begin_search, get_hit, sort_hits
from raystream.kernels.tally import SHADINGS, add_to, tally_of

_INF = np.float32(np.inf)
_ZERO = np.float32(0.0)
_MISS = np.int32(-1)
_VALID = np.uint8(RayStatus.VALID)


class RayScene(NamedTuple):
    """The arguments that all rays of a query share.

    Attributes
    ----------
    source : RaySource or None
    frame : SceneFrame
    arrays : NamedTuple
        The structure's arrays.
    stack : uint64
        Address of the traversal's memory.
    status : uint64 or None
        Address of the first ray's status, a byte; written for invalid rays only.
    filter : HitFilter or None
        Decides which hits exist.
    """

    source: RaySource | None
    frame: SceneFrame
    arrays: Any
    stack: np.uint64
    status: np.uint64 | None
    filter: HitFilter | None


class Goal(NamedTuple):
    """The goal of one ray's search: see `kernels.search.Search`."""

    capacity: np.uint64
    hits: HitAddresses | None
    first_row: np.uint64
    surfaces: bool
    counters: np.uint64 | None


@device
def ray_filter(filter_, i, ray):
    """The `RayFilter` of ray i, a `LocalRay`; None without a filter."""
    if filter_ is None:
        return None
    return RayFilter(filter_, i, ray.t_scale, ray.t_offset)


@device
def note_status(at, i, status):
    """Write the status of ray i if it is not valid; `at` is None for no statuses."""
    if at is not None and status != _VALID:
        store(at + i, status)


class Searches(NamedTuple):
    """The searches of a single ray.

    Attributes
    ----------
    of_batch : device function
        ``of_batch(i, scene, goal) -> (search, ray)`` for ray i of a `RayScene` and a `Goal`: the
        finished search, and a `LocalRay` whose scale and offset turn its hits' t into world t.
    of_numbers : device function
        ``of_numbers(numbers, scene, goal) -> (search, ray)``, for the origin and direction, six
        float64 numbers in world space, and the limits, float32.
    """

    of_batch: Callable[..., Any]
    of_numbers: Callable[..., Any]


def searches(traverse: Callable[..., Any]) -> Searches:
    """Make the searches of a structure whose triangles are in the scene's local frame."""

    @device
    def search_local(ray, scene, goal, filter_):
        frame = scene.frame
        local = prepare_ray(ray.ox, ray.oy, ray.oz, ray.dx, ray.dy, ray.dz, frame.max_coordinate)
        search = begin_search(
            ray.t_min,
            ray.t_max,
            goal.capacity,
            goal.hits,
            goal.first_row,
            goal.surfaces,
            goal.counters,
            filter_,
            None,
        )
        return traverse(scene.arrays, local, search, scene.stack)

    @device
    def of_batch(i, scene, goal):
        ray = load_ray(scene.source, i, scene.frame)
        note_status(scene.status, i, ray.status)
        filter_ = ray_filter(scene.filter, i, ray)
        return search_local(ray, scene, goal, filter_), ray

    @device
    def of_numbers(numbers, scene, goal):
        ox, oy, oz, dx, dy, dz, t_min, t_max = numbers
        ray = local_ray(ox, oy, oz, dx, dy, dz, t_min, t_max, scene.frame)
        return search_local(ray, scene, goal, None), ray

    return Searches(of_batch, of_numbers)


@device
def finish_first(out, i, count, ray):
    """Convert the t of ray i's hit to world direction lengths, or write a miss.

    Parameters
    ----------
    out : ResultAddresses or HitAddresses
    i : uint64
    count : uint64
        Hits found.
    ray : LocalRay
    """
    at = i << SHIFT_32
    if count == ZERO_U64:
        store(out.t + at, _INF)
        store(out.u + at, _ZERO)
        store(out.v + at, _ZERO)
        store(out.prim_id + at, _MISS)
    else:
        store(out.t + at, world_t(load(np.float32, out.t + at), ray.t_scale, ray.t_offset))


@device
def finish_rows(hits, first, count, ray, sorts):
    """Convert the t of a ray's hits to world direction lengths; if `sorts`, sort them."""
    if sorts:
        sort_hits(hits, first, count)
    for row in range(first, first + count):
        at = hits.t + (row << SHIFT_32)
        store(at, world_t(load(np.float32, at), ray.t_scale, ray.t_offset))


class Wanted(NamedTuple):
    """The goal of a query that finds several hits per ray.

    Attributes
    ----------
    surfaces : bool
        See `kernels.triangle.intersect`.
    limit : uint64
        Most hits per ray.
    sorts : bool
        Hits are sorted by t, then prim_id.
    """

    surfaces: bool
    limit: np.uint64
    sorts: bool

    @classmethod
    def of(cls, query: Query) -> Wanted:
        """What a query wants of each ray."""
        return cls(query.surfaces, np.uint64(query.limit), query.is_ordered)


class RayQueries(NamedTuple):
    """Compiled loops over the rays begin to end, with one traversal.

    Each takes ``(begin, end, source, frame, arrays, tallies, ...)``: a `RaySource`, the
    `SceneFrame` of its rays, the structure's arrays, and the rays' tallies (`kernels.tally`), or
    None for no counting, at no cost.

    Attributes
    ----------
    first_hit : (..., filter, out)
        Writes a `ResultAddresses`. `filter` is a `HitFilter` or None.
    any_hit : (..., filter, out)
        Writes the bytes at `seen` of a `ResultAddresses`.
    count_hits : (..., status, wanted, counts)
        Writes `counts`, of shape (N,), int64: the number of hits, up to the limit.
    multi_hit : (..., wanted, splits, hits)
        Writes the nearest splits[i + 1] - splits[i] hits of ray i, sorted, from row splits[i] of
        `hits` (HitArrays) on.
    collect_hits : (begin, end, source, frame, arrays, status, wanted, splits, hits)
        Writes the nearest hits of each ray to rows 0 to splits[end - begin] of `hits`. Returns the
        first ray that is not done: `end`, or one whose hits do not fit.
    cast : (frame, arrays, ox, oy, oz, dx, dy, dz, t_min, t_max)
        Takes one ray as float64 numbers, in world space; its limits are rounded to float32.
        Returns its nearest hit ``(t, u, v, prim_id)``, and its status.

    Distances are in world direction lengths. `status` is the address of a byte per ray,
    written for invalid ones. `wanted` is a `Wanted`.
    """

    first_hit: Callable[..., None]
    any_hit: Callable[..., None]
    count_hits: Callable[..., None]
    multi_hit: Callable[..., None]
    collect_hits: Callable[..., int]
    cast: Callable[..., Any]


def output_of(query: Query, sink: Sink) -> tuple[Any, ...]:
    """The last arguments of a query's loop: what is wanted, and where it goes.

    `Query.on_hit` is a `HitFilter` or None, for the nearest and any hit.
    """
    if query.kind is Kind.FIRST_HIT:
        return query.on_hit, ResultAddresses.of_first(sink.memory, sink.status)
    if query.kind is Kind.ANY_HIT:
        return query.on_hit, ResultAddresses.of_any(sink.seen, sink.status)
    wanted = Wanted.of(query)
    if query.kind is Kind.COUNT_HITS:
        return np.uint64(sink.status.ctypes.data), wanted, sink.counts
    return wanted, sink.splits, sink.hits


def ray_queries(
    traverse: Callable[..., Any],
    stack_bytes: int,
    make_searches: Callable[[Callable[..., Any]], Searches] = searches,
) -> RayQueries:
    """Make the queries of a structure.

    Parameters
    ----------
    traverse : device function
        ``traverse(view, ray, search, stack)`` offers the hits of `ray` with the triangles of
        `view`, the structure's `arrays`, to the search (`kernels.search`), and returns it. It
        offers no hit twice, and may leave out those that cannot change the result. The search may
        have hits from elsewhere, but is not full; traversal returns as soon as it `is_full`. Steps
        and tests are added to ``search.counters`` (`kernels.tally`).
    stack_bytes : int
        Size of the memory at the address `stack`, which is aligned to 64 bytes; at least 8. It
        keeps its contents from ray to ray; before the first ray, the first 8 bytes are 0.
    make_searches : callable, optional
        Makes the `Searches` of the traversal [default: `searches`].

    Returns
    -------
    RayQueries
    """
    search_ray, search_numbers = make_searches(traverse)

    @kernel
    def first_hit(begin, end, source, frame, arrays, tallies, filter_, out):
        stack = scratch(stack_bytes)
        store(stack, ZERO_U64)
        scene = RayScene(source, frame, arrays, stack, out.status, filter_)
        hits = HitAddresses(out.t, out.u, out.v, out.prim_id)
        for i in range(np.uint64(begin), np.uint64(end)):
            tally = tally_of(tallies, i)
            search, ray = search_ray(i, scene, Goal(ONE_U64, hits, i, False, tally))
            add_to(tally, SHADINGS, search.hit_count)
            finish_first(out, i, search.hit_count, ray)

    @kernel
    def any_hit(begin, end, source, frame, arrays, tallies, filter_, out):
        stack = scratch(stack_bytes)
        store(stack, ZERO_U64)
        scene = RayScene(source, frame, arrays, stack, out.status, filter_)
        for i in range(np.uint64(begin), np.uint64(end)):
            tally = tally_of(tallies, i)
            search, _ = search_ray(i, scene, Goal(ONE_U64, None, i, False, tally))
            add_to(tally, SHADINGS, search.hit_count)
            store(out.seen + i, np.uint8(search.hit_count != ZERO_U64))

    @kernel
    def count_hits(begin, end, source, frame, arrays, tallies, status, wanted, counts):
        stack = scratch(stack_bytes)
        store(stack, ZERO_U64)
        scene = RayScene(source, frame, arrays, stack, status, None)
        surfaces, most = wanted.surfaces, wanted.limit
        for i in range(np.uint64(begin), np.uint64(end)):
            goal = Goal(most, None, ZERO_U64, surfaces, tally_of(tallies, i))
            search, _ = search_ray(i, scene, goal)
            counts[i] = search.hit_count

    @kernel
    def multi_hit(begin, end, source, frame, arrays, tallies, wanted, splits, hits):
        stack = scratch(stack_bytes)
        store(stack, ZERO_U64)
        scene = RayScene(source, frame, arrays, stack, None, None)
        surfaces, to = wanted.surfaces, hit_addresses(hits)
        for i in range(np.uint64(begin), np.uint64(end)):
            first = np.uint64(splits[i])
            capacity = np.uint64(splits[i + ONE_U64]) - first
            if capacity == ZERO_U64:
                continue
            tally = tally_of(tallies, i)
            search, ray = search_ray(i, scene, Goal(capacity, to, first, surfaces, tally))
            add_to(tally, SHADINGS, search.hit_count)
            finish_rows(to, first, search.hit_count, ray, True)

    @kernel
    def collect_hits(begin, end, source, frame, arrays, status, wanted, splits, hits):
        stack = scratch(stack_bytes)
        store(stack, ZERO_U64)
        scene = RayScene(source, frame, arrays, stack, status, None)
        surfaces, to = wanted.surfaces, hit_addresses(hits)
        most, room, row = wanted.limit, np.uint64(len(hits.t)), ZERO_U64
        splits[0] = 0
        for i in range(np.uint64(begin), np.uint64(end)):
            capacity = min(most, room - row)
            if capacity == ZERO_U64:
                return np.int64(i)
            search, ray = search_ray(i, scene, Goal(capacity, to, row, surfaces, None))
            if search.hit_count == capacity and capacity != most:
                return np.int64(i)
            finish_rows(to, row, search.hit_count, ray, wanted.sorts)
            row += search.hit_count
            splits[i + ONE_U64 - np.uint64(begin)] = row
        return np.int64(end)

    @kernel
    def cast(frame, arrays, ox, oy, oz, dx, dy, dz, t_min, t_max):
        stack, row = scratch(stack_bytes), scratch(16)
        store(stack, ZERO_U64)
        scene = RayScene(None, frame, arrays, stack, None, None)
        hits = HitAddresses(row, row + np.uint64(4), row + np.uint64(8), row + np.uint64(12))
        wanted = ox, oy, oz, dx, dy, dz, np.float32(t_min), np.float32(t_max)
        search, ray = search_numbers(wanted, scene, Goal(ONE_U64, hits, ZERO_U64, False, None))
        finish_first(hits, ZERO_U64, search.hit_count, ray)
        t, u, v, prim_id = get_hit(hits, ZERO_U64)
        numbers = np.float64(t), np.float64(u), np.float64(v), np.int64(prim_id)
        return numbers, np.int64(ray.status)

    return RayQueries(first_hit, any_hit, count_hits, multi_hit, collect_hits, cast)
