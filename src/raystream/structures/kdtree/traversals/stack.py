"""kd-stack: continue at the far child pushed last (Foley 2005, Figure 2)."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import load, store
from raystream.structures.kdtree.state import KdState

_T_OUT = np.uint64(4)
_ENTRY = np.uint64(8)


@device
def push(stack, state, node):
    """Push a node to be searched after the state's own, up to the state's t_out."""
    store(stack + state.top, np.uint32(node))
    store(stack + (state.top + _T_OUT), state.t_out)
    return state.top + _ENTRY


@device
def continue_search(state, stack):
    """Continue at the node on top, which begins where the leaf ends: only then was it pushed."""
    top = state.top - _ENTRY
    node, t_out = load(np.uint32, stack + top), load(np.float32, stack + (top + _T_OUT))
    return KdState(np.uint64(node), state.t_out, t_out, state.t_end, top, False)
