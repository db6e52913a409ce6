"""The rays of a stream: bins of rays of one octant, filled from the batch, emptied to the results.

A ray has two records. What nodes want is one cache line; what only leaves and results want is
another, elsewhere.
"""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import load, store
from raystream.kernels.local_ray import world_t
from raystream.structures.bvh.packet_rays import (
    ARRAY,
    DIRECTION,
    FACTOR,
    FAR,
    INV,
    LONG_FACTOR,
    LONG_OFFSET,
    NEAR,
    NO_PRIM,
    ORIGIN,
    SHEAR,
    T_MIN,
    T,
)

__all__ = [
    "RECORD",
    "STREAM_RAYS",
    "add_ray",
    "axis_offsets",
    "three",
    "write_miss",
    "write_ray",
]

#: Most rays of a stream: their hot records fill a first-level cache, and half of them or twice
#: as many are slower by a tenth.
STREAM_RAYS = 1024

#: Bytes of each of a ray's two records.
RECORD = np.uint64(64)

# The hot record. Axes in world order, but for the origin.
HOT_INV = np.uint64(0)
HOT_NEAR = np.uint64(12)
HOT_FAR = np.uint64(24)
HOT_T_MIN = np.uint64(36)
HOT_T = np.uint64(40)
HOT_ORIGIN = np.uint64(44)
HOT_AXES = np.uint64(56)
HOT_SX = np.uint64(60)

# The cold record.
COLD_SY = np.uint64(0)
COLD_DIRECTION = np.uint64(48)  # in the order of the frame
COLD_PRIM = np.uint64(8)
COLD_U = np.uint64(12)
COLD_V = np.uint64(16)
COLD_RAY = np.uint64(24)
COLD_FACTOR = np.uint64(32)
COLD_OFFSET = np.uint64(40)

_Y = np.uint64(4)
_Z = np.uint64(8)
_LANE = np.uint64(4)
_U0 = np.uint64(0)
_U1 = np.uint64(1)
_U2 = np.uint64(2)
_ZERO = np.float32(0.0)
_INF = np.float32(np.inf)
_MISS = np.int32(-1)
_BYTE = np.uint64(255)


@device
def axis_offsets(packed):
    """Where in a leaf block the coordinates of a frame's axes are, from a ray's `HOT_AXES`."""
    axes = np.uint64(packed)
    return axes & _BYTE, (axes >> np.uint64(8)) & _BYTE, axes >> np.uint64(16)


@device
def three(record):
    """Three adjacent numbers."""
    return (
        load(np.float32, record),
        load(np.float32, record + _Y),
        load(np.float32, record + _Z),
    )


@device
def _copy_three(to, source):
    store(to, load(np.float32, source))
    store(to + _Y, load(np.float32, source + ARRAY))
    store(to + _Z, load(np.float32, source + ARRAY + ARRAY))


@device
def add_ray(hot, cold, group, lane, kind, is_long, ray):
    """Copy a prepared ray of a group into a stream.

    Parameters
    ----------
    hot, cold : uint64
        Addresses of its records.
    group : uint64
        Address of a group, see `packet_rays`.
    lane : uint64
    kind : int32
        The ray's class.
    is_long : bool
        Whether the group has rays that took the long way.
    ray : uint64
        Its number in the batch.
    """
    at = group + lane * _LANE
    kz = np.uint64(kind & np.int32(3))
    kx = kz + _U1 if kz < _U2 else _U0
    ky = kx + _U1 if kx < _U2 else _U0
    _copy_three(hot + HOT_INV, at + INV)
    _copy_three(hot + HOT_NEAR, at + NEAR)
    _copy_three(hot + HOT_FAR, at + FAR)
    store(hot + HOT_T_MIN, load(np.float32, at + T_MIN))
    store(hot + HOT_T, load(np.float32, at + T))
    store(hot + HOT_ORIGIN, load(np.float32, at + ORIGIN + kx * ARRAY))
    store(hot + (HOT_ORIGIN + _Y), load(np.float32, at + ORIGIN + ky * ARRAY))
    store(hot + (HOT_ORIGIN + _Z), load(np.float32, at + ORIGIN + kz * ARRAY))
    axes = (kx | (ky << np.uint64(8)) | (kz << np.uint64(16))) << np.uint64(4)
    store(hot + HOT_AXES, np.uint32(axes))
    store(hot + HOT_SX, load(np.float32, at + SHEAR))
    store(cold + COLD_SY, load(np.float32, at + SHEAR + ARRAY))
    store(cold + COLD_DIRECTION, load(np.float32, at + DIRECTION + kx * ARRAY))
    store(cold + (COLD_DIRECTION + _Y), load(np.float32, at + DIRECTION + ky * ARRAY))
    store(cold + (COLD_DIRECTION + _Z), load(np.float32, at + DIRECTION + kz * ARRAY))
    store(cold + COLD_PRIM, NO_PRIM)
    store(cold + COLD_U, _ZERO)
    store(cold + COLD_V, _ZERO)
    store(cold + COLD_RAY, ray)
    if is_long:
        wide = lane * np.uint64(8)
        store(cold + COLD_FACTOR, load(np.float64, group + LONG_FACTOR + wide))
        store(cold + COLD_OFFSET, load(np.float64, group + LONG_FACTOR + LONG_OFFSET + wide))
    else:
        store(cold + COLD_FACTOR, np.float64(load(np.float32, at + FACTOR)))
        store(cold + COLD_OFFSET, np.float64(0.0))


@device
def write_miss(ray, wants_any, out):
    """Write that a ray hits nothing."""
    if wants_any:
        store(out.seen + ray, np.uint8(0))
        return
    at = ray * _LANE
    store(out.t + at, _INF)
    store(out.u + at, _ZERO)
    store(out.v + at, _ZERO)
    store(out.prim_id + at, _MISS)


@device
def write_ray(hot, cold, wants_any, out):
    """Write the result of a ray of a stream."""
    ray = load(np.uint64, cold + COLD_RAY)
    prim_id = load(np.int32, cold + COLD_PRIM)
    if wants_any:
        store(out.seen + ray, np.uint8(prim_id != NO_PRIM))
        return
    if prim_id == NO_PRIM:
        write_miss(ray, False, out)
        return
    at = ray * _LANE
    factor, offset = load(np.float64, cold + COLD_FACTOR), load(np.float64, cold + COLD_OFFSET)
    store(out.t + at, world_t(load(np.float32, hot + HOT_T), factor, offset))
    store(out.u + at, load(np.float32, cold + COLD_U))
    store(out.v + at, load(np.float32, cold + COLD_V))
    store(out.prim_id + at, prim_id)
