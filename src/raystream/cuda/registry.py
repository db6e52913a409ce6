"""The machines of the CUDA device, by name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from raystream.cuda.devices import open_device
from raystream.cuda.options import OPTIONS
from raystream.machines.backend import Backend
from raystream.machines.devices import Machines
from raystream.structures import Structure

__all__ = ["CUDA_MACHINES"]


class _CudaMachines:
    names: tuple[str, ...] = tuple(OPTIONS)

    def own_options(self, machine: str, options: Mapping[str, Any]) -> dict[str, Any]:
        """Select and check the options of a machine.

        Opens the GPU, so that a missing one is reported before a structure is built.
        """
        if machine not in OPTIONS:
            known = ", ".join(map(repr, OPTIONS))
            raise ValueError(f"machine: expected one of {known} on device 'cuda', got {machine!r}")
        own = {name: value for name, value in options.items() if name in OPTIONS[machine]}
        for name in options:
            homes = [one for one, names in OPTIONS.items() if name in names]
            if homes and machine not in homes:
                raise TypeError(
                    f"{machine}: has no option {name!r}; it is an option of machine={homes[0]!r}"
                )
        open_device(own.get("gpu", 0))
        return own

    def make(self, machine: str, structure: Structure, options: Mapping[str, Any]) -> Backend:
        """Make a backend for a structure."""
        rest = dict(options)
        gpu = open_device(rest.pop("gpu", 0))
        if machine == "multipass":
            from raystream.cuda.multipass import Multipass

            return Multipass(structure, gpu, **rest)
        if structure.precision == "float64":
            from raystream.cuda.float64.backend import Float64CudaBackend

            return Float64CudaBackend(structure, gpu, **rest)
        from raystream.cuda.backend import CudaBackend

        return CudaBackend(structure, gpu, **rest)


CUDA_MACHINES: Machines = _CudaMachines()
