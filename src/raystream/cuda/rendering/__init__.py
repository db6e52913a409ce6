"""Renderers on CUDA: stages of kernels over paths that stay in the device's memory."""

from raystream.cuda.rendering.bands import CudaBands

__all__ = ["CudaBands"]
