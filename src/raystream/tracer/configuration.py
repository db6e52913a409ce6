"""The structure, device and machine of a tracer, from names or typed options."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from raystream.core.choices import MACHINES, DeviceOptions, MachineOptions
from raystream.core.options import Options
from raystream.structures import StructureOptions, options_of
from raystream.tracer.devices import Device, device_of


class Configuration(NamedTuple):
    """A structure, a device and a machine.

    Attributes
    ----------
    structure : StructureOptions or None
        None if the structure is built already.
    device, machine : str
    device_options : DeviceOptions or None
        None for a device registered without a class of options.
    options : mapping
        The given options of the device and the machine, for `Machines.make`.
    """

    structure: StructureOptions | None
    device: str
    machine: str
    device_options: DeviceOptions | None
    options: Mapping[str, Any]


def configure(
    structure: str | StructureOptions | None,
    device: str | DeviceOptions,
    machine: str | MachineOptions | None,
    options: Mapping[str, Any],
) -> Configuration:
    """Check the arguments of a tracer.

    Parameters
    ----------
    structure : str or StructureOptions, optional
        None for one that is built already.
    device : str or DeviceOptions
    machine : str or MachineOptions, optional
        [default: the device's first]
    options : mapping
        Options of those that are given by name: of the device, the machine and the structure.

    Raises
    ------
    ValueError
        If a name is unknown or an option is out of range.
    TypeError
        If there is no such option, or it is given in addition to typed options.
    """
    name = device.name if isinstance(device, DeviceOptions) else device
    entry = device_of(name)
    given = dict(options)
    for one in (device, machine):
        given |= _options_given(one, options)
    kind = machine.name if isinstance(machine, MachineOptions) else machine
    kind = entry.machines.names[0] if kind is None else kind
    own = entry.machines.own_options(kind, given)
    if kind in MACHINES:
        known = MACHINES[kind].names()
        MACHINES[kind](**{option: own[option] for option in known if option in own})
    device_options = _device_options(entry, device, options)
    of_device = () if entry.options is None else entry.options.names()
    rest = {
        option: value
        for option, value in options.items()
        if option not in own and option not in of_device
    }
    if structure is None:
        for option in rest:
            raise TypeError(f"{kind}: has no option {option!r}")
        return Configuration(None, name, kind, device_options, own)
    return Configuration(options_of(structure, rest), name, kind, device_options, own)


def _options_given(one: Any, options: Mapping[str, Any]) -> dict[str, Any]:
    """The options set in a typed device or machine, which must not be given twice."""
    if not isinstance(one, Options):
        return {}
    for option in options:
        if option in one.names():
            raise TypeError(f"{one.name}: give {option!r} as an argument of {type(one).__name__}")
    return one.given()


def _device_options(
    entry: Device, device: str | DeviceOptions, options: Mapping[str, Any]
) -> DeviceOptions | None:
    if isinstance(device, DeviceOptions) or entry.options is None:
        return device if isinstance(device, DeviceOptions) else None
    known = entry.options.names()
    return entry.options(**{option: options[option] for option in known if option in options})
