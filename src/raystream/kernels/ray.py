"""The ray as the tests want it: reciprocals for slabs, a sheared frame for triangles."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import copy_sign

__all__ = ["PAD", "TINY_DIRECTION", "Ray", "component", "prepare_ray"]

#: A box is grown by this much of (largest scene coordinate + largest origin coordinate).
#: Rounding moves a vertex in the ray's frame by at most about 12 units of 2**-24 of that
#: sum, so an accepted ray may pass that far outside its triangle's box; 16 units cover it.
PAD = np.float32(2.0**-20)

#: Direction components below this fraction of the largest one are taken as this in slab
#: tests: their reciprocal stays finite, and zero needs no case of its own (0 x inf is NaN).
#: Over a length of 2**20 scene sizes such a ray moves by less than the padding.
TINY_DIRECTION = np.float32(2.0**-40)

_ONE = np.float32(1.0)


class Ray(NamedTuple):
    """A ray with all that does not depend on a box or a triangle computed once.

    Attributes
    ----------
    kx, ky, kz : int
        Axes of the frame: kz is the largest direction component's, kx and ky follow in
        cyclic order.
    ox, oy, oz : float32
        Origin, in the order of the frame (so ``oz`` lies along kz).
    dx, dy, dz : float32
        Direction, in the order of the frame.
    sx, sy, sz : float32
        Shear that turns the direction into the frame's z axis: d[kx] / d[kz],
        d[ky] / d[kz], 1 / d[kz].
    inv_x, inv_y, inv_z : float32
        Reciprocal direction, world order.
    near_x, near_y, near_z, far_x, far_y, far_z : float32
        Constants of the slab distances ``fma(plane, inv, near)`` and
        ``fma(plane, inv, far)``: origin and padding, world order.
    """

    kx: int
    ky: int
    kz: int
    ox: np.float32
    oy: np.float32
    oz: np.float32
    dx: np.float32
    dy: np.float32
    dz: np.float32
    sx: np.float32
    sy: np.float32
    sz: np.float32
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
def component(k, x, y, z):
    """What belongs to axis k."""
    return x if k == np.uint64(0) else (y if k == np.uint64(1) else z)


@device
def _reciprocal(d, tiny):
    # copysign, not a comparison: -0 points to the negative side, as its neighbours do.
    return copy_sign(_ONE / max(abs(d), tiny), d)


@device
def prepare_ray(ox, oy, oz, dx, dy, dz, max_coordinate):
    """Prepare a ray.

    Parameters
    ----------
    ox, oy, oz, dx, dy, dz : float32
        Finite, local frame; the largest direction component is in [1, 2).
    max_coordinate : float32
        Largest absolute coordinate of the scene.

    Returns
    -------
    Ray
    """
    # Step 1: the frame's z axis is the largest component; the first one wins a tie.
    ax, ay, az = abs(dx), abs(dy), abs(dz)
    kz = np.uint64(0)
    largest = ax
    if ay > largest:
        kz = np.uint64(1)
        largest = ay
    if az > largest:
        kz = np.uint64(2)
        largest = az
    kx = kz + np.uint64(1) if kz < np.uint64(2) else np.uint64(0)
    ky = kx + np.uint64(1) if kx < np.uint64(2) else np.uint64(0)

    # Step 2: slab constants. The padding moves each near plane towards the origin and each
    # far plane away from it, so it takes the direction's sign.
    tiny = largest * TINY_DIRECTION
    reach = max(abs(ox), abs(oy), abs(oz))
    pad = PAD * (max_coordinate + reach)
    inv_x = _reciprocal(dx, tiny)
    inv_y = _reciprocal(dy, tiny)
    inv_z = _reciprocal(dz, tiny)
    pad_x = copy_sign(pad, dx)
    pad_y = copy_sign(pad, dy)
    pad_z = copy_sign(pad, dz)

    # Step 3: the shear. kz is not tiny, so its reciprocal is exact to one rounding.
    sz = component(kz, inv_x, inv_y, inv_z)
    return Ray(
        kx,
        ky,
        kz,
        component(kx, ox, oy, oz),
        component(ky, ox, oy, oz),
        component(kz, ox, oy, oz),
        component(kx, dx, dy, dz),
        component(ky, dx, dy, dz),
        component(kz, dx, dy, dz),
        component(kx, dx, dy, dz) * sz,
        component(ky, dx, dy, dz) * sz,
        sz,
        inv_x,
        inv_y,
        inv_z,
        -((ox + pad_x) * inv_x),
        -((oy + pad_y) * inv_y),
        -((oz + pad_z) * inv_z),
        -((ox - pad_x) * inv_x),
        -((oy - pad_y) * inv_y),
        -((oz - pad_z) * inv_z),
    )
