"""The graph of sectors: boxes that tile space, each linked to those behind its faces."""

from raystream.structures.graph.structure import Graph

__all__ = ["Graph"]
