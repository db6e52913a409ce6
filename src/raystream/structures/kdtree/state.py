"""What a search in a kd-tree works on: the tree by address, the ray, and where the search is."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.cpu import device
from raystream.structures.kdtree.options import MAX_DEPTH

__all__ = [
    "BACKTRACK",
    "EXTENDED",
    "EXTENDED_LINK",
    "RESTART",
    "SHORT_STACK",
    "SHORT_STACK_BYTES",
    "STACK",
    "STACK_BYTES",
    "KdAddresses",
    "KdLeaf",
    "KdSplit",
    "KdState",
    "SplitRay",
    "split_ray",
]

#: How a search goes on after a leaf.
STACK, RESTART, BACKTRACK, SHORT_STACK = np.arange(4, dtype=np.uint64)

#: Bytes of the stack: a node and the end of its interval for each split on a path.
STACK_BYTES = 8 * (MAX_DEPTH + 1)

#: Bytes of a short one: a node to begin again at, and a ring of `traversals.short_stack.PLACES`.
SHORT_STACK_BYTES = 40

#: Bytes of an extended record of `packed.extend`, and where its link is.
EXTENDED, EXTENDED_LINK = np.uint64(32), np.uint64(24)

_HALF = np.float32(0.5)


class KdAddresses(NamedTuple):
    """A tree as kernels take it; whoever calls one keeps the arrays alive.

    Attributes
    ----------
    nodes : uint64
        Address of `layout.KdArrays.nodes`, or of `packed.PackedArrays.splits`; 0 for an empty
        tree.
    leaves : uint64 or None
        Address of `packed.PackedArrays.leaves`; None for nodes of 8 bytes.
    extended : uint64
        Address of what `packed.extend` gives; only for `BACKTRACK`.
    blocks : uint64
        Address of the leaf blocks.
    root : uint64
    traversal : uint64
        `STACK`, `RESTART`, `BACKTRACK` or `SHORT_STACK`.
    low, high : tuple of three float32
        The scene's box.
    """

    nodes: np.uint64
    leaves: np.uint64 | None
    extended: np.uint64
    blocks: np.uint64
    root: np.uint64
    traversal: np.uint64
    low: tuple[np.float32, np.float32, np.float32]
    high: tuple[np.float32, np.float32, np.float32]


class SplitRay(NamedTuple):
    """What steps need of a ray: the constants of its distances to split planes.

    Attributes
    ----------
    inv_x, inv_y, inv_z, middle_x, middle_y, middle_z : float32
    """

    inv_x: np.float32
    inv_y: np.float32
    inv_z: np.float32
    middle_x: np.float32
    middle_y: np.float32
    middle_z: np.float32


class KdState(NamedTuple):
    """Where a ray's search is.

    Attributes
    ----------
    node : uint64
        A node. In Foley's layout bit 31 says that it is a leaf, and the rest is its row.
    t_in, t_out : float32
        The part of the ray in the node: t_in <= t < t_out.
    t_end : float32
        Where the search ends: just after the last t that is wanted.
    top : uint64
        Bytes on the stack; of a short one see `traversals.short_stack`.
    is_backtracking : bool
        The search goes on above the node: `backtrack` is next.
    """

    node: np.uint64
    t_in: np.float32
    t_out: np.float32
    t_end: np.float32
    top: np.uint64
    is_backtracking: bool


class KdSplit(NamedTuple):
    """A node with a plane.

    Attributes
    ----------
    position : float32
    axis : uint64
    below, above : uint64
        Its children.
    """

    position: np.float32
    axis: np.uint64
    below: np.uint64
    above: np.uint64


class KdLeaf(NamedTuple):
    """The triangles of a leaf.

    Attributes
    ----------
    block, end : uint64
        Addresses of its first block, and after its last one.
    triangle_count : uint64
    """

    block: np.uint64
    end: np.uint64
    triangle_count: np.uint64


@device
def split_ray(ray):
    """What steps need of a `kernels.ray.Ray`.

    ``middle`` is the mean of the slab constants of both paddings: that of a plane without any,
    to two roundings.
    """
    return SplitRay(
        ray.inv_x,
        ray.inv_y,
        ray.inv_z,
        (ray.near_x + ray.far_x) * _HALF,
        (ray.near_y + ray.far_y) * _HALF,
        (ray.near_z + ray.far_z) * _HALF,
    )
