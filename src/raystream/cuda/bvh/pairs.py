"""Expansion of wide nodes to binary ones, a wide node per call: on the host and on the device.

Of all binary trees over its children the one of least surface area is found, by dynamic programming
over their subsets: the builder's own tree is one of these.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.cuda.bvh.triangles import TRIANGLE, copy_leaf, hittable_count
from raystream.jit.constants import BITS_32, INF_F32, LOW_32, ONE_U64, SHIFT_32, SHIFT_64, ZERO_U64
from raystream.jit.cpu import device, kernel
from raystream.jit.cuda import RangeKernel
from raystream.jit.simd import count_trailing_zeros, load, scratch, store
from raystream.structures.bvh.layout import WIDTH
from raystream.structures.bvh.node_layout import BOX_FLIP, CHILDREN, NODE, NODE_AXIS

#: Bytes of a binary node, and offset of its two links.
PAIR = np.uint64(64)
_LINKS = np.uint64(48)

_WIDTH = np.uint64(WIDTH)
_NOTHING = (INF_F32, -INF_F32) * 3

#: Scratch: a cost and a choice for each set of children, a mask; and a number for each lane.
_COSTS_BYTES = 8 << WIDTH
_CHOICES_BYTES = 1 << WIDTH
_LANES_BYTES = 8 * WIDTH


class WideAt(NamedTuple):
    """Addresses of a wide tree on the device that expands it.

    Attributes
    ----------
    nodes, leaves : uint64
        See `BvhArrays`.
    firsts : uint64
        For each node a uint64: numbers of binary nodes, and above bit 32 of triangles. First its
        own, then, for `write_row`, those of all nodes before it.
    """

    nodes: np.uint64
    leaves: np.uint64
    firsts: np.uint64


@device
def _link(node, lane):
    return load(np.int32, node + CHILDREN + (lane << SHIFT_32))


@device
def _size(members):
    """Number of children in a set."""
    size = ZERO_U64
    while members != ZERO_U64:
        members &= members - ONE_U64
        size += ONE_U64
    return size


@device
def _box(node, lanes, members):
    """The box around a set of the listed children: low x, high x, and so on."""
    box = _NOTHING
    while members != ZERO_U64:
        k = count_trailing_zeros(members)
        members &= members - ONE_U64
        at = node + (load(np.uint64, lanes + (k << SHIFT_64)) << SHIFT_32)
        low_y, low_z = at + NODE_AXIS, at + NODE_AXIS + NODE_AXIS
        box = (
            min(box[0], load(np.float32, at)),
            max(box[1], load(np.float32, at + BOX_FLIP)),
            min(box[2], load(np.float32, low_y)),
            max(box[3], load(np.float32, low_y + BOX_FLIP)),
            min(box[4], load(np.float32, low_z)),
            max(box[5], load(np.float32, low_z + BOX_FLIP)),
        )
    return box


@device
def _list_lanes(node, leaves, lanes):
    """List the lanes that a ray may enter, uint64 each; returns their number, and of triangles."""
    count, triangles = ZERO_U64, ZERO_U64
    for lane in range(_WIDTH):
        link = _link(node, lane)
        if link == np.int32(0):
            continue
        # `_box` reads the list: a lane that is left out is overwritten by the next one.
        store(lanes + (count << SHIFT_64), lane)
        box = _box(node, lanes, ONE_U64 << count)
        if box[0] > box[1] or box[2] > box[3] or box[4] > box[5]:
            continue
        if link < np.int32(0):
            own = hittable_count(leaves, link)
            if own == ZERO_U64:
                continue
            triangles += own
        count += ONE_U64
    return count, triangles


@kernel
def count_row(row, wide):
    """Count the binary nodes of a wide node, and its triangles."""
    lanes = scratch(_LANES_BYTES)
    count, triangles = _list_lanes(wide.nodes + row * NODE, wide.leaves, lanes)
    pairs = max(count, np.uint64(2)) - ONE_U64
    store(wide.firsts + (row << SHIFT_64), pairs | (triangles << BITS_32))


@device
def _choose(node, lanes, count, is_balanced, costs, choices):
    """Find the tree over each set of children with the least sum of its boxes' areas.

    `choices` gets the left part of each set.
    """
    for members in range(ONE_U64, ONE_U64 << count):
        at, size = costs + (members << SHIFT_64), _size(members)
        if size == ONE_U64:
            store(at, np.float64(0.0))
            continue
        # In a balanced tree both parts have half of the children.
        most = (size + ONE_U64) >> ONE_U64 if is_balanced else size
        least, choice = np.float64(np.inf), ZERO_U64
        # The lowest member is always in the left part: no tree is tried twice.
        lowest = members & (~members + ONE_U64)
        part = (members - ONE_U64) & members
        while part != ZERO_U64:
            other = members ^ part
            is_allowed = max(_size(part), _size(other)) <= most
            if part & lowest != ZERO_U64 and is_allowed:
                cost = load(np.float64, costs + (part << SHIFT_64))
                cost += load(np.float64, costs + (other << SHIFT_64))
                if cost < least or choice == ZERO_U64:
                    least, choice = cost, part
            part = (part - ONE_U64) & members
        box = _box(node, lanes, members)
        x = np.float64(box[1]) - np.float64(box[0])
        y = np.float64(box[3]) - np.float64(box[2])
        z = np.float64(box[5]) - np.float64(box[4])
        store(at, np.float64(least + (x * y + y * z + z * x)))
        store(choices + members, np.uint8(choice))


@device
def _put_child(pair, side, box, link):
    at = pair + side * np.uint64(16)
    for k in range(np.uint64(4)):
        store(at + (k << SHIFT_32), box[k])
    at = pair + np.uint64(32) + (side << SHIFT_64)
    store(at, box[4])
    store(at + np.uint64(4), box[5])
    store(pair + _LINKS + (side << SHIFT_32), np.int32(link))
    store(pair + _LINKS + np.uint64(8) + (side << SHIFT_32), np.int32(0))


@device
def _link_children(node, lanes, count, wide, triangle, triangles, links):
    """Write the leaves' triangles, and list the binary links to the children, int32 each."""
    for k in range(count):
        link = _link(node, load(np.uint64, lanes + (k << SHIFT_64)))
        if link > np.int32(0):
            first = load(np.uint64, wide.firsts + (np.uint64(link) << SHIFT_64)) & LOW_32
            store(links + (k << SHIFT_32), np.int32(first))
        else:
            to = triangles + triangle * TRIANGLE
            store(links + (k << SHIFT_32), np.int32(~np.int32(triangle)))
            triangle += (copy_leaf(wide.leaves, link, to) - to) // TRIANGLE


