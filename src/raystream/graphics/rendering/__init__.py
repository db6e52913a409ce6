"""Renderers on the graphics device: fragment programs in one loop of passes, or compute shaders."""

from raystream.graphics.rendering.compute_bands import ComputeBands
from raystream.graphics.rendering.fragment_bands import FragmentBands

__all__ = ["ComputeBands", "FragmentBands"]
