"""Triangles that rays skip, as the caller names them: by prim_id, or as hits."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.instanced_triangles import InstancedTriangles
from raystream.core.rays import as_host_array
from raystream.core.triangles import Triangles
from raystream.programs.rows import as_skips


def prim_ids_of(skipped: Any) -> Any:
    """`skip_prim_ids` as an array: the triangles of hits, or what is given."""
    return skipped.prim_id if _are_hits(skipped) else skipped


def _are_hits(skipped: Any) -> bool:
    """Whether they are the nearest hits of rays, here, in another library or on a GPU."""
    return hasattr(skipped, "prim_id") and not hasattr(skipped, "ray_splits")


def skipped_triangles(
    skipped: Any, shape: tuple[int, ...], triangles: Triangles | InstancedTriangles
) -> NDArray[np.int32]:
    """Check `skip_prim_ids` of a query of rays of a leading shape.

    Parameters
    ----------
    skipped : array_like of shape S or S + (k,), int, or Hits of shape S
    shape : tuple of int
    triangles : Triangles or InstancedTriangles

    Returns
    -------
    ndarray of shape (N, k), int32
        Triangles; -1 skips nothing. With instances, of shape (N, k, 2): prim_id and instance_id,
        -1 for all instances.

    Raises
    ------
    ValueError, TypeError
        See `programs.rows.as_skips`; or if the instances of hits are not the scene's.
    """
    prim_ids = as_skips(prim_ids_of(skipped), shape, len(triangles))
    if not isinstance(triangles, InstancedTriangles):
        return prim_ids
    pairs = np.full((*prim_ids.shape, 2), -1, np.int32)
    pairs[:, :, 0] = prim_ids
    if _are_hits(skipped):
        instance_id = as_host_array("skip_prim_ids", skipped.instance_id).reshape(prim_ids.shape)
        if instance_id.max(initial=-1) >= len(triangles.instances):
            raise ValueError("skip_prim_ids: the hits are of another scene than the tracer's")
        pairs[:, :, 1] = np.where(prim_ids < 0, -1, instance_id)
    return pairs
