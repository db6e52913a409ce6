"""The queries of rays: each as a function of one ray, around any structure's traversal.

The searches of a ray are made for a precision and a kind of scene; what a query does with them is
written here once. `kernels.answers` makes loops and threads of these functions.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from raystream.core.query import Kind, Query
from raystream.core.rays import RayStatus
from raystream.jit.constants import BYTES_64, ONE_U64, SHIFT_32, SHIFT_64, ZERO_U64
from raystream.jit.cpu import device, kernel
from raystream.jit.simd import load, scratch, store
from raystream.kernels.aligned import array_address
from raystream.kernels.answers import loop_of
from raystream.kernels.hit_filter import HitFilter, RayFilter
from raystream.kernels.hits import HitAddresses, Sink, hit_addresses
from raystream.kernels.ray import SceneFrame, prepare_ray, world_t
from raystream.kernels.ray_source import RaySource, load_ray
from raystream.kernels.search import SearchGoal, begin_search, put_hit, sort_hits, t_of
from raystream.kernels.tally import SHADINGS, add_to, tally_of

_INF = np.float32(np.inf)
_ZERO = np.float32(0.0)
_MISS = np.int32(-1)
_VALID = np.uint8(RayStatus.VALID)

#: Where a ray that is cast lies, and its hit, in bytes behind its origin.
_DIRECTION, _LOW, _HIGH, _STATUS, _T, _U, _V, _PRIM_ID = (
    np.uint64(k) for k in (24, 48, 56, 64, 72, 80, 88, 96)
)


class HitLimits(NamedTuple):
    """What a query that collects hits wants of each ray.

    Attributes
    ----------
    surfaces : bool
        See `kernels.triangle.intersect`.
    most : uint64
        Most hits.
    sorts : bool
        They are sorted by t, then prim_id.
    """

    surfaces: bool
    most: np.uint64
    sorts: bool


class RayScene(NamedTuple):
    """The arguments that all rays of a query share.

    Attributes
    ----------
    source : RaySource
    frame : SceneFrame
    arrays : NamedTuple
        The structure's arrays.
    status : uint64 or None
        Address of the first ray's status, a byte; written for invalid rays only.
    tallies : uint64 or None
        Address of the first ray's tally, see `kernels.tally`. None for no counting, at no cost.
    filter : HitFilter or None
        Decides which hits exist.
    """

    source: RaySource
    frame: SceneFrame
    arrays: Any
    status: np.uint64 | None
    tallies: np.uint64 | None
    filter: HitFilter | None


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


class RaySearches(NamedTuple):
    """The searches of ray i of a `RayScene`; each writes the ray's status and tally.

    Attributes
    ----------
    nearest : device function
        ``nearest(i, scene, hits, memory)`` writes the nearest hit to row i of `HitAddresses`, or a
        miss, and returns the number of hits.
    count : device function
        ``count(i, scene, goal, memory)`` returns the number of hits, up to the capacity of a
        `SearchGoal` without hits.
    keep : device function
        ``keep(i, scene, goal, sorts, memory)`` writes the nearest hits to the rows of the
        `SearchGoal`, sorted or not, and returns their number.
    number : type
        Of the rays' limits, and of t, u and v: float32 or float64.

    Distances are in world direction lengths.
    """

    nearest: Callable[..., Any]
    count: Callable[..., Any]
    keep: Callable[..., Any]
    number: type[np.floating[Any]]


def searches(traverse: Callable[..., Any]) -> RaySearches:
    """Make the searches of a structure whose triangles are in the scene's local frame."""

    @device
    def search_ray(i, scene, goal, memory):
        frame = scene.frame
        ray = load_ray(scene.source, i, frame)
        note_status(scene.status, i, ray.status)
        local = prepare_ray(ray.origin, ray.direction, frame.max_coordinate)
        tally, filter_ = tally_of(scene.tallies, i), ray_filter(scene.filter, i, ray)
        search = begin_search(ray.t_min, ray.t_max, goal, tally, filter_, None)
        return traverse(scene.arrays, local, search, memory), ray

    return searches_of(search_ray)


