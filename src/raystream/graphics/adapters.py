"""Graphics adapters: listing them, choosing one, and opening a device on it."""

from __future__ import annotations

import importlib
import os
import tempfile
import threading
from typing import Any, NamedTuple

from raystream.graphics.errors import GraphicsError

#: Selects an adapter by a part of its name.
ADAPTER_VARIABLE = "RAYSTREAM_ADAPTER"

#: Backends that render to rgba32float: OpenGL does not.
_BACKENDS = ("Vulkan", "Metal", "D3D12")

#: Fastest first, software last.
_KINDS = ("DiscreteGPU", "IntegratedGPU", "VirtualGPU", "Unknown", "CPU")

#: Limits for which all that the adapter offers is requested, beyond what WebGPU guarantees.
_LIMITS = (
    "max-buffer-size",
    "max-storage-buffer-binding-size",
    "max-storage-buffers-per-shader-stage",
    "max-compute-workgroups-per-dimension",
    "max-texture-dimension-2d",
    "max-color-attachments",
    "max-color-attachment-bytes-per-sample",
)

#: Features that are requested where the adapter offers them: fragment programs that write buffers
#: can have the stencil test before them.
EARLY_TEST = "shader-early-depth-test"

#: A device that cannot make a buffer of this size is lost.
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
        As its driver reports it.
    kind : str
        ``"DiscreteGPU"``, ``"IntegratedGPU"``, ``"VirtualGPU"``, ``"Unknown"``, or ``"CPU"`` for
        software.
    backend : str
        ``"Vulkan"``, ``"Metal"`` or ``"D3D12"``.
    description : str
        The driver.
    handle : GPUAdapter
        wgpu's object.
    """

    name: str
    kind: str
    backend: str
    description: str
    handle: Any

    @property
    def is_software(self) -> bool:
        """Whether it runs on the CPU."""
        return self.kind == "CPU"

    def __str__(self) -> str:
        kind = "software" if self.is_software else self.kind
        return f"{self.name} ({kind}, {self.backend})"


class OpenDevice:
    """An open device.

    Attributes
    ----------
    adapter : Adapter
    device : GPUDevice
    limits : dict of str to int
        The device's limits, by wgpu's names.
    has_early_test : bool
        Whether programs that write buffers can have the stencil test before them.
    is_known_lost : bool
        Whether the device was found to be lost.
    lock : RLock
        Held while the device is used: its queries share buffers.
    """

    def __init__(self, adapter: Adapter, device: Any) -> None:
        self.adapter = adapter
        self.device = device
        self.limits: dict[str, int] = dict(device.limits)
        self.has_early_test = EARLY_TEST in device.features
        self.is_known_lost = False
        self.lock = threading.RLock()

    @property
    def is_lost(self) -> bool:
        """Whether the device is lost for good, for instance because its driver was reset."""
        if not self.is_known_lost:
            try:
                self.device.create_buffer(size=_PROBE_BYTES, usage=_wgpu().BufferUsage.COPY_DST)
            except Exception:  # of any kind
                self.is_known_lost = True
        return self.is_known_lost


def _wgpu() -> Any:
    try:
        return importlib.import_module("wgpu")
    except ImportError as error:
        raise GraphicsError(_NO_WGPU) from error
    except Exception as error:  # its native library is missing, or of another platform
        raise GraphicsError(f"device 'graphics': wgpu cannot be used: {error}") from error


def adapters() -> list[Adapter]:
    """List the adapters that can trace rays, best first.

    Raises
    ------
    GraphicsError
        If wgpu is not installed, or cannot be used.
    """
    # Without it, software Vulkan prints a warning about sockets that it never opens.
    if os.name == "posix":
        os.environ.setdefault("XDG_RUNTIME_DIR", tempfile.gettempdir())
    try:
        handles = _wgpu().gpu.enumerate_adapters_sync()
    except GraphicsError:
        raise
    except Exception as error:  # wgpu wraps all errors of a driver
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


#: Open devices by the name requested, and the lock for opening one.
_OPEN: dict[str, OpenDevice] = {}
_OPENING = threading.Lock()


def open_device(name: str | None = None) -> OpenDevice:
    """Open a device on an adapter, or return the one that is open, unless it is lost.

    Parameters
    ----------
    name : str, optional
        A part of the adapter's name [default: ``RAYSTREAM_ADAPTER``, else the best adapter].

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
    """The adapter that `open_device` uses.

    Raises
    ------
    GraphicsError
        If there is no such adapter, or wgpu is not installed.
    """
    name = _wanted(name)
    found = adapters()
    if not found:
        raise GraphicsError(_NO_ADAPTER)
    chosen = [one for one in found if name.lower() in str(one).lower()]
    if not chosen:
        known = ", ".join(map(str, found))
        raise GraphicsError(f"adapter: none is called {name!r}; available: {known}")
    return chosen[0]


def _wanted(name: str | None) -> str:
    return name or os.environ.get(ADAPTER_VARIABLE) or ""


def _open(adapter: Adapter) -> OpenDevice:
    offered = adapter.handle.limits
    wanted = {limit: offered[limit] for limit in _LIMITS if limit in offered}
    try:
        features = [one for one in (EARLY_TEST,) if one in adapter.handle.features]
        device = adapter.handle.request_device_sync(
            required_features=features, required_limits=wanted
        )
    except Exception as error:  # wgpu wraps all errors of a driver
        raise GraphicsError(f"adapter {adapter}: cannot be opened: {error}") from error
    return OpenDevice(adapter, device)
