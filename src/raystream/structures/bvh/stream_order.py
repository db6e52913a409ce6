"""Sort rays for streams: by octant, then by the cell of their origin.

Rays with near origins and similar directions visit the same nodes. They are sorted by a key of 12
bits, the octant of the direction and a cell of 8 x 8 x 8 in the scene's bounds, by counting: the
counts of all keys give each key's place, then the rays' indices are scattered. The rays themselves
are copied when they join a stream, and prefetched long before.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.cpu import device, kernel
from raystream.jit.simd import (
    bits_as_float,
    f32x16,
    f64x16,
    float_as_bits,
    i32x16,
    load,
    load_records,
    maximum,
    minimum,
    narrow,
    prefetch,
    scratch,
    store,
    widen,
)
from raystream.jit.views import view
from raystream.kernels.ray_source import RaySource
from raystream.structures.bvh.node_layout import LANE
from raystream.structures.bvh.packet_load import load_directions, load_origins

__all__ = [
    "COPIES_BYTES",
    "COUNT_BYTES",
    "SORTED_CHUNK",
    "SortedRays",
    "copies_at",
    "copy_sixteen",
    "count_keys",
    "load_copies",
    "number_at",
    "place_keys",
    "place_rays",
    "write_row",
]

#: Different keys.
KEY_COUNT = 8 * 512

#: Rays per chunk: enough to be worth counters for `KEY_COUNT` keys.
SORTED_CHUNK = 16384

_U0 = np.uint64(0)
_U1 = np.uint64(1)
_LANES = np.uint64(16)
_WIDE = np.uint64(8)
_ZERO = np.float32(0.0)
_LAST_CELL = np.float32(7.5)
_KEYS = np.uint64(KEY_COUNT)
_CHUNK = np.uint64(SORTED_CHUNK)
#: Bytes of a chunk's counts: not a power of two, which caches dislike.
COUNT_BYTES = 4 * KEY_COUNT + 64
_ROW = np.uint64(COUNT_BYTES)

#: A nearest hit.
_Row = view([("t", "f4"), ("u", "f4"), ("v", "f4"), ("prim_id", "i4")])

# A record: origin, direction, t_min, t_max; the limits in float32.
_SHORT = np.uint64(32)
_LONG = np.uint64(64)
#: Bytes of the copies of 16 rays.
COPIES_BYTES = 16 * 64

#: Prefetch distance, in rays.
_DISTANCE = np.uint64(32)

_THREE = np.uint64(3)
_SIX = np.uint64(6)
_LOW_BITS = np.int64(2**32 - 1)


class SortedRays(NamedTuple):
    """Some rays of a batch in another order.

    Attributes
    ----------
    first, ray_count : uint64
        The range of the batch that is sorted: index 0 is its ray `first`.
    numbers : uint64
        Address of the sorted indices, uint32.
    octant_ends : uint64
        Address of eight uint64: the end of each octant in the sorted order.
    rows : uint64
        Address of a row (t, u, v, prim_id) per index, for nearest hits.
    """

    first: np.uint64
    ray_count: np.uint64
    numbers: np.uint64
    octant_ends: np.uint64
    rows: np.uint64


@device
def number_at(rays, place):
    """The index of the ray at a place of the sorted order."""
    return np.uint64(load(np.uint32, rays.numbers + place * LANE))


@device
def write_row(rays, number, t, u, v, prim_id):
    """Write the nearest hit of a ray, or a miss, to its row."""
    row = _Row(rays.rows, number)
    row.t, row.u, row.v, row.prim_id = t, u, v, prim_id


@device
def _cell(x, low, high):
    """Cell along an axis, 0 to 7."""
    extent = high - low
    scale = np.float32(8.0) / extent if extent > _ZERO else _ZERO
    # In this order NaN becomes 0.
    inside = minimum(maximum((x - low) * scale, f32x16(_ZERO)), f32x16(_LAST_CELL))
    return i32x16(inside)


@device
def _spread(cell):
    """Spread the three bits of a cell's index for a Morton code."""
    two, four = np.int32(2), np.int32(4)
    return (cell & np.int32(1)) | ((cell & two) << two) | ((cell & four) << four)


