"""One ray: from world space to the scene's local frame, prepared for box and triangle tests.

The way to the local frame is in float64 (design decision 3): translation by the scene's centre,
directions scaled by a power of two, and origins far outside advanced to the scene's box. Then
float32 suffices.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from raystream.core.rays import RayStatus
from raystream.core.triangles import Triangles
from raystream.jit.cpu import device, device_call
from raystream.jit.intrinsics import no_inline
from raystream.jit.simd import bits_as_float, copy_sign, float_as_bits, next_float_up

# Biased float64 exponents of direction lengths that one product scales to [1, 2): all that
# float32 has, and few more.
MANTISSA_BITS = np.int64(52)
POWER_EXPONENT = np.int64(2046)
LEAST_EXPONENT = np.int64(1023 - 149)
MOST_EXPONENT = np.int64(1023 + 127)

_VALID = np.uint8(RayStatus.VALID)
_INVALID = np.uint8(RayStatus.INVALID)

#: Origins are advanced if they are further outside the scene's box than this many times its largest
#: coordinate: nearer ones lose at most three bits of float32 to the distance.
FAR = 4.0

#: Coordinates beyond this make a ray invalid: squares of them must stay finite in float64.
_MAX_COORDINATE = 2.0**200

#: Boxes are padded by this much of (largest scene coordinate + largest origin coordinate).
#: Rounding moves a vertex in the ray's frame by at most about 12 units of 2**-24 of that
#: sum, so a ray that hits may pass that far outside its triangle's box; 16 units cover it.
PAD = np.float32(2.0**-20)

#: Direction components are clamped to at least this fraction of the largest one in slab tests:
#: reciprocals stay finite, and zero is no special case (0 x inf is NaN).
#: Over a length of 2**20 scene sizes such a ray moves by less than the padding.
TINY_DIRECTION = np.float32(2.0**-40)

_INF = np.float32(np.inf)
_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)
_LARGEST = np.float32(np.finfo(np.float32).max)

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


class LocalRay(NamedTuple):
    """A ray in the local frame.

    Attributes
    ----------
    ox, oy, oz, dx, dy, dz : float32
        The largest component of the direction is in [1, 2).
    t_min, t_max : float32
        Closed interval in local direction lengths; empty for a ray that cannot hit.
    t_scale, t_offset : float64
        World t = local t * t_scale + t_offset. The scale is a power of two, the offset zero
        unless the origin was advanced.
    status : uint8
        A `RayStatus`.
    """

    ox: np.float32
    oy: np.float32
    oz: np.float32
    dx: np.float32
    dy: np.float32
    dz: np.float32
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
    if not (abs(t) < _INF):
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
        return _INF
    if abs(t) < _ROUNDED:  # many local distances are reported as the same one
        beyond = (np.float64(t) + _LEAST - t_offset) / t_scale
        return next_float_up(np.float32(beyond))
    if t_offset == 0.0:
        exact = np.float32(np.float64(t) / t_scale)
        if np.float64(exact) * t_scale == np.float64(t):
            return exact
    return _local_limit(t, t_scale, t_offset, 1)


@device
def _outside_by(o, low, high):
    """Distance of a coordinate from the scene's box; negative inside."""
    return max(np.float64(low) - o, o - np.float64(high))


@device_call
def _crossing(o, d, low, high, margin):
    """Interval (t_in, t_out) of a line between two planes that a margin moves apart."""
    to_low = np.float64(low) - margin - o
    to_high = np.float64(high) + margin - o
    if d == 0.0:
        return (np.inf, -np.inf) if to_low > 0.0 or to_high < 0.0 else (-np.inf, np.inf)
    t_low, t_high = to_low / d, to_high / d
    return min(t_low, t_high), max(t_low, t_high)


@device_call
def _entry(ox, oy, oz, dx, dy, dz, frame):
    """Distance at which a line enters the scene's box, padded by its size; inf for a miss."""
    no_inline()
    margin = np.float64(frame.max_coordinate)
    low, high = frame.low, frame.high
    in_x, out_x = _crossing(ox, dx, low[0], high[0], margin)
    in_y, out_y = _crossing(oy, dy, low[1], high[1], margin)
    in_z, out_z = _crossing(oz, dz, low[2], high[2], margin)
    t_in = max(in_x, in_y, in_z)
    return t_in if t_in <= min(out_x, out_y, out_z) else np.inf


