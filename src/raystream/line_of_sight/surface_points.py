"""Points on triangles, as hits."""

from __future__ import annotations

from typing import Any

import numpy as np

from raystream.core.hits import Hits
from raystream.core.instanced_triangles import check_plain
from raystream.core.rays import as_host_array, as_real_array
from raystream.line_of_sight.end_points import check_tracer
from raystream.tracer import Tracer

__all__ = ["surface_points"]

_THIRD = 1.0 / 3.0


def surface_points(tracer: Tracer, prim_ids: Any, u: Any = _THIRD, v: Any = _THIRD) -> Hits:
    """Make points on triangles, for `visibility` and other functions that take hits.

    Parameters
    ----------
    tracer : Tracer
    prim_ids : array_like of shape S, int
        Triangles, counted over the whole scene; -1 for no point, as in a miss.
    u, v : array_like that broadcast to S, real
        Weights of vertices 1 and 2, as in `Hits` [default: the triangles' centres].

    Returns
    -------
    Hits
        With ``t = 0``, and inf where prim_id is -1.

    Raises
    ------
    ValueError
        If a triangle does not exist, a weight is not finite or outside of the triangle, or
        shapes disagree.
    TypeError
        If `prim_ids` are not integers, or weights not real numbers.

    Examples
    --------
    >>> import raystream as rs
    >>> tracer = rs.Tracer(rs.load("cornell"))
    >>> rs.surface_points(tracer, [0, 1], 0.5, 0.25).positions.shape
    (2, 3)
    """
    check_tracer(tracer)
    triangles = tracer.structure.triangles
    check_plain("surface_points", triangles)
    ids = as_host_array("prim_ids", prim_ids)
    if ids.size == 0:
        ids = ids.astype(np.int32)
    if ids.dtype.kind not in "iu":
        raise TypeError(f"prim_ids: expected integers, got {ids.dtype}")
    if ids.size and not (ids.min() >= -1 and ids.max() < len(triangles)):
        wrong = ids.min() if ids.min() < -1 else ids.max()
        raise ValueError(
            f"prim_ids: {wrong} is not a triangle; they are 0 to {len(triangles) - 1:,}, or -1"
        )
    weights = []
    for name, values in (("u", u), ("v", v)):
        array = as_real_array(name, values)
        try:
            weights.append(np.broadcast_to(array, ids.shape).astype(np.float32))
        except ValueError:
            raise ValueError(
                f"{name}: shape {array.shape} does not broadcast to that of prim_ids, {ids.shape}"
            ) from None
    is_miss = ids < 0
    for weight in weights:
        weight[is_miss] = 0.0
    both = weights[0].astype(np.float64) + weights[1]
    is_inside = (weights[0] >= 0.0) & (weights[1] >= 0.0) & (both <= 1.0 + 2.0**-22)
    if not is_inside.all():
        raise ValueError("u, v: expected weights of at least 0, with a sum of at most 1")
    t = np.where(is_miss, np.inf, 0.0).astype(np.float32)
    status = np.zeros(ids.shape, np.uint8)
    return Hits(t, weights[0], weights[1], ids.astype(np.int32), status, triangles)
