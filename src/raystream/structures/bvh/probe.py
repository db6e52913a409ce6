"""A look at some rays of a batch: which kernel suits them."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from raystream.jit.cpu import kernel
from raystream.kernels.local_ray import SceneFrame
from raystream.kernels.ray_source import RaySource, load_ray
from raystream.structures.bvh.packet_rays import GROUPS, PacketOrder, group_rows

__all__ = ["Coherence", "choose", "probe"]

#: Groups of 16 rays that are looked at: some ten microseconds, for any batch.
_SAMPLES = 24

#: A group whose directions differ by less than this fraction of their length is narrow: a
#: packet of it enters few boxes that not all of its rays enter.
_NARROW = np.float32(0.25)

#: A group whose origins differ by less than this fraction of the scene's size starts near.
_NEAR = np.float32(0.1)

#: Trees up to this size mostly stay in a second-level cache, where a stream's lists pay for
#: themselves even if its rays start anywhere; beyond, hiding the memory's latency pays more.
_CACHED_BYTES = 6 << 20

_U1 = np.uint64(1)


class Coherence(NamedTuple):
    """What a sample of groups of 16 rays has in common.

    Attributes
    ----------
    narrow : float
        Share of the groups with nearly the same direction.
    near : float
        Share of the groups that start nearly at the same place.
    """

    narrow: float
    near: float


def probe(source: RaySource, order: PacketOrder, packet_count: int, frame: SceneFrame) -> Coherence:
    """Look at some rays of a batch.

    Parameters
    ----------
    source : RaySource
    order : PacketOrder
    packet_count : int
        At least 1.
    frame : SceneFrame
    """
    groups, narrow, near = _look(packet_count, source, order, frame)
    return Coherence(narrow / max(groups, 1), near / max(groups, 1))


def choose(coherence: Coherence, byte_count: int) -> Literal["packet", "stream", "wavefront"]:
    """The kernel for rays of a coherence.

    Parameters
    ----------
    coherence : Coherence
    byte_count : int
        Size of the tree.
    """
    if coherence.narrow >= 0.5 and coherence.near >= 0.5:
        return "packet"
    if coherence.near >= 0.5 or byte_count <= _CACHED_BYTES:
        return "stream"
    return "wavefront"


@kernel
def _look(packet_count, source, order, frame):
    """Count sampled groups, and those of them that are narrow and near."""
    groups, narrow, near = 0, 0, 0
    size = max(
        frame.high[0] - frame.low[0], frame.high[1] - frame.low[1], frame.high[2] - frame.low[2]
    )
    for sample in range(_SAMPLES):
        # Spread over the batch, and over the rows of a tile.
        number = np.uint64(sample * packet_count // _SAMPLES)
        first, count = group_rows(order, number, np.uint64(sample) % GROUPS)
        if count < np.uint64(2):
            first, count = group_rows(order, number, np.uint64(0))
        if count < np.uint64(2):
            continue
        a = load_ray(source, first, frame)
        bend, way = np.float32(0.0), np.float32(0.0)
        for i in range(first + _U1, first + count):
            b = load_ray(source, i, frame)
            bend = max(bend, abs(a.dx - b.dx), abs(a.dy - b.dy), abs(a.dz - b.dz))
            way = max(way, abs(a.ox - b.ox), abs(a.oy - b.oy), abs(a.oz - b.oz))
        groups += 1
        narrow += bend <= _NARROW
        near += way <= _NEAR * size
    return groups, narrow, near
