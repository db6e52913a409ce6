"""The graph of sectors: boxes that tile space, each linked to those behind its faces."""

from raystream.structures.graph.options import Graph

__all__ = ["Graph"]