def searches_of(search_ray: Callable[..., Any]) -> RaySearches:
    """Make the searches in float32.

    Parameters
    ----------
    search_ray : device function
        ``search_ray(i, scene, goal, memory) -> (search, ray)`` for ray i of a `RayScene` and a
        `SearchGoal`: the finished search, and a `LocalRay` whose scale and offset turn its hits'
        t into world t.
    """

    @device
    def nearest(i, scene, hits, memory):
        search, ray = search_ray(i, scene, SearchGoal(ONE_U64, hits, i, False), memory)
        _finish_first(hits, i, search.hit_count, ray)
        return search.hit_count

    @device
    def count(i, scene, goal, memory):
        search, _ = search_ray(i, scene, goal, memory)
        return search.hit_count

    @device
    def keep(i, scene, goal, sorts, memory):
        search, ray = search_ray(i, scene, goal, memory)
        _finish_rows(goal.hits, goal.first_row, search.hit_count, ray, sorts)
        return search.hit_count

    return RaySearches(nearest, count, keep, np.float32)


@device
def _finish_first(out, i, count, ray):
    """Convert the t of ray i's hit to world direction lengths, or write a miss."""
    if count == ZERO_U64:
        put_hit(out, i, _INF, _ZERO, _ZERO, _MISS)
    else:
        _tell(out, i, ray)


@device
def _finish_rows(hits, first, count, ray, sorts):
    """Convert the t of a ray's hits to world direction lengths; if `sorts`, sort them."""
    if sorts:
        sort_hits(hits, first, count)
    for row in range(first, first + count):
        _tell(hits, row, ray)


@device
def _tell(hits, row, ray):
    """Convert the t of a row to world direction lengths."""
    store(hits.t + (row << SHIFT_32), world_t(t_of(hits, row), ray.t_scale, ray.t_offset))


class CountAddresses(NamedTuple):
    """What is counted of each ray, and where the counts go.

    Attributes
    ----------
    surfaces : bool
        See `kernels.triangle.intersect`.
    most : uint64
        Most hits that are counted.
    counts : uint64
        Address of an int64 per ray.
    """

    surfaces: bool
    most: np.uint64
    counts: np.uint64

    @classmethod
    def of(cls, query: Query, counts: int | np.uint64) -> CountAddresses:
        """For a query, with the address of the counts."""
        return cls(query.surfaces, np.uint64(query.limit), np.uint64(counts))


class RowAddresses(NamedTuple):
    """Where the hits of each ray go.

    Attributes
    ----------
    surfaces : bool
        See `kernels.triangle.intersect`.
    splits : uint64
        Address of int64: ray i owns the rows splits[i] to splits[i + 1].
    hits : HitAddresses
    found : uint64 or None
        Address of an int64 per ray: the hits that were found.
    """

    surfaces: bool
    splits: np.uint64
    hits: HitAddresses
    found: np.uint64 | None


@device
def _note_found(at, i, found):
    if at is not None:
        store(at + (i << SHIFT_64), np.int64(found))


class RayAnswers(NamedTuple):
    """The queries as answers of a `RayScene`, by `Kind`; or their loops, or threads.

    See `kernels.answers`.

    Attributes
    ----------
    first_hit
        Writes row i of `HitAddresses`.
    any_hit
        Writes the byte of ray i at an address.
    count_hits
        Writes the number of ray i's hits, up to the limit, to `CountAddresses`.
    multi_hit
        Writes the nearest splits[i + 1] - splits[i] hits of ray i to its rows of `RowAddresses`,
        sorted.
    """

    first_hit: Any
    any_hit: Any
    count_hits: Any
    multi_hit: Any


def ray_answers(of_ray: RaySearches) -> RayAnswers:
    """Make the answers of the searches of a ray."""
    nearest, count, keep, _ = of_ray

    @device
    def first_hit(i, scene, hits, memory):
        found = nearest(i, scene, hits, memory)
        add_to(tally_of(scene.tallies, i), SHADINGS, found)

    @device
    def any_hit(i, scene, seen, memory):
        found = count(i, scene, SearchGoal(ONE_U64, None, i, False), memory)
        add_to(tally_of(scene.tallies, i), SHADINGS, found)
        store(seen + i, np.uint8(found != ZERO_U64))

    @device
    def count_hits(i, scene, out, memory):
        goal = SearchGoal(out.most, None, i, out.surfaces)
        store(out.counts + (i << SHIFT_64), np.int64(count(i, scene, goal, memory)))

    @device
    def multi_hit(i, scene, rows, memory):
        at = rows.splits + (i << SHIFT_64)
        first = np.uint64(load(np.int64, at))
        capacity, found = np.uint64(load(np.int64, at + BYTES_64)) - first, ZERO_U64
        if capacity != ZERO_U64:
            goal = SearchGoal(capacity, rows.hits, first, rows.surfaces)
            found = keep(i, scene, goal, True, memory)
            add_to(tally_of(scene.tallies, i), SHADINGS, found)
        _note_found(rows.found, i, found)

    return RayAnswers(first_hit, any_hit, count_hits, multi_hit)


