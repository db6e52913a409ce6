"""KdTree: what others know of the kd-tree."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from raystream.core.options import Range
from raystream.structures.registry import StructureOptions, register_structure

__all__ = ["LAYOUTS", "MAX_DEPTH", "TRAVERSALS", "KdTree"]

#: Splits on the longest path that the builder makes and the traversal can take.
MAX_DEPTH = 64


@register_structure
@dataclass(frozen=True, kw_only=True)
class KdTree(StructureOptions):
    """A kd-tree (Foley 2005): every node is a box that a plane splits into two.

    Parameters
    ----------
    traversal : {"stack", "restart", "backtrack", "short-stack"}
        How a search continues after a leaf: with what it left on a stack; from the root again;
        by going up to where the rest of the ray begins; or with a stack of four nodes, and
        again from far up where that has forgotten one (Horn 2007). They visit the same leaves
        in the same order.
    layout : {"compact", "foley"}
        Nodes of 8 bytes, or Foley's of 12, with both children's pointers. ``"backtrack"``
        takes another 32 bytes for each split, in both.
    traversal_cost, intersection_cost : float
        Costs of a step at a split and of a triangle test, by which the tree is built, 1e-6 to
        1e6; only their ratio matters. The defaults are measured, and happen to be Foley's.
    empty_bonus : float
        Share, 0 to 1, of its cost by which a split is cheaper that cuts off empty space.
    max_depth : int, optional
        Most splits on a path, up to 64 [default: 8 + 1.3 log2 of the number of triangles, as
        in pbrt, but at most 64].
    max_leaf_size : int
        Cells with at most this many triangles are not split, 1 to 1024. Leaves may have more:
        where splits do not pay, or `max_depth` is reached.

    Raises
    ------
    ValueError
        If an option is out of range.
    TypeError
        If a number is no number, or no integer where one is needed.
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


#: How a search continues after a leaf, in the order of `state.STACK` and so on.
TRAVERSALS = KdTree.choices("traversal")

#: Bytes of a node: 8, or Foley's 12.
LAYOUTS = KdTree.choices("layout")
