"""kd-backtrack: continue at the lowest ancestor with the rest of the ray (Foley 2005, Figure 4)."""

from __future__ import annotations

import numpy as np

from raystream.jit.constants import ZERO_F32, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import fma, load
from raystream.structures.kdtree.nodes import parent_of
from raystream.structures.kdtree.state import KdState

# Byte offsets in an extended split: second and third coordinate of a corner, and the high corner.
_Y = np.uint64(4)
_Z = np.uint64(8)
_HIGH = np.uint64(12)


@device
def continue_search(state):
    """Start to backtrack from the leaf."""
    return KdState(state.node, state.t_out, state.t_end, state.t_end, ZERO_U64, True)


@device
def backtrack(tree, line, state):
    """Go to the parent of a node, and stop there if it contains t_in (Foley's Up).

    Parameters
    ----------
    tree : KdAddresses
    line : SplitRay
    state : KdState
        Backtracking.

    Returns
    -------
    KdState

    Notes
    -----
    Ancestors contain all that was searched, so only the exit of the ray matters: the first of
    the planes that it approaches. The root has none.
    """
    node, low = parent_of(tree, state.node)
    high = low + _HIGH
    x = load(np.float32, high if line.inv_x > ZERO_F32 else low)
    y = load(np.float32, (high if line.inv_y > ZERO_F32 else low) + _Y)
    z = load(np.float32, (high if line.inv_z > ZERO_F32 else low) + _Z)
    t_out = min(
        fma(x, line.inv_x, line.middle_x),
        fma(y, line.inv_y, line.middle_y),
        fma(z, line.inv_z, line.middle_z),
    )
    is_backtracking = not state.t_in < t_out
    t_out = min(t_out, state.t_end)
    return KdState(node, state.t_in, t_out, state.t_end, state.top, is_backtracking)
