"""Primitives: triangles, height fields and spheres of one scene, in one local frame."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.attributes import Attributes
from raystream.core.height_field import HeightField, LocalField
from raystream.core.solid_parts import SolidPart
from raystream.core.spheres import Spheres, directions_at, slopes_at
from raystream.core.store import Store
from raystream.core.triangles import MAX_TRIANGLES, Triangles, local_frame

if TYPE_CHECKING:
    from raystream.core.hits import HitColumns

#: Rays leave a sphere from this part of (its radius + its centre's largest coordinate) beside its
#: surface: 16 times the rounding of the origin to float64, and of the test.
LEAVING = 2.0**-48


class PrimitiveStore(Store):
    """Where ``prim_id`` counts the triangles of meshes, those of height fields, then spheres.

    Attributes
    ----------
    fields : tuple of HeightField
    spheres : Spheres
    first_fields : ndarray of shape (K + 1,), int64
        Field k owns the prim_ids in [first_fields[k], first_fields[k + 1]); the last number is the
        first sphere's.
    """

    spheres: Spheres
    first_fields: NDArray[np.int64]

    def sphere_rows(self, prim_id: NDArray[np.int32]) -> NDArray[np.int64]:
        """The spheres of hits, -1 for other primitives and misses."""
        first = int(self.first_fields[-1])
        return np.where(prim_id >= first, prim_id.astype(np.int64) - first, -1)

    def _on_spheres(
        self, hits: HitColumns
    ) -> tuple[NDArray[np.bool_], NDArray[np.int64], NDArray[np.float64]]:
        """Which hits are of spheres; of these the spheres, and unit vectors from their centres."""
        rows = self.sphere_rows(hits.prim_id)
        is_sphere = rows >= 0
        return is_sphere, rows[is_sphere], directions_at(hits.u[is_sphere], hits.v[is_sphere])

    def spawned(self, hits: HitColumns, directions: NDArray[Any]) -> NDArray[np.float64]:
        """Origins of rays that leave hits, world space; see `Hits.spawn`.

        A ray into a sphere does not meet the point that it leaves, but the sphere's other side.
        """
        origins = super().spawned(hits, directions)
        is_sphere, rows, normals = self._on_spheres(hits)
        ids = hits.instance_id[is_sphere]
        origins[is_sphere] = self.beside(rows, normals, directions[is_sphere], ids)
        return origins

    def beside(
        self,
        rows: NDArray[np.int64],
        normals: NDArray[np.float64],
        directions: NDArray[Any],
        instance_id: NDArray[np.int32],  # noqa: ARG002
    ) -> NDArray[np.float64]:
        """Points beside spheres, shape (N, 3), on the sides that directions point to.

        `normals` are those of the spheres themselves, also in instances; the rest is in world
        space.
        """
        return self._beside(rows, normals, directions, 0.0)

    def _beside(
        self,
        rows: NDArray[np.int64],
        normals: NDArray[np.float64],
        directions: NDArray[Any],
        far: Any,
    ) -> NDArray[np.float64]:
        """The same among the spheres; `far`: what else rays' origins are rounded at."""
        centers, radii = self.spheres.centers[rows], self.spheres.radii[rows]
        side = np.einsum("ij,ij->i", normals, directions)
        side = np.where(side >= 0.0, 1.0, -1.0)
        offset = LEAVING * (radii + np.abs(centers).max(axis=1, initial=0.0) + far)
        beside: NDArray[np.float64] = centers + (radii + side * offset)[:, None] * normals
        return beside

    def materials_at(self, prim_id: NDArray[np.int32]) -> NDArray[np.int32]:
        """Materials of hits, int32; -1 for misses."""
        materials = super().materials_at(prim_id)
        firsts = self.first_fields
        for k, field in enumerate(self.fields):
            is_here = (prim_id >= firsts[k]) & (prim_id < firsts[k + 1])
            materials[is_here] = field.material_id
        spheres = self.sphere_rows(prim_id)
        materials[spheres >= 0] = self.spheres.material_ids[spheres[spheres >= 0]]
        return materials


