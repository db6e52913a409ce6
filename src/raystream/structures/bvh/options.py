"""Bvh: the options of the bounding volume hierarchy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from raystream.core.options import Range
from raystream.structures.registry import StructureOptions, register_structure

#: Most triangles in a leaf.
MAX_LEAF_SIZE = 32


@register_structure
@dataclass(frozen=True, kw_only=True)
class Bvh(StructureOptions):
    """A bounding volume hierarchy with eight children per node.

    Parameters
    ----------
    quality : {"fast", "balanced"}
        Time spent on the build, for faster traversal.
    max_leaf_size : int
        Maximum number of triangles in a leaf, 1 to 32.
    kernel : {"auto", "wavefront", "packet", "groups", "single"}
        How the CPU traces rays; ``"auto"`` chooses for each batch. All give the same bits; the
        others are for measurements. Queries and scenes that a kernel does not support use another
        one, such as ``"single"`` for ``"groups"`` and spheres, and those with ray counters use
        ``"single"``.

    Raises
    ------
    ValueError
        If an option is out of range.
    TypeError
        If `max_leaf_size` is not an integer.
    """

    name = "bvh"
    structure = "raystream.structures.bvh.structure:BvhStructure"
    forms: ClassVar = {
        "nearest": "raystream.structures.bvh.nearest:find_nearest",
        "nearest search": "raystream.cuda.bvh.points:POINT_SEARCH",
        "multipass": "raystream.machines.steps.bvh:steps",
        "cuda kernels": "raystream.cuda.bvh.plain",
        "cuda build": "raystream.cuda.builders.bvh:build_bvh",
        "graphics": "raystream.graphics.structures.bvh:shader_structure",
    }

    quality: Literal["fast", "balanced"] = "balanced"
    max_leaf_size: Annotated[int, Range(1, MAX_LEAF_SIZE)] = 4
    kernel: Literal["auto", "wavefront", "packet", "groups", "single"] = "auto"
