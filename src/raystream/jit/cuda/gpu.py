"""Gpu: a device by way of CUDA's driver: its memory, its kernels, its stream.

All that fails there becomes one `CudaError`. In Numba's simulator there is one device, and its
memory is the host's.
"""

from __future__ import annotations

import contextlib
import functools
import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numba import cuda
from numpy.typing import NDArray

from raystream.core.errors import RaystreamError
from raystream.jit.cuda.compiler import CAPABILITIES, Capability, Compiled
from raystream.jit.cuda.reasons import code_of, reason_of
from raystream.jit.cuda.simulation import is_simulated

__all__ = ["CudaError", "DeviceArray", "Gpu", "gpu_count", "open_gpu"]


class CudaError(RaystreamError):
    """CUDA cannot do what it was asked for: it is not there, too small, or failed."""


#: Arrays begin at multiples of so many bytes, as those of CUDA do: traversals need 256.
_ALIGNMENT = 256


class DeviceArray:
    """An array in a GPU's memory, freed with this object.

    Parameters
    ----------
    gpu : Gpu
    name : str
        For errors.
    memory : array of numba.cuda, or ndarray
        An ndarray in the simulator.

    Attributes
    ----------
    address : uint64
    shape : tuple of int
    dtype : dtype
    """

    def __init__(self, gpu: Gpu, name: str, memory: Any) -> None:
        self._gpu, self._name, self._memory = gpu, name, memory
        self.shape: tuple[int, ...] = memory.shape
        self.dtype = np.dtype(memory.dtype)
        if is_simulated():
            self.address = np.uint64(memory.ctypes.data)
        else:
            self.address = np.uint64(memory.__cuda_array_interface__["data"][0] or 0)

    def host(self) -> NDArray[Any]:
        """A copy on the host, when the device has done what it was given.

        Raises
        ------
        CudaError
            If what it was given failed.
        """
        if is_simulated():
            return np.array(self._memory)
        with self._gpu.doing(f"reading {self._name}"):
            return np.asarray(self._memory.copy_to_host())

    def fill(self, array: NDArray[Any]) -> None:
        """Copy an array of the host's to it, of its shape and dtype."""
        given = np.ascontiguousarray(array, self.dtype)
        if is_simulated():
            self._memory[...] = given
            return
        with self._gpu.doing(f"writing {self._name}"):
            self._memory.copy_to_device(given)


def _aligned(length: int, dtype: Any) -> NDArray[Any]:
    """Memory of the simulated device, that begins where a device's does."""
    itemsize = np.dtype(dtype).itemsize
    memory = np.empty(length * itemsize + _ALIGNMENT, np.uint8)
    skipped = -memory.ctypes.data % _ALIGNMENT
    return memory[skipped : skipped + length * itemsize].view(dtype)


