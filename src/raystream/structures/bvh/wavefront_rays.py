"""A ray in flight: its slot, how it starts, and how its result is written."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import store
from raystream.jit.views import view
from raystream.kernels.local_ray import world_t
from raystream.kernels.ray import component, prepare_ray
from raystream.structures.bvh.wide import LANE, plane_row, t_key

__all__ = [
    "BOTTOM",
    "BOTTOM_KEY",
    "NO_RAY",
    "SLOT_BYTES",
    "Slot",
    "finish_ray",
    "start_ray",
]

_ZERO = np.float32(0.0)
_INF = np.float32(np.inf)
_MISS = np.int32(-1)

#: The triangle of a ray that has no hit: no number is greater.
NO_PRIM = np.int32(2**31 - 1)

#: In a slot that has no ray.
NO_RAY = np.int64(-1)

#: At the bottom of each stack: no key is smaller, and no node has this number.
BOTTOM_KEY = np.int32(-(2**31))
BOTTOM = np.int32(2**31 - 1)

#: A ray in flight. What belongs to axes is in the order of the ray's frame: kx, ky, kz.
_SLOT = np.dtype(
    [
        ("inv", "f4", 3),
        ("near", "f4", 3),
        ("far", "f4", 3),
        ("origin", "f4", 3),
        ("shear", "f4", 3),
        ("t_min", "f4"),
        ("t", "f4"),
        ("prim_id", "i4"),
        ("u", "f4"),
        ("v", "f4"),
        ("t_key", "i4"),  # children with a larger key lie behind the nearest hit
        ("child", "i4"),  # the node or leaf that is next
        ("top", "u8"),  # bytes on the stack, below the next one
        ("ray", "i8"),
        ("factor", "f8"),
        ("offset", "f8"),
        ("planes", "u8", 3),  # rows of a node's planes that the ray meets first
        ("axes", "u8", 3),  # kx, ky, kz
        ("direction", "f4", 3),
        ("unused", "V12"),
    ]
)
Slot = view(_SLOT)
SLOT_BYTES = np.uint64(_SLOT.itemsize)


@device
def start_ray(slot, keys, children, i, ray, max_coordinate):
    """Put a ray into a slot, before the root."""
    r = prepare_ray(ray.ox, ray.oy, ray.oz, ray.dx, ray.dy, ray.dz, max_coordinate)
    inv_x = component(r.kx, r.inv_x, r.inv_y, r.inv_z)
    inv_y = component(r.ky, r.inv_x, r.inv_y, r.inv_z)
    inv_z = r.sz
    slot.inv = inv_x, inv_y, inv_z
    slot.near = (
        component(r.kx, r.near_x, r.near_y, r.near_z),
        component(r.ky, r.near_x, r.near_y, r.near_z),
        component(r.kz, r.near_x, r.near_y, r.near_z),
    )
    slot.far = (
        component(r.kx, r.far_x, r.far_y, r.far_z),
        component(r.ky, r.far_x, r.far_y, r.far_z),
        component(r.kz, r.far_x, r.far_y, r.far_z),
    )
    slot.origin = r.ox, r.oy, r.oz
    slot.direction = r.dx, r.dy, r.dz
    slot.shear = r.sx, r.sy, r.sz
    slot.planes = plane_row(r.kx, inv_x), plane_row(r.ky, inv_y), plane_row(r.kz, inv_z)
    slot.axes = r.kx, r.ky, r.kz
    slot.t_min, slot.t, slot.t_key = ray.t_min, ray.t_max, t_key(ray.t_max)
    slot.prim_id, slot.u, slot.v = NO_PRIM, _ZERO, _ZERO
    slot.child, slot.top = np.int32(0), LANE
    slot.ray, slot.factor, slot.offset = np.int64(i), ray.factor, ray.offset
    store(keys, BOTTOM_KEY)
    store(children, BOTTOM)


@device
def finish_ray(slot, wants_any, out):
    """Write the result of a slot's ray, if it has one."""
    if slot.ray < np.int64(0):
        return
    i, prim_id = np.uint64(slot.ray), slot.prim_id
    if wants_any:
        store(out.seen + i, np.uint8(prim_id != NO_PRIM))
        return
    t = _INF
    if prim_id == NO_PRIM:
        prim_id = _MISS
    else:
        t = world_t(slot.t, slot.factor, slot.offset)
    at = i * LANE
    store(out.t + at, t)
    store(out.u + at, slot.u)
    store(out.v + at, slot.v)
    store(out.prim_id + at, prim_id)
