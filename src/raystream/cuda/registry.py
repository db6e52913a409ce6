"""The machine of the CUDA device."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from raystream.cuda.devices import open_device
from raystream.machines import MULTIPASS_OPTIONS
from raystream.machines.backend import Backend
from raystream.structures import Structure
from raystream.tracer.devices import Machines

#: Options of the machine.
_OPTIONS = ("gpu", "rays_at_once")

#: Where the machine runs that CUDA does not have.
_MULTIPASS = "device='cpu' and device='graphics'"


class _CudaMachines:
    names: tuple[str, ...] = ("branching",)

    def own_options(self, machine: str, options: Mapping[str, Any]) -> dict[str, Any]:
        """Select and check the options of the machine.

        Opens the GPU, so that a missing one is reported before a structure is built.
        """
        if machine != "branching":
            hint = f", which runs on {_MULTIPASS}" if machine == "multipass" else ""
            raise ValueError(
                f"machine: expected 'branching' on device 'cuda', got {machine!r}{hint}"
            )
        for name in options:
            if name in MULTIPASS_OPTIONS:
                raise TypeError(
                    f"{machine}: has no option {name!r}; it is an option of machine='multipass', "
                    f"on {_MULTIPASS}"
                )
        own = {name: value for name, value in options.items() if name in _OPTIONS}
        open_device(own.get("gpu", 0))
        return own

    def make(self, machine: str, structure: Structure, options: Mapping[str, Any]) -> Backend:  # noqa: ARG002
        """Make a backend for a structure."""
        rest = dict(options)
        gpu = open_device(rest.pop("gpu", 0))
        from raystream.cuda.backend import CudaBackend

        return CudaBackend(structure, gpu, **rest)


CUDA_MACHINES: Machines = _CudaMachines()
