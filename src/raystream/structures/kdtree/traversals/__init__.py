"""How a search continues after a leaf, by traversal: Foley's three and Horn's."""

from __future__ import annotations

from raystream.jit.cpu import device
from raystream.structures.kdtree.state import RESTART, SHORT_STACK, STACK
from raystream.structures.kdtree.traversals import backtrack, restart, short_stack, stack

__all__ = ["continue_search", "push", "restarts"]


@device
def push(tree, memory, state, node):
    """Push the far child of a split, for traversals with a stack.

    Parameters
    ----------
    tree : KdAddresses
    memory : uint64
        Address of `STACK_BYTES`, or of `SHORT_STACK_BYTES`, if the traversal has a stack.
    state : KdState
        At the split.
    node : uint64
        The child; its interval ends where the split's does.

    Returns
    -------
    uint64
        The new `KdState.top`.
    """
    if tree.traversal == STACK:
        return stack.push(memory, state, node)
    if tree.traversal == SHORT_STACK:
        return short_stack.push(memory, state, node)
    return state.top


@device
def restarts(tree, state):
    """Whether `continue_search` will restart, at the root or below."""
    if tree.traversal == SHORT_STACK:
        return short_stack.is_empty(state)
    return tree.traversal == RESTART


@device
def continue_search(tree, state, memory):
    """Continue after a leaf (Foley's Continue).

    Parameters
    ----------
    tree : KdAddresses
    state : KdState
        At the leaf; its t_out must be before t_end.
    memory : uint64
        See `push`.

    Returns
    -------
    KdState
        At the next split or leaf to search; or backtracking.
    """
    if tree.traversal == STACK:
        return stack.continue_search(state, memory)
    if tree.traversal == SHORT_STACK:
        return short_stack.continue_search(state, memory)
    if tree.traversal == RESTART:
        return restart.continue_search(tree, state)
    return backtrack.continue_search(state)
