"""Rays in a GPU's memory, as kernels read them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.rays import RayBatch
from raystream.jit.cuda import DeviceArray
from raystream.kernels.ray_source import RaySource

__all__ = ["ResidentRays", "Upload", "place_rays"]

#: Copies an array to a device: (name, array).
Upload = Callable[[str, NDArray[Any]], DeviceArray]


class ResidentRays(NamedTuple):
    """Some rays of a batch on a device.

    Attributes
    ----------
    source : RaySource
    arrays : tuple of DeviceArray
        To be kept until they are traced.
    """

    source: RaySource
    arrays: tuple[DeviceArray, ...]


def place_rays(batch: RayBatch, rows: slice, upload: Upload) -> ResidentRays:
    """Copy some rays of a batch to a device; what all of them share is copied once.

    Parameters
    ----------
    batch : RayBatch
    rows : slice
    upload : callable
        ``upload(name, array)`` copies an array, such as `Gpu.upload`.

    Raises
    ------
    CudaError
        If there is no memory for them.
    """
    vectors = [_given(array, rows) for array in (batch.origins, batch.directions)]
    limits = [limit if len(limit) == 1 else limit[rows] for limit in batch.limits]
    named = zip(("origins", "directions", "t_min", "t_max"), (*vectors, *limits), strict=True)
    placed = [upload(name, array) for name, array in named]
    steps = [np.uint64(one.shape[0] > 1) * _row_bytes(one) for one in placed]
    origins, directions, t_min, t_max = (one.address for one in placed)
    doubles = [one.dtype.itemsize == 8 for one in placed]
    source = RaySource(
        *(origins, steps[0], doubles[0], directions, steps[1], doubles[1]),
        *(t_min, steps[2], t_max, steps[3]),
    )
    return ResidentRays(source, tuple(placed))


def _given(array: NDArray[Any], rows: slice) -> NDArray[Any]:
    """Rows of an array; one if all are the same."""
    return array[:1] if len(array) > 1 and array.strides[0] == 0 else array[rows]


def _row_bytes(array: DeviceArray) -> np.uint64:
    return np.uint64(array.dtype.itemsize * int(np.prod(array.shape[1:], dtype=np.int64)))
