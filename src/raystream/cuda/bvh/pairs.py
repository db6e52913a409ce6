"""Expansion of wide nodes to binary trees: the best pairs of children, and their nodes."""

from __future__ import annotations

import numpy as np

from raystream.cuda.bvh.entries import COUNT, HIGH, LINK, LOW
from raystream.cuda.bvh.triangles import TRIANGLE, copy_leaf
from raystream.jit.constants import INF_F32, ONE_U64
from raystream.jit.cpu import device, kernel
from raystream.jit.simd import address
from raystream.structures.bvh.layout import WIDTH

_SETS = 1 << WIDTH
_LINKS = 12


@device
def _size(members):
    """Number of children in a set, a mask of up to eight bits."""
    size = 0
    while members != np.uint64(0):
        members &= members - ONE_U64
        size += 1
    return size


@device
def _half_area(box):
    x = np.float64(box[3]) - np.float64(box[0])
    y = np.float64(box[4]) - np.float64(box[1])
    z = np.float64(box[5]) - np.float64(box[2])
    return x * y + y * z + z * x


@device
def _choose(count, is_balanced, boxes, costs, choices):
    """Find the best tree over each set of children; `choices` gets its left part.

    The cost is the sum of the areas of the boxes of all pairs.
    """
    for members in range(ONE_U64, ONE_U64 << count):
        size = _size(members)
        if size == 1:
            costs[members] = 0.0
            continue
        # In a balanced tree, at most half of the set's size rounded up to a power of two.
        most = size - 1
        if is_balanced:
            most = 1
            while most + most < size:
                most += most
        least, choice = np.inf, np.uint64(0)
        # The lowest member is always in the left part: no tree is tried twice.
        lowest = members & (~members + ONE_U64)
        part = (members - ONE_U64) & members
        while part != np.uint64(0):
            other = members ^ part
            is_allowed = not is_balanced or (_size(part) <= most and _size(other) <= most)
            if part & lowest != np.uint64(0) and is_allowed:
                cost = costs[part] + costs[other]
                if cost < least or choice == np.uint64(0):
                    least, choice = cost, part
            part = (part - ONE_U64) & members
        costs[members] = least + _half_area(boxes[members])
        choices[members] = choice


@device
def _unite(entries, row, count, boxes):
    """Compute the boxes of all sets of children."""
    for members in range(ONE_U64, ONE_U64 << count):
        rest = members & (members - ONE_U64)
        last = np.uint64(0)
        while (members >> last) & ONE_U64 == np.uint64(0):
            last += ONE_U64
        for axis in range(np.uint64(3)):
            low = entries[row, last, np.uint64(LOW) + axis]
            high = entries[row, last, np.uint64(HIGH) + axis]
            if rest != np.uint64(0):
                low = min(low, boxes[rest, axis])
                high = max(high, boxes[rest, axis + np.uint64(3)])
            boxes[members, axis], boxes[members, axis + np.uint64(3)] = low, high


@device
def _put_child(nodes, links, node, side, box, link):
    at = np.uint64(4) * side
    nodes[node, at], nodes[node, at + ONE_U64] = box[0], box[3]
    nodes[node, at + np.uint64(2)], nodes[node, at + np.uint64(3)] = box[1], box[4]
    at = np.uint64(8) + np.uint64(2) * side
    nodes[node, at], nodes[node, at + ONE_U64] = box[2], box[5]
    links[node, np.uint64(_LINKS) + side] = link


@kernel
def write_pairs(
    begin, end, is_balanced, first_nodes, first_triangles, wide, nodes, links, triangles
):
    """Write the binary nodes of some wide nodes, and the triangles of their leaves.

    Parameters
    ----------
    begin, end : int
        Rows of `entries`.
    is_balanced : bool
        Whether trees must have the fewest possible levels.
    first_nodes, first_triangles : ndarray of shape (M + 1,), int64
        The first binary node, and the first triangle, of each wide node.
    wide : WideEntries
    nodes, links : ndarray of shape (R, 16), float32 and int32
        The same memory; written.
    triangles : ndarray of shape (T, 12), float32
        Written.
    """
    entries, words, leaves = wide
    leaf_at, triangle_at = address(leaves), address(triangles)
    boxes = np.empty((_SETS, 6), np.float32)
    costs, choices = np.empty(_SETS, np.float64), np.empty(_SETS, np.uint64)
    own = np.empty(WIDTH, np.int32)
    pending_sets, pending_nodes = np.empty(WIDTH, np.uint64), np.empty(WIDTH, np.uint64)
    nothing = np.array([INF_F32, INF_F32, INF_F32, -INF_F32, -INF_F32, -INF_F32], np.float32)
    for row in range(np.uint64(begin), np.uint64(end)):
        # Step 1: the leaves' triangles, and the links of binary nodes to the children.
        to = triangle_at + np.uint64(first_triangles[row]) * TRIANGLE
        triangle, count = first_triangles[row], np.uint64(0)
        while count < np.uint64(WIDTH) and words[row, count, LINK] != 0:
            link = words[row, count, LINK]
            if link > 0:
                own[count] = first_nodes[link]
            else:
                own[count] = ~triangle
                triangle += words[row, count, COUNT]
                to = copy_leaf(leaf_at, link, to)
            count += ONE_U64
        # Step 2: the best trees.
        _unite(entries, row, count, boxes)
        _choose(count, is_balanced, boxes, costs, choices)
        # Step 3: nodes, from the root; children come after their parents.
        node = np.uint64(first_nodes[row])
        if count <= ONE_U64:
            _put_child(nodes, links, node, np.uint64(0), nothing, 0)
            _put_child(nodes, links, node, ONE_U64, nothing, 0)
            if count == ONE_U64:
                _put_child(nodes, links, node, np.uint64(0), boxes[1], own[0])
            continue
        pending_sets[0], pending_nodes[0] = (ONE_U64 << count) - ONE_U64, node
        top = 1
        while top != 0:
            top -= 1
            members, parent = pending_sets[top], pending_nodes[top]
            part = choices[members]
            for side in range(np.uint64(2)):
                if part & (part - ONE_U64) == np.uint64(0):
                    child = np.uint64(0)
                    while (part >> child) & ONE_U64 == np.uint64(0):
                        child += ONE_U64
                    link = own[child]
                else:
                    node += ONE_U64
                    link = np.int32(node)
                    pending_sets[top], pending_nodes[top] = part, node
                    top += 1
                _put_child(nodes, links, parent, side, boxes[part], link)
                part = members ^ part


@kernel
def depth_of(links, depths):
    """Nodes on the longest path; `depths` must be zero, and is overwritten."""
    deepest = 0
    for node in range(len(links)):  # parents come before their children
        depth = depths[node] + 1
        deepest = max(deepest, depth)
        for side in range(2):
            link = links[node, _LINKS + side]
            if link > 0:
                depths[link] = depth
    return deepest
