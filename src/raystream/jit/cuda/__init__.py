"""CUDA: functions compiled for NVIDIA's GPUs, kept on disk, and launched.

Importing it needs ``numba-cuda``, but neither a GPU nor a driver: kernels are compiled without
one, and run in Numba's simulator (``NUMBA_ENABLE_CUDASIM=1``).
"""

from raystream.jit.cuda.checked import CheckedKernel
from raystream.jit.cuda.compiler import CAPABILITIES, Compiled, compile_function
from raystream.jit.cuda.device_loops import DeviceLoop, Launch, set_condition
from raystream.jit.cuda.gpu import CudaError, DeviceArray, Gpu
from raystream.jit.cuda.kernels import RangeKernel
from raystream.jit.cuda.listing import GpuFacts, driver_version, gpu_facts
from raystream.jit.cuda.opening import gpu_count, open_gpu
from raystream.jit.cuda.persistent import PersistentKernel
from raystream.jit.cuda.simulation import is_simulated
from raystream.jit.cuda.streams import CudaStream
from raystream.jit.cuda.tables import MOST_DIMENSIONS, table_at
from raystream.jit.cuda.texts import device_of_text, kernel_of_text
from raystream.jit.cuda.views import DeviceView, stream_of, view_of
from raystream.jit.cuda.work import Work

__all__ = [
    "CAPABILITIES",
    "MOST_DIMENSIONS",
    "CheckedKernel",
    "Compiled",
    "CudaError",
    "CudaStream",
    "DeviceArray",
    "DeviceLoop",
    "DeviceView",
    "Gpu",
    "GpuFacts",
    "Launch",
    "PersistentKernel",
    "RangeKernel",
    "Work",
    "compile_function",
    "device_of_text",
    "driver_version",
    "gpu_count",
    "gpu_facts",
    "is_simulated",
    "kernel_of_text",
    "open_gpu",
    "set_condition",
    "stream_of",
    "table_at",
    "view_of",
]