@device
def _keys_of(rays, frame):
    """Sort keys of 16 rays: origins and directions in float64, world space."""
    ox, oy, oz, dx, dy, dz = rays
    x = narrow((ox - frame.center[0]) * frame.scale)
    y = narrow((oy - frame.center[1]) * frame.scale)
    z = narrow((oz - frame.center[2]) * frame.scale)
    cell = (
        _spread(_cell(x, frame.low[0], frame.high[0]))
        | (_spread(_cell(y, frame.low[1], frame.high[1])) << np.int32(1))
        | (_spread(_cell(z, frame.low[2], frame.high[2])) << np.int32(2))
    )
    sign = np.int64(63)
    octant = (
        ((float_as_bits(dx) >> sign) & np.int64(512))
        | ((float_as_bits(dy) >> sign) & np.int64(1024))
        | ((float_as_bits(dz) >> sign) & np.int64(2048))
    )
    return i32x16(octant) | cell


@device
def _copy_number(to, to_double, source, is_double):
    if to_double:
        if is_double:
            store(to, load(np.float64, source))
        else:
            store(to, np.float64(load(np.float32, source)))
    else:
        store(to, load(np.float32, source))


@device
def _copy_ray(to, source, ray):
    """Copy a ray to a record, in float64 if the origin or the direction is."""
    is_double = source.origins_are_double or source.directions_are_double
    size = _WIDE if is_double else LANE
    origin = source.origins + ray * source.origin_step
    origin_size = _WIDE if source.origins_are_double else LANE
    direction = source.directions + ray * source.direction_step
    direction_size = _WIDE if source.directions_are_double else LANE
    for axis in range(_THREE):
        at = axis * origin_size
        _copy_number(to + axis * size, is_double, origin + at, source.origins_are_double)
        at = axis * direction_size
        _copy_number(
            to + (axis + _THREE) * size,
            is_double,
            direction + at,
            source.directions_are_double,
        )
    limits = to + _SIX * size
    store(limits, load(np.float32, source.t_min + ray * source.t_min_step))
    store(limits + LANE, load(np.float32, source.t_max + ray * source.t_max_step))


@device
def copies_at(records, is_double):
    """The `RaySource` of copied rays."""
    step = _LONG if is_double else _SHORT
    size = _WIDE if is_double else LANE
    directions = records + _THREE * size
    limits = records + _SIX * size
    return RaySource(
        records, step, is_double, directions, step, is_double, limits, step, limits + LANE, step
    )


@device
def copy_sixteen(copies, source, rays, place, count):
    """Copy 16 sorted rays side by side, and prefetch later ones.

    Parameters
    ----------
    copies : uint64
        Address of `COPIES_BYTES`.
    source : RaySource
    rays : SortedRays
    place : uint64
        Of the first one.
    count : uint64
        If there are fewer, the last one is repeated.

    Returns
    -------
    RaySource
        Of the copies.
    """
    copied = copies_at(copies, source.origins_are_double or source.directions_are_double)
    for k in range(_LANES):
        later = rays.first + number_at(rays, min(place + k + _DISTANCE, rays.ray_count - _U1))
        prefetch(source.origins + later * source.origin_step)
        prefetch(source.directions + later * source.direction_step)
        ray = rays.first + number_at(rays, place + min(k, count - _U1))
        _copy_ray(copies + k * copied.origin_step, source, ray)
    return copied


