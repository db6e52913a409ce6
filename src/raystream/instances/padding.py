"""Padding of the boxes of instances for packets of rays that begin far away."""

from __future__ import annotations

import numpy as np

from raystream.instances.traversal import MOST_FAR
from raystream.jit.cpu import device
from raystream.kernels.ray import SceneFrame
from raystream.kernels.ray_source import load_origin
from raystream.structures.bvh.packet_rays import GROUPS, PacketSource, group_rows


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
