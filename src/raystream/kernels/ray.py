"""One ray: from world space to the scene's local frame, prepared for box and triangle tests.

The way to the local frame is in float64 (design decision 3): translation by the scene's centre,
directions scaled by a power of two, and origins far outside advanced to the scene's box. Then
float32 suffices.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from raystream.core.rays import INVALID, VALID
from raystream.core.triangles import Triangles
from raystream.jit.constants import INF_F32, INF_F64, ONE_F32, ONE_F64, ZERO_F32, ZERO_F64
from raystream.jit.cpu import device, device_call
from raystream.jit.intrinsics import no_inline
from raystream.jit.simd import (
    absolute,
    as_float32,
    bits_as_float,
    copy_sign,
    float_as_bits,
    maximum,
    next_float_up,
)
from raystream.kernels.box_entry import advanced, entry_of_one, outside_by

# Biased float64 exponents of direction lengths that one product scales to [1, 2): all that
# float32 has, and few more.
MANTISSA_BITS = np.int64(52)
POWER_EXPONENT = np.int64(2046)
LEAST_EXPONENT = np.int64(1023 - 149)
MOST_EXPONENT = np.int64(1023 + 127)

#: Origins are advanced if they are further outside the scene's box than this many times its largest
#: coordinate: nearer ones lose at most three bits of float32 to the distance.
FAR = 4.0

#: Coordinates beyond this make a ray or a point invalid: squares of them must stay finite in
#: float64.
MOST_COORDINATE = 2.0**200

#: Boxes are padded by this much of (largest scene coordinate + largest origin coordinate).
#: Rounding moves a vertex in the ray's frame by at most about 12 units of 2**-24 of that
#: sum, so a ray that hits may pass that far outside its triangle's box; 16 units cover it.
PAD = np.float32(2.0**-20)

#: Direction components are clamped to at least this fraction of the largest one in slab tests:
#: reciprocals stay finite, and zero is no special case (0 x inf is NaN).
#: Over a length of 2**20 scene sizes such a ray moves by less than the padding.
TINY_DIRECTION = np.float32(2.0**-40)

_LARGEST = np.float32(np.finfo(np.float32).max)
_MOST_FINITE = np.float64(np.finfo(np.float64).max)

#: Below this, reported distances may have lost bits; and their smallest step.
_ROUNDED = np.float32(2.0**-125)
_LEAST = 2.0**-149


class SceneFrame(NamedTuple):
    """The local frame of a scene, see `core.triangles.Triangles`.

    It holds no arrays: kernels pass it on for each ray, and passing an array costs two atomic
    operations.

    Attributes
    ----------
    center : tuple of three float64
    scale, inverse_scale : float
        A power of two, and its reciprocal.
    low, high : tuple of three float32
        The scene's box.
    max_coordinate : float32
    """

    center: tuple[float, float, float]
    scale: float
    inverse_scale: float
    low: tuple[np.float32, np.float32, np.float32]
    high: tuple[np.float32, np.float32, np.float32]
    max_coordinate: np.float32

    @classmethod
    def of(cls, triangles: Triangles) -> SceneFrame:
        """The frame of a triangle store."""
        x, y, z = triangles.center.tolist()
        (low_x, low_y, low_z), (high_x, high_y, high_z) = triangles.bounds
        low, high = (low_x, low_y, low_z), (high_x, high_y, high_z)
        scale = float(triangles.scale)
        return cls((x, y, z), scale, 1.0 / scale, low, high, np.float32(triangles.max_coordinate))

    @classmethod
    def identity(cls, triangles: Triangles) -> SceneFrame:
        """The frame of rays that are local already."""
        return cls.of(triangles)._replace(center=(0.0, 0.0, 0.0), scale=1.0, inverse_scale=1.0)


class WorldRay(NamedTuple):
    """A ray in world space, or in an object's space; or sixteen, as vectors.

    Attributes
    ----------
    origin, direction : triple of float64
    t_min, t_max : float32, or float64 in searches in float64
        Closed interval, in direction lengths.
    """

    origin: tuple[np.float64, np.float64, np.float64]
    direction: tuple[np.float64, np.float64, np.float64]
    t_min: np.floating[Any]
    t_max: np.floating[Any]


class LocalRay(NamedTuple):
    """A ray in the local frame; or sixteen, as vectors.

    Attributes
    ----------
    origin, direction : triple of float32
        The largest component of the direction is in [1, 2).
    t_min, t_max : float32
        Closed interval in local direction lengths; empty for a ray that cannot hit.
    t_scale, t_offset : float64
        World t = local t * t_scale + t_offset. The scale is a power of two, the offset zero
        unless the origin was advanced.
    status : uint8
        A `RayStatus`.
    """

    origin: tuple[np.float32, np.float32, np.float32]
    direction: tuple[np.float32, np.float32, np.float32]
    t_min: np.float32
    t_max: np.float32
    t_scale: np.float64
    t_offset: np.float64
    status: np.uint8


@device
def world_t(t, t_scale, t_offset):
    """A local distance as it is reported, in world direction lengths."""
    world = np.float32(np.float64(t) * t_scale + t_offset)
    # A distance beyond float32 is still a hit: only a miss is infinite.
    return min(max(world, -_LARGEST), _LARGEST)


@device
def _next(t, toward):
    """The next float32 above t if `toward` is positive, else below."""
    return next_float_up(t) if toward > 0 else -next_float_up(-t)


@device_call
def _local_limit(t, t_scale, t_offset, toward):
    """The outermost local distance whose reported value is within the limit t.

    `toward` is +1 for an upper limit and -1 for a lower one. Reported distances are rounded
    to float32, so a hit at exactly the limit may lie up to half a step beyond it.
    """
    no_inline()
    if not (abs(t) < INF_F32):
        return t
    exact = np.float32((np.float64(t)) / t_scale)
    if t_offset == 0.0 and np.float64(exact) * t_scale == np.float64(t):
        return exact
    step = np.float64(_next(t, toward)) - np.float64(t)
    limit = np.float32((np.float64(t) + 0.5 * step - t_offset) / t_scale)
    # The two roundings above are off by at most a few steps.
    for _ in range(4):
        beyond = _next(limit, toward)
        if (world_t(beyond, t_scale, t_offset) - t) * np.float32(toward) > 0.0:
            break
        limit = beyond
    for _ in range(8):
        if (world_t(limit, t_scale, t_offset) - t) * np.float32(toward) <= 0.0:
            break
        limit = _next(limit, -toward)
    return limit


@device
def local_limit(t, t_scale, t_offset):
    """A local distance beyond which all are reported as more than t."""
    if t >= _LARGEST:
        return INF_F32
    if abs(t) < _ROUNDED:  # many local distances are reported as the same one
        beyond = (np.float64(t) + _LEAST - t_offset) / t_scale
        return next_float_up(np.float32(beyond))
    if t_offset == 0.0:
        exact = np.float32(np.float64(t) / t_scale)
        if np.float64(exact) * t_scale == np.float64(t):
            return exact
    return _local_limit(t, t_scale, t_offset, 1)


@device
def largest(x):
    """The largest magnitude of a triple of numbers or vectors; NaN may be passed over."""
    return maximum(maximum(absolute(x[0]), absolute(x[1])), absolute(x[2]))


@device
def are_within(x, bound):
    """Whether the magnitudes of a triple of numbers or vectors are at most `bound`: no NaN is."""
    return (absolute(x[0]) <= bound) & (absolute(x[1]) <= bound) & (absolute(x[2]) <= bound)


@device
def scaled(x, factor):
    """A triple of numbers or vectors times a factor."""
    return x[0] * factor, x[1] * factor, x[2] * factor


@device
def to_frame(point, frame):
    """A point of numbers or vectors, float64, from world space to a local frame."""
    x, y, z = point
    return scaled((x - frame.center[0], y - frame.center[1], z - frame.center[2]), frame.scale)


@device
def length_power(direction, least, most):
    """Scaling by one product, of a direction of numbers or vectors.

    Parameters
    ----------
    direction : triple
    least, most : int64
        Biased exponents.

    Returns
    -------
    is_usual : bool or mask
        Whether all are numbers, and the largest one's exponent is in between.
    power, inverse : float64
        Then, a power of two that scales it to [1, 2), and its reciprocal.
    """
    exponent = float_as_bits(largest(direction)) >> MANTISSA_BITS
    is_usual = (exponent >= least) & (exponent <= most) & are_within(direction, INF_F64)
    power = bits_as_float((POWER_EXPONENT - exponent) << MANTISSA_BITS)
    return is_usual, power, bits_as_float(exponent << MANTISSA_BITS)


@device_call
def scaled_slowly(direction):
    """Two powers of two, and a direction times both, whose largest component is in [1, 2)."""
    no_inline()
    exponent = 1 - math.frexp(largest(direction))[1]
    # Products with a power of two are exact; in two steps no factor overflows, even for the
    # smallest directions. A component that underflows is below 2**-149 of the largest one.
    half = math.ldexp(1.0, exponent // 2)
    rest = math.ldexp(1.0, exponent - exponent // 2)
    return half, rest, scaled(scaled(direction, half), rest)


@device
def missing_ray(status):
    """A ray with an empty interval, safe to trace."""
    origin, direction = (ZERO_F32, ZERO_F32, ZERO_F32), (ONE_F32, ONE_F32, ONE_F32)
    return LocalRay(origin, direction, INF_F32, -INF_F32, ONE_F64, ZERO_F64, status)


@device
def is_valid(ray):
    """Whether the numbers of a `WorldRay` are those of a ray: no NaN is."""
    dx, dy, dz = ray.direction
    if not (are_within(ray.origin, MOST_COORDINATE) and are_within(ray.direction, _MOST_FINITE)):
        return False
    if dx == 0.0 and dy == 0.0 and dz == 0.0:
        return False
    return ray.t_min == ray.t_min and ray.t_max == ray.t_max


@device
def rounded(x):
    """A triple of numbers or vectors in float32."""
    return as_float32(x[0]), as_float32(x[1]), as_float32(x[2])


@device_call
def to_local(ray, frame):
    """Transform a ray to the local frame.

    Parameters
    ----------
    ray : WorldRay
    frame : SceneFrame

    Returns
    -------
    LocalRay
        A ray that is invalid or cannot reach the scene has an empty interval.
    """
    no_inline()
    if not is_valid(ray):
        return missing_ray(INVALID)

    # Step 1: move by the centre; scale so that the largest component is in [1, 2).
    origin = to_frame(ray.origin, frame)
    is_usual, power, _ = length_power(ray.direction, LEAST_EXPONENT, MOST_EXPONENT)
    if is_usual:
        # One exact product, without functions that take as long as the rest.
        direction = scaled(ray.direction, power)
    else:
        half, rest, direction = scaled_slowly(ray.direction)
        # Beyond 2**800 distances leave float32 anyway; the bound keeps t_scale finite.
        power = min(max(half * rest, 2.0**-800), 2.0**800)
    t_scale = power * frame.inverse_scale

    # Step 2: advance an origin that is far outside. A second step corrects the rounding error of
    # the first, which is 2**-53 of the distance.
    t_offset = 0.0
    if outside_by(origin, frame) > FAR * np.float64(frame.max_coordinate):
        total = 0.0
        for _ in range(2):
            step = entry_of_one(origin, direction, frame)
            if step == np.inf:
                return missing_ray(VALID)
            origin = advanced(origin, direction, step)
            total += step
        t_offset = total * t_scale

    return LocalRay(
        rounded(origin),
        rounded(direction),
        # Adding zero turns -0 into 0: the bits of positive numbers are in the numbers' order.
        _local_limit(ray.t_min, t_scale, t_offset, -1) + ZERO_F32,
        _local_limit(ray.t_max, t_scale, t_offset, 1) + ZERO_F32,
        t_scale,
        t_offset,
        VALID,
    )


class Ray(NamedTuple):
    """A prepared ray: all that does not depend on a box or a triangle, computed once.

    Attributes
    ----------
    kx, ky, kz : int
        Axes of the frame: kz is that of the largest direction component; kx and ky follow in
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
    """The component of axis k."""
    return x if k == np.uint64(0) else (y if k == np.uint64(1) else z)


