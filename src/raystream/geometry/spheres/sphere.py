"""The sphere test, in float64: four spheres against a ray, or sixteen rays against a sphere.

Of the two roots of a quadratic equation, one is a difference of numbers that may be nearly equal.
Here neither is: the ray's closest point to the centre gives the discriminant without cancellation
for origins far away, and the root that would cancel comes from the product of both [1]_ [2]_.

As for triangles, t is clamped to the padded slab interval of the sphere's own box. So a hit lies in
the interval of every box that holds the sphere, and a tree leaves out no hit.

References
----------
.. [1] Haines, Guenther and Akenine-Moller, "Precision Improvements for Ray/Sphere Intersection",
   Ray Tracing Gems, chapter 7, 2019.
.. [2] Press, Teukolsky, Vetterling and Flannery, "Numerical Recipes", section 5.6.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.geometry.primitives.records import SPHERES_PER_BLOCK, SphereBlock
from raystream.jit.constants import ONE_F64, ZERO_F32, ZERO_F64
from raystream.jit.cpu import device
from raystream.jit.simd import (
    absolute,
    any_lane,
    as_float32,
    copy_sign,
    count_trailing_zeros,
    mask_bits,
    maximum,
    minimum,
    narrow,
    scratch,
    select,
    square_root,
)
from raystream.jit.views import view
from raystream.kernels.ray import length_power, scaled, scaled_slowly
from raystream.kernels.ray_source import loader, read_ray
from raystream.kernels.search import is_full, offer
from raystream.kernels.tally import TESTS, add_to
from raystream.kernels.triangle_lanes import boxes_interval

_NONE, _ONE, _TWO = np.arange(3, dtype=np.uint64)
_HALF64 = np.float64(0.5)
_LANES = np.uint64(SPHERES_PER_BLOCK)

#: A sphere's box, float32, is grown by this part of (its radius + its centre's coordinate): four
#: times what the roundings of both, and of their sum, amount to.
BOX_GROWTH = np.float32(2.0**-22)

#: What `intersect` writes of each lane: t of both hits, half the way in the sphere, and the ray's
#: closest point to the centre, from there.
HIT = [("near", "f4"), ("far", "f4"), ("half", "f8"), ("x", "f8"), ("y", "f8"), ("z", "f8")]
_Hits = view([(name, kind, SPHERES_PER_BLOCK) for name, kind in HIT])
_HitLanes = view([(name, kind, (SPHERES_PER_BLOCK, 1)) for name, kind in HIT])
_HITS_BYTES = 40 * SPHERES_PER_BLOCK

#: Biased exponents of numbers that are not subnormal, whose reciprocal is not either.
_LEAST_EXPONENT, _MOST_EXPONENT = np.int64(1), np.int64(2045)


class ExactRay(NamedTuple):
    """A ray in float64.

    Attributes
    ----------
    origin : tuple of three float64
        World space.
    direction : tuple of three float64
        Scaled by the power of two that the local ray's direction is scaled by.
    inv_square : float64
        1 / the square of the direction's length.
    offset : float64
        The local distance by which the local ray's origin was advanced.
    center : tuple of three float64
    scale : float64
        The scene's local frame.
    """

    origin: tuple[np.float64, np.float64, np.float64]
    direction: tuple[np.float64, np.float64, np.float64]
    inv_square: np.float64
    offset: np.float64
    center: tuple[np.float64, np.float64, np.float64]
    scale: np.float64


@device
def _unit_scaled(direction):
    """A direction whose largest component is in [1, 2); nothing useful of an invalid ray's."""
    is_usual, power, _ = length_power(direction, _LEAST_EXPONENT, _MOST_EXPONENT)
    if is_usual:
        return scaled(direction, power)
    return scaled_slowly(direction)[2]


@device
def exact_ray(ray, offset, frame):
    """A ray in float64.

    Parameters
    ----------
    ray : WorldRay
    offset : float64
        See `ExactRay`.
    frame : SceneFrame

    Returns
    -------
    ExactRay
    """
    dx, dy, dz = direction = _unit_scaled(ray.direction)
    inv_square = ONE_F64 / (dx * dx + dy * dy + dz * dz)
    scale = np.float64(frame.scale)
    return ExactRay(ray.origin, direction, inv_square, offset, frame.center, scale)


#: ``load_exact(source, i, offset, frame)``: ray i of a `RaySource`, see `exact_ray`.
load_exact = loader(read_ray, exact_ray)


@device
def own_box(spheres, frame):
    """Low and high corners of the spheres' boxes: float32 vectors or numbers.

    Parameters
    ----------
    spheres : tuple of four float64 vectors or numbers
        Centres and radii, world space.
    frame : SceneFrame or ExactRay
    """
    center, scale = frame.center, frame.scale
    x = as_float32((spheres[0] - center[0]) * scale)
    y = as_float32((spheres[1] - center[1]) * scale)
    z = as_float32((spheres[2] - center[2]) * scale)
    radius = as_float32(spheres[3] * scale)
    reach_x = radius + (absolute(x) + radius) * BOX_GROWTH
    reach_y = radius + (absolute(y) + radius) * BOX_GROWTH
    reach_z = radius + (absolute(z) + radius) * BOX_GROWTH
    return (x - reach_x, y - reach_y, z - reach_z), (x + reach_x, y + reach_y, z + reach_z)


