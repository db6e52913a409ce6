"""The four queries as loops over rays, around any structure's traversal."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.cpu import device, kernel
from raystream.jit.simd import address, scratch, store
from raystream.kernels.collect import hit_addresses, sort_hits
from raystream.kernels.local_ray import world_t
from raystream.kernels.ray import set_up
from raystream.kernels.search import begin_search
from raystream.kernels.seen import LEAST_ROOM, SeenSet, clear_seen
from raystream.kernels.tally import SHADINGS, add_to, restore_counts, save_counts, tally_of

__all__ = ["LocalRays", "RayQueries", "ray_queries"]

_INF = np.float32(np.inf)
_ZERO = np.float32(0.0)
_MISS = np.int32(-1)
_ONE = np.uint64(1)


class LocalRays(NamedTuple):
    """Rays in the local frame of a scene, ready to trace.

    Attributes
    ----------
    origins, directions : ndarray of shape (N, 3), float32
        The largest component of each direction is in [1, 2).
    t_min, t_max : ndarray of shape (N,), float32
        Closed interval in local direction lengths; empty for a ray that cannot hit.
    """

    origins: NDArray[np.float32]
    directions: NDArray[np.float32]
    t_min: NDArray[np.float32]
    t_max: NDArray[np.float32]

    @classmethod
    def empty(cls, count: int) -> LocalRays:
        """Make arrays for `count` rays, not initialised."""
        origins, directions = (np.empty((count, 3), np.float32) for _ in range(2))
        return cls(origins, directions, np.empty(count, np.float32), np.empty(count, np.float32))


class RayQueries(NamedTuple):
    """Compiled loops over the rays begin to end; all share one traversal.

    Attributes
    ----------
    first_hit : (begin, end, arrays, extreme, rays, out, tallies)
        Writes row i of `out` (HitArrays) for ray i.
    any_hit : (begin, end, arrays, extreme, rays, seen, tallies)
        Writes `seen`, of shape (N,), bool.
    count_hits : (begin, end, arrays, extreme, rays, repeats, surfaces, limit, counts, tallies)
        Writes `counts`, of shape (N,), int64: the number of hits, at most `limit`.
    multi_hit : (begin, end, arrays, extreme, rays, repeats, surfaces, splits, out, tallies)
        Writes the nearest splits[i + 1] - splits[i] hits of ray i, sorted, from row
        splits[i] of `out`.

    gather : (begin, end, arrays, extreme, rays, t_scale, repeats, surfaces, limit, sorts, splits,
              out)
        Writes the nearest `limit` hits of each ray into rows 0 to splits[end - begin] of
        `out`, with t in world direction lengths, sorted if `sorts`. Returns the first ray
        that is not done: `end`, or one that finds no room in `out`.

    `repeats` says whether the structure lists a triangle more than once. What ray i meets is
    added to row i of `tallies`, of `kernels.tally`; None counts nothing, at no cost.
    """

    first_hit: Callable[..., None]
    any_hit: Callable[..., None]
    count_hits: Callable[..., None]
    multi_hit: Callable[..., None]
    gather: Callable[..., int]


_NOWHERE = np.uint64(0)


@device
def _seen_at(table, room):
    return SeenSet(table, room)


@device
def _no_set(table, room):
    return None


@device
def _new_table(repeats):
    """Memory of a set for triangles seen; without places where none is needed."""
    table = np.empty((LEAST_ROOM if repeats else _NOWHERE) + _ONE, np.int32)
    clear_seen(SeenSet(address(table), np.uint64(len(table)) - _ONE))
    return table


@device
def _larger_table(table):
    larger = np.empty((np.uint64(len(table)) - _ONE) * np.uint64(8) + _ONE, np.int32)
    clear_seen(SeenSet(address(larger), np.uint64(len(larger)) - _ONE))
    return larger


@device
def _ray(rays, i, extreme):
    o, d = rays.origins, rays.directions
    return set_up(o[i, 0], o[i, 1], o[i, 2], d[i, 0], d[i, 1], d[i, 2], extreme)


def ray_queries(
    traverse: Callable[..., Any], stack_bytes: int, *, lists_twice: bool = False
) -> RayQueries:
    """Make the queries of a structure.

    Parameters
    ----------
    traverse : device function
        ``traverse(view, ray, search, stack)`` visits every triangle of `view`, the structure's
        `arrays`, whose hit with `ray` the search may want, offers their hits to it
        (`kernels.search`), and returns the search. It may be given one that has hits already,
        from elsewhere, but none that is full; it returns as soon as it `is_full`. What it meets
        it adds to ``search.counters`` (`kernels.tally`).
    stack_bytes : int
        Size of the memory at the address `stack`, which is aligned to 64 bytes; at least 8.
        What a traversal leaves there, the next ray's finds; before the first ray, the first
        8 bytes are 0.
    lists_twice : bool
        Whether the traversal may offer a triangle more than once: then searches for several hits
        remember the triangles of their hits, where `repeats` is true.

    Returns
    -------
    RayQueries
    """
    seen_at = _seen_at if lists_twice else _no_set

    @kernel
    def first_hit(begin, end, arrays, extreme, rays, out, tallies):
        stack = scratch(stack_bytes)
        store(stack, _NOWHERE)
        to = hit_addresses(out)
        for i in range(np.uint64(begin), np.uint64(end)):
            ray, tally = _ray(rays, i, extreme), tally_of(tallies, i)
            t_min, t_max = rays.t_min[i], rays.t_max[i]
            search = begin_search(t_min, t_max, _ONE, to, i, False, None, tally)
            search = traverse(arrays, ray, search, stack)
            add_to(tally, SHADINGS, search.count)
            if search.count == _NOWHERE:
                out.t[i] = _INF
                out.u[i] = _ZERO
                out.v[i] = _ZERO
                out.prim_id[i] = _MISS

    @kernel
    def any_hit(begin, end, arrays, extreme, rays, out, tallies):
        stack = scratch(stack_bytes)
        store(stack, _NOWHERE)
        for i in range(np.uint64(begin), np.uint64(end)):
            ray, tally = _ray(rays, i, extreme), tally_of(tallies, i)
            t_min, t_max = rays.t_min[i], rays.t_max[i]
            search = begin_search(t_min, t_max, _ONE, None, _NOWHERE, False, None, tally)
            search = traverse(arrays, ray, search, stack)
            add_to(tally, SHADINGS, search.count)
            out[i] = search.count != _NOWHERE

    @kernel
    def count_hits(begin, end, arrays, extreme, rays, repeats, surfaces, limit, counts, tallies):
        stack, saved = scratch(stack_bytes), scratch(32)
        store(stack, _NOWHERE)
        table = _new_table(repeats)
        most = np.uint64(limit)
        for i in range(np.uint64(begin), np.uint64(end)):
            ray, tally = _ray(rays, i, extreme), tally_of(tallies, i)
            t_min, t_max = rays.t_min[i], rays.t_max[i]
            save_counts(tally, saved)
            while True:
                seen = seen_at(address(table), np.uint64(len(table)) - _ONE)
                search = begin_search(t_min, t_max, most, None, _NOWHERE, surfaces, seen, tally)
                search = traverse(arrays, ray, search, stack)
                if not search.has_overflowed:
                    break
                table = _larger_table(table)
                restore_counts(tally, saved)
            counts[i] = search.count
            if repeats:
                table = _new_table(True)

    @kernel
    def multi_hit(begin, end, arrays, extreme, rays, repeats, surfaces, splits, out, tallies):
        stack, saved = scratch(stack_bytes), scratch(32)
        store(stack, _NOWHERE)
        table = _new_table(repeats)
        to = hit_addresses(out)
        for i in range(np.uint64(begin), np.uint64(end)):
            first = np.uint64(splits[i])
            capacity = np.uint64(splits[i + np.uint64(1)]) - first
            if capacity == 0:
                continue
            ray, tally = _ray(rays, i, extreme), tally_of(tallies, i)
            t_min, t_max = rays.t_min[i], rays.t_max[i]
            save_counts(tally, saved)
            while True:
                seen = seen_at(address(table), np.uint64(len(table)) - _ONE)
                search = begin_search(t_min, t_max, capacity, to, first, surfaces, seen, tally)
                search = traverse(arrays, ray, search, stack)
                if not search.has_overflowed:
                    break
                table = _larger_table(table)
                restore_counts(tally, saved)
            add_to(tally, SHADINGS, search.count)
            sort_hits(to, first, search.count)
            if repeats:
                table = _new_table(True)

    @kernel
    def gather(
        begin,
        end,
        arrays,
        extreme,
        rays,
        t_scale,
        repeats,
        surfaces,
        limit,
        sorts,
        splits,
        out,
    ):
        stack = scratch(stack_bytes)
        store(stack, _NOWHERE)
        table = _new_table(repeats)
        to = hit_addresses(out)
        most, room, row = np.uint64(limit), np.uint64(len(out.t)), _NOWHERE
        splits[0] = 0
        for i in range(np.uint64(begin), np.uint64(end)):
            capacity = min(most, room - row)
            if capacity == 0:
                return np.int64(i)
            ray = _ray(rays, i, extreme)
            t_min, t_max = rays.t_min[i], rays.t_max[i]
            while True:
                seen = seen_at(address(table), np.uint64(len(table)) - _ONE)
                search = begin_search(t_min, t_max, capacity, to, row, surfaces, seen, None)
                search = traverse(arrays, ray, search, stack)
                if not search.has_overflowed:
                    break
                table = _larger_table(table)
            if search.count == capacity and capacity != most:
                return np.int64(i)
            if repeats:
                table = _new_table(True)
            if sorts:
                sort_hits(to, row, search.count)
            factor, offset = t_scale.factor[i], t_scale.offset[i]
            for _ in range(search.count):
                out.t[row] = world_t(out.t[row], factor, offset)
                row += _ONE
            splits[i + _ONE - np.uint64(begin)] = row
        return np.int64(end)

    return RayQueries(first_hit, any_hit, count_hits, multi_hit, gather)
