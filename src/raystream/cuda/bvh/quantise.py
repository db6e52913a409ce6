"""Compressed nodes: their order, their quantization steps, and boxes rounded outward.

Each plane is a multiple of 2**-15 steps, by a factor below 2**40, so that float64 compares it
exactly with those of the children.
"""

from __future__ import annotations

import math

import numpy as np

from raystream.cuda.bvh.entries import COUNT, HIGH, LINK, LOW
from raystream.cuda.bvh.triangles import TRIANGLE, copy_leaf
from raystream.jit.constants import ONE_U64
from raystream.jit.cpu import device, kernel
from raystream.jit.simd import address
from raystream.structures.bvh.layout import WIDTH

__all__ = ["LEAST_EXPONENT", "NODE_BYTE", "number_nodes", "write_nodes"]

#: Slot byte of a node. That of a leaf is the offset of its first triangle from the node's first,
#: plus 32 times the number of its triangles; that of an empty slot is 0.
NODE_BYTE = np.uint32(0xE0)

#: Smallest exponent of a step: a step times a reciprocal direction is exact.
LEAST_EXPONENT = -80

#: A step is also at least the largest coordinate, rounded up to a power of two, times 2**-24.
_FINEST = 24

_LEAF_SIZE = 4
_BIAS = 127
_MOST = 255.0
_GRID = 2.0**-15


@kernel
def number_nodes(words, sources, bases, pending):
    """Assign rows to nodes, with contiguous rows for the children of a node.

    Parameters
    ----------
    words : ndarray of shape (M, 8, 8), int32
        Entries in their slots.
    sources : ndarray of shape (R,), int64
        Written: the wide node of each row, or ``~(8 row + slot)`` of a large leaf's entry.
    bases : ndarray of shape (R, 2), uint32
        Written: rows of the first child node, and of the first triangle.
    pending : ndarray of int64
        Scratch memory of 8 rows per level.

    Returns
    -------
    node_count, triangle_count : int
    """
    if len(words) == 0:
        return 0, 0
    sources[0], pending[0] = 0, 0
    rows, triangles, top = 1, 0, 1
    while top != 0:
        top -= 1
        row = pending[top]
        source = sources[row]
        bases[row, 0], bases[row, 1] = rows, triangles
        if source < 0:
            triangles += words[~source >> 3, ~source & 7, COUNT]
            continue
        first = rows
        for slot in range(WIDTH):
            link, count = words[source, slot, LINK], words[source, slot, COUNT]
            if link < 0 and count <= _LEAF_SIZE:
                triangles += count
            elif link != 0:
                sources[rows] = link if link > 0 else ~(source * WIDTH + slot)
                rows += 1
        for k in range(rows - first):  # the first is popped first
            pending[top] = rows - 1 - k
            top += 1
    return rows, triangles


@device
def _step_of(low, high):
    """Origin and exponent of the step for planes from low to high; float64, int."""
    exponent = max(LEAST_EXPONENT, math.frexp(max(abs(low), abs(high)))[1] - _FINEST)
    exponent = max(exponent, math.frexp((high - low) / _MOST)[1])
    while True:
        step = math.ldexp(1.0, exponent)
        origin = math.floor(low / (step * _GRID)) * (step * _GRID)
        if origin + _MOST * step >= high:
            return origin, exponent
        exponent += 1


@device
def _below(plane, origin, step):
    """The largest byte whose plane is not above a given one."""
    q = math.floor((plane - origin) / step)
    return q - 1.0 if origin + q * step > plane else q


@device
def _above(plane, origin, step):
    """The smallest byte whose plane is not below a given one."""
    q = math.ceil((plane - origin) / step)
    return q + 1.0 if origin + q * step < plane else q


@device
def _put_byte(nodes, row, word, slot, byte):
    """Write one of the eight bytes that start at a word."""
    at = np.uint64(word) + (slot >> np.uint64(2))
    nodes[row, at] |= np.uint32(byte) << np.uint32((slot & np.uint64(3)) << np.uint64(3))


@device
def _write_boxes(own, count, floats, nodes, row):
    """Write origin, steps and planes around the boxes of slots; `count` is 0 for empty ones."""
    for axis in range(np.uint64(3)):
        low, high = np.inf, -np.inf
        for slot in range(np.uint64(WIDTH)):
            if count[slot] != 0:
                low = min(low, np.float64(own[slot, np.uint64(LOW) + axis]))
                high = max(high, np.float64(own[slot, np.uint64(HIGH) + axis]))
        if not low <= high:
            return
        origin, exponent = _step_of(low, high)
        step = math.ldexp(1.0, exponent)
        floats[row, axis] = np.float32(origin)
        nodes[row, 3] |= np.uint32(exponent + _BIAS) << np.uint32(axis << np.uint64(3))
        for slot in range(np.uint64(WIDTH)):
            if count[slot] != 0:
                low = np.float64(own[slot, np.uint64(LOW) + axis])
                high = np.float64(own[slot, np.uint64(HIGH) + axis])
                word = np.uint64(8) + (axis << ONE_U64)
                _put_byte(nodes, row, word, slot, _below(low, origin, step))
                _put_byte(nodes, row, word + np.uint64(6), slot, _above(high, origin, step))


@kernel
def write_nodes(begin, end, sources, bases, wide, nodes, floats, triangles):
    """Write some nodes, and the triangles of their leaves.

    Parameters
    ----------
    begin, end : int
        Rows of `nodes`.
    sources, bases
        See `number_nodes`.
    wide : WideEntries
        Entries in their slots.
    nodes, floats : ndarray of shape (R, 20), uint32 and float32
        The same memory, zero; written.
    triangles : ndarray of shape (T, 12), float32
        Written.
    """
    entries, words, leaves = wide
    leaf_at, triangle_at = address(leaves), address(triangles)
    own = np.empty((WIDTH, 8), np.float32)
    count = np.empty(WIDTH, np.int32)  # -1 for a node
    for row in range(np.uint64(begin), np.uint64(end)):
        source = sources[row]
        nodes[row, 4], nodes[row, 5] = bases[row, 0], bases[row, 1]
        to = triangle_at + np.uint64(bases[row, 1]) * TRIANGLE
        count[:] = 0
        if source < 0:
            entry, place = np.uint64(~source >> 3), np.uint64(~source & 7)
            rest = words[entry, place, COUNT]
            copy_leaf(leaf_at, words[entry, place, LINK], to)
            for slot in range(np.uint64(WIDTH)):
                own[slot] = entries[entry, place]
                count[slot] = min(rest, _LEAF_SIZE)
                rest -= count[slot]
        else:
            for slot in range(np.uint64(WIDTH)):
                own[slot] = entries[np.uint64(source), slot]
                link = words[np.uint64(source), slot, LINK]
                leaf_size = words[np.uint64(source), slot, COUNT]
                if link > 0 or leaf_size > _LEAF_SIZE:
                    count[slot] = -1
                elif link < 0:
                    count[slot] = leaf_size
                    to = copy_leaf(leaf_at, link, to)
        _write_boxes(own, count, floats, nodes, row)
        offset = np.uint32(0)
        for slot in range(np.uint64(WIDTH)):
            if count[slot] < 0:
                _put_byte(nodes, row, 6, slot, NODE_BYTE)
                nodes[row, 3] |= np.uint32(1) << np.uint32(np.uint64(24) + slot)
            elif count[slot] > 0:
                _put_byte(nodes, row, 6, slot, (np.uint32(count[slot]) << np.uint32(5)) | offset)
                offset = np.uint32(offset + np.uint32(count[slot]))
