"""Packet traversal of the binary layout: the rays of a warp traverse it together.

All rays visit the same nodes: a node is entered if any ray enters it, starting with the child that
most rays prefer, and a leaf's triangles are tested by all. So a node is read once per warp, and
threads do not diverge, but each ray visits the nodes of all: cheap for coherent rays, expensive for
others.

Hits do not depend on the order of nodes. Only votes, and values that are the same in all threads,
steer the traversal, so that the threads stay converged. Instead of the paper's stack per packet, in
shared memory, each thread has its own, with the same contents.

References
----------
Guenther, Popov, Seidel and Slusallek, "Realtime Ray Tracing on GPU with BVH-based Packet
Traversal", IEEE/Eurographics Symposium on Interactive Ray Tracing 2007.
"""

from __future__ import annotations

import numpy as np

from raystream.cuda.bvh.binary_traversal import child_intervals, pop
from raystream.cuda.bvh.triangles import TRIANGLE, test_triangle
from raystream.jit.constants import NULL, ONE_U64, ZERO_U32
from raystream.jit.cpu import device
from raystream.jit.simd import popcount, store
from raystream.jit.warp import active_mask, ballot
from raystream.kernels.search import is_full
from raystream.kernels.tally import LEAVES, STEPS, add_to

__all__ = ["traverse"]

_ENTRY = np.uint64(4)
_NODE = np.uint64(64)
_ROOT = np.int32(0)
_DONE = np.int32(2**31 - 1)


@device
def traverse(tree, ray, search, stack):
    """Traverse the boxes that any ray of the warp enters.

    See `kernels.queries.ray_queries` for the arguments.
    """
    if tree.nodes == NULL or not (search.t_min <= search.t_far):
        return search
    voters = active_mask()
    is_searching = True
    link, top = _ROOT, stack
    while link != _DONE:
        if link >= _ROOT:
            add_to(search.counters, STEPS, ONE_U64)
            at = tree.nodes + np.uint64(link) * _NODE
            t_min, t_far = search.t_min, search.t_far
            link, top = _visit(at, ray, t_min, t_far, is_searching, voters, stack, top)
            continue
        add_to(search.counters, LEAVES, ONE_U64)
        triangle = tree.triangles + np.uint64(~link) * TRIANGLE
        is_last = not is_searching
        while not is_last:
            search, is_last = test_triangle(triangle, ray, search)
            if is_full(search):
                is_searching, is_last = False, True
            triangle += TRIANGLE
        if ballot(voters, is_searching) == ZERO_U32:
            return search
        link, top = pop(stack, top)
    return search


@device
def _visit(at, ray, t_min, t_far, is_searching, voters, stack, top):
    """Descend to a child that any ray enters; see `binary_traversal`.

    Parameters
    ----------
    at : uint64
        Address of the node.
    ray : Ray
    t_min, t_far : float32
    is_searching : bool
        Whether the ray votes.
    voters : uint32
        See `jit.warp`.
    stack, top : uint64

    Returns
    -------
    link : int32
        A node or leaf, or `_DONE`.
    top : uint64
    """
    left, right, near, far = child_intervals(at, ray)
    enters_left = is_searching and max(left[0], t_min) <= min(left[1], t_far)
    enters_right = is_searching and max(right[0], t_min) <= min(right[1], t_far)
    wants_right = enters_right and (not enters_left or right[0] < left[0])
    lefts, rights = ballot(voters, enters_left), ballot(voters, enters_right)
    if (lefts | rights) == ZERO_U32:
        return pop(stack, top)
    for_right = ballot(voters, wants_right)
    everyone = np.uint64(np.uint32(lefts | rights))
    if popcount(np.uint64(for_right)) + popcount(np.uint64(for_right)) > popcount(everyone):
        near, far = far, near
        lefts, rights = rights, lefts
    if lefts == ZERO_U32:
        return far, top
    if rights != ZERO_U32:
        store(top, far)
        top += _ENTRY
    return near, top
