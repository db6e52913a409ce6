"""Many single rays in flight through a tree of spheres; see `structures.bvh.walks.in_flight`.

Before its result is written, a ray is searched for triangles and height fields, by itself: a field
is too small a tree to wait for memory often.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.geometry.primitives.records import PrimitiveAddresses
from raystream.geometry.primitives.traversal import STACK_BYTES, RayScene, traverse_trees
from raystream.geometry.spheres.sphere import intersect_spheres, load_exact
from raystream.jit.constants import ONE_U64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import scratch
from raystream.jit.views import address_of
from raystream.kernels.hits import HitAddresses
from raystream.kernels.ray import prepare_ray
from raystream.kernels.ray_source import load_ray
from raystream.kernels.search import Search, SearchGoal
from raystream.structures.bvh.node_layout import leaf_address, t_key
from raystream.structures.bvh.walks.in_flight import NO_PRIM, SLOT, filter_of, wavefront_kernel

_T, _U, _V, _PRIM_ID = (np.uint64(SLOT.fields[k][1]) for k in ("t", "u", "v", "prim_id"))  # type: ignore[index]


class PrimitiveTrees(NamedTuple):
    """The trees of primitives.

    Attributes
    ----------
    nodes, leaves : uint64
        Addresses of the root of the spheres' tree and of the first `SphereBlock`.
    others : PrimitiveAddresses
        Without spheres.
    """

    nodes: np.uint64
    leaves: np.uint64
    others: PrimitiveAddresses


@device
def _rays(slot, frame, source):
    """The `Ray` and the `ExactRay` of a slot, loaded again: they would take cache lines."""
    i = np.uint64(slot.ray)
    ray, offset = load_ray(source, i, frame), slot.t_offset / slot.t_scale
    local = prepare_ray(ray.origin, ray.direction, frame.max_coordinate)
    return local, load_exact(source, i, offset, frame)


@device
def _search_of(slot, filter_):
    """A search that continues a slot's, and keeps its hits there."""
    at = address_of(slot)
    hits = HitAddresses(at + _T, at + _U, at + _V, at + _PRIM_ID)
    # It has a hit already: if of no primitive, at the end of the interval.
    goal = SearchGoal(ONE_U64, hits, ZERO_U64, False)
    own = filter_of(filter_, slot)
    return Search(slot.t_min, slot.t, ONE_U64, goal, None, own, None)


@device
def _visit_spheres(slot, tree, frame, source, lanes, wants_any, filter_):  # noqa: ARG001
    """Test the spheres of the next leaf; returns whether the ray is done."""
    (ray, exact), block = _rays(slot, frame, source), leaf_address(tree.leaves, slot.child)
    intersect_spheres(block, ray, exact, _search_of(slot, filter_))
    slot.t_key = t_key(slot.t)
    return wants_any and slot.prim_id != NO_PRIM


@device
def _search_others(slot, tree, frame, source, wants_any, filter_):
    """Search the other trees for a slot's ray, which has been through the spheres'."""
    if slot.ray < np.int64(0) or (wants_any and slot.prim_id != NO_PRIM):
        return
    ray, exact = _rays(slot, frame, source)
    search = _search_of(slot, filter_)
    traverse_trees(RayScene(tree.others, exact), ray, search, scratch(STACK_BYTES))


#: Through the trees of `PrimitiveTrees`.
trace_primitive_wavefront = wavefront_kernel(_visit_spheres, _search_others)
