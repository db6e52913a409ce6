"""The kd-tree, with the traversals of Foley 2005 and Horn 2007."""

from raystream.structures.kdtree.options import KdTree

__all__ = ["KdTree"]