class Primitives(PrimitiveStore):
    """Triangles, height fields and spheres.

    ``prim_id`` counts the triangles of the meshes, then those of the height fields, then the
    spheres. Kernels give a sphere two numbers, for where a ray enters and leaves it: hits at equal
    t are ordered by them. `split_ids` converts.

    Parameters
    ----------
    triangles : Triangles
        Of the meshes, in any frame.
    fields : sequence of HeightField
    spheres : Spheres
    attributes : Attributes
        Of the meshes.

    Attributes
    ----------
    triangles : Triangles
        In the scene's local frame.
    center : ndarray of shape (3,), float64
    scale : float
    bounds : ndarray of shape (2, 3), float32
    max_coordinate : float32
        See `Triangles`; around all primitives.
    mesh_splits : ndarray of shape (M + 1,), int64
        Meshes, then one row for each height field, then one for all spheres, if there are any.
    first_fields : ndarray of shape (K + 1,), int64
        See `PrimitiveStore`.

    Raises
    ------
    ValueError
        If there are too many primitives.
    """

    has_primitives = True
    attributes: Attributes

    def __init__(
        self,
        triangles: Triangles,
        fields: Sequence[HeightField],
        spheres: Spheres,
        attributes: Attributes,
    ) -> None:
        self._given = triangles, tuple(fields), spheres, attributes
        self.fields, self.spheres, self.attributes = tuple(fields), spheres, attributes
        # Without either, that of an empty list of spheres.
        self.kinds = ("fields",) * bool(fields) + ("spheres",) * bool(len(spheres) or not fields)
        counts = np.array([len(triangles), *map(len, fields)], np.int64)
        self.first_fields = np.cumsum(counts)
        kernel_count = int(self.first_fields[-1]) + 2 * len(spheres)
        if kernel_count > MAX_TRIANGLES:
            raise ValueError(
                f"scene: {int(self.first_fields[-1]):,} triangles (including height fields) and "
                f"twice {len(spheres):,} spheres are more than {MAX_TRIANGLES:,}"
            )
        ends = [*self.first_fields[1:], *([len(self)] if len(spheres) else [])]
        self.mesh_splits = np.concatenate([triangles.mesh_splits, ends]).astype(np.int64)
        world = self._bounds(triangles)
        count = len(triangles.prim_ids) + len(spheres)
        self.is_empty = not count and all(one.is_empty for one in fields)
        self.center, self.scale = (np.zeros(3), 1.0) if self.is_empty else local_frame(*world)
        self.triangles = self._in_frame(triangles)
        bounds = (world - self.center) * self.scale
        self.bounds = bounds.astype(np.float32)
        self.max_coordinate = np.float32(np.abs(self.bounds).max())

    def _bounds(self, triangles: Triangles) -> NDArray[np.float64]:
        """The box around all primitives, world space."""
        boxes = [one.bounds for one in self.fields if not one.is_empty]
        if len(triangles.prim_ids):
            boxes.append(triangles.world_bounds)
        if len(self.spheres):
            boxes.append(self.spheres.bounds)
        if not boxes:
            return np.zeros((2, 3))
        low, high = np.min(boxes, axis=0)[0], np.max(boxes, axis=0)[1]
        return np.array([low, high])

    def _in_frame(self, triangles: Triangles) -> Triangles:
        """The triangles in the scene's frame."""
        if triangles.scale == self.scale and np.array_equal(triangles.center, self.center):
            return triangles
        world = triangles.to_world(triangles.corners)
        corners = ((world - self.center) * self.scale).astype(np.float32)
        moved = Triangles.from_local(corners, triangles.mesh_splits, self.center, self.scale)
        moved.attributes = triangles.attributes
        return moved

    def mask_parts(self) -> tuple[NDArray[np.int64], NDArray[np.uint32]]:
        """The parts are the meshes, the height fields and the spheres."""
        count = len(self.spheres)
        numbers = self.first_fields[-1] + 2 * np.arange(count)
        firsts = self.triangles.mesh_splits[:-1], self.first_fields[:-1], numbers
        return np.concatenate(firsts), np.concatenate(list(self.saved_masks().values()))

    def saved_masks(self) -> dict[str, NDArray[np.uint32]]:
        """See `Store.saved_masks`."""
        fields = np.array([one.mask for one in self.fields], np.uint32)
        return super().saved_masks() | {"fields": fields, "spheres": self.spheres.masks}

    def __len__(self) -> int:
        return int(self.first_fields[-1]) + len(self.spheres)

    @property
    def part_counts(self) -> tuple[int, int, int]:
        """See `Store.part_counts`."""
        first, last = int(self.first_fields[0]), int(self.first_fields[-1])
        return first, last - first, len(self.spheres)

    def __reduce__(self) -> tuple[Any, ...]:
        return Primitives, self._given

    @cached_property
    def local_fields(self) -> tuple[LocalField, ...]:
        """The height fields in the scene's local frame."""
        return tuple(one.local(self.center, self.scale) for one in self.fields)

    @property
    def world_bounds(self) -> NDArray[np.float64]:
        """`bounds` in world space, shape (2, 3), float64; zeros if nothing can be hit."""
        return np.zeros((2, 3)) if self.is_empty else self.to_world(self.bounds)

    @property
    def degenerate_count(self) -> int:
        """Triangles of the meshes without area."""
        return self.triangles.degenerate_count

    @property
    def nonfinite_count(self) -> int:
        """Triangles of meshes and fields with a vertex that is not finite."""
        missing = sum(one.missing_count for one in self.fields)
        return self.triangles.nonfinite_count + missing

    @property
    def byte_count(self) -> int:
        """Bytes of the arrays, without those of heights that the caller gave."""
        held = sum(one.byte_count for one in self.local_fields)
        spheres = self.spheres.centers.nbytes + self.spheres.radii.nbytes
        return self.triangles.byte_count + held + spheres

    def saved_arrays(self) -> dict[str, NDArray[Any]]:
        """See `Store.saved_arrays`: those of the triangles as they were given, and all others."""
        triangles, fields, spheres, _ = self._given
        arrays = {f"triangles.{name}": one for name, one in triangles.saved_arrays().items()}
        for k, one in enumerate(fields):
            arrays |= {f"field{k}.heights": one.heights, f"field{k}.x": one.x, f"field{k}.y": one.y}
            arrays[f"field{k}.base"] = np.array([one.base, one.material_id], np.float64)
        named = ("centers", "radii", "material_ids")
        return arrays | {f"spheres.{name}": getattr(spheres, name) for name in named}

    def solid_numbers(self) -> NDArray[np.int32]:
        """The triangles of the meshes that can be hit, increasing."""
        return self.triangles.prim_ids

    def face_numbers(self) -> NDArray[np.int32]:
        """See `Store.face_numbers`."""
        firsts, parts = self.first_fields, [self.triangles.prim_ids]
        for k, field in enumerate(self.fields):
            numbers = np.arange(len(field))
            if field.missing_count:
                corners = field.corners_of(numbers, self.local_fields[k])
                numbers = numbers[np.isfinite(corners).all(axis=(1, 2))]
            parts.append(firsts[k] + numbers)
        parts.append(np.arange(firsts[-1], len(self)))
        return np.concatenate(parts).astype(np.int32)

    def ids_of(self, numbers: NDArray[np.int32]) -> tuple[NDArray[np.int32], None]:
        """The numbers themselves: unlike kernels' they count a sphere once."""
        return numbers, None

    def object_corners(self) -> NDArray[np.float32]:
        """`Triangles.corners` of the meshes."""
        return self.triangles.corners

    def split_ids(self, numbers: NDArray[np.int32]) -> tuple[NDArray[np.int32], None]:
        """The prim_ids of kernels' numbers, see `Primitives`; -1 stays -1."""
        first = np.int32(self.first_fields[-1])
        if not len(self.spheres):
            return numbers, None
        return np.where(numbers < first, numbers, first + ((numbers - first) >> 1)), None

    @cached_property
    def _field_parts(self) -> list[SolidPart]:
        parts, first_mesh = [], len(self.triangles.mesh_splits) - 1
        for k, (field, local) in enumerate(zip(self.fields, self.local_fields, strict=True)):
            corners = field.corners_of(np.arange(len(field)), local).astype(np.float32)
            splits = np.array([0, len(field)], np.int64)
            part = Triangles.from_local(corners, splits, self.center, self.scale)
            parts.append(SolidPart(part, first_mesh + k, open_kind="a height field"))
        return parts

    def solid_parts(self) -> list[SolidPart]:
        """The triangles of the meshes and those of each height field; see `Store`."""
        return [SolidPart(self.triangles), *self._field_parts]

    # Geometry of hits. Spheres have no corners: NaN. On them, u and v are where the hit is, see
    # `core.spheres.directions_at`, and normals point away from the centre.

    def corners_at(
        self,
        prim_id: NDArray[np.int32],
        instance_id: NDArray[np.int32],  # noqa: ARG002
    ) -> NDArray[np.float64]:
        """Corners of triangles, shape (..., 3, 3), float64, local frame; NaN for -1."""
        prims = prim_id.reshape(-1)
        corners = np.full((len(prims), 3, 3), np.nan)
        firsts = self.first_fields
        rows = np.flatnonzero((prims >= 0) & (prims < firsts[0]))
        if len(rows):
            corners[rows] = self.triangles.corners[prims[rows]]
        for k, (field, local) in enumerate(zip(self.fields, self.local_fields, strict=True)):
            rows = np.flatnonzero((prims >= firsts[k]) & (prims < firsts[k + 1]))
            if len(rows):
                corners[rows] = field.corners_of(prims[rows] - firsts[k], local)
        return corners.reshape(*prim_id.shape, 3, 3)

    def planes_at(self, hits: HitColumns) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """See `Store.planes_at`; a sphere's is the plane that touches it at the hit."""
        normals, sizes = super().planes_at(hits)
        is_sphere, rows, _ = self._on_spheres(hits)
        sizes[is_sphere] = 2.0 * self.spheres.radii[rows] * self.scale
        return normals, sizes

    def touching_corners(self, hits: HitColumns) -> NDArray[np.float64]:
        """See `Store.touching_corners`."""
        corners = super().touching_corners(hits)
        is_sphere, rows, normals = self._on_spheres(hits)
        u, v, radii = hits.u[is_sphere], hits.v[is_sphere], self.spheres.radii[rows, None]
        by_u, by_v = (radii * one for one in slopes_at(u, v))
        points = self.spheres.centers[rows] + radii * normals
        first = points - u[:, None] * by_u - v[:, None] * by_v
        corners[is_sphere] = np.stack([first, first + by_u, first + by_v], axis=1)
        return corners

    def local_positions(self, hits: HitColumns) -> NDArray[np.float64]:
        """Points of hits, shape (..., 3), local frame; NaN for misses."""
        positions = super().local_positions(hits)
        is_sphere, rows, normals = self._on_spheres(hits)
        centers = self.spheres.centers[rows] - self.center
        positions[is_sphere] = (centers + self.spheres.radii[rows, None] * normals) * self.scale
        return positions

    def local_normals(self, hits: HitColumns) -> NDArray[np.float64]:
        """Unit normals of hits, shape (..., 3), local frame; NaN for misses."""
        normals = super().local_normals(hits)
        is_sphere, _, normals_there = self._on_spheres(hits)
        normals[is_sphere] = normals_there
        return normals

    def flat_corners(self, hits: HitColumns) -> NDArray[np.float32]:
        """Corners of flat surfaces, shape (N, 3, 3), float32, local frame; 0 for misses.

        The triangles that are hit; for spheres, triangles in the plane that touches them at the
        hit, which is the first corner. Hits must have shape (N,).
        """
        corners = self.corners_at(hits.prim_id, hits.instance_id)
        is_sphere, _, normals = self._on_spheres(hits)
        first = self.local_positions(hits)[is_sphere]
        # As large as the coordinates: rounding then turns the plane by some 2**-22.
        size = 0.25 * np.abs(first).max(axis=1, initial=0.0)
        size = np.where(size > 0.0, size, 1.0)[:, None]
        axis = np.eye(3)[np.abs(normals).argmin(axis=1)] if len(normals) else np.zeros((0, 3))
        across = np.cross(axis, normals)
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        second, third = first + size * across, first + size * np.cross(normals, across)
        corners[is_sphere] = np.stack([first, second, third], axis=1)
        corners[hits.prim_id < 0] = 0.0
        return corners.astype(np.float32)

    def some(self, most: int) -> Triangles:
        """Some triangles near the primitives, to choose a camera by.

        Parameters
        ----------
        most : int
            How many of each kind, at most. Spheres stand as two triangles across their box.
        """
        count = int(self.first_fields[-1])
        numbers = np.arange(0, count, max(1, -(-count // most)), dtype=np.int32)
        corners = self.corners_at(numbers, numbers)
        points = [self.to_world(corners).reshape(-1, 3)]
        step = max(1, -(-2 * len(self.spheres) // most))
        centers, radii = self.spheres.centers[::step], self.spheres.radii[::step, None]
        for a, b, c in _ACROSS:
            points.append(np.stack([centers + radii * k for k in (a, b, c)], axis=1).reshape(-1, 3))
        vertices = np.concatenate(points)
        faces = np.arange(len(vertices), dtype=np.int32).reshape(-1, 3)
        return Triangles([(vertices, faces)])


#: Corners of two triangles across the unit cube.
_ACROSS = np.array(
    [[[-1, -1, -1], [1, 1, -1], [1, 1, 1]], [[1, -1, -1], [-1, 1, -1], [-1, 1, 1]]], np.float64
)