@device
def _miss(status):
    """A ray with an empty interval, safe to trace."""
    return LocalRay(
        _ZERO, _ZERO, _ZERO, _ONE, _ONE, _ONE, _INF, -_INF, np.float64(1.0), np.float64(0.0), status
    )


@device
def _is_valid(ox, oy, oz, dx, dy, dz, t_min, t_max):
    # Written so that a NaN fails.
    if not (abs(ox) <= _MAX_COORDINATE and abs(oy) <= _MAX_COORDINATE):
        return False
    if not (abs(oz) <= _MAX_COORDINATE and abs(dx) < np.inf):
        return False
    if not (abs(dy) < np.inf and abs(dz) < np.inf):
        return False
    if dx == 0.0 and dy == 0.0 and dz == 0.0:
        return False
    return t_min == t_min and t_max == t_max


@device_call
def to_local(ox, oy, oz, dx, dy, dz, t_min, t_max, frame):
    """Transform a ray to the local frame.

    Parameters
    ----------
    ox, oy, oz, dx, dy, dz : float64
        World space.
    t_min, t_max : float32
        Closed interval, in direction lengths.
    frame : SceneFrame

    Returns
    -------
    LocalRay
        A ray that is invalid or cannot reach the scene has an empty interval.
    """
    no_inline()
    if not _is_valid(ox, oy, oz, dx, dy, dz, t_min, t_max):
        return _miss(_INVALID)

    # Step 1: move by the centre; scale so that the largest component is in [1, 2).
    # A component that underflows is below 2**-149 of the largest one.
    ox = (ox - frame.center[0]) * frame.scale
    oy = (oy - frame.center[1]) * frame.scale
    oz = (oz - frame.center[2]) * frame.scale
    length = max(abs(dx), abs(dy), abs(dz))
    biased = float_as_bits(length) >> MANTISSA_BITS
    if biased >= LEAST_EXPONENT and biased <= MOST_EXPONENT:
        # One exact product, without functions that take as long as the rest.
        power = bits_as_float((POWER_EXPONENT - biased) << MANTISSA_BITS)
        dx *= power
        dy *= power
        dz *= power
        t_scale = power * frame.inverse_scale
    else:
        exponent = math.frexp(length)[1]
        # Products with a power of two are exact; in two steps no factor overflows, even for the
        # smallest directions.
        half = math.ldexp(1.0, (1 - exponent) // 2)
        rest = math.ldexp(1.0, (1 - exponent) - (1 - exponent) // 2)
        dx = dx * half * rest
        dy = dy * half * rest
        dz = dz * half * rest
        # Beyond 2**800 distances leave float32 anyway; the bound keeps t_scale finite.
        t_scale = math.ldexp(1.0 / frame.scale, max(-800, min(1 - exponent, 800)))

    # Step 2: advance an origin that is far outside. A second step corrects the rounding error of
    # the first, which is 2**-53 of the distance.
    t_offset = 0.0
    low, high = frame.low, frame.high
    outside = max(
        _outside_by(ox, low[0], high[0]),
        _outside_by(oy, low[1], high[1]),
        _outside_by(oz, low[2], high[2]),
    )
    if outside > FAR * np.float64(frame.max_coordinate):
        total = 0.0
        for _ in range(2):
            step = _entry(ox, oy, oz, dx, dy, dz, frame)
            if step == np.inf:
                return _miss(_VALID)
            ox += step * dx
            oy += step * dy
            oz += step * dz
            total += step
        t_offset = total * t_scale

    return LocalRay(
        np.float32(ox),
        np.float32(oy),
        np.float32(oz),
        np.float32(dx),
        np.float32(dy),
        np.float32(dz),
        # Adding zero turns -0 into 0: the bits of positive numbers are in the numbers' order.
        _local_limit(t_min, t_scale, t_offset, -1) + _ZERO,
        _local_limit(t_max, t_scale, t_offset, 1) + _ZERO,
        t_scale,
        t_offset,
        _VALID,
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
def _reciprocal(d, tiny):
    # copysign, not a comparison: -0 counts as negative, like its neighbours.
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

    # Step 2: slab constants. Padding moves near planes towards the origin and far planes away
    # from it, so it has the direction's sign.
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
