"""The uniform grid: cells of one size, and a list of triangles for each."""

from raystream.structures.grid.options import Grid

__all__ = ["Grid"]
