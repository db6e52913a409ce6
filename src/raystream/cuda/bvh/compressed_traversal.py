"""Single-ray traversal of the compressed layout, with a stack of the remaining parts of nodes.

Planes are not decoded: the distance to p + q s is fma(q, s inv, base), with base = p inv + near.
That is one FMA per plane, as for an uncompressed box. The product s inv is exact, since s is a
power of two; base is rounded, so it is moved down, or up for the far planes, by more than its
error. Rounding is monotone: a ray enters a quantised box no later, and leaves it no earlier, than
the exact box within it, bit for bit, and the guarantees that the CPU's traversal relies on
(`kernels.slab.box_interval`) hold here.

A search's state is the group of a node's children that are still to be visited: the row of the
first child node, the mask of slots that are nodes, and the mask of those entered, in the ray's
order. Its triangles are tested before the next node is visited; the paper's test of whether enough
threads of a warp take part is omitted, since it depends on the other threads.

References
----------
Ylitie, Karras, Laine 2017, section 4.
"""

from __future__ import annotations

import numpy as np

from raystream.cuda.bvh.triangles import TRIANGLE, test_triangle
from raystream.jit.constants import NULL, ONE_U32, ONE_U64, ZERO_F32, ZERO_U32
from raystream.jit.cpu import device
from raystream.jit.simd import (
    bits_as_float,
    count_trailing_zeros,
    fma,
    lane,
    load,
    load_constant,
    popcount,
    store,
    u32x4,
)
from raystream.kernels.search import is_full
from raystream.kernels.tally import LEAVES, STEPS, add_to

__all__ = ["traverse"]

_ENTRY = np.uint64(8)
_NODE = np.uint64(80)
_QUARTER = np.uint64(16)
_BYTE = np.uint32(255)
_EIGHT = np.uint32(8)
_FIVE = np.uint32(5)
_OFFSET = np.uint32(31)
_EXPONENT_AT = np.uint32(23)
_IS_NODE = np.uint32(7)

#: Relative and absolute terms that together exceed a unit in the last place of any float32.
_UNIT = np.float32(2.0**-23)
_LEAST = np.float32(2.0**-149)


@device
def traverse(tree, ray, search, stack):
    """Traverse the boxes that a ray enters; see `kernels.queries.ray_queries` for the arguments."""
    if tree.nodes == NULL or not (search.t_min <= search.t_far):
        return search
    turned = _octant(ray)
    # The root, as the only child of a node.
    base, inner, hits = ZERO_U32, ONE_U32, np.uint32(ONE_U32 << turned)
    top = stack
    while True:
        # Step 1: the nearest node of the group; push the rest.
        bit = np.uint32(count_trailing_zeros(np.uint64(hits)))
        hits = np.uint32(hits & (hits - ONE_U32))
        before = np.uint32((ONE_U32 << np.uint32(bit ^ turned)) - ONE_U32)
        node = np.uint64(base) + popcount(np.uint64(np.uint32(inner & before)))
        if hits != ZERO_U32:
            store(top, base)
            store(top + np.uint64(4), np.uint32((hits << _EIGHT) | inner))
            top += _ENTRY
        add_to(search.counters, STEPS, ONE_U64)
        at = tree.nodes + node * _NODE
        base, inner, hits, triangle, pending = _visit(at, ray, turned, search)
        # Step 2: the triangles of its leaves.
        triangle = tree.triangles + triangle * TRIANGLE
        while pending != ZERO_U32:
            place = count_trailing_zeros(np.uint64(pending))
            pending = np.uint32(pending & (pending - ONE_U32))
            search, _ = test_triangle(triangle + place * TRIANGLE, ray, search)
            if is_full(search):
                return search
        # Step 3: the next group.
        if hits == ZERO_U32:
            if top == stack:
                return search
            top -= _ENTRY
            base = load(np.uint32, top)
            hits = load(np.uint32, top + np.uint64(4))
            inner = np.uint32(hits & _BYTE)
            hits = np.uint32(hits >> _EIGHT)


@device
def _octant(ray):
    """Octant of a ray: bit k is set if its direction is negative along axis k."""
    x = ONE_U32 if ray.inv_x < ZERO_F32 else ZERO_U32
    y = np.uint32(2) if ray.inv_y < ZERO_F32 else ZERO_U32
    z = np.uint32(4) if ray.inv_z < ZERO_F32 else ZERO_U32
    return np.uint32(x | y | z)


