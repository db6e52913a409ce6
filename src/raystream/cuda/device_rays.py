"""DeviceRays: rays in arrays of the caller's that are on the device, read where they are."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from raystream.core.arrays import as_real_array, is_on_gpu
from raystream.core.rays import DEFAULT_LIMITS
from raystream.cuda.packing import pack
from raystream.jit.cuda import DeviceArray, DeviceView, Gpu, StreamScope, view_of
from raystream.kernels.ray_source import RaySource

__all__ = ["DeviceRays", "place_device_rays", "usual_limits"]

#: Numbers of a host array that is copied along: a vector.
_FEW = 3


class DeviceRays(NamedTuple):
    """Rays on a device.

    Attributes
    ----------
    shape : tuple of int
        The leading shape.
    source : RaySource
    """

    shape: tuple[int, ...]
    source: RaySource

    def __len__(self) -> int:
        return math.prod(self.shape)

    def source_from(self, first: int) -> RaySource:
        """Where the rays from one on are."""

        def moved(address: np.uint64, step: np.uint64) -> np.uint64:
            return np.uint64((int(address) + first * int(step)) % 2**64)

        own = self.source
        return own._replace(
            origins=moved(own.origins, own.origin_step),
            directions=moved(own.directions, own.direction_step),
            t_min=moved(own.t_min, own.t_min_step),
            t_max=moved(own.t_max, own.t_max_step),
        )


@cache
def usual_limits(gpu: Gpu) -> dict[float, DeviceArray]:
    """The limits that most rays have, copied to a device once."""
    return {value: gpu.upload("limits", one) for value, one in DEFAULT_LIMITS.items()}


def place_device_rays(
    work: StreamScope, origins: Any, directions: Any, t_min: Any, t_max: Any
) -> DeviceRays:
    """View rays where they are, at least some of them on the device.

    Parameters
    ----------
    work : StreamScope
        In whose stream they are read.
    origins, directions, t_min, t_max
        As for `RayBatch`; arrays on the device are float32 or float64, and those on the host
        have one vector or number.

    Raises
    ------
    ValueError
        If shapes disagree.
    TypeError
        If numbers are of another type, or an array is on the host.
    CudaError
        If an array is on another device, or there is no memory.

    Notes
    -----
    Nothing is copied where one step leads from each ray to the next: one value for all, rows
    with or without gaps, backward. Other layouts, such as columns or two arrays broadcast
    against each other in different directions, and limits in float64, are packed on the device.
    """
    vectors = _vectors(work, "origins", origins), _vectors(work, "directions", directions)
    try:
        shape = np.broadcast_shapes(*(one.shape[:-1] for one in vectors))
    except ValueError:
        raise ValueError(
            f"origins and directions: shapes {vectors[0].shape} and {vectors[1].shape} "
            "do not broadcast against each other"
        ) from None
    limits = _limit(work, "t_min", t_min, shape), _limit(work, "t_max", t_max, shape)
    places: list[Any] = []
    for name, one in zip(("origins", "directions"), vectors, strict=True):
        places += [*_placed(work, name, one, shape), one.dtype.itemsize == 8]
    for name, one in zip(("t_min", "t_max"), limits, strict=True):
        row = (*one.shape, 1), (*one.strides, one.dtype.itemsize)
        places += _placed(work, name, one._replace(shape=row[0], strides=row[1]), shape)
    return DeviceRays(shape, RaySource(*places))


def _vectors(work: StreamScope, name: str, values: Any) -> DeviceView:
    view = _view(work, name, values)
    if view.shape == (0,):
        view = view._replace(shape=(0, 3), strides=(0, view.dtype.itemsize))
    if not view.shape or view.shape[-1] != 3:
        raise ValueError(f"{name}: expected shape (..., 3), got {view.shape}")
    return view


def _limit(work: StreamScope, name: str, values: Any, shape: tuple[int, ...]) -> DeviceView:
    usual = usual_limits(work.gpu)
    if type(values) in (float, int) and values in usual:
        return DeviceView(int(usual[values].address), (), (), np.dtype(np.float32))
    view = _view(work, name, values, lambda one: one.astype(np.float32))
    try:
        fits = np.broadcast_shapes(view.shape, shape) == shape
    except ValueError:
        fits = False
    if not fits:
        raise ValueError(
            f"{name}: shape {view.shape} does not broadcast to the rays' shape {shape}"
        )
    return view


def _view(
    work: StreamScope, name: str, values: Any, convert: Callable[[Any], Any] = np.ascontiguousarray
) -> DeviceView:
    if is_on_gpu(values):
        view = view_of(work, name, values)
        if view.dtype not in (np.float32, np.float64):
            raise TypeError(f"{name}: expected float32 or float64 on a GPU, got {view.dtype}")
        steps = (view.address, *view.strides)
        if any(step % view.dtype.itemsize for step in steps):
            raise TypeError(f"{name}: its numbers are not aligned; copy the array")
        return view
    array = as_real_array(name, values)
    if array.size > _FEW:
        raise TypeError(
            f"{name}: the array is on the host, and other arrays of the rays are on a GPU; "
            "copy it there, or those to the host"
        )
    with np.errstate(over="ignore"):
        array = np.ascontiguousarray(convert(array)).reshape(array.shape)
    placed = work.placed(name, array)
    return DeviceView(int(placed.address), array.shape, array.strides, array.dtype)


def _placed(
    work: StreamScope, name: str, view: DeviceView, shape: tuple[int, ...]
) -> tuple[np.uint64, np.uint64]:
    """Address and step of vectors or of limits of shape S + (1,); packed if these do not do."""
    *lengths, width = view.shape
    *steps, last = view.strides
    strides = [0] * (len(shape) - len(lengths))
    strides += [s if n > 1 else 0 for n, s in zip(lengths, steps, strict=True)]
    runs = _runs(shape, strides)
    fits = last == view.dtype.itemsize if width == 3 else view.dtype == np.float32
    if len(runs) <= 1 and fits:
        step = runs[0][1] if runs else 0
        return np.uint64(view.address), np.uint64(step % 2**64)
    return pack(work, name, view, runs, last, math.prod(shape))


def _runs(shape: tuple[int, ...], strides: list[int]) -> list[tuple[int, int]]:
    """Lengths and strides, outermost first, with directions put together that are one."""
    runs: list[tuple[int, int]] = []
    for length, stride in zip(shape, strides, strict=True):
        if length == 1:
            continue
        if runs and runs[-1][1] == stride * length:
            runs[-1] = runs[-1][0] * length, stride
        else:
            runs.append((length, stride))
    return [] if all(stride == 0 for _, stride in runs) else runs
