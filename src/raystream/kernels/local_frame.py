"""Rays from world space into a scene's local frame, and distances back.

All of it is done in float64 (design decision 3): moving by the scene's centre, scaling
directions by a power of two, and advancing origins that lie far outside to the scene's box.
Then float32 suffices for the rest.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.rays import RayStatus
from raystream.jit.cpu import device, device_call, kernel

__all__ = ["FAR", "SceneFrame", "TScale", "to_local_rays", "to_world_t"]

_VALID = np.uint8(RayStatus.VALID)
_INVALID = np.uint8(RayStatus.INVALID)

#: Origins further outside the scene's box than this many times its largest coordinate are
#: advanced: nearer ones lose at most three bits of float32 to the distance.
FAR = 4.0

#: Coordinates beyond this make a ray invalid: squares of them must stay finite in float64.
_MAX_COORDINATE = 2.0**200

_INF = np.float32(np.inf)
_LARGEST = np.float32(np.finfo(np.float32).max)


class SceneFrame(NamedTuple):
    """The local frame of a scene, see `core.triangles.Triangles`.

    Attributes
    ----------
    center : ndarray of shape (3,), float64
    scale : float
    bounds : ndarray of shape (2, 3), float32
    extreme : float32
    """

    center: NDArray[np.float64]
    scale: float
    bounds: NDArray[np.float32]
    extreme: np.float32


class TScale(NamedTuple):
    """How a ray's distances go back to world space: t = local t * factor + offset.

    Attributes
    ----------
    factor : ndarray of shape (N,), float64
        A power of two.
    offset : ndarray of shape (N,), float64
        Zero but for origins that were advanced.
    """

    factor: NDArray[np.float64]
    offset: NDArray[np.float64]


@device
def _world_t(t, factor, offset):
    """A local distance in world direction lengths, as it is reported."""
    world = np.float32(np.float64(t) * factor + offset)
    # A distance beyond float32 is still a hit: only a miss is infinite.
    return min(max(world, -_LARGEST), _LARGEST)


@device_call
def _local_limit(t, factor, offset, toward):
    """The outermost local distance whose reported value is still within the limit t.

    `toward` is +1 for an upper limit and -1 for a lower one. Reported distances are rounded
    to float32, so hits at exactly the limit must be looked for up to half a step beyond it.
    """
    if not (abs(t) < _INF):
        return t
    exact = np.float32((np.float64(t)) / factor)
    if offset == 0.0 and np.float64(exact) * factor == np.float64(t):
        return exact
    step = np.float64(np.nextafter(t, np.float32(toward) * _INF)) - np.float64(t)
    limit = np.float32((np.float64(t) + 0.5 * step - offset) / factor)
    # The two roundings above are off by a few steps at most.
    for _ in range(4):
        beyond = np.nextafter(limit, np.float32(toward) * _INF)
        if (_world_t(beyond, factor, offset) - t) * np.float32(toward) > 0.0:
            break
        limit = beyond
    for _ in range(8):
        if (_world_t(limit, factor, offset) - t) * np.float32(toward) <= 0.0:
            break
        limit = np.nextafter(limit, np.float32(-toward) * _INF)
    return limit


@device
def _is_valid(origin, direction, t_min, t_max):
    for axis in range(3):
        if not (abs(origin[axis]) <= _MAX_COORDINATE):
            return False
        if not (abs(direction[axis]) < np.inf):
            return False
    if direction[0] == 0.0 and direction[1] == 0.0 and direction[2] == 0.0:
        return False
    return t_min == t_min and t_max == t_max


@device
def _outside_by(origin, frame):
    """How far the origin lies outside the scene's box, along the axis where it is most."""
    outside = 0.0
    for axis in range(3):
        low, high = np.float64(frame.bounds[0, axis]), np.float64(frame.bounds[1, axis])
        outside = max(outside, low - origin[axis], origin[axis] - high)
    return outside


@device_call
def _entry(origin, direction, frame):
    """Where the line enters the scene's box grown by the scene's size; inf if it misses it."""
    t_in, t_out = -np.inf, np.inf
    margin = np.float64(frame.extreme)
    for axis in range(3):
        low = np.float64(frame.bounds[0, axis]) - margin - origin[axis]
        high = np.float64(frame.bounds[1, axis]) + margin - origin[axis]
        d = direction[axis]
        if d == 0.0:
            if low > 0.0 or high < 0.0:
                return np.inf
            continue
        t_low, t_high = low / d, high / d
        t_in = max(t_in, min(t_low, t_high))
        t_out = min(t_out, max(t_low, t_high))
    return t_in if t_in <= t_out else np.inf


