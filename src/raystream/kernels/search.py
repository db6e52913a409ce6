"""The search of one ray as a value: its interval, the hits so far, and when it is over.

A query loop begins a search, a structure's traversal takes and returns it, and each leaf offers
its hits to it; no other code depends on the query. A search that was begun in one structure can be
continued in another: only `offer` changes its count and its t_far. `enter_instance` continues it
in object space, and `leave_instance` takes it back.

Hits are ordered by t, then prim_id, so the order never depends on the traversal.

Whether an optional member is None is known when a kernel is compiled, and code for None is left
out. That holds for arguments only, so a function that takes the member as its argument tests it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.constants import ONE_U64, SHIFT_32, ZERO_U64
from raystream.jit.cpu import device, device_call
from raystream.jit.simd import load, store
from raystream.kernels.hit_filter import RayFilter, keeps
from raystream.kernels.hits import HitAddresses
from raystream.kernels.ray import local_limit, world_t

# The nearest hits

#: Of t, u and v in rows of hits: their type, and the shift that a row's number takes. For rows of
#: float64, functions are copied with others, see `geometry.float64.rows`.
ROW_NUMBER, ROW_SHIFT = np.float32, np.uint64(2)


@device
def t_of(out, row):
    """Read the t of a row's hit."""
    return load(ROW_NUMBER, out.t + (row << ROW_SHIFT))


@device
def _prim_id_of(out, row):
    return load(np.int32, out.prim_id + (row << SHIFT_32))


@device
def put_hit(out, row, t, u, v, prim_id):
    """Write a hit to a row."""
    at = row << ROW_SHIFT
    store(out.t + at, t)
    store(out.u + at, u)
    store(out.v + at, v)
    store(out.prim_id + (row << SHIFT_32), prim_id)


@device
def get_hit(out, row):
    """Read the hit of a row: t, u, v, prim_id."""
    at = row << ROW_SHIFT
    return (
        load(ROW_NUMBER, out.t + at),
        load(ROW_NUMBER, out.u + at),
        load(ROW_NUMBER, out.v + at),
        _prim_id_of(out, row),
    )


@device
def is_before(t, prim_id, other_t, other_prim_id):
    """Whether a hit is before another one."""
    return t < other_t or (t == other_t and prim_id < other_prim_id)


@device
def _sift_down(out, first, count, hole, t, u, v, prim_id):
    """Insert a hit into a max-heap, starting at an empty node."""
    while True:
        child = hole + hole + ONE_U64
        if child >= count:
            break
        at = first + child
        if child + ONE_U64 < count and is_before(
            t_of(out, at),
            _prim_id_of(out, at),
            t_of(out, at + ONE_U64),
            _prim_id_of(out, at + ONE_U64),
        ):
            child += ONE_U64
            at += ONE_U64
        if not is_before(t, prim_id, t_of(out, at), _prim_id_of(out, at)):
            break
        t_, u_, v_, prim_id_ = get_hit(out, at)
        put_hit(out, first + hole, t_, u_, v_, prim_id_)
        hole = child
    put_hit(out, first + hole, t, u, v, prim_id)


@device
def keep_hit(out, first, count, capacity, t, u, v, prim_id, t_far):
    """Keep a hit if it is among the `capacity` nearest ones so far.

    Parameters
    ----------
    out : HitAddresses
        Rows first to first + count hold the hits kept: a max-heap once there are `capacity`
        of them, in no order before.
    first, count, capacity : uint64
        The ray's first row, its rows in use, and all its rows (at least 1).
    t, u, v : float32
    prim_id : int32
    t_far : float32
        Hits beyond are not wanted.

    Returns
    -------
    count : uint64
        Rows in use now.
    t_far : float32
        Hits beyond are not wanted any more.
    """
    if count == capacity and not is_before(t, prim_id, t_of(out, first), _prim_id_of(out, first)):
        return count, t_of(out, first)
    if capacity == ONE_U64:  # known when a query of the nearest hit is compiled
        put_hit(out, first, t, u, v, prim_id)
        return ONE_U64, t
    return _insert(out, first, count, capacity, t, u, v, prim_id, t_far)


@device_call
def _insert(out, first, count, capacity, t, u, v, prim_id, t_far):
    """Write a hit that is kept; see `keep_hit`."""
    if count == capacity:
        _sift_down(out, first, count, ZERO_U64, t, u, v, prim_id)
        return count, t_of(out, first)
    put_hit(out, first + count, t, u, v, prim_id)
    count += ONE_U64
    if count == capacity:
        _make_heap(out, first, count)
        t_far = t_of(out, first)
    return count, t_far


@device
def _make_heap(out, first, count):
    hole = count >> ONE_U64
    while hole != np.uint64(0):
        hole -= ONE_U64
        t, u, v, prim_id = get_hit(out, first + hole)
        _sift_down(out, first, count, hole, t, u, v, prim_id)


@device_call
def sort_hits(out, first, count):
    """Sort rows first to first + count, in any order, by t, then prim_id."""
    _make_heap(out, first, count)
    last = count
    while last > ONE_U64:
        last -= ONE_U64
        t, u, v, prim_id = get_hit(out, first + last)
        t_, u_, v_, prim_id_ = get_hit(out, first)
        put_hit(out, first + last, t_, u_, v_, prim_id_)
        _sift_down(out, first, last, np.uint64(0), t, u, v, prim_id)


# The search


