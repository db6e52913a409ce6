"""Devices by name: who builds the structures that trace on them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from raystream.core.triangles import Triangles
from raystream.jit.threads import Progress
from raystream.structures import Structure, build_structure

__all__ = ["DEVICES", "DeviceFactory", "build_on_device", "register_device"]

#: Makes a structure that traces on a device: (name, triangles, progress=, **options).
DeviceFactory = Callable[..., Structure]

#: Factories by the name of their device.
DEVICES: dict[str, DeviceFactory] = {"cpu": build_structure}


def register_device(name: str, factory: DeviceFactory) -> None:
    """Make a device known by name.

    Parameters
    ----------
    name : str
        What ``Tracer(device=...)`` takes.
    factory : callable
        ``factory(structure_name, triangles, progress=None, **options)`` returns a
        `Structure` whose queries run on the device.
    """
    DEVICES[name] = factory


def build_on_device(
    device: str,
    structure: str,
    triangles: Triangles,
    *,
    progress: Progress | None = None,
    **options: Any,
) -> Structure:
    """Build a structure on a device.

    Parameters
    ----------
    device : str
        A name that was registered.
    structure : str
    triangles : Triangles
    progress : callable, optional
    **options
        Build options of the structure.

    Raises
    ------
    ValueError
        If the device or the structure is unknown.
    """
    if device not in list(DEVICES):
        known = ", ".join(repr(known) for known in DEVICES)
        raise ValueError(f"device: expected one of {known}, got {device!r}")
    return DEVICES[device](structure, triangles, progress=progress, **options)
