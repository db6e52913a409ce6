"""A ray in flight of a wavefront: its slot, how it starts, and how its result is written."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import load, store
from raystream.kernels.local_ray import world_t
from raystream.kernels.ray import pick, set_up
from raystream.structures.bvh.wide import LANE, plane_offset, t_key

__all__ = [
    "AXIS",
    "BOTTOM",
    "BOTTOM_KEY",
    "CHILD",
    "DIRECTION",
    "FAR",
    "INV",
    "NEAR",
    "ORIGIN",
    "PLANE",
    "PRIM",
    "RAY",
    "SHEAR",
    "SLOT",
    "TOP",
    "T_KEY",
    "T_MIN",
    "Y_WORD",
    "Z_WORD",
    "T",
    "U",
    "V",
    "finish_ray",
    "start_ray",
    "three",
]

_ZERO = np.float32(0.0)
_INF = np.float32(np.inf)
_MISS = np.int32(-1)

#: The triangle of a ray that has no hit: no number is greater.
NO_PRIM = np.int32(2**31 - 1)

#: At the bottom of each stack: no key is smaller, and no node has this number.
BOTTOM_KEY = np.int32(-(2**31))
BOTTOM = np.int32(2**31 - 1)

# A ray in flight, in bytes from the start of its slot. What belongs to axes is in the order
# of the ray's frame: x, y, z stand for its kx, ky, kz.
SLOT = np.uint64(192)
INV = np.uint64(0)
NEAR = np.uint64(12)
FAR = np.uint64(24)
ORIGIN = np.uint64(36)
SHEAR = np.uint64(48)
T_MIN = np.uint64(60)
T = np.uint64(64)
PRIM = np.uint64(68)
U = np.uint64(72)
V = np.uint64(76)
T_KEY = np.uint64(80)  # children with a larger key lie behind the nearest hit
CHILD = np.uint64(84)  # the node or leaf that is next
TOP = np.uint64(88)  # bytes on the stack, below the next one
RAY = np.uint64(96)
FACTOR = np.uint64(104)
OFFSET = np.uint64(112)
PLANE = np.uint64(120)  # where in a node the near planes of each axis are
DIRECTION = np.uint64(168)
AXIS = np.uint64(144)  # where in a leaf block a corner's coordinates of each axis are

Y = np.uint64(4)
Z = np.uint64(8)
Y_WORD = np.uint64(8)
Z_WORD = np.uint64(16)


@device
def start_ray(slot, keys, children, i, ray, extreme):
    """Put a ray into a slot, before the root."""
    r = set_up(ray.ox, ray.oy, ray.oz, ray.dx, ray.dy, ray.dz, extreme)
    inv_x = pick(r.kx, r.inv_x, r.inv_y, r.inv_z)
    inv_y = pick(r.ky, r.inv_x, r.inv_y, r.inv_z)
    inv_z = r.sz
    store(slot + INV, inv_x)
    store(slot + (INV + Y), inv_y)
    store(slot + (INV + Z), inv_z)
    store(slot + NEAR, pick(r.kx, r.near_x, r.near_y, r.near_z))
    store(slot + (NEAR + Y), pick(r.ky, r.near_x, r.near_y, r.near_z))
    store(slot + (NEAR + Z), pick(r.kz, r.near_x, r.near_y, r.near_z))
    store(slot + FAR, pick(r.kx, r.far_x, r.far_y, r.far_z))
    store(slot + (FAR + Y), pick(r.ky, r.far_x, r.far_y, r.far_z))
    store(slot + (FAR + Z), pick(r.kz, r.far_x, r.far_y, r.far_z))
    store(slot + ORIGIN, r.ox)
    store(slot + (ORIGIN + Y), r.oy)
    store(slot + (ORIGIN + Z), r.oz)
    store(slot + DIRECTION, r.dx)
    store(slot + (DIRECTION + Y), r.dy)
    store(slot + (DIRECTION + Z), r.dz)
    store(slot + SHEAR, r.sx)
    store(slot + (SHEAR + Y), r.sy)
    store(slot + (SHEAR + Z), r.sz)
    store(slot + T_MIN, ray.t_min)
    store(slot + T, ray.t_max)
    store(slot + PRIM, NO_PRIM)
    store(slot + U, _ZERO)
    store(slot + V, _ZERO)
    store(slot + T_KEY, t_key(ray.t_max))
    store(slot + CHILD, np.int32(0))
    store(slot + TOP, LANE)
    store(slot + RAY, np.int64(i))
    store(slot + FACTOR, ray.factor)
    store(slot + OFFSET, ray.offset)
    store(slot + PLANE, plane_offset(r.kx, inv_x))
    store(slot + (PLANE + Y_WORD), plane_offset(r.ky, inv_y))
    store(slot + (PLANE + Z_WORD), plane_offset(r.kz, inv_z))
    store(slot + AXIS, r.kx << np.uint64(4))
    store(slot + (AXIS + Y_WORD), r.ky << np.uint64(4))
    store(slot + (AXIS + Z_WORD), r.kz << np.uint64(4))
    store(keys, BOTTOM_KEY)
    store(children, BOTTOM)


@device
def finish_ray(slot, wants_any, out):
    """Write the result of a slot's ray, if it has one."""
    i = load(np.int64, slot + RAY)
    if i < np.int64(0):
        return
    i = np.uint64(i)
    prim_id = load(np.int32, slot + PRIM)
    if wants_any:
        store(out.seen + i, np.uint8(prim_id != NO_PRIM))
        return
    t = _INF
    if prim_id == NO_PRIM:
        prim_id = _MISS
    else:
        factor, offset = load(np.float64, slot + FACTOR), load(np.float64, slot + OFFSET)
        t = world_t(load(np.float32, slot + T), factor, offset)
    at = i * LANE
    store(out.t + at, t)
    store(out.u + at, load(np.float32, slot + U))
    store(out.v + at, load(np.float32, slot + V))
    store(out.prim_id + at, prim_id)


@device
def three(slot, at):
    """Three numbers of a slot, one for each axis."""
    return (
        load(np.float32, slot + at),
        load(np.float32, slot + (at + Y)),
        load(np.float32, slot + (at + Z)),
    )
