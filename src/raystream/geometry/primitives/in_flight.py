"""Many single rays in flight through a tree of spheres; see `structures.bvh.walks.in_flight`.

Before its result is written, a ray is searched for triangles and height fields, by itself: a field
is too small a tree to wait for memory often.
"""

from __future__ import annotations

from typing import Any, NamedTuple

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
from raystream.structures.bvh.walks.all_hits import SlotSearches
from raystream.structures.bvh.walks.in_flight import (
    NO_PRIM,
    SLOT,
    filter_of,
    finish_ray,
    wavefront_kernel,
)

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
def _begin_nearest(slot, wanted, instance):
    at = address_of(slot)
    hits = HitAddresses(at + _T, at + _U, at + _V, at + _PRIM_ID)
    # It has a hit already: if of no primitive, at the end of the interval.
    goal, own = SearchGoal(ONE_U64, hits, ZERO_U64, False), filter_of(wanted.filter, slot)
    return Search(slot.t_min, slot.t, ONE_U64, goal, None, own, instance)


@device
def _end_nearest(slot, search, wanted):  # noqa: ARG001
    slot.t_key = t_key(slot.t)
    return wanted.wants_any and slot.prim_id != NO_PRIM


#: Of rays whose nearest or any hits are kept in their slots, for a `NearestWanted`.
_NEAREST = SlotSearches(_begin_nearest, _end_nearest, finish_ray)


def primitive_wavefront(searches: SlotSearches) -> Any:
    """The kernel of some searches through `PrimitiveTrees`."""
    begin, end, finish = searches

    @device
    def visit_spheres(slot, tree, frame, source, lanes, wanted):  # noqa: ARG001
        (ray, exact), block = _rays(slot, frame, source), leaf_address(tree.leaves, slot.child)
        search = intersect_spheres(block, ray, exact, begin(slot, wanted, None))
        return end(slot, search, wanted)

    @device
    def search_others(slot, tree, frame, source, wanted):
        """Search the other trees for a slot's ray, which has been through the spheres'."""
        if slot.ray < np.int64(0) or (wanted.wants_any and slot.prim_id != NO_PRIM):
            return
        ray, exact = _rays(slot, frame, source)
        memory, search = scratch(STACK_BYTES), begin(slot, wanted, None)
        search = traverse_trees(RayScene(tree.others, exact), ray, search, memory)
        end(slot, search, wanted)

    return wavefront_kernel(visit_spheres, finish, search_others)


#: The nearest or any hits, for a `NearestWanted`.
trace_primitive_wavefront = primitive_wavefront(_NEAREST)