class InstanceRay(NamedTuple):
    """A ray in the space of an instance's object, as a search needs it for its hits.

    Attributes
    ----------
    t_scale, t_offset : float64
        World t = t * t_scale + t_offset; see `kernels.ray.LocalRay`.
    first_id : int32
        The number of the object's first triangle in this instance, counted over all instances.
    """

    t_scale: np.float64
    t_offset: np.float64
    first_id: np.int32


class SearchGoal(NamedTuple):
    """The goal of one ray's search.

    Attributes
    ----------
    capacity : uint64
        Most hits to find, at least 1.
    hits : HitAddresses or None
        The nearest hits; None if hits are only counted.
    first_row : uint64
        The first of this ray's `capacity` rows of `hits`.
    surfaces : bool
        The rule at edges and vertices, see `kernels.triangle.intersect`.
    """

    capacity: np.uint64
    hits: HitAddresses | None
    first_row: np.uint64
    surfaces: bool


class Search(NamedTuple):
    """A ray's search: its goal, and its results so far.

    Addresses and numbers only: an array member costs two atomic operations per new search.

    Attributes
    ----------
    t_min, t_far : float32
        Closed interval in which a hit is wanted; t_far decreases as hits are kept.
    hit_count : uint64
        Hits kept or counted.
    goal : SearchGoal
    counters : uint64 or None
        Address of the ray's counts, see `kernels.tally`.
    filter : RayFilter or None
        Decides which hits exist.
    instance : InstanceRay or None
        In a scene with instances: hits are kept with their world t, and their number among the
        triangles of all instances.
    """

    t_min: np.float32
    t_far: np.float32
    hit_count: np.uint64
    goal: SearchGoal
    counters: np.uint64 | None
    filter: RayFilter | None
    instance: InstanceRay | None


@device
def begin_search(t_min, t_max, goal, counters, filter_, instance):
    """A search without hits; see `Search` for the arguments."""
    return Search(t_min, t_max, ZERO_U64, goal, counters, filter_, instance)


@device
def _changed(search, count, t_far):
    """The same search with other results."""
    goal, counters, filter_ = search.goal, search.counters, search.filter
    return Search(search.t_min, t_far, count, goal, counters, filter_, search.instance)


@device
def offer(search, t, u, v, prim_id):
    """Keep or count a hit, unless a filter ignores it.

    Parameters
    ----------
    search : Search
        Not full, see `is_full`.
    t : float32
        In the search's interval.
    u, v : float32
    prim_id : int32

    Returns
    -------
    Search
    """
    number = _number(search.instance, prim_id)
    if not keeps(search.filter, t, u, v, number):
        return search
    found = _with_hit(search.goal.hits, search, _told(search.instance, t), u, v, number)
    t_far = _limited(search.goal.hits, search.instance, search.t_far, found)
    return _changed(search, found.hit_count, t_far)


@device
def _number(instance, prim_id):
    """The number of a triangle as hits are kept with it, and filters called."""
    if instance is None:
        return prim_id
    return np.int32(prim_id + instance.first_id)


@device
def _told(instance, t):
    """The distance of a hit as it is kept."""
    if instance is None:
        return t
    return world_t(t, instance.t_scale, instance.t_offset)


@device
def _with_hit(hits, search, t, u, v, prim_id):
    """The same search with another hit, and t_far as hits are kept."""
    goal, count, t_far = search.goal, search.hit_count, search.t_far
    if hits is None:
        return _changed(search, count + ONE_U64, t_far)
    first, capacity = goal.first_row, goal.capacity
    count, t_far = keep_hit(hits, first, count, capacity, t, u, v, prim_id, t_far)
    return _changed(search, count, t_far)


@device
def _limited(hits, instance, t_far, search):
    """The farthest t in object space that the hits kept leave of an interval up to t_far."""
    if hits is None or search.hit_count != search.goal.capacity:
        return t_far
    if instance is None:
        return search.t_far
    farthest = t_of(hits, search.goal.first_row)
    return min(t_far, local_limit(farthest, instance.t_scale, instance.t_offset))


@device
def enter_instance(search, ray, first_id):
    """Continue a search of the instances of a scene in one of them.

    Parameters
    ----------
    search : Search
    ray : LocalRay
        The ray in object space, with its own interval.
    first_id : int32
        See `InstanceRay`.

    Returns
    -------
    Search
    """
    instance = InstanceRay(ray.t_scale, ray.t_offset, first_id)
    t_far = _limited(search.goal.hits, instance, ray.t_max, search)
    filter_, count = _moved_filter(search.filter, ray), search.hit_count
    return Search(ray.t_min, t_far, count, search.goal, search.counters, filter_, instance)


@device
def _moved_filter(filter_, ray):
    """The filter of a ray, for its hits in an object's space; None if there is none."""
    if filter_ is None:
        return None
    return RayFilter(filter_.filter, filter_.ray, ray.t_scale, ray.t_offset)


@device
def leave_instance(search, inner):
    """The search of the instances, with the results of the search in one of them."""
    t_far = _limited(search.goal.hits, search.instance, search.t_far, inner)
    return _changed(search, inner.hit_count, t_far)


@device
def _is_counted(hits):
    return hits is None


@device
def is_full(search):
    """Whether no further hit can change the result: the traversal returns."""
    return search.hit_count == search.goal.capacity and _is_counted(search.goal.hits)


@device
def is_over(search, t_out):
    """Whether no hit at t_out or beyond can change the result.

    For traversals that visit cells in order. A counting search is over when it `is_full`.
    """
    return search.hit_count == search.goal.capacity and search.t_far < t_out


@device
def wants_any(search):
    """Whether this is an any-hit search."""
    return search.goal.capacity == ONE_U64 and _is_counted(search.goal.hits)
