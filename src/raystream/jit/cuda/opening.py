"""Opening GPUs by their numbers, once each."""

from __future__ import annotations

import functools
import operator
import threading

from numba import cuda

from raystream.jit.cuda.compiler import CAPABILITIES
from raystream.jit.cuda.gpu import CudaError, Gpu
from raystream.jit.cuda.reasons import reason_of
from raystream.jit.cuda.simulation import is_simulated

__all__ = ["gpu_count", "open_gpu"]


def open_gpu(number: int = 0) -> Gpu:
    """A device by its number.

    Raises
    ------
    CudaError
        If there is none of that number, or it is too old.
    TypeError
        If it is no integer.
    """
    try:
        wanted = operator.index(number)
    except TypeError:
        raise TypeError(f"gpu: expected the number of a device, got {number!r}") from None
    count = gpu_count()
    if not 0 <= wanted < count:
        there = "there is one, 0" if count == 1 else f"there are {count}, from 0 to {count - 1}"
        raise CudaError(f"gpu: no device has the number {wanted}; {there}")
    with _opening:
        gpu = _opened(wanted)
    if gpu.capability < CAPABILITIES[0]:
        given, least = (".".join(map(str, one)) for one in (gpu.capability, CAPABILITIES[0]))
        raise CudaError(
            f"device 'cuda': {gpu.name} has compute capability {given}; kernels need {least} or "
            "more; use device='cpu' or 'graphics'"
        )
    return gpu


#: One thread opens a device.
_opening = threading.Lock()

_opened = functools.cache(Gpu)


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
