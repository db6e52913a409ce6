"""BlockKernel: a function run by blocks of threads with shared memory.

Such functions use ``cuda``, which the simulator replaces: they are plain Python, and access device
memory through the four functions here, which the simulator calls as compiled for the CPU.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import cuda, types

from raystream.jit.constants import BYTES_32, BYTES_64
from raystream.jit.cpu import kernel
from raystream.jit.cuda.compiler import Capability, Compiled, compile_function
from raystream.jit.cuda.gpu import Gpu
from raystream.jit.cuda.simulation import is_simulated, simulating
from raystream.jit.simd import load, store

#: An argument of a launch: a number or an address.
Number = int | np.uint64


@kernel
def get_32(array, i):
    """Element i of an array of uint32 at an address, as a uint64."""
    return np.uint64(load(np.uint32, array + i * BYTES_32))


@kernel
def put_32(array, i, number):
    """Write element i of an array of uint32 at an address."""
    store(array + i * BYTES_32, np.uint32(number))


@kernel
def get_64(array, i):
    """Element i of an array of uint64 at an address."""
    return load(np.uint64, array + i * BYTES_64)


@kernel
def put_64(array, i, number):
    """Write element i of an array of uint64 at an address."""
    store(array + i * BYTES_64, number)


class BlockKernel:
    """Runs a function on blocks of threads.

    Parameters
    ----------
    function : callable
        Plain Python that takes uint64 numbers, including addresses, and returns nothing.
    argument_count : int
    block_size : int
        Threads per block.
    """

    def __init__(self, function: Callable[..., Any], argument_count: int, block_size: int) -> None:
        self._function = function
        self._types = (types.uint64,) * argument_count
        self.block_size = block_size
        self._loaded: dict[int, Any] = {}

    def compiled(self, capability: Capability) -> Compiled:
        """PTX; needs no device.

        Raises
        ------
        numba.core.errors.NumbaError
            If it does not compile.
        """
        return compile_function(self._function, self._types, capability)

    def launch(self, gpu: Gpu, block_count: int, *numbers: Number, stream: Any = None) -> None:
        """Launch it asynchronously.

        Parameters
        ----------
        gpu : Gpu
        block_count : int
        *numbers : int or uint64
            Arguments of the function.
        stream : cuda.core.Stream, optional
            [default: the device's stream]

        Raises
        ------
        CudaError
            If it does not compile, or cannot be launched.
        """
        values = [np.uint64(number) for number in numbers]
        if is_simulated():
            with simulating:
                cuda.jit(self._function)[block_count, self.block_size](*values)
            return
        if gpu.number not in self._loaded:
            self._loaded[gpu.number] = gpu.load(self.compiled(gpu.target))
        gpu.launch(self._loaded[gpu.number], block_count, self.block_size, values, stream)
