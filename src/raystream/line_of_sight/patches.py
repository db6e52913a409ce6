"""Patches: groups of triangles and spheres, and points and directions sampled on them.

They are known by the numbers of `Store.numbers_of`: those of all instances, if there are any.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.rays import as_integers
from raystream.core.spawn import WORLD_UNIT
from raystream.core.store import Store
from raystream.line_of_sight.end_points import leaving_distance, planes_of
from raystream.line_of_sight.placed_ends import leaving_heights

#: Points keep this many times the distance at which their rays start from their triangle's edges,
#: so that rays do not start behind a neighbour at an angle of 10 degrees or more.
_CLEARANCE = 8.0

#: Singular values of transforms that keep spheres as they are differ by less, relative.
_EVEN = 2.0**-40

#: Sample numbers are multiples of 2**-24; this moves them to the middle of their intervals.
_HALF_STEP = 2.0**-25


class Patches(NamedTuple):
    """N patches of F triangles or spheres, in the scene's local frame.

    Attributes
    ----------
    ids : ndarray of shape (F,), int64
        The patch of each triangle or sphere; -1 for none.
    numbers : ndarray of shape (A,), int64
        Those with a patch and an area, patch by patch.
    splits : ndarray of shape (N + 1,), int64
        Patch i has ``numbers[splits[i]:splits[i + 1]]``.
    shares : ndarray of shape (A,), float64
        Areas of what the patch has up to this one, as shares of the patch.
    areas : ndarray of shape (N,), float64
        World units.
    normals : ndarray of shape (F, 3), float64
        Unit length, in front; NaN without an area, and for spheres.
    triangles : Store
    """

    ids: NDArray[np.int64]
    numbers: NDArray[np.int64]
    splits: NDArray[np.int64]
    shares: NDArray[np.float64]
    areas: NDArray[np.float64]
    normals: NDArray[np.float64]
    triangles: Store


def patch_ids(values: Any, triangles: Store) -> NDArray[np.int64]:
    """Read the patch of each triangle, by default its mesh or instance; see `view_factors`."""
    placed: Any = triangles
    if values is None:
        splits = triangles.mesh_splits if triangles.instances is None else placed.first_ids
        return np.repeat(np.arange(len(splits) - 1), np.diff(splits))
    # Spheres of instances have two numbers, and a patch at the first.
    size = len(triangles) if triangles.instances is None else triangles.number_count
    numbers = np.arange(size, dtype=np.int32)
    if triangles.instances is not None and triangles.has_primitives:
        numbers = numbers[triangles.numbers_of(*placed.split_ids(numbers)) == numbers]
    count, ids = len(numbers), as_integers("patches", values)
    if ids.shape != (count,):
        raise ValueError(
            f"patches: expected one for each triangle, shape ({count},), got {ids.shape}"
        )
    if count and not (ids.min() >= -1 and ids.max() < count):
        wrong = ids.min() if ids.min() < -1 else ids.max()
        raise ValueError(f"patches: expected -1 to {count - 1:,}, got {wrong}")
    found = np.full(size, -1)
    found[numbers] = ids
    return found


def make_patches(ids: NDArray[np.int64], triangles: Store) -> Patches:
    """Sort the triangles by patch, and measure them.

    Raises
    ------
    ValueError
        If a patch has no area.
    """
    numbers = np.arange(len(ids))
    prim_ids, instance_ids = triangles.ids_of(numbers.astype(np.int32))
    normals, _, areas = planes_of(triangles.local_corners(numbers))
    if triangles.instances is not None:
        normals *= triangles.instances.sides[instance_ids, None]
    rows = triangles.sphere_rows(prim_ids)
    if triangles.has_primitives:
        areas[rows >= 0] = _sphere_areas(triangles, rows, instance_ids)
    is_used = np.zeros(len(ids), bool)
    is_used[triangles.face_numbers()] = True
    is_used &= (ids >= 0) & (areas > 0.0)
    numbers = np.flatnonzero(is_used)
    numbers = numbers[np.argsort(ids[numbers], kind="stable")]
    count = int(ids.max(initial=-1)) + 1
    splits = np.searchsorted(ids[numbers], np.arange(count + 1))
    empty = np.flatnonzero(np.diff(splits) == 0)
    if len(empty):
        raise ValueError(f"patches: patch {empty[0]} has no triangle with an area")
    sums = np.cumsum(areas[numbers])
    before = np.concatenate([[0.0], sums])[splits]
    totals = np.diff(before)
    patch = ids[numbers]
    shares = (sums - before[:-1][patch]) / totals[patch]
    shares[splits[1:] - 1] = 1.0
    areas = totals / triangles.scale**2
    return Patches(ids, numbers, splits, shares, areas, normals, triangles)


def _sphere_areas(
    triangles: Any, rows: NDArray[np.int64], instance_ids: NDArray[np.int32] | None
) -> NDArray[np.float64]:
    """Areas of spheres, scene's local frame; in instances the most that they may be stretched to.

    `rows` are the spheres of some numbers, -1 of others.
    """
    is_sphere = rows >= 0
    areas = 4.0 * np.pi * (triangles.spheres.radii[rows[is_sphere]] * triangles.scale) ** 2
    if instance_ids is not None:
        areas = areas * _most_stretch(triangles)[instance_ids[is_sphere]]
    return np.asarray(areas)


def _most_stretch(triangles: Any) -> NDArray[np.float64]:
    """How much instances' transforms enlarge areas, at most."""
    sizes = np.linalg.svd(triangles.instances.transforms[:, :, :3], compute_uv=False)
    return np.asarray(sizes[:, 0] * sizes[:, 1])


