"""The multipass machine of the graphics device: Purcell's ray tracer on the graphics pipeline."""

from raystream.graphics.multipass.backend import LOOPS, MultipassBackend

__all__ = ["LOOPS", "MultipassBackend"]
