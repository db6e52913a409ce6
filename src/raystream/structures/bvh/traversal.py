"""Traversal of the wide tree by a single ray: `walk` with the ray's boxes. For all queries."""

from __future__ import annotations

from raystream.jit.constants import INF_F32, ONE_U64
from raystream.jit.cpu import device
from raystream.kernels.leaf_block import block_ray, search_blocks
from raystream.kernels.search import is_full, wants_any
from raystream.kernels.tally import LEAVES, STEPS, add_to
from raystream.structures.bvh.steps import enter, leaf_blocks
from raystream.structures.bvh.walks.single import tree_walk


@device
def _interval(line, search):
    return search.t_min, search.t_far, search.t_far


@device
def _enter(node, line, search, t_min, t_far):
    add_to(search.counters, STEPS, ONE_U64)
    return enter(node, line, t_min, t_far)


def tree_traversal(search_leaf):
    """Make the traversal of a wide tree.

    Parameters
    ----------
    search_leaf : device function
        ``search_leaf(tree, child, line, search, stack) -> search`` offers the hits in a leaf to a
        search; `line` is the `BlockRay`. See `tree_walk` for the memory at `stack`.

    Returns
    -------
    function
        See `kernels.queries.ray_queries`.
    """

    @device
    def visit_leaf(tree, child, line, search, stack):
        add_to(search.counters, LEAVES, ONE_U64)
        search = search_leaf(tree, child, line, search, stack)
        return search, is_full(search)

    walk = tree_walk(_interval, _enter, visit_leaf)

    def traverse(tree, ray, search, stack):
        return walk(tree, block_ray(ray), search, stack, wants_any(search))

    return traverse


@device
def _search_blocks(tree, child, line, search, stack):
    block, end = leaf_blocks(tree, child)
    return search_blocks(block, end, line, search, search.t_min, INF_F32)


#: Traverse the tree of triangles with a ray.
traverse = device(tree_traversal(_search_blocks))
