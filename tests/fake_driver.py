"""A fake CUDA driver: the calls that raystream makes, done on the host."""

from __future__ import annotations

import contextlib
import ctypes
import sys
import threading
from types import SimpleNamespace

import numpy as np

from raystream.jit.cuda import devices, gpu


class Memory:
    """Memory of the fake device."""

    def __init__(self, byte_count):
        self._bytes = np.zeros(max(byte_count, 1), np.uint8)
        self.handle = self._bytes.ctypes.data

    @property
    def __cuda_array_interface__(self):
        return {"data": (self.handle, False)}


class Driver:
    """A driver that fails where it is told to.

    Attributes
    ----------
    failing : dict
        Messages of its errors, by what is asked.
    capability : (int, int)
    count : int
        Of its devices.
    """

    def __init__(self):
        self.failing, self.capability, self.count = {}, (9, 0), 2
        self._threads = threading.local()

    def may(self, what):
        if what in self.failing:
            raise RuntimeError(self.failing[what])

    @property
    def gpus(self):
        self.may("init")
        return [contextlib.nullcontext()] * self.count

    def current_context(self, _number):
        self.may("open")
        return SimpleNamespace(get_memory_info=lambda: SimpleNamespace(total=10**9, free=10**9))

    def device_array(self, length, _dtype):
        self.may("allocate")
        return Memory(length)

    def allocate(self, byte_count, stream):  # noqa: ARG002
        self.may("allocate")
        return Memory(byte_count)

    def pinned_array(self, length, dtype):
        return np.zeros(length, dtype)

    def device(self, number):
        """The device as an object of this thread, as cuda.core has it: to be set current first."""
        devices = self._threads.__dict__.setdefault("devices", {})
        if number not in devices:
            devices[number] = SimpleNamespace(
                name=f"Fake {number}", allocate=self.allocate, is_current=False
            )
        device = devices[number]
        device.compute_capability = self.capability

        def set_current():
            device.is_current = True

        def create_stream(options):
            if not device.is_current:
                raise RuntimeError(f"Device {number} is not yet initialized")
            return self

        device.set_current, device.create_stream = set_current, create_stream
        return device

    #: Of a stream.
    handle = 1

    def wait(self, _other):
        pass

    def record(self):
        """An event: all is done at once."""
        return SimpleNamespace(is_done=True)

    # ---- Functions of cuda.bindings.driver.

    CUresult = SimpleNamespace(CUDA_SUCCESS=0)

    def cuMemcpyAsync(self, to, source, byte_count, _stream):  # noqa: N802 - NVIDIA's
        self.may("copy")
        ctypes.memmove(to, source, byte_count)
        return (0,)

    def cuMemsetD8Async(self, address, value, byte_count, _stream):  # noqa: N802
        self.may("clear")
        ctypes.memset(address, value, byte_count)
        return (0,)

    def load(self, _ptx, name):
        self.may("load")
        return SimpleNamespace(get_kernel=lambda _entry: name)

    def launch(self, *_arguments):
        self.may("launch")

    def sync(self):
        self.may("sync")

    @property
    def core(self):
        """The replacement of cuda.core."""
        return SimpleNamespace(
            Device=self.device,
            StreamOptions=lambda nonblocking: nonblocking,
            PER_THREAD_DEFAULT_STREAM=self,
            Stream=None,
            LEGACY_DEFAULT_STREAM=self,
            LaunchConfig=lambda grid, block: (grid, block),
            ObjectCode=SimpleNamespace(from_ptx=self.load),
            launch=self.launch,
        )


def install(monkeypatch, driver):
    """Replace CUDA's driver and cuda.core by a fake one; devices must be reopened."""
    monkeypatch.setitem(sys.modules, "cuda.core", driver.core)
    monkeypatch.setitem(sys.modules, "cuda.bindings", SimpleNamespace(driver=driver))
    for module in (gpu, devices):
        monkeypatch.setattr(module, "cuda", driver)
    devices._opened.cache_clear()
