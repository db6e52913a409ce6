"""Columns of paths and shadow rays in GPU memory."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.jit.cuda import DeviceArray
from raystream.kernels.ray_source import RaySource
from raystream.rendering.shading.streams import StreamAddresses

#: Allocates an array: (name, shape, dtype).
Empty = Callable[[str, Any, Any], DeviceArray]

#: Strides of origins, directions and numbers in bytes.
_ORIGIN, _DIRECTION, _NUMBER = np.uint64(24), np.uint64(12), np.uint64(4)


class StreamColumns:
    """Memory for `Paths` or `ShadowRays`; see `rendering.shading.streams`.

    Parameters
    ----------
    empty : callable
        Allocates an array.
    count : int
        Rows.

    Attributes
    ----------
    addresses : StreamAddresses
    """

    def __init__(self, empty: Empty, count: int) -> None:
        self.arrays = (
            empty("pixels", count, np.int64),
            empty("origins", (count, 3), np.float64),
            empty("directions", (count, 3), np.float32),
            empty("weights", (count, 3), np.float32),
            empty("densities", count, np.float32),
        )
        self.addresses = StreamAddresses(*(array.address for array in self.arrays))

    @classmethod
    def copied(
        cls, upload: Callable[[str, NDArray[Any]], DeviceArray], stream: tuple[NDArray[Any], ...]
    ) -> StreamColumns:
        """Copy a stream from the host."""
        given = iter(stream)

        def copied(name: str, _shape: Any, _dtype: Any) -> DeviceArray:
            return upload(name, next(given))

        return cls(copied, len(stream[0]))

    def source(self, t_min: np.uint64, t_max: np.uint64, has_ends: bool) -> RaySource:
        """Its rays as a source for queries.

        Parameters
        ----------
        t_min, t_max : uint64
            Addresses of the default limits.
        has_ends : bool
            Whether its numbers are the rays' ``t_max``.
        """
        origins, directions, ends = self.addresses[1], self.addresses[2], self.addresses[4]
        none = np.uint64(0)
        end = (ends, _NUMBER) if has_ends else (t_max, none)
        return RaySource(origins, _ORIGIN, True, directions, _DIRECTION, False, t_min, none, *end)
