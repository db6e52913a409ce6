"""Opens and lists GPUs; imports ``numba-cuda`` when they are first used."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from raystream.core.errors import RaystreamError

if TYPE_CHECKING:
    from raystream.jit.cuda import Gpu, GpuFacts


@contextlib.contextmanager
def _needing_package() -> Iterator[None]:
    try:
        yield
    except ImportError as error:
        raise RaystreamError(
            "device 'cuda': needs numba-cuda; pip install 'raystream[cuda]', or use device='cpu' "
            "or 'graphics'"
        ) from error


def open_device(number: Any = 0) -> Gpu:
    """Open a GPU by its number.

    Raises
    ------
    RaystreamError
        If it does not exist, or numba-cuda is not installed.
    TypeError
        If the number is not an integer.
    """
    with _needing_package():
        from raystream.jit.cuda import open_gpu
    return open_gpu(number)


def list_gpus() -> tuple[list[GpuFacts], tuple[int, int] | None]:
    """List the GPUs, and the CUDA version of the driver; None in the simulator.

    Raises
    ------
    RaystreamError
        If there is no GPU or driver, or ``numba-cuda`` is not installed.
    """
    with _needing_package():
        from raystream.jit.cuda import driver_version, gpu_facts
    return gpu_facts(), driver_version()