def makes_ellipsoids(triangles: Store) -> bool:
    """Whether an instance may make ellipsoids of spheres."""
    if triangles.instances is None or not triangles.has_primitives:
        return False
    sizes = np.linalg.svd(triangles.instances.transforms[:, :, :3], compute_uv=False)
    return bool((sizes[:, 2] < (1.0 - _EVEN) * sizes[:, 0]).any())


class Emitter:
    """Rays from one patch.

    Parameters
    ----------
    patches : Patches
    patch : int
    two_sided : bool
        Whether half of the rays leave from the back.
    opacity : Opacity, optional
        What is cut out, see `programs.cutouts`.
    """

    def __init__(self, patches: Patches, patch: int, two_sided: bool, opacity: Any = None) -> None:
        rows = slice(patches.splits[patch], patches.splits[patch + 1])
        self._patches, self._two_sided, self._opacity = patches, two_sided, opacity
        self._numbers, self._shares = patches.numbers[rows], patches.shares[rows]
        self._lows = np.concatenate([[0.0], self._shares[:-1]])
        self._table: _TriangleTable | None = None

    def rays(self, numbers: NDArray[np.float32]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Rays from points uniform on the patch, in directions distributed by the cosine.

        Parameters
        ----------
        numbers : ndarray of shape (n, 4) or (n, 5), float32
            In [0, 1): two for the point, two for the direction; and one to choose points of
            ellipsoids by, if there are any.

        Returns
        -------
        origins, directions : ndarray of shape (n, 3), float64
            World space; unit length. NaN where the point is cut out, or not chosen.
        """
        x, y, p, q, *choice = numbers.T.astype(np.float64) + _HALF_STEP
        shares = self._shares
        chosen = np.minimum(np.searchsorted(shares, x, side="right"), len(shares) - 1)
        low = self._lows[chosen]
        width = np.maximum(shares[chosen] - low, np.finfo(float).tiny)
        x = np.clip((x - low) / width, 0.0, 1.0)  # the rest of the number, uniform again
        first, along_u, along_v, normal, tangent, inset, distance = self._triangles(chosen)
        store: Any = self._patches.triangles
        prim_ids, instance_ids = store.ids_of(self._numbers[chosen].astype(np.int32))
        rows = store.sphere_rows(prim_ids)
        is_sphere = rows >= 0
        if is_sphere.any():
            outward, along = _around(x[is_sphere], y[is_sphere])
            ids = rows[is_sphere] if instance_ids is None else instance_ids[is_sphere]
            normal[is_sphere], tangent[is_sphere], share = _stretched(store, outward, along, ids)

        root = np.sqrt(x)
        keep = 1.0 - inset
        u = 1.0 / 3.0 + (y * root - 1.0 / 3.0) * keep
        v = 1.0 / 3.0 + (root - y * root - 1.0 / 3.0) * keep
        if self._two_sided:
            is_back = q >= 0.5
            q = 2.0 * q - is_back
            normal = np.where(is_back[:, None], -normal, normal)
        origins = first + u[:, None] * along_u + v[:, None] * along_v
        origins += distance[:, None] * normal

        other = np.cross(normal, tangent)
        radius, turn = np.sqrt(p), 2.0 * np.pi * q
        directions = (radius * np.cos(turn))[:, None] * tangent
        directions += (radius * np.sin(turn))[:, None] * other
        directions += np.sqrt(1.0 - p)[:, None] * normal
        if self._opacity:
            directions[~self._opacity.at(prim_ids, u, v)] = np.nan
        origins = store.to_world(origins)
        if is_sphere.any():
            origins[is_sphere] = store.beside(rows[is_sphere], outward, normal[is_sphere], ids)
            if choice:
                is_left = np.flatnonzero(is_sphere)[choice[0][is_sphere] > share]
                directions[is_left] = np.nan
        return origins, directions

    def _triangles(self, chosen: NDArray[np.intp]) -> _TriangleTable:
        """The columns of triangles; of all only if those are fewer than the rays."""
        if self._table is None and len(self._numbers) > len(chosen):
            return _triangle_table(self._patches, self._numbers[chosen])
        if self._table is None:
            self._table = _triangle_table(self._patches, self._numbers)
        return _TriangleTable._make(column[chosen] for column in self._table)


class _TriangleTable(NamedTuple):
    """Vertex 0, edges, normals, tangents, insets of points and distances at which rays start."""

    first: NDArray[np.float64]
    along_u: NDArray[np.float64]
    along_v: NDArray[np.float64]
    normals: NDArray[np.float64]
    tangents: NDArray[np.float64]
    insets: NDArray[np.float64]
    distances: NDArray[np.float64]


def _around(
    x: NDArray[np.float64], y: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Unit vectors distributed uniformly over a sphere, and others at right angles to them."""
    # Heights are uniform (Archimedes); a sine by its factors keeps its digits near the poles.
    sine, turn = 2.0 * np.sqrt(x * (1.0 - x)), 2.0 * np.pi * y
    normals = np.stack([sine * np.cos(turn), sine * np.sin(turn), 1.0 - 2.0 * x], axis=1)
    return normals, np.stack([-np.sin(turn), np.cos(turn), np.zeros_like(turn)], axis=1)


def _stretched(
    triangles: Any,
    outward: NDArray[np.float64],
    along: NDArray[np.float64],
    instance_ids: NDArray[np.int32],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Unit normals and tangents of spheres' points in world space; and how dense points are there.

    Points that are even on spheres are even on ellipsoids if they are kept with this probability.
    """
    if triangles.instances is None:
        return outward, along, np.ones(len(outward))
    linear = triangles.instances.transforms[instance_ids, :, :3]
    normals = triangles.normals_to_world(outward, instance_ids)
    tangents = np.einsum("nij,nj->ni", linear, along)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    # What a sphere's area at the normal n becomes: |det(L) inverse(L).T n|.
    turned = np.einsum("nji,nj->ni", triangles.instances.inverses[instance_ids, :, :3], outward)
    stretch = np.abs(np.linalg.det(linear)) * np.linalg.norm(turned, axis=1)
    return normals, tangents, stretch / _most_stretch(triangles)[instance_ids]


def _triangle_table(patches: Patches, numbers: NDArray[np.int64]) -> _TriangleTable:
    triangles: Any = patches.triangles
    corners = triangles.local_corners(numbers)
    first = corners[:, 0]
    along_u, along_v = corners[:, 1] - first, corners[:, 2] - first
    normals = patches.normals[numbers]
    if triangles.instances is None:
        extents = (corners.max(axis=1) - corners.min(axis=1)).max(axis=-1)
        distance = leaving_distance(triangles, extents, np.abs(corners).max(axis=(1, 2)))
    else:
        heights = leaving_heights(triangles, numbers, normals)
        distance = (heights + WORLD_UNIT * np.abs(triangles.center).max()) * triangles.scale
    sides = corners - np.roll(corners, 1, axis=1)
    doubled = np.linalg.norm(np.cross(along_u, along_v), axis=-1)
    radius = doubled / np.linalg.norm(sides, axis=-1).sum(axis=-1)  # of the inscribed circle
    with np.errstate(divide="ignore", invalid="ignore"):
        inset = np.minimum(np.nan_to_num(_CLEARANCE * distance / radius, nan=0.5), 0.5)
    tangents = along_u / np.linalg.norm(along_u, axis=-1, keepdims=True)
    return _TriangleTable(first, along_u, along_v, normals, tangents, inset, distance)
