"""The GPUs of this machine: counting, opening and describing them."""

from __future__ import annotations

import functools
import operator
import threading
from typing import NamedTuple

from numba import cuda

from raystream.jit.cuda.compiler import CAPABILITIES, Capability
from raystream.jit.cuda.driver_errors import explain
from raystream.jit.cuda.gpu import CudaError, Gpu
from raystream.jit.cuda.simulation import is_simulated


def open_gpu(number: int = 0) -> Gpu:
    """Open a device by its number; each is opened once.

    Raises
    ------
    CudaError
        If no device has this number, or it is too old.
    TypeError
        If `number` is not an integer.
    """
    try:
        wanted = operator.index(number)
    except TypeError:
        raise TypeError(f"gpu: expected the number of a device, got {number!r}") from None
    count = gpu_count()
    if not 0 <= wanted < count:
        raise CudaError(f"gpu: expected a number from 0 to {count - 1}, got {wanted}")
    with _opening:
        gpu = _opened(wanted)
    if gpu.capability < CAPABILITIES[0]:
        given, least = (".".join(map(str, one)) for one in (gpu.capability, CAPABILITIES[0]))
        raise CudaError(
            f"device 'cuda': {gpu.name} has compute capability {given}; kernels need {least} or "
            "more; use device='cpu' or 'graphics'"
        )
    return gpu


#: One thread at a time opens a device.
_opening = threading.Lock()

_opened = functools.cache(Gpu)


def gpu_count() -> int:
    """Number of devices.

    Raises
    ------
    CudaError
        If there is no device, or no driver.
    """
    if is_simulated():
        return 1
    try:
        count = len(cuda.gpus)
    except Exception as error:  # the driver is missing, or too old
        raise CudaError(
            f"device 'cuda': {explain(error)}; use device='cpu' or 'graphics'"
        ) from error
    if count == 0:
        raise CudaError("device 'cuda': there is no NVIDIA GPU; use device='cpu' or 'graphics'")
    return count


class GpuFacts(NamedTuple):
    """Properties of a GPU.

    Attributes
    ----------
    number : int
        CUDA's device number.
    name : str
    capability : (int, int) or None
        Compute capability; None if the device cannot be opened.
    byte_count : int
        Size of its memory.
    error : str or None
        Why it cannot be used.
    """

    number: int
    name: str
    capability: Capability | None
    byte_count: int
    error: str | None


def gpu_facts() -> list[GpuFacts]:
    """Properties of all GPUs, also of those that cannot be used.

    Raises
    ------
    CudaError
        If there is no device, or no driver.
    """
    return [_facts_of(number) for number in range(gpu_count())]


def _facts_of(number: int) -> GpuFacts:
    try:
        gpu = Gpu(number)
    except CudaError as error:
        return GpuFacts(number, f"GPU {number}", None, 0, str(error))
    reason: str | None = None
    try:
        open_gpu(number)
    except CudaError as error:
        reason = str(error)
    return GpuFacts(number, gpu.name, gpu.capability, gpu.byte_count, reason)


def driver_version() -> Capability | None:
    """Major and minor version of CUDA that the driver supports; None in the simulator.

    Raises
    ------
    CudaError
        If there is no driver.
    """
    if is_simulated():
        return None
    from numba.cuda.cudadrv.driver import driver

    gpu_count()  # its error is clearer than the driver's
    major, minor = driver.get_version()
    return int(major), int(minor)
