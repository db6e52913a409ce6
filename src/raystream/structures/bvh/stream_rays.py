"""The rays of a stream: records that are filled from the batch, and written to results.

A ray has two records: a cache line with what nodes need, and half of one with what only leaves and
results need.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import bits_as_float, f32x16, i32x16, load, select, store, store_records
from raystream.jit.views import address_of, view
from raystream.kernels.ray import world_t
from raystream.structures.bvh.packet_load import load_rays
from raystream.structures.bvh.packet_rays import GROUP, NO_PRIM, GroupLanes
from raystream.structures.bvh.packet_rays import three as vectors
from raystream.structures.bvh.stream_order import (
    COPIES_BYTES,
    copy_sixteen,
    load_copies,
    number_at,
    write_row,
)

__all__ = [
    "FILL_BYTES",
    "STREAM_BYTES",
    "STREAM_RAYS",
    "Cold",
    "Fill",
    "Hot",
    "StreamRays",
    "fill",
    "stream_rays",
    "write_results",
]

#: Most rays of a stream. Twice or four times as many: 0.9 to 1.1 times as fast.
STREAM_RAYS = 1024

#: A ray for nodes. Axes are in world order, except for the origin's, which are the frame's.
_HOT = np.dtype(
    [
        ("inv", "f4", 3),
        ("near", "f4", 3),
        ("far", "f4", 3),
        ("t_min", "f4"),
        ("t", "f4"),
        ("origin", "f4", 3),
        ("axes", "u1", 3),  # kx, ky, kz
        ("unused", "u1"),
        ("sx", "f4"),
    ]
)
Hot = view(_HOT)

#: The rest of it, for leaves and results.
_COLD = np.dtype(
    [
        ("direction", "f4", 3),  # in the order of the frame
        ("sy", "f4"),
        ("t_scale", "f4"),
        ("u", "f4"),
        ("v", "f4"),
        ("prim_id", "i4"),
    ]
)
Cold = view(_COLD)

#: Valid in groups with a ray that took the slow path.
_SLOW = np.dtype([("t_scale", "f8"), ("t_offset", "f8")])
_Slow = view(_SLOW)

_HOT_BYTES = np.uint64(_HOT.itemsize)
_COLD_BYTES = np.uint64(_COLD.itemsize)
_COLD_AT = np.uint64(STREAM_RAYS * _HOT.itemsize)
_SLOW_AT = np.uint64(STREAM_RAYS * (_HOT.itemsize + _COLD.itemsize))
_FLAGS_AT = np.uint64(STREAM_RAYS * (_HOT.itemsize + _COLD.itemsize + _SLOW.itemsize))

#: Bytes of the rays of a stream.
STREAM_BYTES = int(_FLAGS_AT) + STREAM_RAYS // 16 + 64

#: The scratch of `fill`: a group, the statuses and the copies of its rays.
_FILL = np.dtype(
    [
        ("group", GROUP),
        ("status", "u8", (2, 1)),
        ("unused", "V48"),
        ("copies", "u1", (COPIES_BYTES, 1)),
    ]
)
Fill = view(_FILL)
FILL_BYTES = _FILL.itemsize

_U0, _U1 = np.uint64(0), np.uint64(1)
_LANES = np.uint64(16)
_ZERO = np.float32(0.0)
_INF = np.float32(np.inf)
_MISS = np.int32(-1)


def _packed(kx: int, ky: int, kz: int) -> np.int32:
    """The four bytes of `Hot.axes` and what follows it."""
    return np.int32(kx | ky << 8 | kz << 16)


_AXES_X = _packed(1, 2, 0)
_AXES_Y = _packed(2, 0, 1)
_AXES_Z = _packed(0, 1, 2)


class StreamRays(NamedTuple):
    """The rays of a stream in memory.

    Attributes
    ----------
    hot, cold, slow, flags : uint64
        Addresses: of the records, of the slow path's t transforms, and of a uint8 per group, which
        is 1 if a ray of it took the slow path.
    """

    hot: np.uint64
    cold: np.uint64
    slow: np.uint64
    flags: np.uint64


@device
def stream_rays(memory):
    """The `StreamRays` in `STREAM_BYTES` of memory."""
    return StreamRays(memory, memory + _COLD_AT, memory + _SLOW_AT, memory + _FLAGS_AT)


@device
def _in_frame(is_y, is_z, x, y, z):
    """Coordinates in the order of the frames, whose last axis is y, z or x."""
    return (
        select(is_z, x, select(is_y, z, y)),
        select(is_z, y, select(is_y, x, z)),
        select(is_z, z, select(is_y, y, x)),
    )


@device
def _write_records(hot, cold, group):
    """Write a prepared group as 16 records."""
    kinds = group.direction_class & np.int32(3)
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
    result = group.t_scale, zero, zero, bits_as_float(i32x16(NO_PRIM))
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
    memory : Fill
        Scratch.
    status : uint64
        Address of the batch's statuses; written for invalid rays only.
    """
    group, found, copies = memory.group, address_of(memory.status), address_of(memory.copies)
    lanes = GroupLanes(address_of(group))
    is_double = source.origins_are_double or source.directions_are_double
    for j in range(_U0, count, _LANES):
        memory.status[_U0], memory.status[_U1] = _U0, _U0
        copied = copy_sixteen(copies, source, rays, place + j, count - j)
        sixteen, t_min, t_max = load_copies(copies, is_double)
        is_slow = load_rays(group, sixteen, t_min, t_max, copied, frame, found)
        _write_records(stream.hot + j * _HOT_BYTES, stream.cold + j * _COLD_BYTES, group)
        store(stream.flags + j // _LANES, np.uint8(is_slow))
        if is_slow:
            for k in range(min(_LANES, count - j)):
                slow = _Slow(stream.slow, j + k)
                slow.t_scale, slow.t_offset = lanes.slow_t_scale[k], lanes.slow_t_offset[k]
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
        cold = Cold(stream.cold, j)
        if wants_any:
            store(out.seen + rays.first + number, np.uint8(cold.prim_id != NO_PRIM))
            continue
        t_scale, t_offset = np.float64(cold.t_scale), np.float64(0.0)
        if load(np.uint8, stream.flags + j // _LANES) != np.uint8(0):
            slow = _Slow(stream.slow, j)
            t_scale, t_offset = slow.t_scale, slow.t_offset
        t = world_t(Hot(stream.hot, j).t, t_scale, t_offset)
        if cold.prim_id == NO_PRIM:
            write_row(rays, number, _INF, cold.u, cold.v, _MISS)
        else:
            write_row(rays, number, t, cold.u, cold.v, cold.prim_id)
