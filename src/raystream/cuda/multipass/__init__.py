"""The multipass machine of the CUDA device."""

from raystream.cuda.multipass.machine import MAX_PASSES, Multipass

__all__ = ["MAX_PASSES", "Multipass"]
