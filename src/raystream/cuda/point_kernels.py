"""The kernels of closest points: the CPU's search for the nearest triangles, a point per thread."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np

from raystream.core.rays import RayStatus
from raystream.jit.constants import ZERO_U64
from raystream.jit.cpu import kernel
from raystream.jit.cuda import RangeKernel
from raystream.jit.simd import scratch
from raystream.kernels.nearest import ROW
from raystream.kernels.point_queries import PointSearch, begin_point, read_point, write_nearest
from raystream.structures import form_of

_ROW_BYTES = np.uint64(ROW.itemsize)
_VALID = np.uint8(RayStatus.VALID)


def point_kernel(search: PointSearch) -> Callable[..., None]:
    """Make the function of a point with a structure's search.

    Returns
    -------
    kernel
        ``find_nearest(i, source, frame, arrays, capacity, rows, out)``: of point i of a
        `PointSource` writes the `capacity` nearest triangles to `NearestAddresses`. `rows` is the
        address of as many `kernels.nearest.ROW` for each point.
    """
    find, stack_bytes = search

    @kernel
    def find_nearest(i, source, frame, arrays, capacity, rows, out):
        stack = scratch(stack_bytes)
        own = rows + i * capacity * _ROW_BYTES
        query = read_point(source, i, frame)
        found = ZERO_U64
        if query.status == _VALID:
            nearest = begin_point(query, frame, own, capacity)
            nearest = find(arrays, frame, query.moved, nearest, stack)
            found = nearest.found_count
        write_nearest(out, i, query, own, found, capacity, frame)

    return find_nearest


@cache
def nearest_kernel(name: str) -> RangeKernel:
    """The kernel of a structure with the form ``"nearest search"``."""
    return RangeKernel(point_kernel(form_of(name, "nearest search")))
