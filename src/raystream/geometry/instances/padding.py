"""Packets of rays from far away, for which boxes are padded, and with directions of any length."""

from __future__ import annotations

import numpy as np

from raystream.core.rays import INVALID
from raystream.geometry.instances.traversal import MOST_FAR, is_scalable
from raystream.jit.constants import INF_F32
from raystream.jit.cpu import device, device_call
from raystream.jit.intrinsics import no_inline
from raystream.jit.simd import store
from raystream.kernels.ray import SceneFrame
from raystream.kernels.ray_source import load_direction, load_origin
from raystream.structures.bvh.packets.rays import GROUPS, NO_CLASS, PacketSource, group_rows


@device
def padded_source(source, top, first, last):
    """The source with a frame whose boxes are padded for the rays of some packets.

    Parameters
    ----------
    source : PacketSource
    top : TopAddresses
    first, last : uint64
        The packets, to before the last.

    Returns
    -------
    PacketSource
    """
    reach = _reach(source, first, last)
    far = np.float32(min(top.far_unit * (reach * source.frame.scale), MOST_FAR))
    return _padded(source, far)


@device
def _reach(source, first, last):
    """The largest coordinate of the origins of some packets."""
    reach = np.float64(0.0)
    for packet in range(first, last):
        for row in range(GROUPS):
            ray, length = group_rows(source.order, packet, row)
            for i in range(ray, ray + length):
                x, y, z = load_origin(source.rays, i)
                farthest = max(abs(x), abs(y), abs(z))
                if farthest > reach and farthest < np.inf:
                    reach = farthest
    return reach


@device
def _padded(source, far):
    """The source with a frame whose boxes are padded more."""
    frame = source.frame
    grown = SceneFrame(
        frame.center,
        frame.scale,
        frame.inverse_scale,
        frame.low,
        frame.high,
        np.float32(frame.max_coordinate + far),
    )
    return PacketSource(source.rays, source.order, grown, source.status)


@device_call
def drop_invalid(lanes, first, count, source):
    """Make the rays of a group invalid whose directions are too long or too short.

    Parameters
    ----------
    lanes : GroupLanes
        With a ray that took the slow path: only these may be.
    first, count : uint64
        Its rays.
    source : PacketSource
    """
    no_inline()
    for k in range(count):
        if not is_scalable(load_direction(source.rays, first + k)):
            store(source.status + first + k, INVALID)
            lanes.t[k], lanes.t_min[k], lanes.direction_class[k] = -INF_F32, INF_F32, NO_CLASS
