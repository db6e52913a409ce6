"""BVHs of triangles on the GPU: binary nodes, and triangles in their leaves."""

from __future__ import annotations

from raystream.cuda.bvh.binary import STACK_BYTES, unfold
from raystream.cuda.bvh.kernels import LaidOut, with_arrays
from raystream.cuda.bvh.triangles import traverse
from raystream.structures.bvh.structure import BvhStructure

__all__ = ["STACK_BYTES", "lay_out", "traverse"]


def lay_out(structure: BvhStructure) -> LaidOut:
    """Convert a BVH; see `bvh.kernels.LAYOUTS`."""
    made = unfold(*structure.tree)
    return with_arrays(structure, {"nodes": made.nodes, "leaves": made.leaves})
