"""Rays in GPU memory: copied from the host, or read in the caller's device arrays."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.rays import DEFAULT_LIMITS, RayArrays, RayBatch, as_real_array, is_on_gpu
from raystream.cuda.packing import pack
from raystream.jit.cuda import DeviceArray, DeviceView, Gpu, StreamScope, view_of
from raystream.kernels.ray_source import RaySource
from raystream.tracer.traced_scene import flat_ids

#: Most hits of rays that are traced together; a ray with more is traced by itself.
HITS_AT_ONCE = 1 << 22

#: Most numbers of a host array that is copied along with device arrays: a vector.
_FEW = 3


def moved(address: np.uint64, count: int, byte_count: int | np.uint64) -> np.uint64:
    """An address `count` records of `byte_count` bytes further on, or back."""
    return np.uint64((int(address) + count * int(byte_count)) % 2**64)


def split_rows(
    rows: slice,
    most: int,
    splits: NDArray[np.int64] | None = None,
    hits_at_once: int = HITS_AT_ONCE,
) -> Iterator[slice]:
    """Split rays into parts of at most `most` rays, and at most `hits_at_once` hits if possible."""
    begin = rows.start
    while begin < rows.stop:
        end = min(begin + most, rows.stop)
        if splits is not None:
            fits = int(np.searchsorted(splits, splits[begin] + hits_at_once, "right")) - 1
            end = min(end, max(fits, begin + 1))
        yield slice(begin, end)
        begin = end


class DeviceRays(NamedTuple):
    """Rays on a device.

    Attributes
    ----------
    shape : tuple of int
        The leading shape.
    source : RaySource
    arrays : tuple of DeviceArray
        Keep them until the rays are traced.
    worlds : uint64 or None
        Address of the world of each ray, int32, in a scene whose instances are in worlds.
    masks : DeviceArray of shape (N,) or (1,), uint32, or None
        The mask of each ray, or of all; None for all bits.
    """

    shape: tuple[int, ...]
    source: RaySource
    arrays: tuple[DeviceArray, ...] = ()
    worlds: np.uint64 | None = None
    masks: DeviceArray | None = None

    def __len__(self) -> int:
        return math.prod(self.shape)

    def with_masks(self, masks: DeviceArray | None) -> DeviceRays:
        """The same rays with masks."""
        return DeviceRays(self.shape, self.source, self.arrays, self.worlds, masks)

    def source_from(self, first: int) -> RaySource:
        """The source of the rays from `first` on."""
        own = self.source
        return own._replace(
            origins=moved(own.origins, first, own.origin_step),
            directions=moved(own.directions, first, own.direction_step),
            t_min=moved(own.t_min, first, own.t_min_step),
            t_max=moved(own.t_max, first, own.t_max_step),
        )


def place_rays(
    batch: RayBatch, rows: slice, upload: Callable[[str, NDArray[Any]], DeviceArray]
) -> DeviceRays:
    """Copy some rays of a batch to a device; a value that all of them share is copied once.

    Parameters
    ----------
    batch : RayBatch
    rows : slice
    upload : callable
        ``upload(name, array)`` copies an array, such as `StreamScope.placed`.

    Raises
    ------
    CudaError
        If there is no memory for them.
    """
    vectors = [_given(array, rows) for array in (batch.origins, batch.directions)]
    limits = [limit if len(limit) == 1 else limit[rows] for limit in batch.exact_limits]
    named = zip(("origins", "directions", "t_min", "t_max"), (*vectors, *limits), strict=True)
    placed = [upload(name, array) for name, array in named]
    steps = [np.uint64(one.shape[0] > 1) * _row_bytes(one) for one in placed]
    origins, directions, t_min, t_max = (one.address for one in placed)
    doubles = [one.dtype.itemsize == 8 for one in placed]
    source = RaySource(
        *(origins, steps[0], doubles[0], directions, steps[1], doubles[1]),
        *(t_min, steps[2], t_max, steps[3]),
    )
    worlds = None
    if batch.worlds is not None:
        placed.append(upload("worlds", batch.worlds[rows]))
        worlds = placed[-1].address
    return DeviceRays((rows.stop - rows.start,), source, tuple(placed), worlds)


def _given(array: NDArray[Any], rows: slice) -> NDArray[Any]:
    """Rows of an array; one if it is broadcast."""
    return array[:1] if len(array) > 1 and array.strides[0] == 0 else array[rows]


def _row_bytes(array: DeviceArray) -> np.uint64:
    return np.uint64(array.dtype.itemsize * int(np.prod(array.shape[1:], dtype=np.int64)))


@cache
def usual_limits(gpu: Gpu) -> dict[float, DeviceArray]:
    """The default limits, copied to a device once."""
    return {value: gpu.upload("limits", one) for value, one in DEFAULT_LIMITS[np.float32].items()}


def place_device_rays(
    scope: StreamScope,
    arrays: RayArrays,
    world_count: int = 0,
    kind: type[np.floating[Any]] = np.float32,
) -> DeviceRays:
    """View rays in the caller's arrays, at least one of which is on the device.

    Parameters
    ----------
    scope : StreamScope
        Its stream reads them.
    arrays : RayArrays
        As for `RayBatch`; arrays on the device are float32 or float64, and those on the host
        a single vector or number. Worlds may be on either, and those on the device are read to be
        checked. Masks are left out: see `host_values`.
    world_count : int
        Worlds of the scene.
    kind : float32 or float64
        The type of the limits that kernels read.

    Raises
    ------
    ValueError
        If shapes disagree, or a world is out of range.
    TypeError
        If a dtype is not supported, a larger array is on the host, or worlds on the device have
        gaps.
    CudaError
        If an array is on another device, or there is no memory.

    Notes
    -----
    Arrays with a single stride from ray to ray are not copied: one value for all rays, or rows
    with or without gaps, forward or backward. Other layouts, such as columns or two arrays
    broadcast along different axes, and limits of another type, are packed on the device.
    """
    origins, directions, t_min, t_max, worlds, _ = arrays
    vectors = _vectors(scope, "origins", origins), _vectors(scope, "directions", directions)
    try:
        shape = np.broadcast_shapes(*(one.shape[:-1] for one in vectors))
    except ValueError:
        raise ValueError(
            f"origins and directions: shapes {vectors[0].shape} and {vectors[1].shape} "
            "do not broadcast against each other"
        ) from None
    low, high = (
        _limit(scope, name, one, shape, kind) for name, one in (("t_min", t_min), ("t_max", t_max))
    )
    places: list[Any] = []
    for name, one in zip(("origins", "directions"), vectors, strict=True):
        places += [*_placed(scope, name, one, shape, one.dtype), one.dtype.itemsize == 8]
    for name, one in (("t_min", low), ("t_max", high)):
        row = (*one.shape, 1), (*one.strides, one.dtype.itemsize)
        limit = one._replace(shape=row[0], strides=row[1])
        places += _placed(scope, name, limit, shape, np.dtype(kind))
    at = None if worlds is None else _placed_worlds(scope, worlds, world_count, shape)
    return DeviceRays(shape, RaySource(*places), worlds=at)


def _placed_worlds(
    scope: StreamScope, worlds: Any, count: int, shape: tuple[int, ...]
) -> np.uint64:
    """Address of the worlds of rays, checked on the host."""
    worlds = host_values(scope, "worlds", worlds)
    return scope.placed("worlds", flat_ids("worlds", worlds, count, shape)).address


def host_values(scope: StreamScope, name: str, values: Any) -> Any:
    """Values on the host, to be checked there; those on a device are copied.

    Raises
    ------
    TypeError
        If an array on the device has gaps.
    """
    if not is_on_gpu(values):
        return values
    view = view_of(scope, name, values)
    copied = np.empty(view.shape, view.dtype)
    long = [k for k, size in enumerate(view.shape) if size > 1] if copied.size else []
    if any(view.strides[k] != copied.strides[k] for k in long):
        raise TypeError(f"{name}: expected a contiguous array on a GPU; copy it")
    scope.gpu.copy(copied.ctypes.data, view.address, copied.nbytes, scope.stream)
    scope.stream.sync()
    return copied


def _vectors(scope: StreamScope, name: str, values: Any) -> DeviceView:
    view = _view(scope, name, values)
    if view.shape == (0,):
        view = view._replace(shape=(0, 3), strides=(0, view.dtype.itemsize))
    if not view.shape or view.shape[-1] != 3:
        raise ValueError(f"{name}: expected shape (..., 3), got {view.shape}")
    return view


def _limit(
    scope: StreamScope,
    name: str,
    values: Any,
    shape: tuple[int, ...],
    kind: type[np.floating[Any]],
) -> DeviceView:
    usual = usual_limits(scope.gpu) if kind is np.float32 else {}
    if type(values) in (float, int) and values in usual:
        return DeviceView(int(usual[values].address), (), (), np.dtype(np.float32))
    view = _view(scope, name, values, lambda one: one.astype(kind))
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
    scope: StreamScope, name: str, values: Any, convert: Callable[[Any], Any] = np.ascontiguousarray
) -> DeviceView:
    if is_on_gpu(values):
        view = view_of(scope, name, values)
        if view.dtype not in (np.float32, np.float64):
            raise TypeError(f"{name}: expected float32 or float64 on a GPU, got {view.dtype}")
        steps = (view.address, *view.strides)
        if any(step % view.dtype.itemsize for step in steps):
            raise TypeError(f"{name}: its elements are not aligned; copy the array")
        return view
    array = as_real_array(name, values)
    if array.size > _FEW:
        raise TypeError(
            f"{name}: the array is on the host, but other arrays of the rays are on a GPU; "
            "copy it to the GPU, or the others to the host"
        )
    with np.errstate(over="ignore"):
        array = np.ascontiguousarray(convert(array)).reshape(array.shape)
    placed = scope.placed(name, array)
    return DeviceView(int(placed.address), array.shape, array.strides, array.dtype)


def _placed(
    scope: StreamScope, name: str, view: DeviceView, shape: tuple[int, ...], dtype: np.dtype[Any]
) -> tuple[np.uint64, np.uint64]:
    """Address and stride of numbers of a dtype: vectors, or limits; packed if necessary."""
    *lengths, width = view.shape
    *steps, last = view.strides
    strides = [0] * (len(shape) - len(lengths))
    strides += [s if n > 1 else 0 for n, s in zip(lengths, steps, strict=True)]
    runs = _runs(shape, strides)
    fits = last == view.dtype.itemsize if width == 3 else view.dtype == dtype
    if len(runs) <= 1 and fits:
        step = runs[0][1] if runs else 0
        return np.uint64(view.address), np.uint64(step % 2**64)
    return pack(scope, name, view, runs, last, math.prod(shape), dtype)


def _runs(shape: tuple[int, ...], strides: list[int]) -> list[tuple[int, int]]:
    """Lengths and strides, outermost first, with contiguous dimensions merged."""
    runs: list[tuple[int, int]] = []
    for length, stride in zip(shape, strides, strict=True):
        if length == 1:
            continue
        if runs and runs[-1][1] == stride * length:
            runs[-1] = runs[-1][0] * length, stride
        else:
            runs.append((length, stride))
    return [] if all(stride == 0 for _, stride in runs) else runs
