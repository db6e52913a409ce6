"""Graphics adapters: which there are, which one is taken, and the device that is opened on it."""

from __future__ import annotations

import importlib
import os
import tempfile
import threading
from typing import Any, NamedTuple

from raystream.graphics.errors import GraphicsError

__all__ = ["ADAPTER_VARIABLE", "Adapter", "OpenDevice", "adapters", "choose_adapter", "open_device"]

#: Names an adapter that is to be taken: a part of its name.
ADAPTER_VARIABLE = "RAYSTREAM_ADAPTER"

#: Those that render to rgba32float: the OpenGL one does not.
_BACKENDS = ("Vulkan", "Metal", "D3D12")

#: Real hardware first, and of that the fastest.
_KINDS = ("DiscreteGPU", "IntegratedGPU", "VirtualGPU", "Unknown", "CPU")

#: Where adapters offer more than WebGPU promises, this much is asked for.
_LIMITS = (
    "max-buffer-size",
    "max-storage-buffer-binding-size",
    "max-storage-buffers-per-shader-stage",
    "max-compute-workgroups-per-dimension",
    "max-texture-dimension-2d",
    "max-color-attachments",
    "max-color-attachment-bytes-per-sample",
)

#: A device that makes no buffer of this size is lost.
_PROBE_BYTES = 16

_NO_WGPU = "device 'graphics': needs wgpu; install it with: pip install 'raystream[graphics]'"

_NO_ADAPTER = (
    "device 'graphics': no Vulkan, Metal or Direct3D 12 adapter; install the driver of your GPU, "
    "or a software one (Debian, Ubuntu: apt install mesa-vulkan-drivers libvulkan1)"
)


class Adapter(NamedTuple):
    """A graphics adapter.

    Attributes
    ----------
    name : str
        As its driver calls it.
    kind : str
        ``"DiscreteGPU"``, ``"IntegratedGPU"``, ``"VirtualGPU"``, ``"Unknown"``, or ``"CPU"`` for
        software.
    backend : str
        ``"Vulkan"``, ``"Metal"`` or ``"D3D12"``.
    description : str
        Of the driver.
    handle : GPUAdapter
        What wgpu has for it.
    """

    name: str
    kind: str
    backend: str
    description: str
    handle: Any

    @property
    def is_software(self) -> bool:
        """Whether the processor does a GPU's work."""
        return self.kind == "CPU"

    def __str__(self) -> str:
        kind = "software" if self.is_software else self.kind
        return f"{self.name} ({kind}, {self.backend})"


class OpenDevice:
    """A device, opened.

    Attributes
    ----------
    adapter : Adapter
    device : GPUDevice
    limits : dict of str to int
        The device's, by wgpu's names.
    is_known_lost : bool
        Whether the device was found to be lost.
    lock : RLock
        Held by who uses the device: its queries have buffers in common.
    """

    def __init__(self, adapter: Adapter, device: Any) -> None:
        self.adapter = adapter
        self.device = device
        self.limits: dict[str, int] = dict(device.limits)
        self.is_known_lost = False
        self.lock = threading.RLock()

    @property
    def is_lost(self) -> bool:
        """Whether the device is gone, because its driver was reset, say: it never comes back."""
        if not self.is_known_lost:
            try:
                self.device.create_buffer(size=_PROBE_BYTES, usage=_wgpu().BufferUsage.COPY_DST)
            except Exception:  # of any kind: a device that has not even this much is of no use
                self.is_known_lost = True
        return self.is_known_lost


def _wgpu() -> Any:
    try:
        return importlib.import_module("wgpu")
    except ImportError as error:
        raise GraphicsError(_NO_WGPU) from error
    except Exception as error:  # its own library is missing, or made for another machine
        raise GraphicsError(f"device 'graphics': wgpu cannot be used: {error}") from error


def adapters() -> list[Adapter]:
    """The adapters that can trace rays, best first.

    Raises
    ------
    GraphicsError
        If wgpu is not installed, or cannot be used.
    """
    # Software Vulkan complains on standard error without a folder for sockets that it never opens.
    if os.name == "posix":
        os.environ.setdefault("XDG_RUNTIME_DIR", tempfile.gettempdir())
    try:
        handles = _wgpu().gpu.enumerate_adapters_sync()
    except GraphicsError:
        raise
    except Exception as error:  # wgpu wraps whatever a driver says
        raise GraphicsError(f"device 'graphics': wgpu cannot list adapters: {error}") from error
    found = [
        Adapter(
            str(handle.info["device"]),
            str(handle.info["adapter_type"]),
            str(handle.info["backend_type"]),
            str(handle.info["description"]),
            handle,
        )
        for handle in handles
        if handle.info["backend_type"] in _BACKENDS
    ]
    return sorted(found, key=lambda one: _KINDS.index(one.kind) if one.kind in _KINDS else 3)


#: Devices by the name that was asked for, and who may open one.
_OPEN: dict[str, OpenDevice] = {}
_OPENING = threading.Lock()


def open_device(name: str | None = None) -> OpenDevice:
    """Open a device on an adapter; the same one each time, until it is lost.

    Parameters
    ----------
    name : str, optional
        A part of the adapter's name; else of what ``RAYSTREAM_ADAPTER`` holds; else the best
        adapter is taken.

    Raises
    ------
    GraphicsError
        If there is no such adapter, or it gives no device.
    """
    wanted = _wanted(name)
    with _OPENING:
        if wanted not in _OPEN or _OPEN[wanted].is_lost:
            _OPEN[wanted] = _open(choose_adapter(wanted))
        return _OPEN[wanted]


def choose_adapter(name: str | None = None) -> Adapter:
    """The adapter that `open_device` takes.

    Raises
    ------
    GraphicsError
        If there is none, or wgpu is not installed.
    """
    name = _wanted(name)
    found = adapters()
    if not found:
        raise GraphicsError(_NO_ADAPTER)
    chosen = [one for one in found if name.lower() in str(one).lower()]
    if not chosen:
        known = ", ".join(map(str, found))
        raise GraphicsError(f"adapter: none is called {name!r}; there are {known}")
    return chosen[0]


def _wanted(name: str | None) -> str:
    return name or os.environ.get(ADAPTER_VARIABLE) or ""


def _open(adapter: Adapter) -> OpenDevice:
    offered = adapter.handle.limits
    wanted = {limit: offered[limit] for limit in _LIMITS if limit in offered}
    try:
        device = adapter.handle.request_device_sync(required_limits=wanted)
    except Exception as error:  # wgpu wraps whatever a driver says
        raise GraphicsError(f"adapter {adapter}: gives no device: {error}") from error
    return OpenDevice(adapter, device)
