"""Foley's kernels on a kd-tree, with the packed state of Foley 2005, Figure 6, for kd-backtrack.

Three records of four floats each: pointers are pairs of floats, coordinates in a texture, and sign
bits say whether a node is a leaf and what the ray does next. Intersect tests one triangle, by
Möller and Trumbore. The routines are those of Figures 2 and 4.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import load
from raystream.kernels.leaf_block import AXIS, BLOCK, PRIM_IDS, SECOND, THIRD
from raystream.kernels.ray import component
from raystream.kernels.search import put_hit
from raystream.machines.records import (
    AT_LEAF,
    BACKTRACKING,
    CONTINUING,
    DONE,
    INTERSECTING,
    SHADING,
    TRAVERSING,
    RayState,
)
from raystream.machines.steps.base import StepKernel, Steps
from raystream.structures.kdtree.nodes import parent_of, split_of
from raystream.structures.kdtree.structure import KdTreeStructure
from raystream_lab.as_published.triangle import PrintedHit, intersect_triangle

#: TraversalState, IntersectState and HitState: four floats each.
PACKED = np.dtype(
    [
        ("node", np.float32, 2),
        ("t_min", np.float32),
        ("t_max", np.float32),
        ("triangle", np.float32, 2),
        ("count", np.float32),
        ("t_leaf", np.float32),
        ("best", np.float32, 2),
        ("t_hit", np.float32),
        ("t_end", np.float32),
    ]
)

#: Texels in a row of a texture, as a shift. A float counts to 2**24, so pointers reach 2**35.
_ROW = np.uint64(11)
_COLUMN = np.uint64(0x7FF)

_RECORD = np.uint64(12)
_LEAF_BIT, _ROW_BITS = np.uint64(1 << 31), np.uint64((1 << 30) - 1)
_WORD, _NEXT = np.uint64(4), np.uint64(8)
_LANES = np.uint64(4)
_HIGH = np.uint64(12)
_ZERO, _ONE, _INF = np.float32(0.0), np.float32(1.0), np.float32(np.inf)
_PLUS, _MINUS = np.float32(1.0), np.float32(-1.0)
_NO_TRIANGLE = (_MINUS, _ZERO)


class Textures(NamedTuple):
    """The tree in Foley's layout; fields as in `structures.kdtree.nodes.KdAddresses`."""

    nodes: np.uint64
    leaves: np.uint64
    extended: np.uint64
    blocks: np.uint64
    root: np.uint64
    low: tuple[np.float32, np.float32, np.float32]
    high: tuple[np.float32, np.float32, np.float32]


@device
def _packed_index(number):
    """A row of a texture as a pair of floats."""
    return np.float32(number & _COLUMN), np.float32(number >> _ROW)


@device
def _index(x, y):
    return np.uint64(abs(x)) + (np.uint64(y) << _ROW)


@device
def _packed_node(node):
    """A pointer to a node; the sign of its first float says that it is a leaf.

    A column is stored as its number plus one, so that a sign shows.
    """
    x, y = _packed_index(node & _ROW_BITS)
    return math.copysign(x + _ONE, _MINUS if node >= _LEAF_BIT else _PLUS), y


@device
def _node(pointer):
    number = _index(abs(pointer[0]) - _ONE, pointer[1])
    return number | _LEAF_BIT if pointer[0] < _ZERO else number


@device
def _signs(state):
    """Sign bits of a ray's state, for t_min and t_max: traverse ++, intersect -+, done --."""
    # Without branches, as on hardware with predicates.
    is_traversing = (state == TRAVERSING) | (state == BACKTRACKING)
    is_done = (state == DONE) | (state == SHADING)
    return _PLUS if is_traversing else _MINUS, _MINUS if is_done else _PLUS


@device
def _traversal(node, t_min, t_max, state):
    """A TraversalState."""
    first, second = _signs(state)
    pointer = _packed_node(node)
    return pointer, math.copysign(t_min, first), math.copysign(t_max, second)


