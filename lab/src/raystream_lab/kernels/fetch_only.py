"""Versions of the key kernels that fetch and store the same, and compute next to nothing.

Foley 2005, section 4.2: "stripped down to perform the same number of fetches and writes, but only
enough math to prevent the driver from eliminating the fetches". Each returns records like the
kernel that it replaces. It reads the same fields of a ray's records, and each word of the structure
once, at the same addresses, except for the order of a triangle's corners and for the child of a
split, where it takes the lower one.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from raystream.jit.constants import BYTES_32, ONE_U64, TWO_U64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import f32x4, load, mask_bits
from raystream.kernels.leaf_block import BLOCK, SECOND, THIRD
from raystream.machines.records import RayState
from raystream.machines.steps import Steps

_TRAVERSING = np.uint8(RayState.TRAVERSING)
_INTERSECTING = np.uint8(RayState.INTERSECTING)
_BACKTRACKING = np.uint8(RayState.BACKTRACKING)
_ZERO = np.float32(0.0)
_NODE = np.uint64(8)
_CORNERS = np.uint64(36)
_AXIS = np.uint64(16)

# Foley's layout of a kd-tree; see `structures.kdtree.foley_layout`.
_LEAF = np.uint64(1 << 31)
_ROW = np.uint64((1 << 30) - 1)
_RECORD = np.uint64(12)
_EXTENDED = np.uint64(32)
_HIGH = np.uint64(12)
_LINK = np.uint64(24)


@device
def _sum_of_ray(ray):
    o, d = ray.origin, ray.direction
    return ((o[0] + o[1]) + (o[2] + d[0])) + (d[1] + d[2])


@device
def _triple(v):
    return (v[0] + v[1]) + v[2]


@device
def _word(at):
    return np.uint64(load(np.uint32, at))


@device
def _sum_of_corners(tree, row):
    """Sum a reference's triangle: nine numbers."""
    at = tree.corners + np.uint64(load(np.int32, tree.references + row * BYTES_32)) * _CORNERS
    total = load(np.float32, at)
    for k in range(ONE_U64, np.uint64(9)):
        total += load(np.float32, at + k * BYTES_32)
    return total


@device
def _found(wanted, found, more):
    """A record of hits that depends on everything read."""
    count = found.count ^ np.uint32(wanted.capacity ^ wanted.first)
    return np.uint32(count), found.t_far + more


@device
def brute_intersect(ray, wanted, found, place, tree):
    """Replaces `machines.steps.brute.intersect`."""
    row = np.uint64(place.row)
    total = (_sum_of_ray(ray) + ray.t_min) + _sum_of_corners(tree, row)
    return _found(wanted, found, total), (np.uint32(row + ONE_U64),), _INTERSECTING


@device
def _same_place(place, t_in, row, end):
    return (
        place.cell,
        place.outer,
        place.t_next,
        place.plane,
        place.t_after,
        t_in,
        place.t_end,
        np.uint32(row),
        np.uint32(end),
    )


@device
def grid_traverse(ray, found, place, tree):
    """Replaces `machines.steps.grid.traverse` in a one-level grid."""
    at = tree.splits + np.uint64(place.cell) * BYTES_32
    row = found.count ^ place.row ^ np.uint32(_word(at))
    end = place.end ^ np.uint32(_word(at + BYTES_32))
    t_in = place.t_in + (_sum_of_ray(ray) + found.t_far)
    return _same_place(place, t_in, row, end), _TRAVERSING


@device
def grid_intersect(ray, wanted, found, place, tree):
    """Replaces `machines.steps.grid.intersect` in a one-level grid."""
    total = _sum_of_ray(ray) + _sum_of_corners(tree, np.uint64(place.row))
    place = _same_place(place, place.t_in, place.row, place.end)
    return _found(wanted, found, total), place, _INTERSECTING


@device
def _same_search(place, node, t_in, t_out, left):
    return np.uint32(node), t_in, t_out, place.t_end, place.top, ZERO_U64, np.uint32(left)


@device
def _split(leaves, tree, node):
    """Position of a split, and the words of its children."""
    if leaves is not None:
        at = tree.nodes + node * _RECORD
        return load(np.float32, at), _word(at + BYTES_32) ^ _word(at + _NODE)
    at = tree.nodes + node * _NODE
    child = _word(at + BYTES_32) >> TWO_U64
    return load(np.float32, at), _word(tree.nodes + child * _NODE + BYTES_32)


@device
def _parent(leaves, tree, node):
    """The parent node, and its extended record."""
    if leaves is not None:
        leaf = leaves + (node & _ROW) * _RECORD + _NODE
        node = _word(leaf if node >= _LEAF else tree.extended + node * _EXTENDED + _LINK)
        return node, tree.extended + node * _EXTENDED
    row = tree.extended + ((node - ONE_U64) >> ONE_U64) * _EXTENDED
    node = _word(row + _LINK)
    return node ^ _word(tree.nodes + node * _NODE + BYTES_32), row


@device
def kdtree_down(ray, place, tree):
    """Replaces `machines.steps.kdtree.descend`."""
    position, node = _split(tree.leaves, tree, np.uint64(place.node))
    total = _sum_of_ray(ray) + position
    return _same_search(place, node, place.t_in, place.t_out + total, 0), _TRAVERSING


@device
def kdtree_up(ray, place, tree):
    """Replaces `machines.steps.kdtree.backtrack`."""
    o, d = ray.origin, ray.direction
    node, row = _parent(tree.leaves, tree, np.uint64(place.node))
    high = row + _HIGH
    x = load(np.float32, high if d[0] > _ZERO else row)
    y = load(np.float32, (high if d[1] > _ZERO else row) + BYTES_32)
    z = load(np.float32, (high if d[2] > _ZERO else row) + _NODE)
    t_out = ((o[0] + x) + (o[1] + y)) + ((o[2] + z) + (d[0] + (d[1] + d[2])))
    return _same_search(place, node, place.t_in, t_out, 0), _BACKTRACKING


@device
def _corner_lanes(at):
    return load(f32x4, at) + load(f32x4, at + _AXIS) + load(f32x4, at + _AXIS + _AXIS)


@device
def kdtree_intersect(ray, wanted, found, place):
    """Replaces `machines.steps.kdtree.intersect`; reads a block without its prim_ids."""
    block = place.block
    total = _corner_lanes(block) + _corner_lanes(block + SECOND) + _corner_lanes(block + THIRD)
    bits = np.uint32(mask_bits(total > f32x4(_ZERO)))
    place = (
        place.node,
        place.t_in,
        place.t_out,
        place.t_end,
        place.top,
        block + BLOCK,
        np.uint32(place.left ^ bits),
    )
    return _found(wanted, found, _sum_of_ray(ray)), place, _INTERSECTING


#: By the structure and kernel that each replaces.
FETCH_ONLY: dict[tuple[str, str], Callable[..., Any]] = {
    ("brute", "intersect"): brute_intersect,
    ("grid", "traverse"): grid_traverse,
    ("grid", "intersect"): grid_intersect,
    ("kdtree", "down"): kdtree_down,
    ("kdtree", "up"): kdtree_up,
    ("kdtree", "intersect"): kdtree_intersect,
}


def fetch_only(structure: str, steps: Steps, number: int) -> Steps:
    """The steps of a traversal with one kernel replaced by its fetch-only version.

    Raises
    ------
    KeyError
        If the kernel has no such version; see `FETCH_ONLY`.
    """
    kernels = list(steps.kernels)
    function = FETCH_ONLY[structure, kernels[number].name]
    kernels[number] = kernels[number]._replace(function=function)
    return steps._replace(kernels=tuple(kernels))
