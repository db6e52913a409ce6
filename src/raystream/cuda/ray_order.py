"""Ray order: sorts rays by origin and direction, so that the rays of a warp diverge less.

Rays with similar origins and directions visit the same nodes: the threads of a warp then read the
same memory and end at about the same time. Ray indices are sorted by a key of origin and
direction. Rays and answers are not moved: thread j traces ray ``order[j]``, and writes to that
ray's place.

References
----------
Aila and Karras, "Architecture Considerations for Tracing Incoherent Rays", High Performance
Graphics 2010: keys of origins and directions. Meister, Boksansky, Guthe and Bittner, "On Ray
Reordering Techniques for Faster GPU Ray Tracing", Interactive 3D Graphics and Games 2020: keys of
32 bits, compared.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from raystream.core.rays import RayStatus
from raystream.jit.cpu import device, kernel
from raystream.jit.cuda import CudaStream, DeviceArray, Gpu, RangeKernel, is_simulated
from raystream.jit.cuda.block_kernel import get_32
from raystream.jit.cuda.radix_sort import sort_pairs
from raystream.jit.simd import store
from raystream.kernels.ray import SceneFrame
from raystream.kernels.ray_source import RaySource, load_ray

__all__ = ["KEY_BITS", "MAKE_KEY", "reordered", "sort_rays"]

#: A key has, from the top: the signs of the direction; this number of bits per axis for the cell of
#: the origin; and for each of two barycentric weights of the direction in its octant.
_CELL_BITS, _WEIGHT_BITS = 5, 7
KEY_BITS = 3 + 3 * _CELL_BITS + 2 * _WEIGHT_BITS

_VALID = np.uint8(RayStatus.VALID)
_ZERO = np.float32(0.0)
_WORD = np.uint64(2)  # a number's four bytes, as a shift
_ONE = np.uint32(1)
_NO_BITS = np.uint32(0)
_LAST = np.uint32(2**32 - 1)
_CELLS = np.float32(2**_CELL_BITS)
_LAST_CELL = np.float32(2**_CELL_BITS - 1)
_WEIGHTS = np.float32(2**_WEIGHT_BITS)
_LAST_WEIGHT = np.float32(2**_WEIGHT_BITS - 1)


@device
def _spread_by_three(number):
    """Insert two zeros after each bit of a number below 2**10."""
    number = np.uint32((number | np.uint32(number << np.uint32(16))) & np.uint32(0x030000FF))
    number = np.uint32((number | np.uint32(number << np.uint32(8))) & np.uint32(0x0300F00F))
    number = np.uint32((number | np.uint32(number << np.uint32(4))) & np.uint32(0x030C30C3))
    return np.uint32((number | np.uint32(number << np.uint32(2))) & np.uint32(0x09249249))


@device
def _spread_by_two(number):
    """Insert a zero after each bit of a number below 2**8."""
    number = np.uint32((number | np.uint32(number << np.uint32(4))) & np.uint32(0x0F0F))
    number = np.uint32((number | np.uint32(number << np.uint32(2))) & np.uint32(0x3333))
    return np.uint32((number | np.uint32(number << _ONE)) & np.uint32(0x5555))


@device
def _step_of(x, last):
    """Truncate a number and clamp it to [0, last]; NaN becomes 0."""
    if not x > _ZERO:
        return _NO_BITS
    return np.uint32(min(x, last))


@device
def _cell(x, low, scale):
    return _spread_by_three(_step_of((x - low) * scale, _LAST_CELL))


@device
def _key_of(ray, frame):
    """The key of a local ray."""
    if ray.status != _VALID:
        return _LAST
    x = _ONE if ray.dx < _ZERO else _NO_BITS
    y = _ONE if ray.dy < _ZERO else _NO_BITS
    z = _ONE if ray.dz < _ZERO else _NO_BITS
    key = np.uint32(x | np.uint32(y << _ONE) | np.uint32(z << np.uint32(2)))
    # Cubic cells, 32 along the longest side of the scene's box. Origins outside are clamped.
    longest = max(
        frame.high[0] - frame.low[0], frame.high[1] - frame.low[1], frame.high[2] - frame.low[2]
    )
    scale = _CELLS / longest if longest > _ZERO else _ZERO
    cell = np.uint32(
        _cell(ray.ox, frame.low[0], scale)
        | np.uint32(_cell(ray.oy, frame.low[1], scale) << _ONE)
        | np.uint32(_cell(ray.oz, frame.low[2], scale) << np.uint32(2))
    )
    key = np.uint32(np.uint32(key << np.uint32(3 * _CELL_BITS)) | cell)
    # The direction in its octant, projected to the plane through (1, 0, 0), (0, 1, 0) and
    # (0, 0, 1). Its largest component is at least 1.
    fine = _WEIGHTS / (abs(ray.dx) + abs(ray.dy) + abs(ray.dz))
    first = _spread_by_two(_step_of(abs(ray.dx) * fine, _LAST_WEIGHT))
    second = _spread_by_two(_step_of(abs(ray.dy) * fine, _LAST_WEIGHT))
    weights = np.uint32(first | np.uint32(second << _ONE))
    return np.uint32(np.uint32(key << np.uint32(2 * _WEIGHT_BITS)) | weights)


@kernel
def _make_key(i, source, frame, keys, numbers):
    """Write the key of ray i, and i."""
    store(keys + (i << _WORD), _key_of(load_ray(source, i, frame), frame))
    store(numbers + (i << _WORD), np.uint32(i))


#: The keys, for ``(source, frame, keys, numbers)``; the last two are addresses of uint32.
MAKE_KEY = RangeKernel(_make_key)


def sort_rays(
    gpu: Gpu,
    source: RaySource,
    count: int,
    frame: SceneFrame,
    empty: Callable[[str, Any, Any], DeviceArray],
    stream: CudaStream,
) -> DeviceArray:
    """Launch the sort of rays; does not wait.

    Parameters
    ----------
    gpu : Gpu
    source : RaySource
        Rays on the device.
    count : int
        Number of rays, less than 2**32.
    frame : SceneFrame
        Frame of the scene.
    empty : callable
        ``empty(name, shape, dtype)`` allocates an array that the stream may use at once, and that
        may be dropped when all that uses it has been launched there.
    stream : CudaStream

    Returns
    -------
    DeviceArray of shape (count,), uint32
        Ray indices by increasing key; invalid rays come last, and rays with equal keys keep
        their order.

    Raises
    ------
    CudaError
        If there is no memory: the sort takes 16 bytes per ray.

    Notes
    -----
    The order is deterministic: a key depends on the ray and the scene's box alone, and the sort
    is stable.
    """
    keys = empty("keys of rays", count, np.uint32)
    numbers = empty("numbers of rays", count, np.uint32)
    arguments = source, frame, keys.address, numbers.address
    MAKE_KEY.launch(gpu, count, arguments, stream.native)
    _, order = sort_pairs(gpu, keys, numbers, KEY_BITS, empty=empty, stream=stream.native)
    return order


def reordered(function: Callable[..., Any]) -> Callable[..., Any]:
    """Wrap a kernel so that it reads its ray index from an order.

    Parameters
    ----------
    function : kernel
        ``function(i, *arguments)``.

    Returns
    -------
    callable
        For ``(j, order, *arguments)``: calls `function` with the uint32 at index j of the address
        `order`. Compiled for CUDA only; the simulator interprets it.
    """

    def ordered(j: Any, order: Any, *arguments: Any) -> None:
        function(np.uint64(get_32(order, j)), *arguments)

    ordered.__name__ = ordered.__qualname__ = f"{function.__name__}_reordered"
    return ordered if is_simulated() else device(ordered)