@device
def _reciprocal(d, tiny, unit):
    # copysign, not a comparison: -0 counts as negative, like its neighbours.
    return copy_sign(unit / maximum(absolute(d), tiny), d)


@device
def slab_constants(origin, direction, tiny, pad, unit):
    """What slab distances of a ray take, or of sixteen: numbers or vectors.

    Padding moves near planes towards the origin and far planes away from it, so it has the
    direction's sign.

    Parameters
    ----------
    origin, direction : triple
    tiny : number
        Components of the direction are at least this large.
    pad : number
        How much boxes are padded, positive.
    unit : number
        The distance in which the others are measured, positive.

    Returns
    -------
    inv, near, far : triple
        Reciprocal direction; the distance to a near plane is fma(plane, inv, near), and to a far
        one fma(plane, inv, far).
    """
    (ox, oy, oz), (dx, dy, dz) = origin, direction
    inv_x = _reciprocal(dx, tiny, unit)
    inv_y = _reciprocal(dy, tiny, unit)
    inv_z = _reciprocal(dz, tiny, unit)
    pad_x, pad_y, pad_z = copy_sign(pad, dx), copy_sign(pad, dy), copy_sign(pad, dz)
    near = -((ox + pad_x) * inv_x), -((oy + pad_y) * inv_y), -((oz + pad_z) * inv_z)
    far = -((ox - pad_x) * inv_x), -((oy - pad_y) * inv_y), -((oz - pad_z) * inv_z)
    return (inv_x, inv_y, inv_z), near, far


