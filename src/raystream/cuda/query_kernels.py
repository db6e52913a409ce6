"""Query kernels: the CPU's device functions, one ray per CUDA thread.

A thread reads its ray where the caller has it, transforms it to the local frame, traverses the
structure, and writes world distances.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from raystream.jit.constants import ONE_U64, SHIFT_64, ZERO_U64
from raystream.jit.cpu import device, kernel
from raystream.jit.cuda import RangeKernel
from raystream.jit.simd import load, scratch, store
from raystream.kernels.hits import HitAddresses
from raystream.kernels.queries import (
    Goal,
    RayScene,
    Searches,
    finish_first,
    finish_rows,
    searches,
)
from raystream.kernels.tally import ROW, SHADINGS, add_to


class CountAddresses(NamedTuple):
    """Where the counts of hits go: addresses of the first ray's.

    Attributes
    ----------
    status : uint64
        A byte per ray, a `RayStatus`; written for invalid rays only.
    counts : uint64
        An int64 per ray.
    """

    status: np.uint64
    counts: np.uint64


class RowAddresses(NamedTuple):
    """Where the hits of each ray go.

    Attributes
    ----------
    splits : uint64
        Address of int64: ray i owns the rows splits[i] to splits[i + 1].
    hits : HitAddresses
    found : uint64
        Address of an int64 per ray: the hits that were found.
    """

    splits: np.uint64
    hits: HitAddresses
    found: np.uint64


class QueryKernels(NamedTuple):
    """The kernels of a structure, from `make_kernels`."""

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


def make_kernels(
    traverse: Callable[..., Any],
    stack_bytes: int,
    make_searches: Callable[[Callable[..., Any]], Searches] = searches,
) -> QueryKernels:
    """Make the kernels of a structure.

    Parameters
    ----------
    traverse : device function
        See `kernels.queries.ray_queries`.
    stack_bytes : int
        Of its stack.
    make_searches : callable, optional
        `Structure.make_searches` [default: `searches`].

    Returns
    -------
    QueryKernels
        Each takes ``(source, frame, tree, tallies, ...)``: the rays, the scene's frame, the
        structure's arrays, and the address of tallies or None.
    """
    search_ray = make_searches(traverse).of_batch

    @kernel
    def first_hit(i, source, frame, tree, tallies, out):
        stack = scratch(stack_bytes)
        store(stack, ZERO_U64)
        tally = _tally_at(tallies, i)
        hits = HitAddresses(out.t, out.u, out.v, out.prim_id)
        scene = RayScene(source, frame, tree, stack, out.status, None)
        search, ray = search_ray(i, scene, Goal(ONE_U64, hits, i, False, tally))
        add_to(tally, SHADINGS, search.hit_count)
        finish_first(out, i, search.hit_count, ray)

    @kernel
    def any_hit(i, source, frame, tree, tallies, out):
        stack = scratch(stack_bytes)
        store(stack, ZERO_U64)
        tally = _tally_at(tallies, i)
        scene = RayScene(source, frame, tree, stack, out.status, None)
        search, _ = search_ray(i, scene, Goal(ONE_U64, None, ZERO_U64, False, tally))
        add_to(tally, SHADINGS, search.hit_count)
        store(out.seen + i, np.uint8(search.hit_count != ZERO_U64))

    @kernel
    def count_hits(i, source, frame, tree, tallies, surfaces, limit, out):
        stack = scratch(stack_bytes)
        store(stack, ZERO_U64)
        scene = RayScene(source, frame, tree, stack, out.status, None)
        goal = Goal(limit, None, ZERO_U64, surfaces, _tally_at(tallies, i))
        search, _ = search_ray(i, scene, goal)
        store(out.counts + (i << SHIFT_64), np.int64(search.hit_count))

    @kernel
    def multi_hit(i, source, frame, tree, tallies, surfaces, out):
        first = np.uint64(load(np.int64, out.splits + (i << SHIFT_64)))
        capacity = np.uint64(load(np.int64, out.splits + ((i + ONE_U64) << SHIFT_64))) - first
        store(out.found + (i << SHIFT_64), np.int64(0))
        if capacity == ZERO_U64:
            return
        stack = scratch(stack_bytes)
        store(stack, ZERO_U64)
        tally = _tally_at(tallies, i)
        scene = RayScene(source, frame, tree, stack, None, None)
        goal = Goal(capacity, out.hits, first, surfaces, tally)
        search, ray = search_ray(i, scene, goal)
        store(out.found + (i << SHIFT_64), np.int64(search.hit_count))
        add_to(tally, SHADINGS, search.hit_count)
        finish_rows(out.hits, first, search.hit_count, ray, True)

    return QueryKernels(*(RangeKernel(one) for one in (first_hit, any_hit, count_hits, multi_hit)))
