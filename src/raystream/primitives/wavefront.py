"""Many single rays in flight through a tree of spheres; see `structures.bvh.wavefront`.

Before its result is written, a ray is searched for triangles and height fields, by itself: a field
is too small a tree to wait for memory often.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.constants import ONE_U64, ZERO_U64
from raystream.jit.cpu import device
from raystream.jit.simd import scratch
from raystream.jit.views import address_of
from raystream.kernels.hits import HitAddresses
from raystream.kernels.leaf_block import AXIS
from raystream.kernels.ray import component, prepare_ray
from raystream.kernels.ray_source import load_direction, load_origin, load_ray
from raystream.kernels.search import Search
from raystream.primitives.records import PrimitiveAddresses
from raystream.primitives.sphere import exact_ray, intersect_spheres
from raystream.primitives.traversal import STACK_BYTES, RayScene, traverse_trees
from raystream.structures.bvh.node_layout import leaf_address, t_key
from raystream.structures.bvh.wavefront import NO_PRIM, SLOT, wavefront_kernel

_TWO = np.uint64(2)


def _offset(name: str) -> np.uint64:
    assert SLOT.fields is not None
    return np.uint64(SLOT.fields[name][1])


_T, _U, _V, _PRIM_ID = map(_offset, ("t", "u", "v", "prim_id"))


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

    @classmethod
    def of(cls, arrays: PrimitiveAddresses) -> PrimitiveTrees:
        """Those of a scene with spheres."""
        others = arrays._replace(sphere_nodes=ZERO_U64)
        return cls(arrays.sphere_nodes, arrays.sphere_blocks, others)


class _SlabRay(NamedTuple):
    """What the sphere test takes of a `kernels.ray.Ray`."""

    inv_x: np.float32
    inv_y: np.float32
    inv_z: np.float32
    near_x: np.float32
    near_y: np.float32
    near_z: np.float32
    far_x: np.float32
    far_y: np.float32
    far_z: np.float32


@device
def _place(axes, axis):
    """Where an axis of the world is in the order of a ray's frame."""
    at = axis * AXIS
    return ZERO_U64 if axes[0] == at else (ONE_U64 if axes[1] == at else _TWO)


@device
def _slab_ray(slot):
    x, y, z = _place(slot.axes, ZERO_U64), _place(slot.axes, ONE_U64), _place(slot.axes, _TWO)
    inv, near, far = slot.inv, slot.near, slot.far
    return _SlabRay(
        component(x, inv[0], inv[1], inv[2]),
        component(y, inv[0], inv[1], inv[2]),
        component(z, inv[0], inv[1], inv[2]),
        component(x, near[0], near[1], near[2]),
        component(y, near[0], near[1], near[2]),
        component(z, near[0], near[1], near[2]),
        component(x, far[0], far[1], far[2]),
        component(y, far[0], far[1], far[2]),
        component(z, far[0], far[1], far[2]),
    )


@device
def _exact_ray(slot, frame, source):
    """The `ExactRay` of a slot's ray, loaded again: it would take a cache line of each slot."""
    i = np.uint64(slot.ray)
    ox, oy, oz = load_origin(source, i)
    dx, dy, dz = load_direction(source, i)
    return exact_ray((ox, oy, oz, dx, dy, dz), slot, frame)


@device
def _search_of(slot):
    """A search that continues a slot's, and keeps its hits there."""
    at = address_of(slot)
    hits = HitAddresses(at + _T, at + _U, at + _V, at + _PRIM_ID)
    # It has a hit already: if of no primitive, at the end of the interval.
    one, none = ONE_U64, ZERO_U64
    return Search(slot.t_min, slot.t, one, one, hits, none, False, None, None, None)


@device
def _visit_spheres(slot, tree, frame, source, lanes, wants_any, filter_):  # noqa: ARG001
    """Test the spheres of the next leaf; returns whether the ray is done."""
    exact, block = _exact_ray(slot, frame, source), leaf_address(tree.leaves, slot.child)
    intersect_spheres(block, _slab_ray(slot), exact, _search_of(slot))
    slot.t_key = t_key(slot.t)
    return wants_any and slot.prim_id != NO_PRIM


@device
def _search_others(slot, tree, frame, source, wants_any):
    """Search the other trees for a slot's ray, which has been through the spheres'."""
    if slot.ray < np.int64(0) or (wants_any and slot.prim_id != NO_PRIM):
        return
    ray = load_ray(source, np.uint64(slot.ray), frame)
    local = prepare_ray(ray.ox, ray.oy, ray.oz, ray.dx, ray.dy, ray.dz, frame.max_coordinate)
    scene = RayScene(tree.others, _exact_ray(slot, frame, source))
    traverse_trees(scene, local, _search_of(slot), scratch(STACK_BYTES))


#: Through the trees of `PrimitiveTrees`.
trace_primitive_wavefront = wavefront_kernel(_visit_spheres, _search_others)
