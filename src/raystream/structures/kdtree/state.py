"""The state of a search in a kd-tree."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.structures.kdtree.options import MAX_DEPTH

#: How a search continues after a leaf.
STACK, RESTART, BACKTRACK, SHORT_STACK = np.arange(4, dtype=np.uint64)

#: Bytes of a stack: a node and the end of its interval for each split on a path.
STACK_BYTES = 8 * (MAX_DEPTH + 1)

#: Bytes of a short stack: the restart node, and a ring of `traversals.short_stack.PLACES`.
SHORT_STACK_BYTES = 40


class KdState(NamedTuple):
    """The state of a ray's search.

    Attributes
    ----------
    node : uint64
        See `nodes`.
    t_in, t_out : float32
        The part of the ray in the node: t_in <= t < t_out.
    t_end : float32
        End of the search: the next float32 after the last t wanted.
    top : uint64
        Bytes on the stack; for a short one see `traversals.short_stack`.
    is_backtracking : bool
        The search continues above the node: `backtrack` is next.
    """

    node: np.uint64
    t_in: np.float32
    t_out: np.float32
    t_end: np.float32
    top: np.uint64
    is_backtracking: bool
