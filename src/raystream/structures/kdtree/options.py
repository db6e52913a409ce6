"""KdTree: the options of the kd-tree."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from raystream.core.options import Range
from raystream.structures.registry import StructureOptions, register_structure

#: Greatest depth that the builder makes and the traversal supports.
MAX_DEPTH = 64


@register_structure
@dataclass(frozen=True, kw_only=True)
class KdTree(StructureOptions):
    """A kd-tree (Foley 2005): a binary tree of axis-aligned split planes.

    Parameters
    ----------
    traversal : {"stack", "restart", "backtrack", "short-stack"}
        How a search continues after a leaf: from a stack; by a restart at the root; by
        backtracking to the ancestor that contains the rest of the ray; or from a short stack of
        four nodes, with a restart when it is empty (Horn 2007). All visit the same leaves
        in the same order.
    layout : {"compact", "foley"}
        Nodes of 8 bytes, or Foley's of 12 with pointers to both children. ``"backtrack"``
        takes another 32 bytes per split in both.
    traversal_cost, intersection_cost : float
        Costs of a traversal step and of a triangle test for the surface area heuristic, 1e-6 to
        1e6; only their ratio matters. The defaults are measured, and happen to equal Foley's.
    empty_bonus : float
        Discount, 0 to 1, on the cost of a split that cuts off empty space.
    max_depth : int, optional
        Maximum depth, up to 64 [default: 8 + 1.3 log2 of the number of triangles, as
        in pbrt, but at most 64].
    max_leaf_size : int
        Cells with at most this many triangles are not split, 1 to 1024. Leaves may have more
        where splits do not pay or `max_depth` is reached.
    overlap : {"plane", "exact", "box"}
        Which cells list a triangle: those that its box and its plane overlap; only those that the
        triangle overlaps, clipped to the cell ("perfect splits"); or all those that its box
        overlaps, as in pbrt. ``"exact"`` is for comparison with the papers: lists are shorter, but
        hits may differ from those of other structures, or be missed, where a ray grazes a
        triangle's edge.

    Raises
    ------
    ValueError
        If an option is out of range.
    TypeError
        If an option is not a number, or not an integer where one is required.
    """

    name = "kdtree"
    structure = "raystream.structures.kdtree.structure:KdTreeStructure"
    forms: ClassVar = {
        "multipass": "raystream.machines.steps.kdtree:steps",
        "cuda build": "raystream.cuda.builders.kdtree.structure:build_kdtree",
        "graphics": "raystream.graphics.structures.kdtree:shader_structure",
        "graphics multipass": "raystream.graphics.multipass.kernels.kdtree:kernels",
    }

    traversal: Literal["stack", "restart", "backtrack", "short-stack"] = "stack"
    layout: Literal["compact", "foley"] = "compact"
    traversal_cost: Annotated[float, Range(1e-6, 1e6)] = 8.0
    intersection_cost: Annotated[float, Range(1e-6, 1e6)] = 1.0
    empty_bonus: Annotated[float, Range(0, 1)] = 0.2
    max_depth: Annotated[int | None, Range(0, MAX_DEPTH)] = None
    max_leaf_size: Annotated[int, Range(1, 1024)] = 1
    overlap: Literal["plane", "exact", "box"] = "plane"


#: How a search continues after a leaf, in the order of `state.STACK` and so on.
TRAVERSALS = KdTree.choices("traversal")

#: Which cells list a triangle, in the order of `subtree.EXACT` and so on.
OVERLAPS = KdTree.choices("overlap")

#: Node layouts: 8 bytes, or Foley's 12.
LAYOUTS = KdTree.choices("layout")
