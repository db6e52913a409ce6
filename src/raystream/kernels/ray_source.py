"""Addresses of a query's rays and results; a ray is read and made local when it is traced.

Batches are not copied: kernels read the caller's arrays by address. Nearly all rays take a fast
path with the result of `kernels.ray.to_local`; the others (float64 directions, far origins,
extreme lengths, limits that float32 cannot represent, invalid numbers) call it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.rays import DEFAULT_LIMITS, VALID
from raystream.jit.constants import (
    BYTES_32,
    BYTES_64,
    ONE_U64,
    TWO_U64,
    ZERO_F32,
    ZERO_F64,
    ZERO_U64,
)
from raystream.jit.cpu import device
from raystream.jit.simd import as_float32, load, widen
from raystream.kernels.adjacent_rows import adjacent_rows
from raystream.kernels.aligned import array_address
from raystream.kernels.ray import (
    FAR,
    LEAST_EXPONENT,
    MOST_EXPONENT,
    LocalRay,
    WorldRay,
    are_within,
    length_power,
    rounded,
    scaled,
    to_frame,
    to_local,
)

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


@device
def _three(at, are_double):
    """Three adjacent numbers as float64."""
    if are_double:
        return (
            load(np.float64, at),
            load(np.float64, at + BYTES_64),
            load(np.float64, at + (BYTES_64 + BYTES_64)),
        )
    return (
        np.float64(load(np.float32, at)),
        np.float64(load(np.float32, at + BYTES_32)),
        np.float64(load(np.float32, at + (BYTES_32 + BYTES_32))),
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
def _read_ray(source, i, number):
    t_min = load(number, source.t_min + i * source.t_min_step)
    t_max = load(number, source.t_max + i * source.t_max_step)
    return WorldRay(load_origin(source, i), load_direction(source, i), t_min, t_max)


@device
def read_ray(source, i):
    """Ray i in world space: a `WorldRay`."""
    return _read_ray(source, i, np.float32)


@device
def read_float64_ray(source, i):
    """Ray i of a source with limits in float64."""
    return _read_ray(source, i, np.float64)


def loader(read: Callable[..., Any], move: Callable[..., Any]) -> Callable[..., Any]:
    """Make the loader of a ray or a point into the frame in which it is searched.

    Parameters
    ----------
    read : device function
        ``read(source, i)``: it in world space.
    move : device function
        ``move(ray, *frame)``: it in the frame.

    Returns
    -------
    device function
        ``load(source, i, *frame)``
    """

    @device
    def load_one(source, i, *frame):
        return move(read(source, i), *frame)

    return load_one


@device
def in_object(ray, instance):
    """A `WorldRay`, or sixteen, in the space of an instance's object; see `InstanceRecord`."""
    linear, shift = instance.linear, instance.shift
    x_row, y_row, z_row = linear[ZERO_U64], linear[ONE_U64], linear[TWO_U64]
    x, y, z = _product(x_row, ray.origin), _product(y_row, ray.origin), _product(z_row, ray.origin)
    direction = ray.direction
    return WorldRay(
        (x + shift[0], y + shift[1], z + shift[2]),
        (_product(x_row, direction), _product(y_row, direction), _product(z_row, direction)),
        ray.t_min,
        ray.t_max,
    )


@device
def _product(row, x):
    return x[0] * row[0] + x[1] * row[1] + x[2] * row[2]


@device
def scale_ray(ray, frame):
    """Lengths of a `WorldRay`, or of sixteen, in a local frame.

    Returns
    -------
    is_usual : bool or mask
        Whether one power of two scales the direction.
    power : float64
        Of two: it scales the largest component of the direction to [1, 2).
    t_scale : float64
    low, high : float32
        The limits.
    is_exact : two bool or masks
        Whether these are exact.
    """
    is_usual, power, inverse = length_power(ray.direction, LEAST_EXPONENT, MOST_EXPONENT)
    t_scale, inverse = power * frame.inverse_scale, inverse * frame.scale
    t_min, t_max = widen(ray.t_min), widen(ray.t_max)
    # Adding zero turns -0 into 0: the bits of positive numbers are in the numbers' order.
    low, high = as_float32(t_min * inverse) + ZERO_F32, as_float32(t_max * inverse) + ZERO_F32
    is_exact = widen(low) * t_scale == t_min, widen(high) * t_scale == t_max
    return is_usual, power, t_scale, low, high, is_exact


@device
def near_ray(ray, frame):
    """A ray, or sixteen, in the local frame, if `to_local` gives the same.

    Returns
    -------
    is_so : bool or mask
    local : LocalRay
    """
    is_usual, power, t_scale, low, high, is_exact = scale_ray(ray, frame)
    origin = rounded(to_frame(ray.origin, frame))
    is_near = are_within(origin, NEAR_REACH * frame.max_coordinate)
    direction = rounded(scaled(ray.direction, power))
    local = LocalRay(origin, direction, low, high, t_scale, ZERO_F64, VALID)
    return is_usual & is_near & is_exact[0] & is_exact[1], local


@device
def local_ray(ray, frame, instance=None):
    """A ray in the local frame of a scene or of an instance's object.

    Parameters
    ----------
    ray : WorldRay
    frame : SceneFrame
    instance : InstanceRecord, optional
        Without it, the frame is of the space that the ray is in.

    Returns
    -------
    LocalRay
        The result of `kernels.ray.to_local`, mostly without the call.
    """
    if instance is not None:
        ray = in_object(ray, instance)
    is_so, local = near_ray(ray, frame)
    if is_so:
        return local
    return to_local(ray, frame)


#: ``load_ray(source, i, frame, instance=None)``: ray i of a `RaySource`, see `local_ray`.
load_ray = loader(read_ray, local_ray)
