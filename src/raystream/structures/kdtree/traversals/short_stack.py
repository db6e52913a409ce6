"""kd-short-stack: continue from a ring that drops its oldest nodes, or from a restart node.

A full stack has an entry for every split on a path, and each of many thousand rays in flight needs
one. A short stack keeps the few nodes pushed last. When it is empty, the search restarts: not at
the root but at the lowest node that contains the rest of the ray ("push-down"). `descend` is at
that node whenever a state's t_out is its t_end, so it is stored when the first node is pushed on
an empty stack.

Horn and others, "Interactive k-D Tree GPU Raytracing", Interactive 3D Graphics 2007 ("push-down"
and "short-stack").

In memory: the restart node, in 8 bytes, then `PLACES` nodes, each with the end of its interval.
In `KdState.top`: the next place, and from bit 8 on the number of entries.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raystream.jit.constants import BYTES_32, ONE_U64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import load, store
from raystream.structures.kdtree.state import KdState

#: Entries; a power of two.
PLACES = 4

_MASK = np.uint64(PLACES - 1)
_MOST = np.uint64(PLACES)
_COUNT_SHIFT = np.uint64(8)
_ENTRY = np.uint64(8)


@device
def is_empty(state):
    """Whether the stack is empty: the next node was dropped."""
    return state.top >> _COUNT_SHIFT == ZERO_U64


@device
def push(stack, state, node):
    """Push a node to be searched after the state's own, up to the state's t_out.

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
    if state.t_out == state.t_end:  # the stack is empty
        store(stack, np.uint32(state.node))
    place = state.top & _MASK
    at = stack + (place + ONE_U64) * _ENTRY
    store(at, np.uint32(node))
    store(at + BYTES_32, state.t_out)
    count = min((state.top >> _COUNT_SHIFT) + ONE_U64, _MOST)
    return ((place + ONE_U64) & _MASK) | (count << _COUNT_SHIFT)


@device
def continue_search(state, stack):
    """Continue at the node pushed last, or at the restart node.

    Parameters
    ----------
    state : KdState
        At the leaf; its t_out must be before t_end, so a node was pushed before.
    stack : uint64

    Returns
    -------
    KdState
    """
    t_in, t_end = state.t_out, state.t_end
    if is_empty(state):
        node = np.uint64(load(np.uint32, stack))
        return KdState(node, t_in, t_end, t_end, ZERO_U64, False)
    # The child pushed last begins where the leaf ends: only then was it pushed.
    place = (state.top - ONE_U64) & _MASK
    at = stack + (place + ONE_U64) * _ENTRY
    node = np.uint64(load(np.uint32, at))
    count = (state.top >> _COUNT_SHIFT) - ONE_U64
    top = place | (count << _COUNT_SHIFT)
    return KdState(node, t_in, load(np.float32, at + BYTES_32), t_end, top, False)


def stack_entries(memory: NDArray[np.uint8], top: int) -> NDArray[np.uint32]:
    """The entries of a short stack, for inspection: nodes, and bits of the ends, oldest first.

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
