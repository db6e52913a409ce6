"""BVHs in float64 on the GPU: binary nodes with boxes in float32, and the CPU's leaf blocks."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from raystream.cuda.bvh import binary, points
from raystream.cuda.bvh.kernels import LaidOut, with_arrays
from raystream.cuda.bvh.walk import binary_walk, one_tree
from raystream.geometry.float64.nearest import tree_search
from raystream.geometry.float64.queries import LANES_BYTES
from raystream.geometry.float64.structure import Float64Bvh
from raystream.geometry.float64.traversal import blocks_by, box_interval
from raystream.jit.constants import ZERO_F64
from raystream.jit.cpu import device

#: Bytes of a search's memory: lanes of a block, and the stack.
stack_bytes = LANES_BYTES + binary.STACK_BYTES


@device
def _enter(box, line, _search, near, far):
    ray, _, _ = line
    low_x, high_x, low_y, high_y, low_z, high_z = box
    if ray.inv[0] < ZERO_F64:
        low_x, high_x = high_x, low_x
    if ray.inv[1] < ZERO_F64:
        low_y, high_y = high_y, low_y
    if ray.inv[2] < ZERO_F64:
        low_z, high_z = high_z, low_z
    t_in, t_out = box_interval((low_x, low_y, low_z), (high_x, high_y, high_z), ray)
    return t_in, max(t_in, near) <= min(t_out, far)


def _walk(
    interval: Callable[..., Any], enter: Callable[..., Any], visit_leaf: Callable[..., Any]
) -> Callable[..., Any]:
    walk_tree = binary_walk(interval, enter, one_tree(visit_leaf))

    @device
    def walk(tree, line, search, stack, _wants_any):
        return walk_tree(tree, line, search, stack)

    return walk


traverse = blocks_by(_walk, _enter)

point_search = tree_search(points.nearest_walk, points.STACK_BYTES)


def lay_out(structure: Float64Bvh) -> LaidOut:
    """Convert the nodes; see `bvh.kernels.LAYOUTS`."""
    return with_arrays(structure, {"nodes": binary.unfold(structure.arrays["nodes"]).nodes})