@device_call
def _advance(origin, direction, frame):
    """Move the origin along the line to the scene; returns how far, or inf if it misses.

    A second step corrects what the first one's rounding leaves of a long way: float64 keeps
    2**-53 of it.
    """
    total = 0.0
    for _ in range(2):
        step = _entry(origin, direction, frame)
        if step == np.inf:
            return step
        for axis in range(3):
            origin[axis] += step * direction[axis]
        total += step
    return total


@device
def _set_to_miss(rays, t_scale, i):
    for axis in range(3):
        rays.origins[i, axis] = 0.0
        rays.directions[i, axis] = 1.0
    rays.t_min[i] = _INF
    rays.t_max[i] = -_INF
    t_scale.factor[i] = 1.0
    t_scale.offset[i] = 0.0


@kernel
def to_local_rays(begin, end, origins, directions, t_min, t_max, frame, rays, t_scale, status):
    """Turn rays begin to end into local ones.

    Parameters
    ----------
    begin, end : int
    origins, directions : ndarray of shape (N, 3), float32 or float64
        World space.
    t_min, t_max : ndarray of shape (N,), float32
        Closed interval, in direction lengths.
    frame : SceneFrame
    rays : LocalRays
        Written. Rays that are invalid or cannot reach the scene get an empty interval.
    t_scale : TScale
        Written.
    status : ndarray of shape (N,), uint8
        Written: a `RayStatus`.
    """
    origin = np.empty(3, np.float64)
    direction = np.empty(3, np.float64)
    for i in range(np.uint64(begin), np.uint64(end)):
        status[i] = _VALID
        if not _is_valid(origins[i], directions[i], t_min[i], t_max[i]):
            status[i] = _INVALID
            _set_to_miss(rays, t_scale, i)
            continue

        # Step 1: move by the centre; scale so that the largest component is in [1, 2).
        # A component that vanishes on the way is below 2**-149 of the largest one.
        largest = 0.0
        for axis in range(3):
            origin[axis] = (np.float64(origins[i, axis]) - frame.center[axis]) * frame.scale
            largest = max(largest, abs(np.float64(directions[i, axis])))
        exponent = math.frexp(largest)[1]
        # Products with a power of two are exact; in two steps it stays a float64 even for
        # the smallest directions.
        half = math.ldexp(1.0, (1 - exponent) // 2)
        rest = math.ldexp(1.0, (1 - exponent) - (1 - exponent) // 2)
        for axis in range(3):
            direction[axis] = np.float64(directions[i, axis]) * half * rest
        # Beyond 2**800 distances leave float32 anyway; the bound keeps the factor finite.
        factor = math.ldexp(1.0 / frame.scale, max(-800, min(1 - exponent, 800)))

        # Step 2: advance an origin that lies far outside.
        offset = 0.0
        if _outside_by(origin, frame) > FAR * np.float64(frame.extreme):
            local_offset = _advance(origin, direction, frame)
            if local_offset == np.inf:
                _set_to_miss(rays, t_scale, i)
                continue
            offset = local_offset * factor

        for axis in range(3):
            rays.origins[i, axis] = origin[axis]
            rays.directions[i, axis] = direction[axis]
        t_scale.factor[i] = factor
        t_scale.offset[i] = offset
        rays.t_min[i] = _local_limit(t_min[i], factor, offset, -1)
        rays.t_max[i] = _local_limit(t_max[i], factor, offset, 1)


@kernel
def to_world_t(begin, end, splits, t_scale, t):
    """Turn the distances of rays begin to end into world direction lengths, in place.

    Parameters
    ----------
    begin, end : int
    splits : ndarray of shape (N + 1,), int64
        Ray i owns rows splits[i] to splits[i + 1] of `t`.
    t_scale : TScale
    t : ndarray of shape (K,), float32
        Misses (inf) stay as they are.
    """
    for i in range(np.uint64(begin), np.uint64(end)):
        for row in range(np.uint64(splits[i]), np.uint64(splits[i + np.uint64(1)])):
            if t[row] < _INF:
                t[row] = _world_t(t[row], t_scale.factor[i], t_scale.offset[i])
