"""PersistentKernel: a range whose indices are fetched by persistent threads.

As many threads as the device runs at once. A warp that is done takes the next 32 indices from a
counter, so that a few long rays do not delay others of their block, and blocks are not started per
128 indices. A block is one warp, which then has the barrier and the shared memory to itself.

Source: Aila, Laine, "Understanding the Efficiency of Ray Traversal on GPUs", High Performance
Graphics 2009, section 3.3.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from numba import cuda

from raystream.jit.cuda.arguments import flat, type_of
from raystream.jit.cuda.compiler import Capability, Compiled, compile_function
from raystream.jit.cuda.device_array import DeviceArray
from raystream.jit.cuda.gpu import Gpu
from raystream.jit.cuda.range_kernel import RangeKernel
from raystream.jit.cuda.simulation import is_simulated, simulating

__all__ = ["PersistentKernel"]

#: Threads per block: one warp.
_BLOCK_SIZE = 32
_AT_ONCE = np.uint64(_BLOCK_SIZE)

#: Blocks in the simulator, where threads are slow.
_SIMULATED_BLOCKS = 2

#: Counters kept alive: the maximum number of unfinished launches.
_COUNTERS = 64

_COUNTER_TYPE = numba.types.Array(numba.types.uint64, 1, "C")


def _fetching(function: Callable[..., Any]) -> Callable[..., Any]:
    """A kernel that calls a function with the indices that its warp fetches."""

    def run(count: Any, counter: Any, arguments: Any) -> None:
        begin = cuda.shared.array(1, np.uint64)
        lane = np.uint64(cuda.threadIdx.x)
        while True:
            if lane == np.uint64(0):
                begin[0] = cuda.atomic.add(counter, 0, _AT_ONCE)
            cuda.syncthreads()
            i = np.uint64(begin[0] + lane)
            cuda.syncthreads()  # all threads have read it
            if i - lane >= count:
                return
            if i < count:
                function(i, *arguments)

    run.__name__ = run.__qualname__ = f"{getattr(function, '__name__', 'run')}_persistent"
    return run


class PersistentKernel(RangeKernel):
    """Runs a function for each index of a range, as `RangeKernel` does, by persistent threads.

    Parameters
    ----------
    function : callable
        As of `RangeKernel`.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        self._run = _fetching(function)
        self._counters: deque[DeviceArray] = deque(maxlen=_COUNTERS)

    def compiled(self, arguments: tuple[Any, ...], capability: Capability) -> Compiled:
        """PTX for arguments of such types; see `RangeKernel.compiled`."""
        count = type_of(np.uint64(0))
        return compile_function(self._run, (count, _COUNTER_TYPE, type_of(arguments)), capability)

    def launch(self, gpu: Gpu, count: int, arguments: tuple[Any, ...], stream: Any = None) -> None:
        """Launch it asynchronously; see `RangeKernel.launch`."""
        if count == 0:
            return
        block_count = -(-count // _BLOCK_SIZE)
        if is_simulated():
            block_count = min(block_count, _SIMULATED_BLOCKS)
            counter = np.zeros(1, np.uint64)
            with simulating:
                cuda.jit(self._run)[block_count, _BLOCK_SIZE](np.uint64(count), counter, arguments)
            return
        key = gpu.number, type_of(arguments)
        if key not in self._loaded:
            self._loaded[key] = gpu.load(self.compiled(arguments, gpu.target))
        kernel = self._loaded[key]
        block_count = min(block_count, gpu.most_blocks(kernel, _BLOCK_SIZE))
        # Each launch has its own counter, which must live until it has ended.
        placed = gpu.upload("a counter", np.zeros(1, np.uint64))
        self._counters.append(placed)
        values = [np.uint64(count), *_array_values(placed), *flat(arguments)]
        gpu.launch(kernel, block_count, _BLOCK_SIZE, values, stream)


def _array_values(array: DeviceArray) -> list[Any]:
    """A one-dimensional array as the numbers that Numba's kernels expect.

    Two null pointers for the owner, the number and size of items, the address, shape and strides.
    """
    count, itemsize = np.int64(array.shape[0]), np.int64(array.dtype.itemsize)
    return [np.uint64(0), np.uint64(0), count, itemsize, array.address, count, itemsize]
