"""Renderers on CUDA: stages as kernels over paths in device memory."""

from raystream.cuda.rendering.cuda_bands import CudaBands

__all__ = ["CudaBands"]
