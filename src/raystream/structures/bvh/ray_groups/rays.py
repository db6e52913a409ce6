"""The rays of a block as groups and as records, for streams of groups; see `walks.groups`."""

from __future__ import annotations

import numpy as np

from raystream.jit.constants import ONE_U64, THREE_U64, ZERO_F32, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import (
    bits_as_float,
    count_trailing_zeros,
    fma,
    i32x16,
    load,
    mask_bits,
    maximum,
    minimum,
    popcount,
    select,
    store,
    store_records,
)
from raystream.jit.views import view
from raystream.structures.bvh.layout import MAX_DEPTH
from raystream.structures.bvh.node_layout import LANE
from raystream.structures.bvh.packets.load import load_group, prefetch_group, set_slow
from raystream.structures.bvh.packets.rays import (
    GROUP,
    GROUP_BYTES,
    GROUPS,
    PACKET_RAYS,
    Group,
    GroupLanes,
    group_entry,
    group_rows,
    put_three,
    store_group,
    three,
)

#: Most rays of a block: all that descend the tree together.
BLOCK_RAYS = 8192
#: The same in packets.
BLOCK_PACKETS = BLOCK_RAYS // PACKET_RAYS
_GROUPS = BLOCK_RAYS // 16
#: An entry of a list of groups: the group's number, shifted by this, and the rays as bits.
GROUP_SHIFT = np.uint64(16)
RAY_BITS = np.uint64(0xFFFF)
LANE_SHIFT = np.uint64(4)
LAST_LANE = np.uint64(15)
_PLACE_SHIFT = np.uint64(3)

#: A ray for nodes and the signs of a leaf; the origin and the shear are in the order of its frame.
_HOT = np.dtype(
    [
        ("inv", "f4", 3),
        ("low", "f4", 3),
        ("high", "f4", 3),
        ("t_min", "f4"),
        ("t", "f4"),
        ("origin", "f4", 3),
        ("axes", "u1", 3),  # kx, ky, kz
        ("unused", "u1"),
        ("sx", "f4"),
    ]
)
Hot = view(_HOT)
#: What only leaves need: the direction in the order of the frame, and the shear's second number.
_COLD = np.dtype([("direction", "f4", 3), ("sy", "f4")])
Cold = view(_COLD)
_HOT_BYTES, _COLD_BYTES = np.uint64(_HOT.itemsize), np.uint64(_COLD.itemsize)

HOT_AT = np.uint64(_GROUPS * GROUP.itemsize)
COLD_AT = HOT_AT + np.uint64(BLOCK_RAYS * _HOT.itemsize)
FLAGS_AT = COLD_AT + np.uint64(BLOCK_RAYS * _COLD.itemsize)
#: With a filter: where each group begins in the batch, see `packets.rays.GroupPlaces`.
PLACES_AT = FLAGS_AT + np.uint64(_GROUPS + 64)
HITS_AT = PLACES_AT + np.uint64(8 * _GROUPS)
LISTS_AT = HITS_AT + np.uint64(4 * BLOCK_RAYS + 64)
MEMORY_BYTES = int(LISTS_AT) + 4 * (MAX_DEPTH + 1) * 9 * (BLOCK_RAYS + 16) + 64


def _packed(kx: int, ky: int, kz: int) -> np.int32:
    """The four bytes of `_HOT`'s axes and what follows them."""
    return np.int32(kx | ky << 8 | kz << 16)


_AXES_X = _packed(1, 2, 0)
_AXES_Y = _packed(2, 0, 1)
_AXES_Z = _packed(0, 1, 2)


@device
def in_frame(is_y, is_z, x, y, z):
    """Vectors along the world's axes in the order of the frames."""
    return (
        select(is_z, x, select(is_y, z, y)),
        select(is_z, y, select(is_y, x, z)),
        select(is_z, z, select(is_y, y, x)),
    )


@device
def axis_kinds(group):
    """The masks of the rays whose largest direction is along y, and along z."""
    kinds = group.direction_class & np.int32(3)
    return kinds == np.int32(1), kinds == np.int32(2)