@kernel
def write_row(row, wide, is_balanced, pairs, triangles):
    """Write the binary nodes of a wide node, and the triangles of its leaves.

    Parameters
    ----------
    row : uint64
    wide : WideAt
    is_balanced : bool
        Whether its tree must have the fewest possible levels.
    pairs, triangles : uint64
        Addresses of all binary nodes and triangles.
    """
    node = wide.nodes + row * NODE
    lanes, links, pending = scratch(_LANES_BYTES), scratch(_LANES_BYTES), scratch(_LANES_BYTES)
    costs, choices = scratch(_COSTS_BYTES), scratch(_CHOICES_BYTES)
    firsts = load(np.uint64, wide.firsts + (row << SHIFT_64))
    count, _triangle_count = _list_lanes(node, wide.leaves, lanes)
    _link_children(node, lanes, count, wide, firsts >> BITS_32, triangles, links)
    root = pairs + (firsts & LOW_32) * PAIR
    if count <= ONE_U64:
        _put_child(root, ZERO_U64, _NOTHING, np.int32(0))
        _put_child(root, ONE_U64, _NOTHING, np.int32(0))
        if count == ONE_U64:
            _put_child(root, ZERO_U64, _box(node, lanes, ONE_U64), load(np.int32, links))
        return
    _choose(node, lanes, count, is_balanced, costs, choices)
    # Sets of children, and above eight bits how many binary nodes are before each one's.
    store(pending, np.uint64((ONE_U64 << count) - ONE_U64))
    top = pending + np.uint64(8)
    while top != pending:
        top -= np.uint64(8)
        packed = load(np.uint64, top)
        members, before = packed & np.uint64(255), packed >> np.uint64(8)
        part, own = np.uint64(load(np.uint8, choices + members)), before + ONE_U64
        # A tree over n children has n - 1 nodes: those of the left part come first.
        right = before + _size(part)
        for side in range(np.uint64(2)):
            if part & (part - ONE_U64) == ZERO_U64:
                link = load(np.int32, links + (count_trailing_zeros(part) << SHIFT_32))
            else:
                link = np.int32((firsts & LOW_32) + own)
                store(top, part | (own << np.uint64(8)))
                top += np.uint64(8)
            _put_child(root + before * PAIR, side, _box(node, lanes, part), link)
            part, own = members ^ part, right


@kernel
def count_rows(begin, end, wide):
    """`count_row` for several rows."""
    for row in range(np.uint64(begin), np.uint64(end)):
        count_row(row, wide)


@kernel
def write_rows(begin, end, wide, is_balanced, pairs, triangles):
    """`write_row` for several rows."""
    for row in range(np.uint64(begin), np.uint64(end)):
        write_row(row, wide, is_balanced, pairs, triangles)


class _Kernels(NamedTuple):
    count_row: RangeKernel
    write_row: RangeKernel


KERNELS = _Kernels(RangeKernel(count_row), RangeKernel(write_row))
