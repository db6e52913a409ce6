"""Sample the rays of a batch for coherence, and choose the kernel that suits them."""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import numpy as np

from raystream.jit.constants import ONE_U64
from raystream.jit.cpu import device, kernel
from raystream.kernels.ray import SceneFrame
from raystream.kernels.ray_source import RaySource, load_ray
from raystream.structures.bvh.packets.rays import GROUPS, PacketOrder, group_rows

#: Groups of 16 rays in a sample: about ten microseconds, for any batch.
_SAMPLES = 24

#: A group whose directions differ by less than this fraction of their length is narrow: a
#: packet of it enters few boxes that not all of its rays enter.
_NARROW = np.float32(0.25)

#: A group whose origins differ by less than this fraction of the scene's size starts near.
_NEAR = np.float32(0.1)

#: A group is close if, besides, its origins differ by less than this many triangle sizes: a packet
#: of rays that are further apart enters boxes that few of its rays enter. (Shadow rays in a forest
#: of a million triangles, 14 triangles apart: groups are 1.6 times as fast as packets. In six
#: other scenes, 0.1 to 2.5 triangles apart, packets are, or nearly.)
_CLOSE = 4.0

#: Approximate bytes of a tree per triangle.
_TRIANGLE_BYTES = 110

#: Lists of rays pay off where many share a node: up to this many bytes of the tree per ray, if rays
#: start near each other and if they start anywhere. Beyond, hiding memory latency pays more.
#: (Measured with 1,500 to 786,432 rays on trees of 8 MB and 110 MB.)
_NEAR_BYTES = 8192
_FAR_BYTES = 200

#: Rays that start anywhere share few nodes of a tree of more bytes, however many they are. (Random
#: rays on a tree of 110 MB: the wavefront is 1.7 times as fast as groups.)
_GROUP_BYTES = 1 << 26


class Coherence(NamedTuple):
    """Coherence of a sample of groups of 16 rays.

    Attributes
    ----------
    narrow : float
        Share of the groups with nearly the same direction.
    near : float
        Share of the groups with nearly the same origin.
    close : float
        Share of the groups whose origins are few triangles apart.
    joint : float
        Share of the groups with one origin.
    """

    narrow: float
    near: float
    close: float
    joint: float

    def kind(self) -> tuple[bool, ...]:
        """Which of these half of the groups are."""
        return tuple(share >= 0.5 for share in self)


def probe(source: RaySource, order: PacketOrder, frame: SceneFrame, byte_count: int) -> Coherence:
    """Sample the rays of a batch.

    Parameters
    ----------
    source : RaySource
    order : PacketOrder
        Of at least one packet.
    frame : SceneFrame
    byte_count : int
        Size of the tree.
    """
    # Of the scene's size, if the triangles covered the sides of its box.
    triangle_size = math.sqrt(6.0 * _TRIANGLE_BYTES / max(byte_count, 1))
    close = np.float32(min(_CLOSE * triangle_size, float(_NEAR)))
    groups, *shares = _look(order.packet_count, source, order, frame, close)
    return Coherence(*(share / max(groups, 1) for share in shares))


def choose_kernel(
    coherence: Coherence, count: int, byte_count: int
) -> Literal["packet", "groups", "wavefront"]:
    """The kernel for rays of a coherence.

    Parameters
    ----------
    coherence : Coherence
    count : int
        Number of rays.
    byte_count : int
        Size of the tree.
    """
    if coherence.narrow >= 0.5 and coherence.close >= 0.5:
        return "packet"
    is_near = coherence.near >= 0.5
    most = count * _NEAR_BYTES if is_near else min(count * _FAR_BYTES, _GROUP_BYTES)
    return "groups" if byte_count <= most else "wavefront"


def rivals(coherence: Coherence, guess: str) -> tuple[str, ...]:
    """Kernels that may be faster than the one of `choose_kernel`, for a race.

    Packets have none for rays from one point in similar directions: groups are at most as fast.
    """
    if guess == "packet":
        return () if coherence.joint >= 0.5 else ("groups",)
    if coherence.narrow >= 0.5:
        return ("packet",)
    return ("groups",) if guess == "wavefront" else ("wavefront",)


@device
def _largest_difference(p, q):
    return max(abs(p[0] - q[0]), abs(p[1] - q[1]), abs(p[2] - q[2]))


@kernel
def _look(packet_count, source, order, frame, closeness):
    """Count sampled groups, and those of them that are narrow, near, close and joint."""
    groups, narrow, near, close, joint = 0, 0, 0, 0, 0
    size = max(
        frame.high[0] - frame.low[0], frame.high[1] - frame.low[1], frame.high[2] - frame.low[2]
    )
    for sample in range(_SAMPLES):
        # Spread over the batch and over the rows of a tile.
        number = np.uint64(sample * packet_count // _SAMPLES)
        first, count = group_rows(order, number, np.uint64(sample) % GROUPS)
        if count < np.uint64(2):
            first, count = group_rows(order, number, np.uint64(0))
        if count < np.uint64(2):
            continue
        a = load_ray(source, first, frame)
        bend, way = np.float32(0.0), np.float32(0.0)
        for i in range(first + ONE_U64, first + count):
            b = load_ray(source, i, frame)
            bend = max(bend, _largest_difference(a.direction, b.direction))
            way = max(way, _largest_difference(a.origin, b.origin))
        groups += 1
        narrow += bend <= _NARROW
        near += way <= _NEAR * size
        close += way <= closeness * size
        joint += way == np.float32(0.0)
    return groups, narrow, near, close, joint
