"""The CUDA device: traces rays on NVIDIA GPUs with the device functions of the CPU.

``pip install raystream[cuda]``. Structures are built on the CPU and copied to the GPU, or built
there with ``build="device"``.
"""

from raystream.core.choices import Cuda
from raystream.cuda.build import build_structure
from raystream.cuda.registry import CUDA_MACHINES
from raystream.tracer.devices import register_device

__all__ = ["CUDA_MACHINES"]

register_device("cuda", build_structure, CUDA_MACHINES, Cuda)
