"""The machines of the CUDA device, by name."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from raystream.core.errors import RaystreamError
from raystream.cuda.bvh.kernels import kernel_of
from raystream.cuda.options import check_names
from raystream.machines import MULTIPASS_OPTIONS
from raystream.machines.backend import Backend
from raystream.machines.devices import Machines
from raystream.structures import Structure

if TYPE_CHECKING:
    from raystream.jit.cuda import Gpu, GpuFacts

__all__ = ["CUDA_MACHINES", "OPTIONS", "list_gpus", "open_device"]

_SHARED = ("gpu", "rays_at_once")

#: Options of each machine.
OPTIONS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "branching": (*_SHARED, "kernel", "launch", "order"),
        "multipass": (*_SHARED, *MULTIPASS_OPTIONS, "loop", "max_passes"),
    }
)


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
    """A GPU by its number.

    Raises
    ------
    RaystreamError
        If there is none, or numba-cuda is missing.
    TypeError
        If it is no integer.
    """
    with _needing_package():
        from raystream.jit.cuda import open_gpu
    return open_gpu(number)


def list_gpus() -> tuple[list[GpuFacts], tuple[int, int] | None]:
    """All GPUs, and the version of CUDA that the driver is for, None in the simulator.

    Raises
    ------
    RaystreamError
        If there is none, or no driver, or ``numba-cuda`` is not installed.
    """
    with _needing_package():
        from raystream.jit.cuda import driver_version, gpu_facts
    return gpu_facts(), driver_version()


class _CudaMachines:
    names: tuple[str, ...] = tuple(OPTIONS)

    def own_options(self, machine: str, options: Mapping[str, Any]) -> dict[str, Any]:
        """Those of a tracer's options that are a machine's.

        The device is opened, too: where there is none, no structure need be built to say so.
        """
        if machine not in OPTIONS:
            known = ", ".join(map(repr, OPTIONS))
            raise ValueError(f"machine: expected one of {known} on device 'cuda', got {machine!r}")
        own = {name: value for name, value in options.items() if name in OPTIONS[machine]}
        for name in options:
            homes = [one for one, names in OPTIONS.items() if name in names]
            if homes and machine not in homes:
                raise TypeError(
                    f"{machine}: has no option {name!r}; it is one of machine={homes[0]!r}"
                )
        kernel_of("bvh", own.get("kernel", "auto"))  # whether there is one of that name
        check_names(own)
        open_device(own.get("gpu", 0))
        return own

    def make(self, machine: str, structure: Structure, options: Mapping[str, Any]) -> Backend:
        """Make a machine for a structure that was built on the CPU."""
        rest = dict(options)
        gpu = open_device(rest.pop("gpu", 0))
        if machine == "multipass":
            from raystream.cuda.multipass import Multipass

            return Multipass(structure, gpu, **rest)
        from raystream.cuda.branching import Branching

        return Branching(structure, gpu, **rest)


CUDA_MACHINES: Machines = _CudaMachines()
