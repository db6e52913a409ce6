"""The rays of a packet in memory, and which rays of a batch form one.

A packet is 256 rays: a tile of 16 x 16 pixels of an image-shaped batch, or 256 rays in a
row. It lies on the stack, group after group of 16 rays; a group has a vector for each number
of its rays.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import f32x16, maximum, minimum

__all__ = [
    "ARRAY",
    "CLASS",
    "DIRECTION",
    "FACTOR",
    "FAR",
    "GROUP",
    "GROUPS",
    "GROUP_BYTES",
    "INV",
    "LIVE_T",
    "LONG_FACTOR",
    "LONG_OFFSET",
    "NEAR",
    "NO_CLASS",
    "NO_PRIM",
    "ORIGIN",
    "PACKET_BYTES",
    "PACKET_RAYS",
    "PRIM",
    "SHEAR",
    "T_MIN",
    "PacketOrder",
    "T",
    "U",
    "V",
    "group_rows",
    "packet_order",
    "world_lanes",
]

#: Rays of a packet: wider ones share more nodes and fill the first-level cache.
PACKET_RAYS = 256

GROUPS = np.uint64(PACKET_RAYS // 16)

#: Bytes of one number of a group's rays, and of the whole group. (One array of each number
#: for all of the packet would be 1024 bytes apart from the next: loads would wait for stores
#: to other arrays at the same place in a page.)
ARRAY = np.uint64(64)
GROUP_BYTES = 30 * 64
GROUP = np.uint64(GROUP_BYTES)

# Where each number is in a group. Axes in world order, except for the shear's.
INV = np.uint64(0)
NEAR = np.uint64(3) * ARRAY
FAR = np.uint64(6) * ARRAY
ORIGIN = np.uint64(9) * ARRAY
SHEAR = np.uint64(12) * ARRAY  # sx, sy, sz
T_MIN = np.uint64(15) * ARRAY
T = np.uint64(16) * ARRAY  # t_max, then the nearest hit's
LIVE_T = np.uint64(17) * ARRAY  # the same for the rays of the pass, -inf for others
PRIM = np.uint64(18) * ARRAY
U = np.uint64(19) * ARRAY
V = np.uint64(20) * ARRAY
CLASS = np.uint64(21) * ARRAY  # octant and largest axis of the direction
FACTOR = np.uint64(22) * ARRAY
DIRECTION = np.uint64(27) * ARRAY
#: For rays that do not take the short way into the local frame, in float64.
LONG_FACTOR = np.uint64(23) * ARRAY
LONG_OFFSET = np.uint64(2) * ARRAY  # from there
PACKET_BYTES = GROUP_BYTES * PACKET_RAYS // 16

_LARGEST = np.float32(np.finfo(np.float32).max)

NO_PRIM = np.int32(2**31 - 1)
NO_CLASS = np.int32(-1)

_U1 = np.uint64(1)
_LANES = np.uint64(16)
_SIDE = np.uint64(16)


class PacketOrder(NamedTuple):
    """Which rays of a batch form a packet.

    Attributes
    ----------
    width, height : int
        Of an image-shaped batch; a width of 0 means rays in a row.
    ray_count : int
        Of the batch.
    """

    width: np.uint64
    height: np.uint64
    ray_count: np.uint64


def packet_order(shape: tuple[int, ...]) -> tuple[PacketOrder, int]:
    """How rays of a leading shape form packets of 256, and how many packets there are.

    The last two dimensions are taken as an image's rows and columns.
    """
    count = math.prod(shape)
    side = int(_SIDE)
    if len(shape) < 2 or shape[-1] < side:
        return PacketOrder(np.uint64(0), np.uint64(0), np.uint64(count)), -(-count // PACKET_RAYS)
    width, height = shape[-1], count // shape[-1]
    order = PacketOrder(np.uint64(width), np.uint64(height), np.uint64(count))
    return order, -(-width // side) * -(-height // side)


@device
def group_rows(order, packet, group):
    """The rays of a group: number of the first one, and how many follow each other."""
    if order.width == np.uint64(0):
        first = packet * np.uint64(PACKET_RAYS) + group * _LANES
        return first, min(order.ray_count - min(first, order.ray_count), _LANES)
    across = (order.width + _SIDE - _U1) // _SIDE
    x = packet % across * _SIDE
    y = packet // across * _SIDE + group
    if y >= order.height:
        return np.uint64(0), np.uint64(0)
    return y * order.width + x, min(order.width - x, _LANES)


@device
def world_lanes(t, factor):
    """Distances of a group without rays that took the long way, in world direction lengths."""
    # A distance beyond float32 is still a hit: only a miss is infinite.
    return minimum(maximum(t * factor, f32x16(-_LARGEST)), f32x16(_LARGEST))
