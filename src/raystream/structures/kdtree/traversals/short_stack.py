"""The short stack: a ring that forgets its oldest nodes, and a node to begin again at.

A whole stack has room for every split on a path, and each of many thousand rays in flight needs
one. A short stack keeps the few nodes that were left last. When it is asked for one that it has
forgotten, the search begins again: not at the root but at the lowest node that holds all that is
left of the ray. `descend` comes to that node whenever a state's t_out is its t_end, so it is noted
there when the first node is put on an empty stack.

Horn and others, "Interactive k-D Tree GPU Raytracing", Interactive 3D Graphics 2007 ("push-down"
and "short-stack").

In memory: the node to begin again at, in 8 bytes, then `PLACES` nodes, each with the end of its
interval. In `KdState.top`: the place that is next, and from bit 8 on how many nodes are kept.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raystream.jit.cpu import device
from raystream.jit.simd import load, store
from raystream.structures.kdtree.state import KdState

__all__ = ["PLACES", "continue_search", "has_forgotten", "kept_entries", "push"]

#: Nodes that are kept; a power of two.
PLACES = 4

_MASK = np.uint64(PLACES - 1)
_MOST = np.uint64(PLACES)
_COUNT_SHIFT = np.uint64(8)
_NONE = np.uint64(0)
_ONE = np.uint64(1)
_WORD = np.uint64(4)
_ENTRY = np.uint64(8)


@device
def has_forgotten(state):
    """Whether the stack has nothing to give: what comes next was forgotten."""
    return state.top >> _COUNT_SHIFT == _NONE


@device
def push(stack, state, node):
    """Keep a node that is to be searched after a state's own, up to the state's t_out.

    Parameters
    ----------
    stack : uint64
        Address of `SHORT_STACK_BYTES`.
    state : KdState
        At the split above the node.
    node : uint64

    Returns
    -------
    uint64
        The new `KdState.top`.
    """
    if state.t_out == state.t_end:  # so nothing is on the stack, whatever was
        store(stack, np.uint32(state.node))
    place = state.top & _MASK
    at = stack + (place + _ONE) * _ENTRY
    store(at, np.uint32(node))
    store(at + _WORD, state.t_out)
    count = min((state.top >> _COUNT_SHIFT) + _ONE, _MOST)
    return ((place + _ONE) & _MASK) | (count << _COUNT_SHIFT)


@device
def continue_search(state, stack):
    """Go on at the node that was kept last, or where to begin again.

    Parameters
    ----------
    state : KdState
        At the leaf; its t_out must be before t_end, so something was put on the stack once.
    stack : uint64

    Returns
    -------
    KdState
    """
    t_in, t_end = state.t_out, state.t_end
    if has_forgotten(state):
        node = np.uint64(load(np.uint32, stack))
        return KdState(node, t_in, t_end, t_end, _NONE, False)
    # The child that was kept last begins where the leaf ends: only then was it kept.
    place = (state.top - _ONE) & _MASK
    at = stack + (place + _ONE) * _ENTRY
    node = np.uint64(load(np.uint32, at))
    count = (state.top >> _COUNT_SHIFT) - _ONE
    top = place | (count << _COUNT_SHIFT)
    return KdState(node, t_in, load(np.float32, at + _WORD), t_end, top, False)


def kept_entries(memory: NDArray[np.uint8], top: int) -> NDArray[np.uint32]:
    """What is on a short stack, for those who look on: nodes, and bits of the ends, oldest first.

    Parameters
    ----------
    memory : ndarray of shape (`SHORT_STACK_BYTES`,), uint8
    top : int
        `KdState.top`.

    Returns
    -------
    ndarray of shape (N, 2), uint32
    """
    ring = memory[8 : 8 + 8 * PLACES].view(np.uint32).reshape(PLACES, 2)
    count, place = top >> 8, top % PLACES
    return ring[(place - count + np.arange(count)) % PLACES]
