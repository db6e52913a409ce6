"""Queries of groups of rays: one loop for all kinds of scenes."""

from __future__ import annotations

from typing import Any

import numpy as np

from raystream.jit.constants import ZERO_U64
from raystream.jit.cpu import device, kernel
from raystream.jit.simd import scratch
from raystream.structures.bvh.packets.filters import packet_filter
from raystream.structures.bvh.packets.rays import GroupPlaces
from raystream.structures.bvh.ray_groups.leaf import SMALL_BYTES, Small, nearest_leaf
from raystream.structures.bvh.ray_groups.rays import (
    BLOCK_PACKETS,
    LISTS_AT,
    PLACES_AT,
    load_block,
    store_block,
)
from raystream.structures.bvh.walks.groups import STREAM_STACK_BYTES, trace_block


def group_kernel(load: Any, trace: Any, finish: Any, block_packets: int) -> Any:
    """Make the kernel that traces packets as groups of rays.

    Parameters
    ----------
    load : device function
        ``load(memory, source, first, last, scene, wanted)`` loads packets first to last of a
        `PacketSource`, and lists their groups at ``memory + LISTS_AT``. It returns the length of
        the list, its rays, and the groups that were loaded.
    trace : device function
        ``trace(memory, count, ray_count, scene, source, wanted)`` traces the list.
    finish : device function
        ``finish(memory, source, first, last, scene, group_count, wanted)`` writes the results;
        returns False if they do not fit.
    block_packets : int
        Packets whose rays are traced together.

    Returns
    -------
    kernel
        ``trace_groups(begin, end, scene, source, wanted, memory)`` traces packets begin to end;
        `scene` and `wanted` are for these functions. The address of the memory is a multiple of 64.
        It returns the first packet of those whose results do not fit, or `end`.
    """
    step = np.uint64(block_packets)

    @kernel
    def trace_groups(begin, end, scene, source, wanted, memory):
        memory = np.uint64(memory)
        for first in range(np.uint64(begin), np.uint64(end), step):
            last = min(first + step, np.uint64(end))
            count, ray_count, group_count = load(memory, source, first, last, scene, wanted)
            trace(memory, count, ray_count, scene, source, wanted)
            if not finish(memory, source, first, last, scene, group_count, wanted):
                return np.int64(first)
        return np.int64(end)

    return trace_groups


@device
def _load(memory, source, first, last, scene, wanted):
    return load_block(memory, source, first, last, wanted.filter is not None)


@device
def _trace(memory, count, ray_count, scene, source, wanted):
    stack, small, groups = scratch(STREAM_STACK_BYTES), scratch(SMALL_BYTES), memory + LISTS_AT
    places = GroupPlaces(memory + PLACES_AT, ZERO_U64, ZERO_U64)
    leaf = nearest_leaf(wanted.wants_any, packet_filter(wanted.filter, places, ~ZERO_U64))
    trace_block(memory, groups, count, ray_count, scene, stack, Small(small), leaf)


@device
def finish_nearest(memory, source, first, last, scene, group_count, wanted):
    """Write the nearest or any hits of packets; see `group_kernel`."""
    store_block(memory, source.order, first, last, wanted.wants_any, wanted.out)
    return True


#: The nearest or any hits of one tree, `TreeAddresses`, which is not empty, for a
#: `packets.queries.NearestWanted`; in `ray_groups.rays.MEMORY_BYTES` bytes.
trace_groups = group_kernel(_load, _trace, finish_nearest, BLOCK_PACKETS)
