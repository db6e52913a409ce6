"""The multipass machine of the graphics device: Purcell's ray tracer on the graphics pipeline."""

from raystream.graphics.multipass.machine import LOOPS, Multipass

__all__ = ["LOOPS", "Multipass"]