@device
def _record(traversal, intersect, hit):
    """The three records as one of `PACKED`."""
    return (*traversal, *intersect, *hit)


@device
def _traversal_of(place):
    node = place.node
    return (node[0], node[1]), place.t_min, place.t_max


@device
def _intersect_of(place):
    triangle = place.triangle
    return (triangle[0], triangle[1]), place.count, place.t_leaf


@device
def _hit_of(place):
    best = place.best
    return (best[0], best[1]), place.t_hit, place.t_end


@device
def _downward(node):
    return AT_LEAF if node >= _LEAF_BIT else TRAVERSING


@device
def _slab(o, d, low, high, t_in, t_out):
    near, far = (low - o) / d, (high - o) / d
    # In this order, so that a NaN changes nothing.
    return max(t_in, min(near, far)), min(t_out, max(near, far))


def initialize(ray, tree):
    """Find the ray's range in the scene's box, and begin at the root (``kd-search``)."""
    o, d = ray.origin, ray.direction
    t_in, t_out = ray.t_min, ray.t_max
    t_in, t_out = _slab(o[0], d[0], tree.low[0], tree.high[0], t_in, t_out)
    t_in, t_out = _slab(o[1], d[1], tree.low[1], tree.high[1], t_in, t_out)
    t_in, t_out = _slab(o[2], d[2], tree.low[2], tree.high[2], t_in, t_out)
    is_active = tree.nodes != np.uint64(0) and t_in <= t_out
    state = _downward(tree.root) if is_active else DONE
    nothing = (_ZERO, _ZERO), _ZERO, _ZERO
    hit = _NO_TRIANGLE, ray.t_max, t_out
    return _record(_traversal(tree.root, t_in, t_out, state), nothing, hit), state


def down(ray, place, tree):
    """Descend to the first child that the range meets (``search-split``)."""
    o, d = ray.origin, ray.direction
    node = _node(place.node)
    t_min, t_max = abs(place.t_min), abs(place.t_max)
    split = split_of(tree, node)
    along = component(split.axis, d[0], d[1], d[2])
    t_hit = (split.position - component(split.axis, o[0], o[1], o[2])) / along
    first = split.below if along > _ZERO else split.above
    second = split.above if along > _ZERO else split.below
    if t_hit <= t_min:
        first = second
    elif t_hit < t_max:
        t_max = t_hit
    state = _downward(first)
    traversal = _traversal(first, t_min, t_max, state)
    return _record(traversal, _intersect_of(place), _hit_of(place)), state


def leaf(place, tree):
    """Prepare a ray to intersect the triangles of a leaf (``search-leaf``)."""
    at = tree.leaves + (_node(place.node) & _ROW_BITS) * _RECORD
    count = load(np.uint32, at)
    first = np.uint64(load(np.uint32, at + _WORD)) * _LANES
    state = CONTINUING if count == np.uint32(0) else INTERSECTING
    intersection = _packed_index(first), np.float32(count), abs(place.t_max)
    return _record(_traversal_of(place), intersection, _hit_of(place)), state


@device
def _corner(at):
    return load(np.float32, at), load(np.float32, at + AXIS), load(np.float32, at + AXIS + AXIS)


@device
def _tested(ray, tree, number, h):
    """Test the triangle in a lane of the leaves' blocks; keeps its place, not its number."""
    o, d = ray.origin, ray.direction
    at = tree.blocks + (number >> np.uint64(2)) * BLOCK + ((number & np.uint64(3)) << np.uint64(2))
    v0, v1, v2 = _corner(at), _corner(at + SECOND), _corner(at + THIRD)
    own = np.int32(number)
    return intersect_triangle((o[0], o[1], o[2]), (d[0], d[1], d[2]), v0, v1, v2, own, h)


