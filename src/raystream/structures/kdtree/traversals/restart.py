"""kd-restart: continue at the root with the rest of the ray (Foley 2005, Figure 3)."""

from __future__ import annotations

from raystream.jit.constants import ZERO_U64
from raystream.jit.cpu import device
from raystream.structures.kdtree.state import KdState


@device
def continue_search(tree, state):
    """Continue at the root: t_min = t_max, t_max = the end of the ray."""
    return KdState(tree.root, state.t_out, state.t_end, state.t_end, ZERO_U64, False)
