"""Devices by name, with their builders of structures and their machines."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from raystream.core.choices import Cpu, DeviceOptions
from raystream.jit.threads import Progress
from raystream.machines import MACHINES, make_machine, own_options
from raystream.structures import Structure, StructureOptions, build_structure, builder_for

if TYPE_CHECKING:
    from raystream.machines.backend import Backend

#: Builds a structure for a device: (structure, triangles, progress=, device=), with the options of
#: both.
DeviceFactory = Callable[..., Structure]


class Machines(Protocol):
    """The machines of a device.

    Attributes
    ----------
    names : tuple of str
        Values of ``Tracer(machine=...)``; the first is the default.
    """

    names: tuple[str, ...]

    def own_options(self, machine: str, options: Mapping[str, Any]) -> dict[str, Any]:
        """The options of a tracer that are the machine's; see `machines.own_options`."""
        ...

    def make(self, machine: str, structure: Structure, options: Mapping[str, Any]) -> Backend:
        """Make the backend of a machine; see `machines.make_machine`."""
        ...


class _CpuMachines:
    names: tuple[str, ...] = MACHINES
    own_options = staticmethod(own_options)
    make = staticmethod(make_machine)


#: The machines of the CPU.
CPU_MACHINES: Machines = _CpuMachines()


class Device(NamedTuple):
    """A device.

    Attributes
    ----------
    build : callable
        A `DeviceFactory`.
    machines : Machines
    options : type of DeviceOptions, optional
        None if it has no options besides its machines'.
    """

    build: DeviceFactory
    machines: Machines
    options: type[DeviceOptions] | None = None


def build_on_cpu(
    structure: StructureOptions,
    triangles: Any,
    *,
    progress: Progress | None = None,
    device: DeviceOptions | None = None,  # noqa: ARG001 - part of `DeviceFactory`
) -> Structure:
    """Build a structure on the CPU; a `DeviceFactory`.

    Raises
    ------
    ValueError
        If the structure does not support the kind of scene.
    """
    if not triangles.kinds:
        return build_structure(structure, triangles, progress=progress)
    made: Structure = builder_for(structure.name, triangles)(
        triangles, structure, progress=progress
    )
    return made


#: Devices by name: those in use, and those that were registered.
DEVICES: dict[str, Device] = {"cpu": Device(build_on_cpu, CPU_MACHINES, Cpu)}

#: Rooms that register their device on import, at its first use.
_ROOMS = {"cuda": "raystream.cuda", "graphics": "raystream.graphics"}


def register_device(
    name: str,
    build: DeviceFactory = build_on_cpu,
    machines: Machines = CPU_MACHINES,
    options: type[DeviceOptions] | None = None,
) -> None:
    """Register a device by name.

    Parameters
    ----------
    name : str
        Value of ``Tracer(device=...)``.
    build : callable, optional
        ``build(structure, triangles, progress=None, device=None)`` takes the `StructureOptions`
        and `DeviceOptions`, and returns a `Structure` [default: on the CPU].
    machines : Machines, optional
        How the device traverses structures [default: as the CPU does].
    options : type of DeviceOptions, optional
        Also accepted by ``Tracer(device=...)``: a frozen dataclass.
    """
    DEVICES[name] = Device(build, machines, options)


def device_of(name: str) -> Device:
    """A device by name.

    Raises
    ------
    ValueError
        If the name is unknown.
    """
    if name in list(_ROOMS) and name not in DEVICES:
        importlib.import_module(_ROOMS[name])
    if name not in list(DEVICES):
        known = ", ".join(map(repr, dict.fromkeys([*DEVICES, *_ROOMS])))
        raise ValueError(f"device: expected one of {known}, got {name!r}")
    return DEVICES[name]
