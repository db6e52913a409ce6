"""Streams of groups in float64: the kernel for many rays.

Lists of groups of 16 rays descend the tree as in `structures.bvh.group_stream`, with the same tests
of boxes, in float32 with their padding: it exceeds the rounding of the rays, and the boxes hold
the triangles for sure. Leaves test triangles in float64. Each ray has the interval of its nearest
hit's distance; its upper end, rounded up to float32, is what boxes are compared to.
"""

from __future__ import annotations

import numpy as np

from raystream.float64.block import (
    AXIS,
    BLOCK,
    HIGH,
    PRIM_IDS,
    SECOND,
    THIRD,
    interval_of,
    leaf_end,
    sides_of,
    test_block,
    triangle_edges,
)
from raystream.float64.queries import tree_searches, write_nearest
from raystream.float64.ray import Line, exact_line, exact_ray, local_origin
from raystream.float64.search import NO_PRIM, Nearest, is_counted, no_hit, offer, within
from raystream.float64.traversal import STACK_BYTES
from raystream.jit.cpu import device, device_call, kernel
from raystream.jit.intrinsics import no_inline
from raystream.jit.simd import (
    address,
    any_lane,
    count_trailing_zeros,
    f64x16,
    load,
    mask_bits,
    next_float_up,
    scratch,
    select,
    store,
)
from raystream.jit.views import address_of, view
from raystream.kernels.ray_source import load_direction, load_origin
from raystream.structures.bvh.group_leaf import SMALL_BYTES, Small
from raystream.structures.bvh.group_rays import (
    FLAGS_AT,
    GROUP_SHIFT,
    HOT_AT,
    LANE_SHIFT,
    LISTS_AT,
    MEMORY_BYTES,
    Hot,
    load_block,
)
from raystream.structures.bvh.group_stream import GROUP_STACK_BYTES, block_trace
from raystream.structures.bvh.node_layout import LANE, leaf_address
from raystream.structures.bvh.packet_rays import (
    GROUPS,
    PACKET_RAYS,
    Group,
    GroupLanes,
    PacketSource,
    group_rows,
    three,
)

__all__ = ["BLOCK_RAYS", "WORKING_BYTES", "trace_exact"]