class RayQueries(NamedTuple):
    """The compiled queries of a structure on the CPU.

    Attributes
    ----------
    loops : RayAnswers
        Each takes ``(begin, end, scene, out)``.
    collect_hits : (begin, end, scene, limits, splits, hits)
        Writes the nearest hits of each ray, within `HitLimits`, to rows 0 to splits[end - begin]
        of `hits` (HitArrays). Returns the first ray that is not done: `end`, or one whose hits do
        not fit.
    cast : (frame, arrays, numbers)
        Takes one ray as eight float64 numbers: origin and direction, in world space, and limits,
        which are rounded to the precision. Returns its nearest hit ``(t, u, v, prim_id)``, and its
        status.
    """

    loops: RayAnswers
    collect_hits: Callable[..., int]
    cast: Callable[..., Any]


def output_of(query: Query, sink: Sink) -> Any:
    """Where a query's loop writes: the addresses of a sink's arrays, which must be kept."""
    if query.kind is Kind.FIRST_HIT:
        return sink.nearest
    if query.kind is Kind.ANY_HIT:
        return np.uint64(array_address(sink.seen))
    if query.kind is Kind.COUNT_HITS:
        return CountAddresses.of(query, array_address(sink.counts))
    splits = np.uint64(array_address(sink.splits))
    return RowAddresses(query.surfaces, splits, HitAddresses.of(sink.hits), None)


def ray_queries(
    traverse: Callable[..., Any],
    stack_bytes: int,
    make_searches: Callable[[Callable[..., Any]], RaySearches] = searches,
) -> RayQueries:
    """Make the queries of a structure.

    Parameters
    ----------
    traverse : device function
        ``traverse(view, ray, search, stack)`` offers the hits of `ray` with the triangles of
        `view`, the structure's, to the search (`kernels.search`), and returns it. It offers no hit
        twice, and may leave out those that cannot change the result. The search may
        have hits from elsewhere, but is not full; traversal returns as soon as it `is_full`. Steps
        and tests are added to ``search.counters`` (`kernels.tally`).
    stack_bytes : int
        Size of the memory at the address `stack`, which is aligned to 64 bytes; at least 8. It
        keeps its contents from ray to ray; before the first ray, the first 8 bytes are 0.
    make_searches : callable, optional
        Makes the `RaySearches` of the traversal [default: `searches`].

    Returns
    -------
    RayQueries
    """
    of_ray = make_searches(traverse)
    nearest, keep, number = of_ray.nearest, of_ray.keep, of_ray.number

    @kernel
    def collect_hits(begin, end, scene, limits, splits, hits):
        memory, to = scratch(stack_bytes), hit_addresses(hits)
        store(memory, ZERO_U64)
        room, row = np.uint64(len(hits.t)), ZERO_U64
        splits[0] = 0
        for i in range(np.uint64(begin), np.uint64(end)):
            capacity = min(limits.most, room - row)
            if capacity == ZERO_U64:
                return np.int64(i)
            goal = SearchGoal(capacity, to, row, limits.surfaces)
            found = keep(i, scene, goal, limits.sorts, memory)
            if found == capacity and capacity != limits.most:
                return np.int64(i)
            row += found
            splits[i + ONE_U64 - np.uint64(begin)] = row
        return np.int64(end)

    @kernel
    def cast(frame, arrays, numbers):
        memory, at = scratch(stack_bytes), scratch(128)
        store(memory, ZERO_U64)
        # The ray is written where a batch of one ray would be.
        direction, low, high, status = at + _DIRECTION, at + _LOW, at + _HIGH, at + _STATUS
        for k in range(3):
            store(at + np.uint64(k) * BYTES_64, numbers[k])
            store(direction + np.uint64(k) * BYTES_64, numbers[k + 3])
        store(low, number(numbers[6]))
        store(high, number(numbers[7]))
        store(status, _VALID)
        step = ZERO_U64  # there is one ray
        source = RaySource(at, step, True, direction, step, True, low, step, high, step)
        scene = RayScene(source, frame, arrays, status, None, None)
        hit = HitAddresses(at + _T, at + _U, at + _V, at + _PRIM_ID)
        nearest(ZERO_U64, scene, hit, memory)
        t, u, v = load(number, hit.t), load(number, hit.u), load(number, hit.v)
        columns = np.float64(t), np.float64(u), np.float64(v), np.int64(load(np.int32, hit.prim_id))
        return columns, np.int64(load(np.uint8, status))

    loops = (loop_of(answer, stack_bytes) for answer in ray_answers(of_ray))
    return RayQueries(RayAnswers(*loops), collect_hits, cast)
