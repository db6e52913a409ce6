"""The kd-tree: nested split planes, and three ways through them (Foley 2005)."""

from raystream.structures.kdtree.options import KdTree

__all__ = ["KdTree"]
