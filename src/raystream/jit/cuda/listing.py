"""Which GPUs there are, and why some are of no use."""

from __future__ import annotations

from typing import NamedTuple

from raystream.jit.cuda.compiler import Capability
from raystream.jit.cuda.gpu import CudaError, Gpu
from raystream.jit.cuda.opening import gpu_count, open_gpu
from raystream.jit.cuda.simulation import is_simulated

__all__ = ["GpuFacts", "driver_version", "gpu_facts"]


class GpuFacts(NamedTuple):
    """What is known of a GPU.

    Attributes
    ----------
    number : int
        As CUDA counts them.
    name : str
    capability : (int, int) or None
        None if it cannot be opened.
    byte_count : int
        Its memory.
    error : str or None
        Why it cannot be used.
    """

    number: int
    name: str
    capability: Capability | None
    byte_count: int
    error: str | None


def gpu_facts() -> list[GpuFacts]:
    """All GPUs.

    Raises
    ------
    CudaError
        If there is none, or no driver.
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
    """Major and minor version of CUDA that the driver is for; None in the simulator.

    Raises
    ------
    CudaError
        If there is no driver.
    """
    if is_simulated():
        return None
    from numba.cuda.cudadrv.driver import driver

    gpu_count()  # says clearly why there is none
    major, minor = driver.get_version()
    return int(major), int(minor)
