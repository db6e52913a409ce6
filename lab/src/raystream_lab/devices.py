"""The devices that experiments run on: their machines, and what they are here."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

#: Devices that have experiments.
DEVICES = ("cpu", "graphics", "cuda")

#: The machines of each device that experiments run on: first the one that traces a ray from start
#: to end in one run of a program.
MACHINES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "cpu": ("branching", "multipass"),
        "graphics": ("compute", "multipass"),
        "cuda": ("branching",),
    }
)

#: What passes took on CUDA, for tables that have none; the figures are those of decision 0054.
CUDA_PASSES = (
    "CUDA's multipass machine has been removed. On an H100, its passes took 2.6 to 10 times as "
    "long as one thread per ray: raystream's decision 0054."
)


class DeviceFacts(NamedTuple):
    """A device of this machine.

    Attributes
    ----------
    text : str
        Its name and driver; empty for the CPU, whose name is the machine's.
    is_software : bool
        Whether it is simulated on the CPU.
    """

    text: str
    is_software: bool

    @property
    def note(self) -> str:
        """A sentence for tables."""
        kind = " It is software, so its times are not those of a GPU." if self.is_software else ""
        return f"Device: {self.text}.{kind}"


def open_facts(device: str) -> DeviceFacts:
    """Open a device and describe it.

    Parameters
    ----------
    device : str
        One of `DEVICES`.

    Raises
    ------
    RaystreamError
        If it is not available; the message says what is missing.
    """
    if device == "graphics":
        from raystream.graphics.adapters import open_device as open_adapter

        adapter = open_adapter().adapter
        text = f"{adapter.name}, {adapter.backend}, {adapter.description}"
        return DeviceFacts(text, adapter.is_software)
    if device == "cuda":
        from raystream.cuda.devices import list_gpus, open_device

        gpu = open_device()
        driver = list_gpus()[1]
        if driver is None:  # Numba's simulator
            return DeviceFacts(gpu.name, True)
        capability, version = (".".join(map(str, one)) for one in (gpu.capability, driver))
        text = f"{gpu.name}, compute capability {capability}, driver for CUDA {version}"
        return DeviceFacts(text, False)
    return DeviceFacts("", False)
