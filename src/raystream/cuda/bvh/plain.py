"""BVHs of triangles on the GPU: binary nodes, and triangles in their leaves."""

from __future__ import annotations

from raystream.cuda.bvh import binary
from raystream.cuda.bvh.kernels import LaidOut, with_arrays
from raystream.cuda.bvh.triangles import traverse
from raystream.structures.bvh.structure import BvhStructure

__all__ = ["lay_out", "stack_bytes", "traverse"]

stack_bytes = binary.STACK_BYTES


def lay_out(structure: BvhStructure) -> LaidOut:
    """Convert a BVH; see `bvh.kernels.LAYOUTS`."""
    made = binary.unfold(*structure.tree)
    return with_arrays(structure, {"nodes": made.nodes, "leaves": made.leaves})
