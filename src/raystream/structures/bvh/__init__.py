"""Bounding volume hierarchy: boxes around boxes around triangles."""

from raystream.structures.bvh.structure import Bvh

__all__ = ["Bvh"]
