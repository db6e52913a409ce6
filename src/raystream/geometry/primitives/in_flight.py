"""Many single rays in flight through a tree of spheres; see `structures.bvh.walks.in_flight`.

Before its result is written, a ray is searched for what the other trees have, by itself.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from raystream.geometry.primitives.records import PrimitiveAddresses
from raystream.geometry.primitives.traversal import STACK_BYTES, RayScene, traverse_trees
from raystream.geometry.spheres.sphere import ExactRay, intersect_spheres, load_exact
from raystream.jit.constants import NULL, ONE_U64, ZERO_U64
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
    WIDE,
    TreeKind,
    filter_of,
    finish_ray,
    wavefront_kernel,
)

#: A ray in flight with its slabs in the order of the world's axes, and in float64. Both take longer
#: to compute for each leaf than to load.
_EXACT = [("origin", "f8", 3), ("direction", "f8", 3), ("inv_square", "f8"), ("offset", "f8")]
_SLABS = [(f"{name}_{axis}", "f4") for name in ("inv", "near", "far") for axis in "xyz"]
PRIMITIVE_SLOT = np.dtype([*SLOT.descr, ("exact", _EXACT), *_SLABS, ("_unused", "V28")])

_T, _U, _V, _PRIM_ID = (np.uint64(SLOT.fields[k][1]) for k in ("t", "u", "v", "prim_id"))  # type: ignore[index]


class PrimitiveTrees(NamedTuple):
    """The trees of primitives.

    Attributes
    ----------
    nodes, leaves : uint64
        Addresses of the root of the spheres' tree and of the first `SphereBlock`; or of a
        `FieldRecord`, and nothing.
    others : PrimitiveAddresses
        Without these.
    """

    nodes: np.uint64
    leaves: np.uint64
    others: PrimitiveAddresses


@device
def begin_ray(slot, stack, i, ray, tree, frame, source):  # noqa: ARG001
    """Write what boxes and spheres are tested with; see `walks.in_flight.TreeKind`."""
    local = prepare_ray(ray.origin, ray.direction, frame.max_coordinate)
    slot.inv_x, slot.inv_y, slot.inv_z = local.inv_x, local.inv_y, local.inv_z
    slot.near_x, slot.near_y, slot.near_z = local.near_x, local.near_y, local.near_z
    slot.far_x, slot.far_y, slot.far_z = local.far_x, local.far_y, local.far_z
    own, exact = slot.exact, load_exact(source, i, ray.t_offset / ray.t_scale, frame)
    own.origin, own.direction = exact.origin, exact.direction
    own.inv_square, own.offset = exact.inv_square, exact.offset


@device
def _exact_of(slot, frame):
    own = slot.exact
    scale = np.float64(frame.scale)
    return ExactRay(own.origin, own.direction, own.inv_square, own.offset, frame.center, scale)


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
NEAREST_IN_SLOT = SlotSearches(_begin_nearest, _end_nearest, finish_ray)


def primitive_wavefront(searches: SlotSearches, search_leaf: Any, kind: TreeKind) -> Any:
    """Make the kernel of some searches through `PrimitiveTrees`.

    ``search_leaf(slot, tree, frame, search) -> search`` offers the hits of the slot's next leaf.
    """
    begin, end, finish = searches

    @device
    def visit_leaf(slot, tree, frame, source, lanes, wanted):  # noqa: ARG001
        return end(slot, search_leaf(slot, tree, frame, begin(slot, wanted, None)), wanted)

    @device
    def search_others(slot, tree, frame, source, wanted):
        """Search the other trees for a slot's ray, which has been through the one in flight."""
        others = tree.others
        is_empty = others.nodes == NULL and others.sphere_nodes == NULL
        if is_empty and others.shape_nodes == NULL and others.field_count == ZERO_U64:
            return
        if slot.ray < np.int64(0) or (wanted.wants_any and slot.prim_id != NO_PRIM):
            return
        ray = load_ray(source, np.uint64(slot.ray), frame)
        local = prepare_ray(ray.origin, ray.direction, frame.max_coordinate)
        memory, search = scratch(STACK_BYTES), begin(slot, wanted, None)
        search = traverse_trees(RayScene(others, _exact_of(slot, frame)), local, search, memory)
        end(slot, search, wanted)

    return wavefront_kernel(visit_leaf, finish, search_others, kind)


@device
def _search_spheres(slot, tree, frame, search):
    block = leaf_address(tree.leaves, slot.child)
    return intersect_spheres(block, slot, _exact_of(slot, frame), search)


_SPHERES = WIDE._replace(record=PRIMITIVE_SLOT, begin=begin_ray)


def spheres_in_flight(searches: SlotSearches) -> Any:
    """The kernel of some searches with the spheres' tree in flight."""
    return primitive_wavefront(searches, _search_spheres, _SPHERES)
