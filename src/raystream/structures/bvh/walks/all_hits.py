"""All hits of rays in flight, or their numbers, in place of the nearest: `walks.in_flight`.

Each leaf continues the search of its ray as a single ray's does. Hits are appended to the buffers
of a call in the order of discovery, and sorted by ray at the end of the call.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from raystream.jit.constants import INF_F32, NULL, ONE_U64, SHIFT_32, SHIFT_64, ZERO_U64
from raystream.jit.cpu import device, kernel
from raystream.jit.simd import load, store
from raystream.kernels.growing_buffers import GrowingBuffers
from raystream.kernels.hit_filter import HitFilter
from raystream.kernels.hits import HitAddresses, HitBatch
from raystream.kernels.leaf_block import search_blocks
from raystream.kernels.ray import world_t
from raystream.kernels.ray_source import ResultAddresses, load_ray
from raystream.kernels.search import SearchGoal, begin_search
from raystream.structures.batch_kernels import Batch, BatchKernel, Calls, CallSize
from raystream.structures.bvh.node_layout import LANE, leaf_address, leaf_end
from raystream.structures.bvh.packets.hits import Buffers, sort_by_ray
from raystream.structures.bvh.packets.multi_hit import FIRST_CAPACITY, PacketBuffers
from raystream.structures.bvh.walks.in_flight import (
    NO_RAY,
    filter_of,
    line_of,
    wavefront_kernel,
)

_UNLIMITED = np.uint64(2**64 - 1)

#: Calls that collect hits: with fewer rays, slots are empty at their ends more often, and with
#: more, buffers leave the cache. (1,024 and 8,192 take 1.03 to 1.05, and 1.00 to 1.08 of the time.)
_COLLECTED_SIZE = CallSize(1024, 4096, joins_chunks=False)


class HitsWanted(NamedTuple):
    """What is wanted of rays in flight whose hits are all wanted.

    Attributes
    ----------
    surfaces : bool
        See `kernels.triangle.intersect`.
    filter : HitFilter or None
    out : ResultAddresses
        The status only.
    counts : uint64
        Address of the number of hits of each ray, int64; 0 if hits are collected.
    buffers : uint64
        Address of `PacketBuffers.addresses`. When too many are found, the number in use is the
        capacity less 1.
    first : uint64
        The first ray of the call.
    wants_any : bool
    """

    surfaces: bool
    filter: HitFilter | None
    out: ResultAddresses
    counts: np.uint64
    buffers: np.uint64
    first: np.uint64
    wants_any: bool = False


class SlotSearches(NamedTuple):
    """The search of a ray in flight, as its leaves continue it.

    Attributes
    ----------
    begin : device function
        ``begin(slot, wanted, instance)`` makes the `Search` of a leaf; `instance` is an
        `InstanceRay`, or None.
    end : device function
        ``end(slot, search, wanted)`` keeps its results; returns whether the ray is done.
    finish : device function
        See `in_flight.wavefront_kernel`.
    """

    begin: Any
    end: Any
    finish: Any


# Counts


@device
def _begin_count(slot, wanted, instance):
    goal = SearchGoal(_UNLIMITED, None, ZERO_U64, wanted.surfaces)
    return begin_search(slot.t_min, slot.t, goal, None, filter_of(wanted.filter, slot), instance)


@device
def _end_count(slot, search, wanted):
    slot.count = np.uint32(slot.count + np.uint32(search.hit_count))
    return False


@device
def _finish_count(slot, wanted):
    if slot.ray >= np.int64(0):
        store(wanted.counts + (np.uint64(slot.ray) << SHIFT_64), np.int64(slot.count))
    slot.ray = NO_RAY


#: Of rays whose hits are counted.
COUNTED = SlotSearches(_begin_count, _end_count, _finish_count)


# All hits


@device
def _begin_rows(slot, wanted, instance):
    to = Buffers(wanted.buffers)
    hits = HitAddresses(to.found.t, to.found.u, to.found.v, to.found.prim_id)
    # There is room for one at least: see `_end_rows`.
    goal = SearchGoal(to.capacity - to.used, hits, to.used, wanted.surfaces)
    return begin_search(slot.t_min, slot.t, goal, None, filter_of(wanted.filter, slot), instance)


@device
def _end_rows(slot, search, wanted):
    to, count = Buffers(wanted.buffers), search.hit_count
    row, ray = to.used, np.int32(np.uint64(slot.ray) - wanted.first)
    for k in range(row, row + count):
        store(to.found.ray + k * LANE, ray)
    # A search that has filled the buffers may have left out hits: the call will be repeated.
    to.used = min(row + count, to.capacity - ONE_U64)
    return to.used == to.capacity - ONE_U64


@device
def _finish_rows(slot, wanted):
    slot.ray = NO_RAY


#: Of rays whose hits are collected.
COLLECTED = SlotSearches(_begin_rows, _end_rows, _finish_rows)


@kernel
def _sort_rows(begin, end, frame, source, at, sorts):
    """Sort what a call has found by ray; convert distances to world direction lengths.

    Parameters
    ----------
    begin, end : int
        The call's rays.
    frame : SceneFrame or None
        The one that distances are of. None if they are in world direction lengths.
    source : RaySource
    at : uint64
        Address of `PacketBuffers.addresses`.
    sorts : bool
    """
    to, first, count = Buffers(at), np.uint64(begin), np.uint64(end - begin)
    store(to.splits, ZERO_U64)
    ends = to.splits + (ONE_U64 << SHIFT_64)
    sort_by_ray(to, to.used, ends, count, ZERO_U64, sorts)
    if frame is not None:
        row = ZERO_U64
        for k in range(count):
            row_end = load(np.uint64, ends + (k << SHIFT_64))
            if row != row_end:
                ray = load_ray(source, first + k, frame)
                for own in range(row, row_end):
                    t = to.rows.t + (own << SHIFT_32)
                    store(t, world_t(load(np.float32, t), ray.t_scale, ray.t_offset))
            row = row_end


# Kernels of batches


#: ``scene_of(structure, batch)``: the arguments of a kernel for rays in flight between its rays and
#: what is wanted. The second and the third are the frame of distances, or None, and the rays.
SceneOf = Callable[[Any, Batch], tuple[Any, ...]]


def _wanted(batch: Batch, counts: np.uint64, buffers: np.uint64, first: int) -> HitsWanted:
    query, status = batch.query, np.uint64(batch.sink.status.ctypes.data)
    out = ResultAddresses(NULL, NULL, NULL, NULL, NULL, status)
    return HitsWanted(query.surfaces, query.on_hit, out, counts, buffers, np.uint64(first))


def _count_all(trace: Any, scene_of: SceneOf, structure: Any, batch: Batch) -> Calls:
    """Count the hits of rays; see `BatchKernel.bind`."""
    counts = np.uint64(batch.sink.counts.ctypes.data)
    return trace, (*scene_of(structure, batch), _wanted(batch, counts, NULL, 0))


def _visit_all(
    trace: Any, scene_of: SceneOf, in_world: bool, structure: Any, batch: Batch
) -> Calls:
    """Deliver all hits of rays to the sink's visitor, call by call; see `BatchKernel.bind`."""
    visitor, scene = batch.sink.visitor, scene_of(structure, batch)
    assert visitor is not None
    frame = None if in_world else structure.frame

    def fill(begin: int, end: int, buffers: PacketBuffers) -> int:
        at = np.uint64(buffers.addresses.ctypes.data)
        used = buffers.addresses[-2:-1]
        used[:] = 0
        trace(begin, end, *scene, _wanted(batch, NULL, at, begin))
        if int(used[0]) == buffers.capacity - 1:
            return begin
        _sort_rows(begin, end, frame, batch.source, at, batch.query.is_ordered)
        visitor(HitBatch(buffers.rows, buffers.splits[: end - begin + 1], None, begin))
        return end

    return GrowingBuffers(PacketBuffers.of, fill, FIRST_CAPACITY), ()


