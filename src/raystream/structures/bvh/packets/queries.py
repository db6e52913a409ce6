"""Queries of packets: one loop for all kinds of scenes and all kinds of answers."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from raystream.jit.cpu import device, kernel
from raystream.jit.simd import scratch
from raystream.kernels.hit_filter import HitFilter
from raystream.kernels.ray_source import ResultAddresses
from raystream.structures.bvh.leaf_kinds import nearest_leaf
from raystream.structures.bvh.packets.filters import packet_filter
from raystream.structures.bvh.packets.load import load_packet
from raystream.structures.bvh.packets.rays import GROUPS, PACKET_BYTES, group_places, store_packet
from raystream.structures.bvh.walks.packet import TRACE_BYTES, trace_packet

_LEAST_BYTES = 64


class PacketScene(NamedTuple):
    """How packets are traced in scenes of a kind.

    Attributes
    ----------
    load : device function
        ``load(packet, number, source, scene, memory)`` loads a packet; returns bits of the groups
        with a ray that took the slow path, see `packets.load.load_packet`, and the largest
        coordinate of the boxes.
    trace : device function
        ``trace(packet, scene, max_coordinate, memory, leaf)`` traces it.
    byte_count : int
        Of the memory, which both have for a packet.
    """

    load: Any
    trace: Any
    byte_count: int


class PacketAnswer(NamedTuple):
    """What is wanted of packets, and where it goes.

    Attributes
    ----------
    begin : device function
        ``begin(packet, number, slow_groups, source, wanted, state)`` makes the leaf that a loaded
        packet is traced with.
    finish : device function
        ``finish(packet, number, slow_groups, source, scene, wanted, state)`` writes the results of
        a packet; returns False if they do not fit.
    byte_count : int
        Of the state.
    """

    begin: Any
    finish: Any
    byte_count: int


def packet_kernel(scenes: PacketScene, answer: PacketAnswer) -> Any:
    """Make the kernel of a query of packets.

    Returns
    -------
    kernel
        ``trace_packets(begin, end, scene, source, wanted)`` traces packets begin to end of a
        `PacketSource` through what the functions of `scenes` take; `wanted` is for those of the
        answer. It returns the first packet whose results do not fit, or `end`.
    """
    load, trace, memory_bytes = scenes.load, scenes.trace, max(scenes.byte_count, _LEAST_BYTES)
    start, finish, state_bytes = answer.begin, answer.finish, max(answer.byte_count, _LEAST_BYTES)

    @kernel
    def trace_packets(begin, end, scene, source, wanted):
        packet, memory, state = scratch(PACKET_BYTES), scratch(memory_bytes), scratch(state_bytes)
        for number in range(np.uint64(begin), np.uint64(end)):
            slow_groups, most = load(packet, number, source, scene, memory)
            leaf = start(packet, number, slow_groups, source, wanted, state)
            trace(packet, scene, most, memory, leaf)
            if not finish(packet, number, slow_groups, source, scene, wanted, state):
                return np.int64(number)
        return np.int64(end)

    return trace_packets


# Scenes without instances


@device
def _load(packet, number, source, scene, memory):
    return load_packet(packet, number, source), source.frame.max_coordinate


@device
def _trace(packet, scene, max_coordinate, memory, leaf):
    trace_packet(packet, GROUPS, scene, max_coordinate, scratch(TRACE_BYTES), leaf)


#: Of one tree, `TreeAddresses`, which is not empty.
TREES = PacketScene(_load, _trace, 0)


# The nearest or any hits


class NearestWanted(NamedTuple):
    """What is wanted by `NEAREST`.

    Attributes
    ----------
    wants_any : bool
        Find whether there is a hit, else the nearest one.
    filter : HitFilter or None
    out : ResultAddresses
    """

    wants_any: bool
    filter: HitFilter | None
    out: ResultAddresses


@device
def _begin_nearest(packet, number, slow_groups, source, wanted, state):
    mine = packet_filter(wanted.filter, group_places(source.order, number), slow_groups)
    return nearest_leaf(wanted.wants_any, mine)


@device
def _store_nearest(packet, number, slow_groups, source, scene, wanted, state):
    store_packet(packet, number, source.order, slow_groups, wanted.wants_any, wanted.out)
    return True


#: The nearest or any hits, for a `NearestWanted`.
NEAREST = PacketAnswer(_begin_nearest, _store_nearest, 0)
