"""CUDA: functions compiled for NVIDIA's GPUs, cached on disk, and launched.

Importing it needs ``numba-cuda``, but neither a GPU nor a driver: kernels are compiled without
one, and run in Numba's simulator (``NUMBA_ENABLE_CUDASIM=1``).
"""

from raystream.jit.cuda.array_views import DeviceView, stream_of, view_of
from raystream.jit.cuda.compiler import CAPABILITIES, Compiled, compile_function
from raystream.jit.cuda.device_array import DeviceArray
from raystream.jit.cuda.devices import (
    GpuFacts,
    driver_version,
    gpu_count,
    gpu_facts,
    open_gpu,
)
from raystream.jit.cuda.gpu import CudaError, Gpu
from raystream.jit.cuda.range_kernel import RangeKernel, gpu_kernel, kernels_in
from raystream.jit.cuda.simulation import is_simulated
from raystream.jit.cuda.stream_scope import StreamScope
from raystream.jit.cuda.streams import CudaStream
from raystream.jit.cuda.user_kernel import UserKernel

__all__ = [
    "CAPABILITIES",
    "Compiled",
    "CudaError",
    "CudaStream",
    "DeviceArray",
    "DeviceView",
    "Gpu",
    "GpuFacts",
    "RangeKernel",
    "StreamScope",
    "UserKernel",
    "compile_function",
    "driver_version",
    "gpu_count",
    "gpu_facts",
    "gpu_kernel",
    "is_simulated",
    "kernels_in",
    "open_gpu",
    "stream_of",
    "view_of",
]
