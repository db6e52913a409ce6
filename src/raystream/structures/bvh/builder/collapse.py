"""Collapse the binary tree: which of its nodes become nodes or leaves of the wide one.

A wide node has eight lanes. Dynamic programming from the leaves to the root finds, for every
binary node, the least cost of its subtree in 1 to 8 lanes of a wide node: in one lane as a leaf or
a wide node, in more by dividing the lanes among its children. The result is optimal for the given
binary tree.

References
----------
Ylitie, Karras, Laine, "Efficient Incoherent Ray Traversal on GPUs Through Compressed Wide
BVHs", High Performance Graphics 2017.
"""

from __future__ import annotations

import numpy as np

from raystream.jit.constants import INF_F32
from raystream.jit.cpu import device, device_call, kernel
from raystream.jit.simd import (
    address,
    f32x8,
    i32x8,
    lane,
    lanes_from_bits,
    load,
    mask8,
    minimum,
    permutation,
    select,
    store,
)
from raystream.jit.views import view
from raystream.structures.bvh.builder.binary_tree import Link, put_node
from raystream.structures.bvh.builder.binning import block_count
from raystream.structures.bvh.builder.prim_refs import COUNT_AT, REF_BYTES, half_area
from raystream.structures.bvh.layout import WIDTH

#: Costs of a node in 1 to 8 lanes, float32.
COST_BYTES = 32
COST_FLOATS = WIDTH

#: Scratch of `list_children`: nodes, and the lanes that each may fill.
_LISTED = np.dtype([("node", "i4"), ("lanes", "i4")])
_Listed = view(_LISTED)
LISTING_BYTES = _LISTED.itemsize * (WIDTH + 1)


#: A decision: for n = 2 to 8 lanes the number that the left child gets, three bits at 3 (n - 2),
#: 0 if one lane is as good; and whether a single lane is a leaf.
_IS_LEAF = 1 << 21

_up_a_lane = permutation(0, 0, 1, 2, 3, 4, 5, 6)


@device
def leaf_costs(box, prices):
    """Costs of a binary leaf: the same in any number of lanes."""
    count = load(np.int32, box + np.uint64(COUNT_AT))
    return f32x8((half_area(load(f32x8, box)) * prices[1] + prices[2]) * block_count(count))


@device_call
def merge_costs(box, link, left, right, max_leaf_size, prices):
    """Costs of an inner node from those of its children; writes the decision into its link.

    Parameters
    ----------
    box : uint64
        Address of the node's row.
    link : Link
    left, right : f32x8
        Costs of its children.
    max_leaf_size : int
    prices : tuple of float32
        See `BuildSettings.costs`.
    """
    # best: lane i is the least cost in i + 1 lanes that the children share.
    best, choice = f32x8(INF_F32), i32x8(np.int32(1))
    not_first, nothing = lanes_from_bits(mask8, 254), f32x8(INF_F32)
    moved = right
    for k in range(np.int32(1), np.int32(WIDTH)):
        moved = select(not_first, _up_a_lane(moved), nothing)
        shared = f32x8(lane(left, k - np.int32(1))) + moved
        better = shared < best
        best = select(better, shared, best)
        choice = select(better, i32x8(k), choice)

    area = half_area(load(f32x8, box))
    node_cost = lane(best, WIDTH - 1) + area * prices[0]
    count = load(np.int32, box + np.uint64(COUNT_AT))
    price = (area * prices[1] + prices[2]) * block_count(count)
    leaf_cost = price if count <= max_leaf_size else INF_F32
    decision = np.int32(_IS_LEAF) if leaf_cost <= node_cost else np.int32(0)
    one = f32x8(min(leaf_cost, node_cost))
    # Eight lanes are always shared: that is a wide node.
    not_last = lanes_from_bits(mask8, 127)
    choice = select((one <= best) & not_last, i32x8(np.int32(0)), choice)
    for k in range(np.int32(2), np.int32(WIDTH + 1)):
        decision |= lane(choice, k - np.int32(1)) << (np.int32(3) * (k - np.int32(2)))
    link.decision = np.int32(decision)
    return minimum(one, best)