#: Rays that descend the tree together.
BLOCK_RAYS = 4096
_PACKETS = np.uint64(BLOCK_RAYS // PACKET_RAYS)

#: A ray, and its nearest hit.
_RECORD = np.dtype(
    [
        ("origin", "f8", 3),
        ("direction", "f8", 3),
        ("t_min", "f8"),
        ("t_max", "f8"),
        ("low", "f8"),
        ("high", "f8"),
        ("place", "u8"),
        ("prim_id", "i4"),
        ("status", "u4"),
        ("half", "f8"),
        ("rest", "f8"),
        ("scale", "f8"),  # local t of float32 = t * scale - offset
        ("offset", "f8"),
    ]
)
_Record = view(_RECORD)

#: Sixteen rays, and the end of each one's interval: -inf for one that is not traced here.
_SIXTEEN = np.dtype(
    [("origin", "f8", (3, 16)), ("direction", "f8", (3, 16)), ("t_min", "f8", 16), ("far", "f8", 16)]
)
_Sixteen = view(_SIXTEEN)
_SixteenLanes = view(
    [
        ("origin", "f8", (3, 16, 1)),
        ("direction", "f8", (3, 16, 1)),
        ("t_min", "f8", (16, 1)),
        ("far", "f8", (16, 1)),
    ]
)

_RECORDS_AT = np.uint64(-(-MEMORY_BYTES // 64) * 64)
_SIXTEENS_AT = _RECORDS_AT + np.uint64(BLOCK_RAYS * _RECORD.itemsize)

#: Bytes of memory of a call, of which most are never touched.
WORKING_BYTES = int(_SIXTEENS_AT) + BLOCK_RAYS // 16 * _SIXTEEN.itemsize + 64

#: Origins that are further from the scene's middle than this many times its largest coordinate are
#: traced singly: moved to the scene, as float32 needs it, they would lose too many digits.
_FAR = 2.0**20

#: Distances are rounded up by this part of the offset, whose own rounding it covers.
_OFFSET_SLACK = 2.0**-50

_nearest, _anything = tree_searches

_NONE = np.uint64(0)
_ONE = np.uint64(1)
_WORD = np.uint64(2)
_DOUBLE = np.uint64(3)
_LANES = np.uint64(16)
_BLOCK_LANES = np.uint64(4)
_LAST_LANE = np.uint64(15)
_X, _Y, _Z = np.uint64(0), np.uint64(1), np.uint64(2)
_INF = np.float64(np.inf)
_INF32 = np.float32(np.inf)
_ZERO = np.float64(0.0)


@device
def _record(memory, number):
    return _Record(memory + _RECORDS_AT, number)


@device
def _line(record):
    return Line(record.origin, record.direction, record.t_min, record.t_max)


@device
def _best(record):
    return Nearest(record.low, record.high, record.place, record.prim_id)


@device_call
def _fill_record(record, lanes, k, group, source, i, frame):
    """Load ray i, lane k of a group; returns whether it is traced in the group."""
    no_inline()
    t_min = source.t_min[i if len(source.t_min) > 1 else _NONE]
    t_max = source.t_max[i if len(source.t_max) > 1 else _NONE]
    origin, direction = load_origin(source.rays, i), load_direction(source.rays, i)
    line, half, rest, status = exact_line(origin, direction, t_min, t_max)
    record.origin, record.direction = line.origin, line.direction
    record.t_min, record.t_max = line.t_min, line.t_max
    best = no_hit()
    record.low, record.high, record.place = best.low, best.high, best.place
    record.prim_id, record.status = best.prim_id, np.uint32(status)
    record.half, record.rest, record.scale = half, rest, np.float64(frame.scale)
    origins, directions = lanes.origin, lanes.direction
    origins[_X, k], origins[_Y, k], origins[_Z, k] = line.origin
    directions[_X, k], directions[_Y, k], directions[_Z, k] = line.direction
    lanes.t_min[k], lanes.far[k] = line.t_min, line.t_max
    x, y, z = local_origin(line, frame)
    return max(abs(x), abs(y), abs(z)) <= _FAR * np.float64(frame.max_coordinate)


@device
def _load(memory, first, last, source, order, frame, is_slow_at):
    """Load the rays of packets in float64, after `load_block`."""
    g = _NONE
    for packet in range(first, last):
        for row in range(GROUPS):
            ray, length = group_rows(order, packet, row)
            if length == _NONE:
                continue
            lanes = _SixteenLanes(memory + _SIXTEENS_AT, g)
            group = GroupLanes(memory, g)
            is_slow = load(np.uint8, is_slow_at + g) != np.uint8(0)
            for k in range(_LANES):
                number = (g << LANE_SHIFT) | k
                record = _record(memory, number)
                if k >= length:
                    lanes.far[k] = -_INF
                    continue
                is_near = _fill_record(record, lanes, k, group, source, ray + k, frame)
                record.offset = _ZERO
                if is_slow:
                    record.offset = group.slow_t_offset[k] / group.slow_t_scale[k]
                if not is_near:
                    lanes.far[k], group.t[k] = -_INF, -_INF32
                    Hot(memory + HOT_AT, number).t = -_INF32
                    record.status |= np.uint32(2)
            g += _ONE


@device
def _set_far(memory, g, k, far):
    """Write the end of a ray's interval wherever it is read."""
    number = (g << LANE_SHIFT) | k
    record = _record(memory, number)
    _SixteenLanes(memory + _SIXTEENS_AT, g).far[k] = far
    local = far * record.scale - record.offset
    local += abs(record.offset) * _OFFSET_SLACK
    short = next_float_up(np.float32(local))
    GroupLanes(memory, g).t[k] = short
    Hot(memory + HOT_AT, number).t = short


@device
def _keep(memory, g, k, low, high, is_sure, place, prim_id, wants_any):
    """Offer a triangle that may be hit to a ray; returns whether it is its hit now."""
    record = _record(memory, (g << LANE_SHIFT) | k)
    line = _line(record)
    if wants_any:
        if not ((is_sure and within(line, low, high)) or is_counted(line, place, False)):
            return False
        record.prim_id = np.int32(0)
        _set_far(memory, g, k, -_INF)
        return True
    best = offer(line, _best(record), low, high, is_sure, place, prim_id)
    if best.place == record.place and best.high == record.high:
        return False
    record.low, record.high = best.low, best.high
    record.place, record.prim_id = best.place, best.prim_id
    _set_far(memory, g, k, best.high)
    return True


@device
def _triple(at):
    return load(np.float64, at), load(np.float64, at + AXIS), load(np.float64, at + (AXIS + AXIS))


@device
def _test_with_group(g, memory, a, edges, place, prim_id, wants_any, lanes):
    """Test a triangle against a group; returns the number of hits."""
    group = _Sixteen(memory + _SIXTEENS_AT, g)
    origin, direction = three(group.origin), three(group.direction)
    low, high, error, base, corner, reach = sides_of(a, edges, origin, direction)
    found = (low >= -error) | (high <= error)
    if not any_lane(found):
        return _NONE
    is_clear, least, most = interval_of(corner, reach, edges, base, error)
    least, most = select(is_clear, least, f64x16(-_INF)), select(is_clear, most, f64x16(_INF))
    found = found & (least <= group.far) & (most >= group.t_min)
    bits = mask_bits(found)
    if bits == _NONE:
        return _NONE
    sure = mask_bits(is_clear & ((low > error) | (high < -error)))
    store(lanes, least)
    store(lanes + np.uint64(128), most)
    hit_count = _NONE
    while bits != _NONE:
        k = count_trailing_zeros(bits)
        bits &= bits - _ONE
        start, end = load(np.float64, lanes + (k << _DOUBLE)), load(
            np.float64, lanes + np.uint64(128) + (k << _DOUBLE)
        )
        is_sure = (sure >> k) & _ONE != _NONE
        hit_count += np.uint64(
            _keep(memory, g, k, start, end, is_sure, place, prim_id, wants_any)
        )
    return hit_count


@device
def _leaf_with_groups(block, groups, count, memory, wants_any, lanes):
    """Test a block's triangles against the groups of a list; returns the number of hits."""
    hit_count = _NONE
    for lane in range(_BLOCK_LANES):
        prim_id = load(np.int32, block + PRIM_IDS + (lane << _WORD))
        if prim_id < np.int32(0):
            break
        place = block + (lane << _DOUBLE)
        a = _triple(place)
        edges = triangle_edges(a, _triple(place + SECOND), _triple(place + THIRD))
        for j in range(count):
            g = np.uint64(load(np.uint32, groups + j * LANE)) >> GROUP_SHIFT
            hit_count += _test_with_group(
                g, memory, a, edges, place, prim_id, wants_any, lanes
            )
    return hit_count


@device
def _leaf_with_rays(block, rays, count, memory, wants_any, lanes):
    """Test a block's triangles against the rays of a list; returns the number of hits."""
    hit_count = _NONE
    for j in range(count):
        number = np.uint64(load(np.uint32, rays + j * LANE))
        g, k = number >> LANE_SHIFT, number & _LAST_LANE
        record = _record(memory, number)
        line = _line(record)
        far = _SixteenLanes(memory + _SIXTEENS_AT, g).far[k]
        found, sure = test_block(block, line, line.t_min, far, lanes)
        while found != _NONE:
            lane = count_trailing_zeros(found)
            found &= found - _ONE
            start = load(np.float64, lanes + (lane << _DOUBLE))
            end = load(np.float64, lanes + HIGH + (lane << _DOUBLE))
            is_sure = (sure >> lane) & _ONE != _NONE
            prim_id = load(np.int32, block + PRIM_IDS + (lane << _WORD))
            place = block + (lane << _DOUBLE)
            is_kept = _keep(memory, g, k, start, end, is_sure, place, prim_id, wants_any)
            hit_count += np.uint64(is_kept)
            if wants_any and is_kept:
                break
    return hit_count


@device
def _search_leaf(tree, child, at, length, is_grouped, memory, small, wants_any, filter_):
    """Test a leaf in float64; see `group_stream.block_trace`."""
    lanes, hit_count = scratch(256), _NONE
    block = leaf_address(tree.leaves, child)
    end = leaf_end(block, child)
    while block != end:
        if is_grouped:
            hit_count += _leaf_with_groups(block, at, length, memory, wants_any, lanes)
        else:
            hit_count += _leaf_with_rays(block, at, length, memory, wants_any, lanes)
        block += BLOCK
    return hit_count


_trace_block = block_trace(_search_leaf)


@device_call
def _finish(record, i, tree, frame, wants_any, status, rows, stack, lanes):
    """Write the result of ray i; one that is far from the scene is traced now."""
    no_inline()
    line = _line(record)
    ray = exact_ray(line, record.half, record.rest, np.uint8(record.status & np.uint32(1)), frame)
    best = _best(record)
    if record.status & np.uint32(1):
        status[i] = np.uint8(1)
    is_far = record.status & np.uint32(2) != np.uint32(0)
    if wants_any:
        is_hit = best.prim_id != NO_PRIM
        if is_far:
            is_hit = _anything(tree, ray, _NONE, stack, lanes, True) != _NONE
        rows.prim_id[i] = is_hit
        return
    if is_far:
        best = _nearest(tree, ray, no_hit(), stack, lanes, False)
    write_nearest(rows, i, best, ray)


@kernel
def trace_exact(begin, end, tree, frame, source, order, wants_any, status, rows):
    """Trace packets begin to end.

    Parameters
    ----------
    begin, end : int
    tree : ExactTree
        With nodes.
    frame : SceneFrame
    source : ExactSource
    order : PacketOrder
    wants_any : bool
        Find whether there is a hit, else the nearest one.
    status : ndarray of shape (N,), uint8
    rows : ExactRows
        Of the nearest hits; or with a `prim_id` that becomes 1 for a ray with any hit, else 0.
    """
    array = np.empty(WORKING_BYTES, np.uint8)
    memory = (address(array) + np.uint64(63)) & ~np.uint64(63)
    stack, single = scratch(GROUP_STACK_BYTES), scratch(STACK_BYTES)
    small, lanes = Small(scratch(SMALL_BYTES)), scratch(64)
    groups = memory + LISTS_AT
    packets = PacketSource(source.rays, order, frame, address(status))
    for first in range(np.uint64(begin), np.uint64(end), _PACKETS):
        last = min(first + _PACKETS, np.uint64(end))
        count, ray_count = load_block(memory, packets, first, last, groups, False)
        _load(memory, first, last, source, order, frame, memory + FLAGS_AT)
        _trace_block(memory, groups, count, ray_count, tree, stack, small, wants_any, None)
        g = _NONE
        for packet in range(first, last):
            for row in range(GROUPS):
                ray, length = group_rows(order, packet, row)
                if length == _NONE:
                    continue
                for k in range(length):
                    record = _record(memory, (g << LANE_SHIFT) | k)
                    _finish(record, ray + k, tree, frame, wants_any, status, rows, single, lanes)
                g += _ONE
    # The memory must outlive its addresses.
    array[0] = np.uint8(0)