@device
def arrange_group(group, memory, number):
    """Put a loaded group's numbers into the order of this kernel, and write its rays' records.

    `near` and `far` become the slab constants of the low and the high planes; origin and direction
    are put in the order of the frames.
    """
    is_y, is_z = axis_kinds(group)
    inv, near, far = group.inv, group.near, group.far
    for axis in range(THREE_U64):
        back = inv[axis] < ZERO_F32
        low, high = select(back, far[axis], near[axis]), select(back, near[axis], far[axis])
        near[axis], far[axis] = low, high
    origin = in_frame(is_y, is_z, *three(group.origin))
    direction = in_frame(is_y, is_z, *three(group.direction))
    put_three(group.origin, origin)
    put_three(group.direction, direction)
    shear_x, shear_y, _ = three(group.shear)
    axes = select(is_z, i32x16(_AXES_Z), select(is_y, i32x16(_AXES_Y), i32x16(_AXES_X)))
    slabs = three(inv) + three(near) + three(far)
    rest = (group.t_min, group.t, *origin, bits_as_float(axes), shear_x)
    store_records(memory + HOT_AT + number * _HOT_BYTES, slabs + rest)
    store_records(memory + COLD_AT + number * _COLD_BYTES, (*direction, shear_y))


@device
def load_block(memory, source, first, last, has_filter):
    """Load packets first to last; list the groups with a ray that can hit anything, at `LISTS_AT`.

    With a filter, the groups' places are written, and their distances are those of rays that took
    the slow path: see `packets.filters.PacketFilter`.

    Returns
    -------
    count, ray_count : uint64
        Groups in the list, and their rays.
    group_count : uint64
        All groups.
    """
    groups, g, count, ray_count = memory + LISTS_AT, ZERO_U64, ZERO_U64, ZERO_U64
    for packet in range(first, last):
        for row in range(GROUPS):
            prefetch_group(packet + ONE_U64, row, source)
            ray, length = group_rows(source.order, packet, row)
            if length == ZERO_U64:
                continue
            at = memory + g * GROUP_BYTES
            group, is_slow = Group(at), load_group(at, ray, length, source)
            if has_filter:
                store(memory + PLACES_AT + (g << _PLACE_SHIFT), group_entry(ray, length))
                if not is_slow:
                    set_slow(group)
            arrange_group(group, memory, g << LANE_SHIFT)
            store(memory + FLAGS_AT + g, np.uint8(is_slow))
            bits = mask_bits(group.t_min <= group.t)
            store(groups + count * LANE, np.uint32((g << GROUP_SHIFT) | bits))
            count += np.uint64(bits != ZERO_U64)
            ray_count += popcount(bits)
            g += ONE_U64
    return count, ray_count, g


@device
def store_block(memory, order, first, last, wants_any, out):
    """Write the results of packets first to last."""
    g = ZERO_U64
    for packet in range(first, last):
        for row in range(GROUPS):
            ray, length = group_rows(order, packet, row)
            if length == ZERO_U64:
                continue
            is_slow = load(np.uint8, memory + FLAGS_AT + g) != np.uint8(0)
            store_group(memory + g * GROUP_BYTES, ray, length, is_slow, wants_any, out)
            g += ONE_U64


@device
def copy_limits(memory, g, bits):
    """Copy the limits of some rays of a group to their records."""
    limits = GroupLanes(memory, g).t
    while bits != ZERO_U64:
        k = count_trailing_zeros(bits)
        bits &= bits - ONE_U64
        Hot(memory + HOT_AT, (g << LANE_SHIFT) | k).t = limits[k]


@device
def interval(corners, inv, low, high):
    """Padded slab interval of boxes, given by their low and high corners, for any direction.

    The same numbers as those of `slab_interval` with the planes chosen: rounding keeps the order of
    the two distances of an axis.
    """
    a, b = corners
    x_1, x_2 = fma(a[0], inv[0], low[0]), fma(b[0], inv[0], high[0])
    y_1, y_2 = fma(a[1], inv[1], low[1]), fma(b[1], inv[1], high[1])
    z_1, z_2 = fma(a[2], inv[2], low[2]), fma(b[2], inv[2], high[2])
    t_in = maximum(maximum(minimum(x_1, x_2), minimum(y_1, y_2)), minimum(z_1, z_2))
    t_out = minimum(minimum(maximum(x_1, x_2), maximum(y_1, y_2)), maximum(z_1, z_2))
    return t_in, t_out
