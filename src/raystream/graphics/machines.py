"""The machines of the graphics device, by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from raystream.core.choices import Graphics, Multipass
from raystream.graphics.adapters import open_device
from raystream.graphics.error_scope import guarded
from raystream.machines.backend import Backend
from raystream.structures import Structure
from raystream.tracer.devices import Machines

_SHARED = ("adapter", "rays_at_once")

#: Options of each machine.
OPTIONS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "compute": _SHARED,
        "branching": _SHARED,
        # Fragment programs cannot compact streams.
        "multipass": tuple(
            name for name in (*Graphics.names(), *Multipass.names()) if name != "compaction"
        ),
    }
)


def _compute(structure: Structure, adapter: str | None, **options: Any) -> Backend:
    from raystream.graphics.compute import ComputeBackend

    made: type[ComputeBackend] = ComputeBackend
    if structure.triangles.instances is not None:
        from raystream.graphics.instanced_rays import InstancedBackend

        made = InstancedBackend
    return made(structure, open_device(adapter), **options)


def _branching(structure: Structure, adapter: str | None, **options: Any) -> Backend:
    from raystream.graphics.branching import BranchingBackend

    return BranchingBackend(structure, open_device(adapter), **options)


def _multipass(structure: Structure, adapter: str | None, **options: Any) -> Backend:
    from raystream.graphics.multipass import MultipassBackend

    return MultipassBackend(structure, open_device(adapter), **options)


_MAKERS: Mapping[str, Callable[..., Backend]] = MappingProxyType(
    {"compute": _compute, "branching": _branching, "multipass": _multipass}
)


class _GraphicsMachines:
    names: tuple[str, ...] = tuple(OPTIONS)

    def own_options(self, machine: str, options: Mapping[str, Any]) -> dict[str, Any]:
        """The options of a tracer that are the machine's.

        Also opens the device: if there is none, this raises before a structure is built.
        """
        if machine not in OPTIONS:
            known = ", ".join(map(repr, OPTIONS))
            raise ValueError(
                f"machine: expected one of {known} on device 'graphics', got {machine!r}"
            )
        own = {name: value for name, value in options.items() if name in OPTIONS[machine]}
        for name in options:
            owner = next((one for one, names in OPTIONS.items() if name in names), None)
            if owner is not None and name not in own:
                raise TypeError(
                    f"{machine}: has no option {name!r}; it is an option of machine={owner!r}"
                )
        open_device(own.get("adapter"))
        return own

    def make(self, machine: str, structure: Structure, options: Mapping[str, Any]) -> Backend:
        """Make the backend of a machine, for a structure that was built on the CPU."""
        rest = dict(options)
        adapter = rest.pop("adapter", None)
        with guarded(open_device(adapter)):
            return _MAKERS[machine](structure, adapter, **rest)


GRAPHICS_MACHINES: Machines = _GraphicsMachines()
