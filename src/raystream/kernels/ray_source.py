"""Addresses of a query's rays and results; a ray is read and made local when it is traced.

Batches are not copied: kernels read the caller's arrays by address. Nearly all rays take a fast
path with the result of `kernels.ray.to_local`; the others (float64 directions, far origins,
extreme lengths, limits that float32 cannot represent, invalid numbers) call it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.rays import DEFAULT_LIMITS, VALID
from raystream.jit.constants import ZERO_F32
from raystream.jit.cpu import device
from raystream.jit.simd import bits_as_float, float_as_bits, load
from raystream.kernels.adjacent_rows import adjacent_rows
from raystream.kernels.aligned import array_address
from raystream.kernels.ray import (
    FAR,
    LEAST_EXPONENT,
    MANTISSA_BITS,
    MOST_EXPONENT,
    POWER_EXPONENT,
    LocalRay,
    to_local,
)

_Y = np.uint64(4)
_Z = np.uint64(8)

#: `to_local` does not advance origins whose local coordinates are within this many times the
#: scene's largest, however it rounds.
NEAR_REACH = np.float32(FAR - 1.1)


class RaySource(NamedTuple):
    """Rays in memory: addresses of the first ray's components, and strides in bytes.

    Attributes
    ----------
    origins, directions : int
        Three adjacent numbers per ray, world space: float32, or float64 where
        `origins_are_double` or `directions_are_double` is true.
    t_min, t_max : int
        One float32 per ray; float64 for searches in float64.
    origin_step, direction_step, t_min_step, t_max_step : int
        0 where all rays share one value.
    """

    origins: np.uint64
    origin_step: np.uint64
    origins_are_double: bool
    directions: np.uint64
    direction_step: np.uint64
    directions_are_double: bool
    t_min: np.uint64
    t_min_step: np.uint64
    t_max: np.uint64
    t_max_step: np.uint64

    @classmethod
    def of(
        cls,
        origins: NDArray[Any],
        directions: NDArray[Any],
        limits: Sequence[NDArray[np.float32]],
        packed: bool = False,
    ) -> tuple[RaySource, object]:
        """The source of arrays, and the objects to keep alive until the rays are traced.

        Parameters
        ----------
        origins, directions, limits
            As in a `RayBatch`.
        packed : bool
            Limits must be adjacent, or share one value.
        """
        origins, directions = _readable(origins), _readable(directions)
        t_min, t_max = (_readable(limit, packed) for limit in limits)
        o, o_step = _place(origins)
        d, d_step = _place(directions)
        low, low_step = _place(t_min)
        high, high_step = _place(t_max)
        is_double = origins.itemsize == 8, directions.itemsize == 8
        source = cls(
            o, o_step, is_double[0], d, d_step, is_double[1], low, low_step, high, high_step
        )
        return source, (origins, directions, t_min, t_max)


def _readable(array: NDArray[Any], packed: bool = False) -> NDArray[Any]:
    """The array, or a copy whose rows are aligned, adjacent numbers, and adjacent if `packed`."""
    flags = array.flags
    if flags.c_contiguous and flags.aligned:
        return array
    if len(array) > 1 and array.strides[0] == 0:
        return array if array.ndim == 1 or array[0].flags.c_contiguous else array.copy()
    if not packed and flags.aligned and (array.ndim == 1 or array.strides[1] == array.itemsize):
        return array
    return np.ascontiguousarray(array) if array.ndim == 1 else adjacent_rows(array)


def _place(array: NDArray[Any]) -> tuple[np.uint64, np.uint64]:
    """Address, and stride in bytes, modulo 2**64 if negative."""
    known = _PLACES.get(id(array))
    if known is not None:
        return known
    step = array.strides[0] if len(array) > 1 else 0
    return np.uint64(array_address(array)), _STEPS.get(step) or np.uint64(step % 2**64)


#: Places of arrays that are never freed, by id: NumPy needs a microsecond for an address.
_PLACES = {
    id(array): (np.uint64(array.ctypes.data), np.uint64(0))
    for arrays in DEFAULT_LIMITS.values()
    for array in arrays.values()
}

#: The usual strides, for the same reason.
_STEPS = {step: np.uint64(step) for step in (4, 8, 12, 24)}


class ResultAddresses(NamedTuple):
    """Results in memory: addresses of the first ray's.

    Attributes
    ----------
    t, u, v, prim_id : int
        A float32 or int32 per ray, of first-hit queries. t is in world direction lengths.
    seen : int
        A byte per ray, of any-hit queries: 1 for a hit.
    status : int
        A byte per ray, a `RayStatus`; written for invalid rays only.
    """

    t: np.uint64
    u: np.uint64
    v: np.uint64
    prim_id: np.uint64
    seen: np.uint64
    status: np.uint64

    @classmethod
    def of_first(cls, memory: NDArray[np.float32], status: NDArray[np.uint8]) -> ResultAddresses:
        """Results of a first-hit query: the rows of an array; see `HitArrays.rows_of`."""
        at, step = array_address(memory), memory.strides[0]
        places = at, at + step, at + 2 * step, at + 3 * step, 0, array_address(status)
        return cls._make(np.array(places, np.uint64))

    @classmethod
    def of_any(cls, seen: NDArray[np.bool_], status: NDArray[np.uint8]) -> ResultAddresses:
        """Results of an any-hit query; the caller keeps the arrays alive."""
        return cls(*np.array((0, 0, 0, 0, array_address(seen), array_address(status)), np.uint64))


@device
def _three(at, are_double):
    """Three adjacent numbers as float64."""
    if are_double:
        return (
            load(np.float64, at),
            load(np.float64, at + np.uint64(8)),
            load(np.float64, at + np.uint64(16)),
        )
    return (
        np.float64(load(np.float32, at)),
        np.float64(load(np.float32, at + _Y)),
        np.float64(load(np.float32, at + _Z)),
    )


@device
def load_origin(source, i):
    """Origin of ray i in world space, as float64 numbers."""
    return _three(source.origins + i * source.origin_step, source.origins_are_double)


@device
def load_direction(source, i):
    """Direction of ray i in world space, as float64 numbers."""
    return _three(source.directions + i * source.direction_step, source.directions_are_double)


@device
def load_limits(source, i):
    """t_min and t_max of ray i, float32."""
    t_min = load(np.float32, source.t_min + i * source.t_min_step)
    return t_min, load(np.float32, source.t_max + i * source.t_max_step)


@device
def load_ray(source, i, frame):
    """Ray i in the local frame.

    Parameters
    ----------
    source : RaySource
    i : uint64
    frame : SceneFrame

    Returns
    -------
    LocalRay
    """
    wx, wy, wz = load_origin(source, i)
    dx, dy, dz = load_direction(source, i)
    t_min, t_max = load_limits(source, i)
    return local_ray(wx, wy, wz, dx, dy, dz, t_min, t_max, frame)


@device
def local_ray(wx, wy, wz, dx, dy, dz, t_min, t_max, frame):
    """A ray in the local frame: the result of `kernels.ray.to_local`, mostly without the call."""
    ox = np.float32((wx - frame.center[0]) * frame.scale)
    oy = np.float32((wy - frame.center[1]) * frame.scale)
    oz = np.float32((wz - frame.center[2]) * frame.scale)
    reach = NEAR_REACH * frame.max_coordinate
    exponent = float_as_bits(max(abs(dx), abs(dy), abs(dz))) >> MANTISSA_BITS
    if (
        exponent >= LEAST_EXPONENT
        and exponent <= MOST_EXPONENT
        and abs(dx) + abs(dy) + abs(dz) < np.inf
        and abs(ox) <= reach
        and abs(oy) <= reach
        and abs(oz) <= reach
    ):
        # 2**(1023 - exponent) scales the largest component to [1, 2).
        power = bits_as_float((POWER_EXPONENT - exponent) << MANTISSA_BITS)
        t_scale = power * frame.inverse_scale
        inverse = bits_as_float(exponent << MANTISSA_BITS) * frame.scale
        # Adding zero turns -0 into 0: the bits of positive numbers are in the numbers' order.
        low = np.float32(np.float64(t_min) * inverse) + ZERO_F32
        high = np.float32(np.float64(t_max) * inverse) + ZERO_F32
        if np.float64(low) * t_scale == t_min and np.float64(high) * t_scale == t_max:
            return LocalRay(
                ox,
                oy,
                oz,
                np.float32(dx * power),
                np.float32(dy * power),
                np.float32(dz * power),
                low,
                high,
                t_scale,
                np.float64(0.0),
                VALID,
            )
    return to_local(wx, wy, wz, dx, dy, dz, t_min, t_max, frame)
