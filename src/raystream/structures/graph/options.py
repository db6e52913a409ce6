"""Graph: the options of the graph of sectors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from raystream.core.options import Range
from raystream.structures.kdtree.options import MAX_DEPTH
from raystream.structures.registry import StructureOptions, register_structure


@register_structure
@dataclass(frozen=True, kw_only=True)
class Graph(StructureOptions):
    """A graph of sectors (Rayforce 2013): boxes linked through their faces.

    Rays traverse sector after sector, without a stack, and test triangles in the order of the ray.
    How sectors are made and linked is our interpretation of Gribble and Naveros, "GPU Ray Tracing
    with Rayforce", SIGGRAPH 2013 posters; see docs/decisions.

    Parameters
    ----------
    crossing_cost, intersection_cost, link_cost : float
        Costs, which the builder minimises, of a step into a sector, of a triangle test, and of a
        plane that separates the sectors behind a face, 1e-6 (for planes 0) to 1e6; only their
        ratios matter. The defaults are measured: sectors and planes are expensive because they
        miss the cache.
    max_depth : int, optional
        Maximum number of splits per sector, up to 64 [default: 8 + 1.3 log2 of the number of
        triangles, but at most 64].
    max_leaf_size : int
        Sectors with at most this many triangles are not split, 1 to 1024.

    Raises
    ------
    ValueError
        If an option is out of range.
    TypeError
        If an option is not a number, or not an integer where one is required.
    """

    name = "graph"
    structure = "raystream.structures.graph.structure:GraphStructure"
    cell_counter = "steps"
    forms: ClassVar = {
        "multipass": "raystream.machines.steps.graph:steps",
        "cuda build": "raystream.cuda.builders.graph.structure:build_graph",
        "graphics": "raystream.graphics.structures.graph:shader_structure",
    }

    crossing_cost: Annotated[float, Range(1e-6, 1e6)] = 24.0
    intersection_cost: Annotated[float, Range(1e-6, 1e6)] = 1.0
    link_cost: Annotated[float, Range(0, 1e6)] = 16.0
    max_depth: Annotated[int | None, Range(0, MAX_DEPTH)] = None
    max_leaf_size: Annotated[int, Range(1, 1024)] = 4
