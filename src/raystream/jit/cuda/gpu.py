"""Gpu: a device's memory, kernels and stream, through CUDA's driver.

Every failure becomes a `CudaError`. Numba's simulator has one device, with the host's memory.
"""

from __future__ import annotations

import contextlib
import ctypes
import math
import operator
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numba import cuda
from numpy.typing import NDArray

from raystream.core.errors import RaystreamError
from raystream.jit.cuda.compiler import CAPABILITIES, Capability, Compiled
from raystream.jit.cuda.device_array import DeviceArray, host_memory
from raystream.jit.cuda.driver_errors import driver_code, explain
from raystream.jit.cuda.keep_alive import KeepAlive
from raystream.jit.cuda.simulation import is_simulated
from raystream.jit.cuda.streams import LEGACY, CudaStream


class CudaError(RaystreamError):
    """CUDA is unavailable, lacks memory, or failed."""


class Gpu:
    """A device.

    Parameters
    ----------
    number : int
        CUDA's device number.

    Attributes
    ----------
    number : int
    name : str
    capability : (int, int)
    target : (int, int)
        Capability that kernels are compiled for: the newest of `CAPABILITIES` that it supports.
        Code for newer ones would come from another compiler, and be untested.
    byte_count : int
        Size of the device's memory.
    stream : CudaStream
        Lives as long as this object, and synchronises with the legacy default stream.
    keep_alive : KeepAlive
        Callers' arrays that kernels read.
    """

    def __init__(self, number: int) -> None:
        self.number = number
        self.name = "CUDA simulator"
        self.capability: Capability = CAPABILITIES[0]
        self.target = self.capability
        self.keep_alive = KeepAlive()
        if is_simulated():
            self.byte_count = 2**62
            self._legacy = self.stream = CudaStream(self, LEGACY)
            return
        from cuda.core import Device

        self._device = Device(number)
        with self.doing("opening it"):
            self.name = str(self._device.name)
            major, minor = self._device.compute_capability
            self.capability = (int(major), int(minor))
            known = [one for one in CAPABILITIES if one <= self.capability]
            self.target = max(known, default=CAPABILITIES[0])
            self.byte_count = int(cuda.current_context(number).get_memory_info().total)
            # Numba copies in this stream, too, so that copies are done before a kernel runs.
            self._legacy = CudaStream(self, LEGACY)
            self.stream = CudaStream.make(self, is_blocking=True)

    @contextlib.contextmanager
    def current(self) -> Iterator[None]:
        """Make it the current device of this thread."""
        if is_simulated():
            yield
            return
        with cuda.gpus[self.number]:
            self._device.set_current()
            yield

    @contextlib.contextmanager
    def doing(self, what: str) -> Iterator[None]:
        """Make it the current device of this thread, and convert failures to `CudaError`.

        Raises
        ------
        CudaError
            If anything fails.
        """
        try:
            with self.current():
                yield
        except (CudaError, MemoryError):  # the latter from the host
            raise
        except Exception as error:  # the driver's
            if is_simulated():  # no driver
                raise
            raise CudaError(f"device 'cuda': {self.name}: {what}: {explain(error)}") from error

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
        """Allocate an uninitialised array.

        Raises
        ------
        CudaError
            If there is no memory for it.
        """
        shape, byte_count = self._size_of(name, shape, dtype)
        if is_simulated():
            memory, address = host_memory(byte_count)
            return DeviceArray(self, name, memory, address, shape, dtype, self._legacy)
        with self._allocating(name, byte_count):
            owner = cuda.device_array(max(byte_count, 1), np.uint8)  # CUDA rejects 0 bytes
            address = int(owner.__cuda_array_interface__["data"][0])
        return DeviceArray(self, name, owner, address, shape, dtype, self._legacy)

    def zeros(self, name: str, shape: Any, dtype: Any) -> DeviceArray:
        """Allocate an array of zeros.

        Raises
        ------
        CudaError
            If there is no memory for it.
        """
        made = self.empty(name, shape, dtype)
        self.clear(made, made.stream)
        return made

    def pooled(
        self, name: str, shape: Any, dtype: Any, stream: CudaStream | None = None
    ) -> DeviceArray:
        """Allocate an uninitialised array from the driver's pool, in the order of a stream.

        Neither allocating nor freeing it waits; the pool reuses freed memory.

        Parameters
        ----------
        name : str
        shape : int or tuple of int
        dtype : dtype
        stream : CudaStream, optional
            [default: the device's `stream`]

        Raises
        ------
        CudaError
            If there is no memory for it.
        """
        order = stream or self.stream
        shape, byte_count = self._size_of(name, shape, dtype)
        if is_simulated():
            memory, address = host_memory(byte_count)
            return DeviceArray(self, name, memory, address, shape, dtype, order)
        with self._allocating(name, byte_count):
            owner = self._device.allocate(max(byte_count, 1), stream=order.native)
        return DeviceArray(self, name, owner, int(owner.handle), shape, dtype, order)

    def pinned(self, byte_count: int) -> NDArray[np.uint8]:
        """Allocate pinned host memory, for asynchronous copies.

        Raises
        ------
        CudaError
            If there is not enough memory.
        """
        if is_simulated():
            return np.empty(byte_count, np.uint8)
        with self.doing(f"pinning {byte_count:,} bytes of host memory"):
            return cuda.pinned_array(byte_count, np.uint8)

    def copy(self, to: Any, source: Any, byte_count: int, stream: CudaStream) -> None:
        """Copy bytes asynchronously between addresses on the device or the host.

        Raises
        ------
        CudaError
            If the driver fails.
        """
        if byte_count == 0:
            return
        if is_simulated():
            ctypes.memmove(int(to), int(source), byte_count)
            return
        from cuda.bindings import driver

        with self.doing("copying"):
            _check(driver.cuMemcpyAsync(int(to), int(source), byte_count, stream.native.handle))

    def clear(self, array: DeviceArray, stream: CudaStream) -> None:
        """Set all bytes of an array to 0, asynchronously.

        Raises
        ------
        CudaError
            If the driver fails.
        """
        if array.nbytes == 0:
            return
        if is_simulated():
            ctypes.memset(int(array.address), 0, array.nbytes)
            return
        from cuda.bindings import driver

        with self.doing("clearing memory"):
            address, handle = int(array.address), stream.native.handle
            _check(driver.cuMemsetD8Async(address, 0, array.nbytes, handle))

    def number_of(self, address: int) -> int:
        """Number of the device that an address is on.

        Raises
        ------
        CudaError
            If it is not on a device.
        """
        if is_simulated() or address == 0:
            return self.number
        from cuda.bindings import driver

        attribute = driver.CUpointer_attribute.CU_POINTER_ATTRIBUTE_DEVICE_ORDINAL
        with self.doing("finding an array"):
            return int(_check(driver.cuPointerGetAttribute(attribute, address)))

    def free_byte_count(self) -> int:
        """Free memory in bytes.

        Raises
        ------
        CudaError
            If the driver fails.
        """
        if is_simulated():
            return self.byte_count
        with self.doing("querying its memory"):
            return int(cuda.current_context(self.number).get_memory_info().free)

    def load(self, compiled: Compiled) -> Any:
        """Load PTX, which the driver compiles for this device.

        Raises
        ------
        CudaError
            If the driver rejects it.
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
        """Launch a kernel asynchronously.

        Parameters
        ----------
        kernel : cuda.core.Kernel
            From `load`.
        block_count, block_size : int
        values : sequence
            Arguments: NumPy numbers.
        stream : cuda.core.Stream, optional
            [default: the legacy default stream]

        Raises
        ------
        CudaError
            If it cannot be launched.
        """
        from cuda.core import LaunchConfig, launch

        config = LaunchConfig(grid=block_count, block=block_size)
        with self.doing("launching a kernel"):
            launch(stream or self._legacy.native, config, kernel, *values)

    def wait(self, stream: Any = None) -> None:
        """Wait until all launches in a stream are done.

        Raises
        ------
        CudaError
            If one of them failed.
        """
        if not is_simulated():
            with self.doing("running a kernel"):
                (stream or self._legacy.native).sync()

    def _size_of(self, name: str, shape: Any, dtype: Any) -> tuple[tuple[int, ...], int]:
        """Shape and bytes of an array; an error if it exceeds the device's memory."""
        shape = tuple(map(operator.index, shape if isinstance(shape, tuple) else (shape,)))
        byte_count = math.prod(shape) * np.dtype(dtype).itemsize
        if byte_count > self.byte_count:
            raise CudaError(self._no_memory(name, byte_count))
        return shape, byte_count

    @contextlib.contextmanager
    def _allocating(self, name: str, byte_count: int) -> Iterator[None]:
        with self.doing(f"allocating {name}"):
            try:
                yield
            except Exception as error:  # the driver's
                if driver_code(error) == "OUT_OF_MEMORY":
                    raise CudaError(self._no_memory(name, byte_count)) from error
                raise

    def _no_memory(self, name: str, byte_count: int) -> str:
        return (
            f"device 'cuda': {self.name} has no memory for {name}, {byte_count:,} bytes; trace a "
            "smaller scene or fewer rays, or use device='cpu'"
        )


def _check(answer: tuple[Any, ...]) -> Any:
    """Result of a driver call; an exception if it failed."""
    from cuda.bindings import driver

    result, *values = answer
    if result != driver.CUresult.CUDA_SUCCESS:
        raise RuntimeError(result.name)
    return values[0] if values else None
