"""Renderers on the graphics pipeline: every stage is a fragment program, in one loop of passes."""

from raystream.graphics.rendering.bands import FragmentBands

__all__ = ["FragmentBands"]
