"""Bounding volume hierarchy."""

from raystream.structures.bvh.options import Bvh

__all__ = ["Bvh"]
