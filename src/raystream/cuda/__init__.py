"""The CUDA device: rays traced by NVIDIA's GPUs, with the CPU's own device functions.

``pip install raystream[cuda]``. Structures are built on the CPU, and the arrays that their
traversals read are copied to the GPU; ``build="device"`` builds them there.
"""

from raystream.core.choices import Cuda
from raystream.cuda.building import build_structure
from raystream.cuda.registry import CUDA_MACHINES
from raystream.machines.devices import register_device

__all__ = ["CUDA_MACHINES"]

register_device("cuda", build_structure, CUDA_MACHINES, Cuda)
