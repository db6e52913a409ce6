"""GraphicsError: an error of a graphics device, in one line."""

from __future__ import annotations

from raystream.core.errors import RaystreamError


class GraphicsError(RaystreamError, RuntimeError):
    """A graphics device that is missing, lost, too small, or cannot run a shader.

    Tracers on the CPU still work in the same process.
    """
