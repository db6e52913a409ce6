"""Patches: groups of triangles, and points and directions sampled on them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.rays import as_host_array
from raystream.core.triangles import Triangles
from raystream.line_of_sight.end_points import leaving_distance, planes_of

__all__ = ["Patches", "emitted_rays", "make_patches", "patch_ids"]

#: Points keep this many times the distance at which their rays start from their triangle's edges,
#: so that rays do not start behind a neighbour at an angle of 10 degrees or more.
_CLEARANCE = 8.0

#: Sample numbers are multiples of 2**-24; this moves them to the middle of their intervals.
_HALF_STEP = 2.0**-25


class Patches(NamedTuple):
    """N patches of F triangles, in the scene's local frame.

    Attributes
    ----------
    ids : ndarray of shape (F,), int64
        The patch of each triangle; -1 for none.
    prim_ids : ndarray of shape (A,), int64
        Triangles with a patch and an area, patch by patch.
    splits : ndarray of shape (N + 1,), int64
        Patch i has ``prim_ids[splits[i]:splits[i + 1]]``.
    shares : ndarray of shape (A,), float64
        Areas of the patch's triangles up to this one, as shares of the patch.
    areas : ndarray of shape (N,), float64
        World units.
    normals : ndarray of shape (F, 3), float64
        Unit length; NaN without an area.
    triangles : Triangles
    """

    ids: NDArray[np.int64]
    prim_ids: NDArray[np.int64]
    splits: NDArray[np.int64]
    shares: NDArray[np.float64]
    areas: NDArray[np.float64]
    normals: NDArray[np.float64]
    triangles: Triangles


def patch_ids(values: Any, triangles: Triangles) -> NDArray[np.int64]:
    """Read the patch of each triangle, by default its mesh; see `view_factors`."""
    count = len(triangles)
    if values is None:
        splits = triangles.mesh_splits
        return np.repeat(np.arange(len(splits) - 1), np.diff(splits))
    ids = as_host_array("patches", values)
    if ids.size == 0:
        ids = ids.astype(np.int64)
    if ids.dtype.kind not in "iu":
        raise TypeError(f"patches: expected integers, got {ids.dtype}")
    if ids.shape != (count,):
        raise ValueError(
            f"patches: expected one for each triangle, shape ({count},), got {ids.shape}"
        )
    if count and not (ids.min() >= -1 and ids.max() < count):
        wrong = ids.min() if ids.min() < -1 else ids.max()
        raise ValueError(f"patches: expected -1 to {count - 1:,}, got {wrong}")
    return ids.astype(np.int64)


def make_patches(ids: NDArray[np.int64], triangles: Triangles) -> Patches:
    """Sort the triangles by patch, and measure them.

    Raises
    ------
    ValueError
        If a patch has no area.
    """
    normals, _, areas = planes_of(triangles.corners.astype(np.float64))
    is_used = np.zeros(len(ids), bool)
    is_used[triangles.prim_ids] = True
    is_used &= (ids >= 0) & (areas > 0.0)
    prim_ids = np.flatnonzero(is_used)
    prim_ids = prim_ids[np.argsort(ids[prim_ids], kind="stable")]
    count = int(ids.max(initial=-1)) + 1
    splits = np.searchsorted(ids[prim_ids], np.arange(count + 1))
    empty = np.flatnonzero(np.diff(splits) == 0)
    if len(empty):
        raise ValueError(f"patches: patch {empty[0]} has no triangle with an area")
    sums = np.cumsum(areas[prim_ids])
    before = np.concatenate([[0.0], sums])[splits]
    totals = np.diff(before)
    patch = ids[prim_ids]
    shares = (sums - before[:-1][patch]) / totals[patch]
    shares[splits[1:] - 1] = 1.0
    areas = totals / triangles.scale**2
    return Patches(ids, prim_ids, splits, shares, areas, normals, triangles)


def emitted_rays(
    patches: Patches, patch: int, numbers: NDArray[np.float32], two_sided: bool
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rays from points uniform on a patch, in directions distributed by the cosine.

    Parameters
    ----------
    patches : Patches
    patch : int
    numbers : ndarray of shape (n, 4), float32
        In [0, 1): two for the point, two for the direction.
    two_sided : bool
        Whether half of the rays leave from the back.

    Returns
    -------
    origins, directions : ndarray of shape (n, 3), float64
        World space; unit length.
    """
    x, y, p, q = numbers.T.astype(np.float64) + _HALF_STEP
    rows = slice(patches.splits[patch], patches.splits[patch + 1])
    shares = patches.shares[rows]
    chosen = np.minimum(np.searchsorted(shares, x, side="right"), len(shares) - 1)
    low = np.concatenate([[0.0], shares[:-1]])[chosen]
    width = np.maximum(shares[chosen] - low, np.finfo(float).tiny)
    x = np.clip((x - low) / width, 0.0, 1.0)  # the rest of the number, uniform again
    prim_ids = patches.prim_ids[rows]
    if len(prim_ids) > len(x):
        table = _triangle_table(patches, prim_ids[chosen])
    else:
        table = tuple(column[chosen] for column in _triangle_table(patches, prim_ids))
    first, along_u, along_v, normal, inset, distance = table

    root = np.sqrt(x)
    keep = 1.0 - inset
    u = 1.0 / 3.0 + (y * root - 1.0 / 3.0) * keep
    v = 1.0 / 3.0 + (root - y * root - 1.0 / 3.0) * keep
    if two_sided:
        is_back = q >= 0.5
        q = 2.0 * q - is_back
        normal = np.where(is_back[:, None], -normal, normal)
    origins = first + u[:, None] * along_u + v[:, None] * along_v + distance[:, None] * normal

    tangent = along_u / np.linalg.norm(along_u, axis=-1, keepdims=True)
    other = np.cross(normal, tangent)
    radius, turn = np.sqrt(p), 2.0 * np.pi * q
    directions = (radius * np.cos(turn))[:, None] * tangent
    directions += (radius * np.sin(turn))[:, None] * other
    directions += np.sqrt(1.0 - p)[:, None] * normal
    return patches.triangles.to_world(origins), directions


def _triangle_table(
    patches: Patches, prim_ids: NDArray[np.int64]
) -> tuple[NDArray[np.float64], ...]:
    """Vertex 0, edges, normals, insets and distances at which rays start, of triangles."""
    corners = patches.triangles.corners[prim_ids].astype(np.float64)
    first = corners[:, 0]
    along_u, along_v = corners[:, 1] - first, corners[:, 2] - first
    normals = patches.normals[prim_ids]
    extents = (corners.max(axis=1) - corners.min(axis=1)).max(axis=-1)
    distance = leaving_distance(patches.triangles, extents, np.abs(corners).max(axis=(1, 2)))
    sides = corners - np.roll(corners, 1, axis=1)
    doubled = np.linalg.norm(np.cross(along_u, along_v), axis=-1)
    radius = doubled / np.linalg.norm(sides, axis=-1).sum(axis=-1)  # of the inscribed circle
    with np.errstate(divide="ignore", invalid="ignore"):
        inset = np.minimum(np.nan_to_num(_CLEARANCE * distance / radius, nan=0.5), 0.5)
    return first, along_u, along_v, normals, inset, distance
