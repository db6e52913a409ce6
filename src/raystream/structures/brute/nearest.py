"""The nearest triangles of a point by brute force."""

from __future__ import annotations

import numpy as np

from raystream.jit.constants import SHIFT_32
from raystream.jit.cpu import device
from raystream.jit.simd import load
from raystream.kernels.answers import loop_of
from raystream.kernels.leaf_block import TRIANGLE_BYTES
from raystream.kernels.nearest import offer_triangle
from raystream.kernels.point_queries import PointSearch, nearest_answer

_STRIDE = np.int32(4)


@device
def offer_all(tree, frame, query, search, stack):
    """Test every triangle; see `kernels.point_queries.PointSearch` for the arguments."""
    for k in range(tree.triangle_count):
        prim_id = load(np.int32, tree.references + (k << SHIFT_32))
        place = tree.corners + np.uint64(prim_id) * TRIANGLE_BYTES
        search = offer_triangle(search, query.moved, prim_id, place, _STRIDE)
    return search


#: The search of a point.
POINT_SEARCH = PointSearch(offer_all, 8)

#: The loop over points.
find_nearest = loop_of(*nearest_answer(POINT_SEARCH))