@device
def _visit(at, ray, turned, search):
    """Test the boxes of a node's children.

    Parameters
    ----------
    at : uint64
        Address of the node.
    ray : Ray
    turned : uint32
        See `_octant`.
    search : Search

    Returns
    -------
    base, inner, hits : uint32
        Row of the first child node; mask of slots that are nodes; mask of those entered, in the
        ray's order.
    triangle : uint64
        Row of the first triangle.
    pending : uint32
        Mask of the triangles of the leaves entered, counted from the first one.
    """
    head = load_constant(u32x4, at)
    links = load_constant(u32x4, at + _QUARTER)
    planes = load_constant(u32x4, at + np.uint64(32))
    more = load_constant(u32x4, at + np.uint64(48))
    rest = load_constant(u32x4, at + np.uint64(64))
    exponents = lane(head, 3)
    axes = (
        _axis(lane(head, 0), exponents, ray.inv_x, ray.near_x, ray.far_x),
        _axis(lane(head, 1), np.uint32(exponents >> _EIGHT), ray.inv_y, ray.near_y, ray.far_y),
        _axis(
            lane(head, 2), np.uint32(exponents >> np.uint32(16)), ray.inv_z, ray.near_z, ray.far_z
        ),
    )
    back_x, back_y, back_z = ray.inv_x < ZERO_F32, ray.inv_y < ZERO_F32, ray.inv_z < ZERO_F32
    hits, pending = ZERO_U32, ZERO_U32
    hits, pending = _visit_four(
        lane(links, 2),
        ZERO_U32,
        (
            _ordered(back_x, lane(planes, 0), lane(more, 2)),
            _ordered(back_y, lane(planes, 2), lane(rest, 0)),
            _ordered(back_z, lane(more, 0), lane(rest, 2)),
        ),
        *(axes, turned, search, hits, pending),
    )
    hits, pending = _visit_four(
        lane(links, 3),
        np.uint32(4),
        (
            _ordered(back_x, lane(planes, 1), lane(more, 3)),
            _ordered(back_y, lane(planes, 3), lane(rest, 1)),
            _ordered(back_z, lane(more, 1), lane(rest, 3)),
        ),
        *(axes, turned, search, hits, pending),
    )
    inner = np.uint32(exponents >> np.uint32(24))
    return lane(links, 0), inner, hits, np.uint64(lane(links, 1)), pending


@device
def _axis(origin, exponent, inv, near, far):
    """Factor of a plane's byte, and the offsets of near and of far planes."""
    step = bits_as_float(np.int32((exponent & _BYTE) << _EXPONENT_AT))
    p = bits_as_float(np.int32(origin))
    first, last = fma(p, inv, near), fma(p, inv, far)
    return step * inv, first - fma(abs(first), _UNIT, _LEAST), last + fma(abs(last), _UNIT, _LEAST)


@device
def _ordered(is_back, low, high):
    """Bytes of the near planes, and of the far ones."""
    return (high, low) if is_back else (low, high)


@device
def _visit_four(kinds, first, planes, axes, turned, search, hits, pending):
    """Test the boxes of four slots, starting at `first`; returns `hits` and `pending`.

    `planes` has the bytes of near and far planes for each axis.
    """
    x, y, z = planes
    for k in range(np.uint32(4)):
        shift = np.uint32(k << np.uint32(3))
        kind = np.uint32(np.uint32(kinds >> shift) & _BYTE)
        t_in = max(
            fma(_byte(x[0], shift), axes[0][0], axes[0][1]),
            fma(_byte(y[0], shift), axes[1][0], axes[1][1]),
            fma(_byte(z[0], shift), axes[2][0], axes[2][1]),
        )
        t_out = min(
            fma(_byte(x[1], shift), axes[0][0], axes[0][2]),
            fma(_byte(y[1], shift), axes[1][0], axes[1][2]),
            fma(_byte(z[1], shift), axes[2][0], axes[2][2]),
        )
        if kind != ZERO_U32 and max(t_in, search.t_min) <= min(t_out, search.t_far):
            size = np.uint32(kind >> _FIVE)
            if size == _IS_NODE:
                hits = np.uint32(hits | (ONE_U32 << np.uint32((first + k) ^ turned)))
            else:
                add_to(search.counters, LEAVES, ONE_U64)
                triangles = np.uint32((ONE_U32 << size) - ONE_U32)
                pending = np.uint32(pending | (triangles << np.uint32(kind & _OFFSET)))
    return hits, pending


@device
def _byte(word, shift):
    """A byte of a word as a float32."""
    return np.float32(np.uint32(np.uint32(word >> shift) & _BYTE))
