"""A driver whose device is the PTX interpreter: tracers run the code compiled for GPUs on it."""

from __future__ import annotations

import ctypes
from types import SimpleNamespace

import fake_driver
from ptx.machine import Kernel
from ptx.memory import Memory, room_for
from raystream.jit.cuda import CAPABILITIES

#: Alignment of CUDA's arrays in bytes.
_ALIGNMENT = 256


class _Array:
    """A device array, which must not be used after it is freed."""

    def __init__(self, memory, byte_count):
        self._memory, self._room = memory, room_for(byte_count, _ALIGNMENT)
        self.handle = memory.add(f"an array of {byte_count} bytes", self._room)

    @property
    def __cuda_array_interface__(self):
        return {"data": (self.handle, False)}

    def __del__(self):
        self._memory.drop(self.handle)


class PtxDriver(fake_driver.Driver):
    """Takes PTX, and runs it when it is launched.

    Attributes
    ----------
    launched : dict
        How often each kernel was, by name.
    """

    def __init__(self):
        super().__init__()
        self.capability = CAPABILITIES[0]
        self.memory = Memory()
        self.launched = {}
        self._kernels = {}

    def device_array(self, length, _dtype):
        return _Array(self.memory, length)

    def allocate(self, byte_count, stream):  # noqa: ARG002
        return _Array(self.memory, byte_count)

    def cuMemsetD8Async(self, to, value, byte_count, _stream):  # noqa: N802 - NVIDIA's
        ctypes.memset(to, value, byte_count)
        return (0,)

    CUpointer_attribute = SimpleNamespace(CU_POINTER_ATTRIBUTE_DEVICE_ORDINAL=9)

    def cuPointerGetAttribute(self, _attribute, _address):  # noqa: N802 - NVIDIA's
        return 0, self.count - 1

    def load(self, ptx, name):
        if name not in self._kernels:
            self._kernels[name] = Kernel(ptx.decode(), name)
        kernel = self._kernels[name]
        return SimpleNamespace(get_kernel=lambda _entry: kernel)

    def launch(self, _stream, config, kernel, *values):
        self.launched[kernel.name] = self.launched.get(kernel.name, 0) + 1
        kernel.launch(self.memory, *config, values)
