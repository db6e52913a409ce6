"""The rays of a stream: records that are filled from the batch and emptied to results.

A ray has two records. What nodes want is one cache line; what only leaves and results want is
half of another, elsewhere.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import (
    bits_as_float,
    f32x16,
    i32x16,
    load,
    select,
    store,
    store_records,
)
from raystream.kernels.local_ray import world_t
from raystream.structures.bvh.packet_load import load_rays
from raystream.structures.bvh.packet_rays import (
    GROUP_BYTES,
    NO_PRIM,
    Group,
    GroupLanes,
)
from raystream.structures.bvh.packet_rays import three as vectors
from raystream.structures.bvh.ray_order import (
    COPIES_BYTES,
    copy_sixteen,
    load_copies,
    number_at,
    write_row,
)

__all__ = [
    "COLD",
    "COLD_DIRECTION",
    "COLD_PRIM",
    "COLD_SY",
    "COLD_U",
    "COLD_V",
    "FILL_BYTES",
    "HOT",
    "HOT_AXES",
    "HOT_FAR",
    "HOT_INV",
    "HOT_NEAR",
    "HOT_ORIGIN",
    "HOT_SX",
    "HOT_T",
    "HOT_T_MIN",
    "STREAM_BYTES",
    "STREAM_RAYS",
    "StreamRays",
    "axis_offsets",
    "fill",
    "stream_rays",
    "three",
    "write_results",
]

#: Most rays of a stream. Twice or four times as many are traced 0.9 to 1.1 times as fast.
STREAM_RAYS = 1024

#: Bytes of a hot and of a cold record.
HOT = np.uint64(64)
COLD = np.uint64(32)

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
COLD_DIRECTION = np.uint64(0)  # in the order of the frame
COLD_SY = np.uint64(12)
COLD_FACTOR = np.uint64(16)
COLD_U = np.uint64(20)
COLD_V = np.uint64(24)
COLD_PRIM = np.uint64(28)

# Behind the records: factor and offset in float64, for groups with a ray that took the long
# way; and whether a group has one.
_LONG = np.uint64(16)
_COLD_AT = np.uint64(STREAM_RAYS * 64)
_LONG_AT = np.uint64(STREAM_RAYS * (64 + 32))
_FLAGS_AT = np.uint64(STREAM_RAYS * (64 + 32 + 16))

#: Bytes of all that belongs to the rays of a stream.
STREAM_BYTES = STREAM_RAYS * (64 + 32 + 16) + STREAM_RAYS // 16 + 64

# The scratch of `fill`: a group, then the statuses and the copies of its rays.
_FOUND = np.uint64(GROUP_BYTES)
_COPIES = np.uint64(GROUP_BYTES + 64)
FILL_BYTES = GROUP_BYTES + 64 + COPIES_BYTES

_Y = np.uint64(4)
_Z = np.uint64(8)
_WORD = np.uint64(8)
_U0 = np.uint64(0)
_LANES = np.uint64(16)
_ZERO = np.float32(0.0)
_INF = np.float32(np.inf)
_MISS = np.int32(-1)
_BYTE = np.uint64(255)


def _packed(kx: int, ky: int, kz: int) -> np.int32:
    """Where a leaf block has the coordinates of a frame's axes, for `axis_offsets`."""
    return np.int32(16 * (kx | ky << 8 | kz << 16))


_AXES_X = _packed(1, 2, 0)
_AXES_Y = _packed(2, 0, 1)
_AXES_Z = _packed(0, 1, 2)


class StreamRays(NamedTuple):
    """Where the rays of a stream are.

    Attributes
    ----------
    hot, cold, long, flags : uint64
        Addresses: of the records, and of what the long way leaves.
    """

    hot: np.uint64
    cold: np.uint64
    long: np.uint64
    flags: np.uint64