@device
def intersect(spheres, interval, exact, t_min, t_far, hits):
    """Test a ray against several spheres, or several rays against one.

    Vectors have a lane for each sphere, or for each ray; the others' are numbers.

    Parameters
    ----------
    spheres
        See `own_box`.
    interval : tuple of two float32 vectors
        The distances at which the rays enter and leave these boxes.
    exact : ExactRay
    t_min, t_far : float32 vector or number
        Closed interval in which a hit is wanted.
    hits : view
        Written, see `HIT`.

    Returns
    -------
    entered, left : uint64
        Bits of the lanes whose sphere is entered, and left, in the interval.
    """
    # Step 1: the centres' distances from the line, at its closest point.
    (x, y, z, radius), (ox, oy, oz), (dx, dy, dz) = spheres, exact.origin, exact.direction
    scale, inv_square = exact.scale, exact.inv_square
    fx, fy, fz = (ox - x) * scale, (oy - y) * scale, (oz - z) * scale
    radius = radius * scale
    middle = -((fx * dx + fy * dy + fz * dz) * inv_square)
    lx, ly, lz = fx + middle * dx, fy + middle * dy, fz + middle * dz
    rest = radius * radius - (lx * lx + ly * ly + lz * lz)
    hit = rest >= ZERO_F64
    if not any_lane(hit):
        return _NONE, _NONE

    # Step 2: both distances, in local units; the one that would cancel from their product.
    half = square_root(rest * inv_square)
    product = (fx * fx + fy * fy + fz * fz - radius * radius) * inv_square
    outer = select(middle >= ZERO_F64, middle + half, middle - half)
    inner = select(outer == ZERO_F64, absolute(outer), product / outer)
    near = narrow(minimum(inner, outer) - exact.offset)
    far = narrow(maximum(inner, outer) - exact.offset)

    # Step 3: clamped to the box. Adding zero turns -0 into 0.
    t_in, t_out = interval
    hit = hit & (t_in <= t_out)
    near = minimum(maximum(near, t_in), t_out) + ZERO_F32
    far = minimum(maximum(far, t_in), t_out) + ZERO_F32
    hits.near, hits.far, hits.half = near, far, half
    hits.x, hits.y, hits.z = lx, ly, lz
    return (
        mask_bits(hit & (near >= t_min) & (near <= t_far)),
        mask_bits(hit & (far >= t_min) & (far <= t_far)),
    )


@device
def place(x, y, z, step, exact):
    """Where on its sphere a hit is, as u and v; see `core.spheres.directions_at`.

    Parameters
    ----------
    x, y, z : float64 vector or number
        The ray's closest point to the centre, from there.
    step : float64 vector or number
        The distance from that point.
    exact : ExactRay
    """
    dx, dy, dz = exact.direction
    return octahedral(x + step * dx, y + step * dy, z + step * dz)


@device
def octahedral(x, y, z):
    """A direction from a sphere's centre as u and v; of no length, that to the top."""
    total = absolute(x) + absolute(y) + absolute(z)
    px, py = x / total, y / total
    # The lower half of the octahedron is folded over the sides of the upper one.
    is_below = z < ZERO_F64
    u = select(is_below, copy_sign(ONE_F64 - absolute(py), px), px)
    v = select(is_below, copy_sign(ONE_F64 - absolute(px), py), py)
    is_center = total == ZERO_F64
    return (
        as_float32(select(is_center, ZERO_F64, u) * _HALF64 + _HALF64),
        as_float32(select(is_center, ZERO_F64, v) * _HALF64 + _HALF64),
    )


@device
def _offer_lanes(bits, side, numbers, exact, search, hits):
    """Offer the hits of lanes: of side 0 where the ray enters, of 1 where it leaves."""
    while bits != _NONE:
        k = count_trailing_zeros(bits)
        bits &= bits - _ONE
        t = hits.far[k] if side == _ONE else hits.near[k]
        if t > search.t_far:
            continue
        half = hits.half[k]
        step = half if side == _ONE else -half
        u, v = place(hits.x[k], hits.y[k], hits.z[k], step, exact)
        search = offer(search, t, u, v, np.int32(numbers[k] + np.int32(side)))
        if is_full(search):
            break
    return search


@device
def intersect_spheres(block, ray, exact, search):
    """Test the spheres of a block against a ray, and offer their hits to a search.

    Parameters
    ----------
    block : uint64
        Address of a `SphereBlock`.
    ray : Ray
    exact : ExactRay
        The same one.
    search : Search

    Returns
    -------
    Search
    """
    at = scratch(_HITS_BYTES)
    add_to(search.counters, TESTS, _LANES)
    held = SphereBlock(block)
    spheres = held.x, held.y, held.z, held.radius
    interval = boxes_interval(ray, *own_box(spheres, exact))
    t_min, t_far = search.t_min, search.t_far
    entered, left = intersect(spheres, interval, exact, t_min, t_far, _Hits(at))
    for side in range(_TWO):
        bits = entered if side == _NONE else left
        search = _offer_lanes(bits, side, held.numbers, exact, search, _HitLanes(at))
        if is_full(search):
            break
    return search