@device
def prepare_ray(origin, direction, max_coordinate):
    """Prepare a ray.

    Parameters
    ----------
    origin, direction : three float32, by index
        Finite, local frame; the largest direction component is in [1, 2).
    max_coordinate : float32
        Largest absolute coordinate of the scene.

    Returns
    -------
    Ray
    """
    ox, oy, oz = origin[0], origin[1], origin[2]
    dx, dy, dz = direction[0], direction[1], direction[2]
    # Step 1: the frame's z axis is the largest component; the first one wins a tie.
    ax, ay, az = abs(dx), abs(dy), abs(dz)
    kz = np.uint64(0)
    longest = ax
    if ay > longest:
        kz = np.uint64(1)
        longest = ay
    if az > longest:
        kz = np.uint64(2)
        longest = az
    kx = kz + np.uint64(1) if kz < np.uint64(2) else np.uint64(0)
    ky = kx + np.uint64(1) if kx < np.uint64(2) else np.uint64(0)

    # Step 2: slab constants, with boxes padded for the rounding of the triangle test.
    pad = PAD * (max_coordinate + largest((ox, oy, oz)))
    tiny = longest * TINY_DIRECTION
    inv, near, far = slab_constants((ox, oy, oz), (dx, dy, dz), tiny, pad, ONE_F32)

    # Step 3: the shear. kz is not tiny, so its reciprocal is exact to one rounding.
    sz = component(kz, *inv)
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
        *inv,
        *near,
        *far,
    )