class Gpu:
    """A device.

    Parameters
    ----------
    number : int
        As CUDA counts them.

    Attributes
    ----------
    number : int
    name : str
    capability : (int, int)
    byte_count : int
        Memory of the device.
    """

    def __init__(self, number: int) -> None:
        self.number = number
        self.name = "CUDA simulator"
        self.capability: Capability = CAPABILITIES[0]
        if is_simulated():
            self.byte_count = 2**62
            return
        from cuda.core import LEGACY_DEFAULT_STREAM, Device

        self._device = Device(number)
        # Numba's copies are in this one, too: so they are done before a kernel runs.
        self._stream = LEGACY_DEFAULT_STREAM
        with self.doing("opening it"):
            self.name = str(self._device.name)
            major, minor = self._device.compute_capability
            self.capability = (int(major), int(minor))
            self.byte_count = int(cuda.current_context(number).get_memory_info().total)

    @contextlib.contextmanager
    def doing(self, what: str) -> Iterator[None]:
        """Use it, as the current device of this thread, and turn what fails into one error.

        Raises
        ------
        CudaError
            If anything fails.
        """
        try:
            with cuda.gpus[self.number]:
                self._device.set_current()
                yield
        except (CudaError, MemoryError):  # the latter is the host's
            raise
        except Exception as error:  # the driver's
            raise CudaError(f"device 'cuda': {self.name}: {what}: {reason_of(error)}") from error

    def upload(self, name: str, array: NDArray[Any]) -> DeviceArray:
        """Copy an array to the device.

        Raises
        ------
        CudaError
            If there is no memory for it.
        """
        made = self.empty(name, array.shape, array.dtype)
        if array.size:
            made.fill(array)
        return made

    def empty(self, name: str, shape: Any, dtype: Any) -> DeviceArray:
        """Make an array on the device, not initialised.

        Raises
        ------
        CudaError
            If there is no memory for it.
        """
        shape = tuple(np.atleast_1d(shape).tolist())
        count = math.prod(shape)
        byte_count = count * np.dtype(dtype).itemsize
        if byte_count > self.byte_count:
            raise CudaError(self._no_memory(name, byte_count))
        length = max(count, 1)  # CUDA has no memory of 0 bytes
        if is_simulated():
            flat = _aligned(length, dtype)
        else:
            with self.doing(f"making room for {name}"):
                try:
                    flat = cuda.device_array(length, dtype)
                except Exception as error:  # the driver's
                    if code_of(error) == "OUT_OF_MEMORY":
                        raise CudaError(self._no_memory(name, byte_count)) from error
                    raise
        flat = flat if count else flat[:0]
        return DeviceArray(self, name, flat if len(shape) == 1 else flat.reshape(shape))

    def load(self, compiled: Compiled) -> Any:
        """Make a kernel of PTX: the driver compiles it for this device.

        Raises
        ------
        CudaError
            If the driver does not take it.
        """
        from cuda.core import ObjectCode

        with self.doing(f"loading {compiled.entry}"):
            code = ObjectCode.from_ptx(compiled.ptx.encode(), name=compiled.entry)
            return code.get_kernel(compiled.entry)

    def launch(
        self,
        kernel: Any,
        block_count: int,
        block_size: int,
        values: Sequence[Any],
        stream: Any = None,
    ) -> None:
        """Begin to run a kernel.

        Parameters
        ----------
        kernel : cuda.core.Kernel
            From `load`.
        block_count, block_size : int
        values : sequence
            Arguments: numbers of NumPy's types.
        stream : cuda.core.Stream, optional
            Without it, the default stream.

        Raises
        ------
        CudaError
            If it cannot be launched.
        """
        from cuda.core import LaunchConfig, launch

        config = LaunchConfig(grid=block_count, block=block_size)
        with self.doing("launching a kernel"):
            launch(stream or self._stream, config, kernel, *values)

    def most_blocks(self, kernel: Any, block_size: int) -> int:
        """How many blocks of a kernel the device runs at once, at least 1.

        Raises
        ------
        CudaError
            If the driver does not say.
        """
        with self.doing("asking how many threads it runs"):
            each = kernel.occupancy.max_active_blocks_per_multiprocessor(block_size, 0)
            return max(1, int(each) * int(self._device.properties.multiprocessor_count))

    def wait(self, stream: Any = None) -> None:
        """Wait until all that was begun is done.

        Raises
        ------
        CudaError
            If some of it failed.
        """
        if not is_simulated():
            with self.doing("running a kernel"):
                (stream or self._stream).sync()

    def _no_memory(self, name: str, byte_count: int) -> str:
        return (
            f"device 'cuda': {self.name} has no memory for {name}, {byte_count:,} bytes; trace a "
            "smaller scene or fewer rays, or use device='cpu'"
        )


@functools.cache
def open_gpu(number: int = 0) -> Gpu:
    """A device by its number.

    Raises
    ------
    CudaError
        If there is none, or it is too old.
    """
    count = gpu_count()
    if not 0 <= number < count:
        raise CudaError(f"gpu: expected a number from 0 to {count - 1}, got {number}")
    gpu = Gpu(number)
    if gpu.capability < CAPABILITIES[0]:
        given, least = (".".join(map(str, one)) for one in (gpu.capability, CAPABILITIES[0]))
        raise CudaError(
            f"device 'cuda': {gpu.name} has compute capability {given}; kernels need {least} or "
            "more; use device='cpu' or 'graphics'"
        )
    return gpu


def gpu_count() -> int:
    """How many devices there are.

    Raises
    ------
    CudaError
        If there is none, or no driver.
    """
    if is_simulated():
        return 1
    try:
        count = len(cuda.gpus)
    except Exception as error:  # no driver, or too old a one
        raise CudaError(
            f"device 'cuda': {reason_of(error)}; use device='cpu' or 'graphics'"
        ) from error
    if count == 0:
        raise CudaError("device 'cuda': there is no NVIDIA GPU; use device='cpu' or 'graphics'")
    return count