@device
def load_copies(records, is_double):
    """Read 16 copies of rays.

    Returns
    -------
    rays : tuple of six f64x16
        Origins and directions, world space.
    t_min, t_max : f32x16
    """
    if is_double:
        ox, oy, oz, dx, dy, dz, limits, _ = load_records(f64x16, 8, records)
        bits = float_as_bits(limits)
        t_min, t_max = _as_f32(bits & _LOW_BITS), _as_f32(bits >> np.int64(32))
    else:
        x, y, z, to_x, to_y, to_z, t_min, t_max = load_records(f32x16, 8, records)
        ox, oy, oz = widen(x), widen(y), widen(z)
        dx, dy, dz = widen(to_x), widen(to_y), widen(to_z)
    return (ox, oy, oz, dx, dy, dz), t_min, t_max


@device
def _as_f32(bits):
    return bits_as_float(i32x16(bits))


@kernel
def count_keys(begin, end, first, count, source, frame, keys, counts):
    """Compute the keys of the rays of some chunks, and count each chunk's rays by key.

    Parameters
    ----------
    begin, end : int
        Chunks of `SORTED_CHUNK` rays.
    first, count : int
        The rays of the batch that are sorted.
    source : RaySource
        Packed.
    frame : SceneFrame
    keys : int
        Address of a uint16 for each ray, and 16 more: written.
    counts : int
        Address of `COUNT_BYTES` for each chunk: written.
    """
    one = np.uint32(1)
    sixteen = scratch(64)
    few = scratch(COPIES_BYTES)
    is_double = source.origins_are_double or source.directions_are_double
    size = _LONG if is_double else _SHORT
    for chunk in range(np.uint64(begin), np.uint64(end)):
        row = counts + chunk * _ROW
        for k in range(_KEYS):
            store(row + k * LANE, np.uint32(0))
        at = chunk * _CHUNK
        chunk_end = min(at + _CHUNK, np.uint64(count))
        while at < chunk_end:
            left = min(chunk_end - at, _LANES)
            ray = np.uint64(first) + at
            if left == _LANES:
                rays = load_origins(source, ray) + load_directions(source, ray)
            else:
                # Do not read behind the last ray.
                for k in range(_LANES):
                    _copy_ray(few + k * size, source, ray + min(k, left - _U1))
                rays, _, _ = load_copies(few, is_double)
            store(sixteen, _keys_of(rays, frame))
            for k in range(left):
                key = np.uint64(load(np.uint32, sixteen + k * LANE))
                store(keys + (at + k + at + k), np.uint16(key))
                place = row + key * LANE
                store(place, np.uint32(load(np.uint32, place) + one))
            at += left


@kernel
def place_keys(chunk_count, counts, octant_ends):
    """Prefix sum: replace the counts of all chunks by the places of their first rays.

    Parameters
    ----------
    chunk_count : int
    counts : int
        See `count_keys`.
    octant_ends : int
        Address of eight uint64: written, the end of each octant.
    """
    place = _U0
    per_octant = _KEYS // _WIDE
    for key in range(_KEYS):
        for chunk in range(np.uint64(chunk_count)):
            at = counts + chunk * _ROW + key * LANE
            count = np.uint64(load(np.uint32, at))
            store(at, np.uint32(place))
            place += count
        if (key + _U1) % per_octant == _U0:
            store(octant_ends + key // per_octant * _WIDE, place)


@kernel
def place_rays(begin, end, count, keys, counts, numbers):
    """Scatter the indices of the rays of some chunks to their places.

    Parameters
    ----------
    begin, end, count, keys, counts
        See `count_keys`; the counts are overwritten.
    numbers : int
        Address of a uint32 per ray: written, the index relative to the first.
    """
    one = np.uint32(1)
    for chunk in range(np.uint64(begin), np.uint64(end)):
        row = counts + chunk * _ROW
        for i in range(chunk * _CHUNK, min((chunk + _U1) * _CHUNK, np.uint64(count))):
            at = row + np.uint64(load(np.uint16, keys + i + i)) * LANE
            place = load(np.uint32, at)
            store(at, np.uint32(place + one))
            store(numbers + np.uint64(place) * LANE, np.uint32(i))