@device
def collapse_subtree(boxes, links, root, node_end, settings, costs):
    """Decide the collapse of the nodes from root to node_end; returns the costs of the root.

    Parameters
    ----------
    boxes, links : uint64
        Addresses of the tree.
    root, node_end : int32
    settings : BuildSettings
    costs : uint64
        Address of scratch for the nodes' costs.
    """
    cost_at = costs - np.uint64(root) * np.uint64(COST_BYTES)
    node = np.uint64(node_end)
    # Children come after their parents: go backwards.
    while node != np.uint64(root):
        node -= np.uint64(1)
        link = Link(links, node)
        left_node = link.left
        box = boxes + node * np.uint64(REF_BYTES)
        to = cost_at + node * np.uint64(COST_BYTES)
        if left_node < np.int32(0):
            store(to, leaf_costs(box, settings.costs))
        else:
            right_node = link.right
            left = load(f32x8, cost_at + np.uint64(left_node) * np.uint64(COST_BYTES))
            right = load(f32x8, cost_at + np.uint64(right_node) * np.uint64(COST_BYTES))
            merged = merge_costs(box, link, left, right, settings.max_leaf_size, settings.costs)
            store(to, merged)
    return load(f32x8, costs)


@device
def is_leaf(links, node):
    """Whether a binary node that fills one lane is a leaf."""
    link = Link(links, np.uint64(node))
    if link.left < np.int32(0):
        return True
    return (link.decision & np.int32(_IS_LEAF)) != np.int32(0)


@device_call
def list_children(links, node, pending, to):
    """List the binary nodes in the lanes of a wide node.

    Parameters
    ----------
    links : uint64
        Address of the links.
    node : int32
    pending, to : uint64
        Addresses of LISTING_BYTES of scratch, and of 8 int32 to write.

    Returns
    -------
    uint64
        Their number.
    """
    count = np.uint64(0)
    root = _Listed(pending)
    root.node, root.lanes = np.int32(node), np.int32(WIDTH)
    top = np.uint64(1)
    while top != np.uint64(0):
        top -= np.uint64(1)
        listed = _Listed(pending, top)
        child, lanes = listed.node, listed.lanes
        link = Link(links, np.uint64(child))
        share = np.int32(0)
        if link.left >= np.int32(0) and lanes > np.int32(1):
            share = (link.decision >> (np.int32(3) * (lanes - np.int32(2)))) & np.int32(7)
        if share == np.int32(0):
            store(to + count * np.uint64(4), child)
            count += np.uint64(1)
        else:
            listed.node, listed.lanes = link.right, np.int32(lanes - share)
            nearer = _Listed(pending, top + np.uint64(1))
            nearer.node, nearer.lanes = link.left, np.int32(share)
            top += np.uint64(2)
    return count


@kernel
def collapse_top(parts, nodes, spans, bounds, costs, tree, settings):
    """Write the nodes above the subtrees, and decide their collapse.

    Parameters
    ----------
    parts : ndarray of shape (U, 2), int32
        Rows of a range's two parts in these arrays, after its own; -1 for a subtree.
    nodes : ndarray of shape (U,), int32
        Row of each range's root in the tree.
    spans : ndarray of shape (U, 2), int32
        Its first reference, and after its last one.
    bounds : ndarray of shape (U, 8), float32
        Boxes around the references.
    costs : ndarray of shape (U, 8), float32
        Given for subtrees; written for the others.
    tree : BinaryTree
    settings : BuildSettings
    """
    cost_at, box_at, link_at = address(costs), address(tree.boxes), address(tree.links)
    for i in range(np.uint64(len(parts))):
        row = np.uint64(len(parts)) - np.uint64(1) - i
        if parts[row, 0] < 0:
            continue
        left, right = np.uint64(parts[row, 0]), np.uint64(parts[row, 1])
        node = np.uint64(nodes[row])
        box = box_at + node * np.uint64(REF_BYTES)
        link = Link(link_at, node)
        whole = load(f32x8, address(bounds) + row * np.uint64(REF_BYTES))
        put_node(box_at, link_at, node, whole, spans[row, 0], spans[row, 1])
        link.left, link.right = np.int32(nodes[left]), np.int32(nodes[right])
        link.is_top = np.int32(1)
        left_costs = load(f32x8, cost_at + left * np.uint64(COST_BYTES))
        right_costs = load(f32x8, cost_at + right * np.uint64(COST_BYTES))
        most = settings.max_leaf_size
        merged = merge_costs(box, link, left_costs, right_costs, most, settings.costs)
        store(cost_at + row * np.uint64(COST_BYTES), merged)
