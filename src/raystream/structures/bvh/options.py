"""Bvh: what others know of the bounding volume hierarchy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from raystream.core.options import Range
from raystream.structures.registry import StructureOptions, register_structure

__all__ = ["MAX_LEAF_SIZE", "Bvh"]

#: Most triangles in a leaf.
MAX_LEAF_SIZE = 32


@register_structure
@dataclass(frozen=True, kw_only=True)
class Bvh(StructureOptions):
    """A bounding volume hierarchy whose nodes have eight children.

    Parameters
    ----------
    quality : {"fast", "balanced", "high"}
        How much time the build may take for a tree that is traced faster.
    max_leaf_size : int
        Most triangles in a leaf, 1 to 32.
    kernel : {"auto", "wavefront", "packet", "stream", "single"}
        How the CPU traces rays: ``"auto"`` chooses for each batch. All give the same bits; the
        others are for measuring. A query that a kernel cannot answer takes another, and one
        that counts what rays meet takes ``"single"``.

    Raises
    ------
    ValueError
        If an option is out of range.
    TypeError
        If `max_leaf_size` is no integer.
    """

    name = "bvh"
    structure = "raystream.structures.bvh.structure:BvhStructure"
    forms: ClassVar = {
        "multipass": "raystream.machines.steps.bvh:steps",
        "cuda kernels": "raystream.cuda.bvh.kernels",
        "cuda build": "raystream.cuda.builders.bvh:build_bvh",
        "graphics": "raystream.graphics.structures.bvh:shader_structure",
    }

    quality: Literal["fast", "balanced", "high"] = "balanced"
    max_leaf_size: Annotated[int, Range(1, MAX_LEAF_SIZE)] = 4
    kernel: Literal["auto", "wavefront", "packet", "stream", "single"] = "auto"