def all_hits_in_flight(
    kernel_of: Callable[[SlotSearches], Any],
    scene_of: SceneOf,
    size: CallSize,
    in_world: bool = False,
) -> tuple[BatchKernel, BatchKernel]:
    """The kernels that deliver all hits of rays in flight to a visitor, and that count them.

    Parameters
    ----------
    kernel_of : callable
        Makes the kernel for `SlotSearches`.
    scene_of : callable
    size : CallSize
        Of calls that count.
    in_world : bool
        Whether hits are kept with t in world direction lengths.
    """
    collect, count = kernel_of(COLLECTED), kernel_of(COUNTED)
    visited = partial(_visit_all, collect, scene_of, in_world)
    counted = partial(_count_all, count, scene_of)
    return (
        BatchKernel(visited, _COLLECTED_SIZE, by_packets=False),
        BatchKernel(counted, size, by_packets=False),
    )


# Trees of triangles


@device
def search_leaf(slot, leaves, search):
    """Test the triangles of a slot's next leaf, and offer their hits to a search."""
    at = leaf_address(leaves, slot.child)
    end = leaf_end(at, slot.child)
    return search_blocks(at, end, line_of(slot), search, slot.t_min, INF_F32)


def triangles_in_flight(searches: SlotSearches) -> Any:
    """The kernel of `SlotSearches` through a tree of triangles, `TreeAddresses`."""
    begin, end, finish = searches

    @device
    def visit_leaf(slot, tree, frame, source, lanes, wanted):
        search = begin(slot, wanted, None)
        return end(slot, search_leaf(slot, tree.leaves, search), wanted)

    return wavefront_kernel(visit_leaf, finish)
