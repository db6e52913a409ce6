"""BVH traversal: one ray, a stack, the nearer child first."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device
from raystream.kernels.leaf import test_triangles
from raystream.kernels.slab import box_interval

__all__ = ["traverse"]

_INF = np.float32(np.inf)


@device
def _child_entry(boxes, node, child, ray, t_min, t_far):
    """Where the ray enters a child's box, or inf if nothing that is wanted lies in it.

    A box is left out only when it is entered *beyond* t_far: a hit at the same distance
    with a lower prim_id may be in it.
    """
    box = boxes[node, child]
    low, high = box[0], box[1]
    t_in, t_out = box_interval(ray, low[0], low[1], low[2], high[0], high[1], high[2])
    t_in = max(t_in, t_min)
    return t_in if t_in <= min(t_out, t_far) else _INF


@device
def _push(stack, size, children, node, child, t_in):
    link = children[node, child]
    stack.node[size] = link[0]
    stack.leaf_count[size] = link[1]
    stack.t_in[size] = t_in
    return size + np.uint64(1)


@device
def traverse(arrays, ray, t_min, t_max, surfaces, keep, capacity, first, out, stack):
    """Visit the boxes that a ray meets; see `kernels.queries.ray_queries` for the arguments."""
    count = 0
    if len(arrays.children) == 0 or not (t_min <= t_max):
        return count
    t_far = t_max
    stack.node[0] = np.int32(0)
    stack.leaf_count[0] = np.int32(0)
    stack.t_in[0] = t_min
    size = np.uint64(1)
    while size != np.uint64(0):
        size -= np.uint64(1)
        if stack.t_in[size] > t_far:
            continue
        node = np.uint64(stack.node[size])
        leaf_count = stack.leaf_count[size]

        if leaf_count != 0:
            count, t_far = test_triangles(
                ray,
                arrays.corners,
                arrays.prim_ids,
                node,
                node + np.uint64(leaf_count),
                t_min,
                t_far,
                surfaces,
                keep,
                count,
                capacity,
                first,
                out,
            )
            if count == capacity and not keep:
                break
            continue

        entry_0 = _child_entry(arrays.boxes, node, np.uint64(0), ray, t_min, t_far)
        entry_1 = _child_entry(arrays.boxes, node, np.uint64(1), ray, t_min, t_far)
        nearer = np.uint64(1) if entry_1 < entry_0 else np.uint64(0)
        near_entry, far_entry = min(entry_0, entry_1), max(entry_0, entry_1)
        if far_entry < _INF:
            size = _push(stack, size, arrays.children, node, np.uint64(1) - nearer, far_entry)
        if near_entry < _INF:
            size = _push(stack, size, arrays.children, node, nearer, near_entry)
    return count
