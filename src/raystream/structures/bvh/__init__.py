"""Bounding volume hierarchy: boxes around boxes around triangles."""

from raystream.structures.bvh.options import Bvh

__all__ = ["Bvh"]
