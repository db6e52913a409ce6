"""Single-ray traversal of the binary layout: a while-while loop over nodes and leaves.

The threads of a warp converge where all of them visit nodes, or all test triangles. So a thread
visits nodes until it reaches a leaf, then leaves until it reaches a node.

References
----------
Aila, Laine, "Understanding the Efficiency of Ray Traversal on GPUs", High Performance Graphics
2009: the while-while kernel, without its speculative variant, which polls the other threads.
"""

from __future__ import annotations

import numpy as np

from raystream.cuda.bvh.triangles import TRIANGLE, test_triangle
from raystream.jit.constants import NULL, ONE_U64
from raystream.jit.cpu import device
from raystream.jit.simd import f32x4, float_as_bits, lane, load, load_constant, store
from raystream.kernels.search import is_full
from raystream.kernels.slab import box_interval
from raystream.kernels.tally import LEAVES, STEPS, add_to

_ENTRY = np.uint64(4)
_NODE = np.uint64(64)
_ROOT = np.int32(0)
_DONE = np.int32(2**31 - 1)


@device
def traverse(tree, ray, search, stack):
    """Traverse the boxes that a ray enters; see `kernels.queries.ray_queries` for the arguments."""
    if tree.nodes == NULL or not (search.t_min <= search.t_far):
        return search
    link, top = _ROOT, stack
    while link != _DONE:
        while link >= _ROOT and link != _DONE:
            add_to(search.counters, STEPS, ONE_U64)
            at = tree.nodes + np.uint64(link) * _NODE
            link, top = _visit(at, ray, search.t_min, search.t_far, stack, top)
        while link < _ROOT:
            add_to(search.counters, LEAVES, ONE_U64)
            triangle = tree.triangles + np.uint64(~link) * TRIANGLE
            while True:
                search, is_last = test_triangle(triangle, ray, search)
                if is_full(search):
                    return search
                if is_last:
                    break
                triangle += TRIANGLE
            link, top = _pop(stack, top)
    return search


@device
def _visit(at, ray, t_min, t_far, stack, top):
    """Descend to the nearer child that the ray enters, and push the other one.

    Parameters
    ----------
    at : uint64
        Address of the node.
    ray : Ray
    t_min, t_far : float32
    stack, top : uint64

    Returns
    -------
    link : int32
        A node or leaf, or `_DONE`.
    top : uint64
    """
    left, right, near, far = _child_intervals(at, ray)
    enters_left = max(left[0], t_min) <= min(left[1], t_far)
    enters_right = max(right[0], t_min) <= min(right[1], t_far)
    if not (enters_left or enters_right):
        return _pop(stack, top)
    if enters_right and (not enters_left or right[0] < left[0]):
        near, far = far, near
    if enters_left and enters_right:
        store(top, far)
        top += _ENTRY
    return near, top


@device
def _child_intervals(at, ray):
    """Intervals in which a ray is inside the boxes of a node's children.

    Parameters
    ----------
    at : uint64
        Address of the node.
    ray : Ray

    Returns
    -------
    left, right : tuple of two float32
    left_child, right_child : int32
        Nodes or leaves.
    """
    left = load_constant(f32x4, at)
    right = load_constant(f32x4, at + np.uint64(16))
    both = load_constant(f32x4, at + np.uint64(32))
    links = float_as_bits(load_constant(f32x4, at + np.uint64(48)))
    return (
        _interval(ray, left, lane(both, 0), lane(both, 1)),
        _interval(ray, right, lane(both, 2), lane(both, 3)),
        lane(links, 0),
        lane(links, 1),
    )


@device
def _interval(ray, box, low_z, high_z):
    return box_interval(ray, lane(box, 0), lane(box, 2), low_z, lane(box, 1), lane(box, 3), high_z)


@device
def _pop(stack, top):
    """Pop the latest child, or `_DONE` from an empty stack."""
    if top == stack:
        return _DONE, top
    top -= _ENTRY
    return load(np.int32, top), top
