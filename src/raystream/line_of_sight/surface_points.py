"""Points on triangles, as hits."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.hits import Hits
from raystream.core.rays import as_integers, as_real_array, broadcast
from raystream.core.scene_kinds import check_support
from raystream.line_of_sight.end_points import check_tracer
from raystream.tracer import Tracer

__all__ = ["surface_points"]

_THIRD = 1.0 / 3.0


def surface_points(
    tracer: Tracer, prim_ids: Any, u: Any = _THIRD, v: Any = _THIRD, instance_ids: Any = None
) -> Hits:
    """Make points on triangles, for `visibility` and other functions that take hits.

    Parameters
    ----------
    tracer : Tracer
    prim_ids : array_like of shape S, int
        Triangles, counted over the whole scene; -1 for no point, as in a miss.
    u, v : array_like that broadcast to S, real
        Weights of vertices 1 and 2, as in `Hits` [default: the triangles' centres]; of spheres, two
        numbers from 0 to 1; of shapes, those of a hit.
    instance_ids : array_like that broadcasts to S, int, optional
        In a scene with instances: the instance that each triangle is in.

    Returns
    -------
    Hits
        With ``t = 0``, and inf where prim_id is -1.

    Raises
    ------
    ValueError
        If a triangle does not exist or is not in its instance, a weight is not finite or lies
        outside the triangle, or shapes disagree.
    TypeError
        If `prim_ids` or `instance_ids` are not integers, or weights are not real numbers.

    Examples
    --------
    >>> import raystream as rs
    >>> tracer = rs.Tracer(rs.load("cornell"))
    >>> rs.surface_points(tracer, [0, 1], 0.5, 0.25).positions.shape
    (2, 3)
    """
    check_tracer(tracer)
    triangles = tracer.structure.triangles
    check_support("surface_points", triangles)
    ids = as_integers("prim_ids", prim_ids)
    if ids.size and not (ids.min() >= -1 and ids.max() < len(triangles)):
        wrong = ids.min() if ids.min() < -1 else ids.max()
        raise ValueError(
            f"prim_ids: {wrong} is not a triangle; they are 0 to {len(triangles) - 1:,}, or -1"
        )
    instances = _instances(instance_ids, ids, triangles)
    weights = []
    for name, values in (("u", u), ("v", v)):
        array = as_real_array(name, values)
        spread = broadcast(name, array, ids.shape, "that of prim_ids,")
        weights.append(spread.astype(triangles.number_type))
    is_miss = ids < 0
    for weight in weights:
        weight[is_miss] = 0.0
    both = weights[0].astype(np.float64) + weights[1]
    most = np.where(triangles.sphere_rows(ids) >= 0, 2.0, 1.0)  # of spheres, each at most 1
    is_inside = (weights[0] >= 0.0) & (weights[1] >= 0.0) & (both <= most + 2.0**-22)
    is_inside &= (weights[0] <= 1.0) & (weights[1] <= 1.0)
    is_shape = triangles.is_curved(ids) & (triangles.sphere_rows(ids) < 0)
    if is_shape.any() and (u is _THIRD or v is _THIRD):
        raise ValueError("u, v: expected those of hits, for shapes")
    is_inside |= is_shape
    if not is_inside.all():
        raise ValueError("u, v: expected weights of at least 0, with a sum of at most 1")
    t = np.where(is_miss, np.inf, 0.0).astype(triangles.number_type)
    status = np.zeros(ids.shape, np.uint8)
    prim_id = ids.astype(np.int32)
    return Hits(t, weights[0], weights[1], prim_id, status, triangles, None, instances)


def _instances(values: Any, prim_ids: NDArray[Any], triangles: Any) -> NDArray[np.int32] | None:
    """Check `instance_ids`; None in a scene without instances."""
    if triangles.instances is None:
        if values is not None:
            raise ValueError("instance_ids: expected None: the scene has no instances")
        return None
    if values is None:
        raise ValueError(
            "instance_ids: expected the instance of each triangle, in a scene with instances"
        )
    given = as_integers("instance_ids", values)
    given = broadcast("instance_ids", given, prim_ids.shape, "that of prim_ids,")
    ids = np.where(prim_ids < 0, -1, given)
    found = prim_ids >= 0
    count = len(triangles.instances)
    if found.any() and not (ids[found].min() >= 0 and ids[found].max() < count):
        raise ValueError(f"instance_ids: expected 0 to {count - 1:,}")
    is_own = triangles.are_of(prim_ids[found], ids[found])
    if not is_own.all():
        wrong = int(np.argmin(is_own))
        raise ValueError(
            f"prim_ids: triangle {prim_ids[found][wrong]} is not one of instance "
            f"{ids[found][wrong]}"
        )
    return ids.astype(np.int32)
