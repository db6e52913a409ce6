"""Triangles, height fields and spheres on the GPU: binary nodes over triangles and over spheres."""

from __future__ import annotations

import numpy as np

from raystream.cuda.bvh import binary, points, triangles
from raystream.cuda.bvh.kernels import LaidOut, with_arrays
from raystream.cuda.bvh.walk import one_tree, ray_traversal
from raystream.geometry.fields.cells import FIELD_BYTES
from raystream.geometry.primitives.nearest import trees_search
from raystream.geometry.primitives.structure import PrimitiveBvh
from raystream.geometry.primitives.traversal import search_spheres, trees_traversal
from raystream.jit.cpu import device
from raystream.kernels.search import is_full

#: Memory of a traversal: of the trees in turn, then of height fields.
stack_bytes = binary.STACK_BYTES + FIELD_BYTES


@device
def _search_leaf(tree, link, ray, search, stack):
    search = search_spheres(tree, link, ray, search, stack)
    return search, is_full(search)


_traverse_spheres = ray_traversal(one_tree(_search_leaf))

#: Search the trees of triangles, of each height field and of spheres.
traverse = device(
    trees_traversal(triangles.traverse, _traverse_spheres, np.uint64(binary.STACK_BYTES))
)

point_search = trees_search(points.walk_triangles, points.nearest_walk, points.STACK_BYTES)


def lay_out(structure: PrimitiveBvh) -> LaidOut:
    """Convert the trees; see `bvh.kernels.LAYOUTS`."""
    memory = structure.arrays
    made = binary.unfold(memory["nodes"], memory["leaves"])
    spheres = binary.unfold(memory["sphere_nodes"])
    arrays = {"nodes": made.nodes, "leaves": made.leaves, "sphere_nodes": spheres.nodes}
    return with_arrays(structure, arrays)