def intersect(ray, place, tree):
    """Test one triangle of a leaf."""
    number = _index(place.triangle[0], place.triangle[1])
    best, t_hit, t_end = _hit_of(place)
    h = _tested(ray, tree, number, PrintedHit(t_hit, _ZERO, _ZERO, np.int32(-1)))
    if h.prim_id >= 0:
        best = place.triangle[0], place.triangle[1]
    left = place.count - _ONE
    state = CONTINUING if left == _ZERO else INTERSECTING
    intersection = _packed_index(number + np.uint64(1)), left, place.t_leaf
    return _record(_traversal_of(place), intersection, (best, h.t, t_end)), state


def continue_search(place):
    """End the search with a hit in the leaf or after the last leaf, or backtrack."""
    t_out, t_end = abs(place.t_max), place.t_end
    is_hit = place.best[0] >= _ZERO
    state = BACKTRACKING
    if is_hit and place.t_hit <= t_out:
        state = SHADING
    elif t_out >= t_end:
        state = SHADING if is_hit else DONE
    traversal = _traversal(_node(place.node), t_out, t_end, state)
    return _record(traversal, _intersect_of(place), _hit_of(place)), state


@device
def _exit(o, d, low, high):
    return ((high if d > _ZERO else low) - o) / d


def up(ray, place, tree):
    """Climb to the parent, and stop there if the range meets its bounds (``backtrack``)."""
    o, d = ray.origin, ray.direction
    t_min = abs(place.t_min)
    node, low = parent_of(tree, _node(place.node))
    high = low + _HIGH
    # The bounds contain the leaf that the ray has left: only their far side can end the range.
    t_max = min(
        place.t_end,
        _exit(o[0], d[0], load(np.float32, low), load(np.float32, high)),
        _exit(o[1], d[1], load(np.float32, low + _WORD), load(np.float32, high + _WORD)),
        _exit(o[2], d[2], load(np.float32, low + _NEXT), load(np.float32, high + _NEXT)),
    )
    state = TRAVERSING if t_min < t_max else BACKTRACKING
    traversal = _traversal(node, t_min, t_max, state)
    return _record(traversal, _intersect_of(place), _hit_of(place)), state


def shade(ray, wanted, place, tree, query):
    """Write a ray's hit; its u and v, which no record keeps, are computed again."""
    number = _index(place.best[0], place.best[1])
    h = _tested(ray, tree, number, PrintedHit(_INF, _ZERO, _ZERO, np.int32(-1)))
    block = tree.blocks + (number >> np.uint64(2)) * BLOCK
    prim_id = load(np.int32, block + PRIM_IDS + ((number & np.uint64(3)) << np.uint64(2)))
    put_hit(query.hits, wanted.first, place.t_hit, h.u, h.v, prim_id)
    return DONE


_KERNELS = (
    StepKernel("initialize", RayState.STARTING, device(initialize), ("place",)),
    StepKernel("down", RayState.TRAVERSING, device(down), ("place",)),
    StepKernel("leaf", RayState.AT_LEAF, device(leaf), ("place",)),
    StepKernel("intersect", RayState.INTERSECTING, device(intersect), ("place",)),
    StepKernel("continue", RayState.CONTINUING, device(continue_search), ("place",)),
    StepKernel("up", RayState.BACKTRACKING, device(up), ("place",)),
    StepKernel("shade", RayState.SHADING, device(shade), ()),
)


def kdtree_steps(tree: KdTreeStructure) -> Steps:
    """Foley's kernels on a kd-tree in his layout that backtracks, for first hits.

    Raises
    ------
    ValueError
        If it has another layout or traversal.
    """
    options = tree.options
    if options.layout != "foley" or options.traversal != "backtrack":
        raise ValueError(
            "structure: expected layout 'foley' and traversal 'backtrack', got "
            f"{options.layout!r} and {options.traversal!r}"
        )
    own = tree.view
    leaves = np.uint64(0) if own.leaves is None else own.leaves
    textures = Textures(own.nodes, leaves, own.extended, own.blocks, own.root, own.low, own.high)
    return Steps(_KERNELS, PACKED, textures)