@device
def stream_rays(memory):
    """The parts of `STREAM_BYTES` of memory."""
    return StreamRays(memory, memory + _COLD_AT, memory + _LONG_AT, memory + _FLAGS_AT)


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
def _in_frame(is_y, is_z, x, y, z):
    """Coordinates in the order of the frames, whose last axis is y, z or else x."""
    return (
        select(is_z, x, select(is_y, z, y)),
        select(is_z, y, select(is_y, x, z)),
        select(is_z, z, select(is_y, y, x)),
    )


@device
def _write_records(hot, cold, group):
    """Turn a prepared group into 16 records."""
    kinds = group.kind & np.int32(3)
    is_y, is_z = kinds == np.int32(1), kinds == np.int32(2)
    ox, oy, oz = vectors(group.origin)
    dx, dy, dz = vectors(group.direction)
    sx, sy, _ = vectors(group.shear)
    axes = select(is_z, i32x16(_AXES_Z), select(is_y, i32x16(_AXES_Y), i32x16(_AXES_X)))
    slabs = vectors(group.inv) + vectors(group.near) + vectors(group.far)
    limits = group.t_min, group.t
    origin = _in_frame(is_y, is_z, ox, oy, oz)
    store_records(hot, slabs + limits + origin + (bits_as_float(axes), sx))
    zero = f32x16(_ZERO)
    result = group.factor, zero, zero, bits_as_float(i32x16(NO_PRIM))
    store_records(cold, _in_frame(is_y, is_z, dx, dy, dz) + (sy,) + result)


@device
def fill(stream, source, rays, place, count, frame, memory, status):
    """Load sorted rays into a stream.

    Parameters
    ----------
    stream : StreamRays
    source : RaySource
    rays : SortedRays
    place : uint64
        Of the first one.
    count : uint64
    frame : SceneFrame
    memory : uint64
        Scratch of `FILL_BYTES`.
    status : uint64
        Address of the batch's statuses; written for invalid rays only.
    """
    found = memory + _FOUND
    group, lanes = Group(memory), GroupLanes(memory)
    is_double = source.origins_are_double or source.directions_are_double
    for j in range(_U0, count, _LANES):
        store(found, _U0)
        store(found + _WORD, _U0)
        copied = copy_sixteen(memory + _COPIES, source, rays, place + j, count - j)
        sixteen, t_min, t_max = load_copies(memory + _COPIES, is_double)
        is_long = load_rays(group, sixteen, t_min, t_max, copied, frame, found)
        _write_records(stream.hot + j * HOT, stream.cold + j * COLD, group)
        store(stream.flags + j // _LANES, np.uint8(is_long))
        if is_long:
            for k in range(min(_LANES, count - j)):
                to = stream.long + (j + k) * _LONG
                store(to, lanes.long_factor[k])
                store(to + _WORD, lanes.long_offset[k])
                kind = load(np.uint8, found + k)
                if kind != np.uint8(0):
                    store(status + rays.first + number_at(rays, place + j + k), kind)


@device
def write_results(stream, rays, place, count, wants_any, out):
    """Write the results of a stream's rays.

    Parameters
    ----------
    stream, rays, place, count
        See `fill`.
    wants_any : bool
    out : ResultAddresses
    """
    for j in range(count):
        number = number_at(rays, place + j)
        cold = stream.cold + j * COLD
        prim_id = load(np.int32, cold + COLD_PRIM)
        if wants_any:
            store(out.seen + rays.first + number, np.uint8(prim_id != NO_PRIM))
            continue
        factor, offset = np.float64(load(np.float32, cold + COLD_FACTOR)), np.float64(0.0)
        if load(np.uint8, stream.flags + j // _LANES) != np.uint8(0):
            factor = load(np.float64, stream.long + j * _LONG)
            offset = load(np.float64, stream.long + j * _LONG + _WORD)
        t = world_t(load(np.float32, stream.hot + j * HOT + HOT_T), factor, offset)
        is_miss = prim_id == NO_PRIM
        write_row(
            rays,
            number,
            _INF if is_miss else t,
            load(np.float32, cold + COLD_U),
            load(np.float32, cold + COLD_V),
            _MISS if is_miss else prim_id,
        )
