"""Primitives: triangles, height fields, spheres and shapes of a scene, in one local frame."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.attributes import Attributes
from raystream.core.height_field import HeightField, LocalField
from raystream.core.primitive_store import LEAVING, PrimitiveStore
from raystream.core.shapes import Shapes
from raystream.core.solid_parts import SolidPart
from raystream.core.spheres import Spheres, directions_at, slopes_at
from raystream.core.triangles import MAX_TRIANGLES, Triangles, local_frame

if TYPE_CHECKING:
    from raystream.core.hits import HitColumns

#: Rays leave a shape from this part of its box's longest side beside it, four times the rounding of
#: the point by u and v, and this part of its largest coordinate.
LEAVING_SHAPE, LEAVING_FAR = 2.0**-20, 2.0**-46


class _Curved(NamedTuple):
    """Hits of spheres and shapes: which ones they are; and of each of these, world space.

    Attributes
    ----------
    is_curved : ndarray of the hits' shape, bool
    bases, normals : ndarray of shape (N, 3), float64
    reaches : ndarray of shape (N,), float64
        Hits are so far from their base along their normal: of spheres, whose base is the centre.
    sizes, leaving : ndarray of shape (N,), float64
        Sizes of what is hit, and how far beside it rays that leave it start.
    """

    is_curved: NDArray[np.bool_]
    bases: NDArray[np.float64]
    normals: NDArray[np.float64]
    reaches: NDArray[np.float64]
    sizes: NDArray[np.float64]
    leaving: NDArray[np.float64]

    def positions(self, center: NDArray[np.float64]) -> NDArray[np.float64]:
        """The points, from a centre."""
        return (self.bases - center) + self.reaches[:, None] * self.normals


class Primitives(PrimitiveStore):
    """Triangles, height fields, spheres and shapes.

    ``prim_id`` counts the triangles of the meshes, then those of the height fields, then the
    spheres, then the shapes. Kernels give a sphere two numbers, for where a ray enters and leaves
    it, and a shape one for each crossing: hits at equal t are ordered by them. `split_ids`
    converts.

    Parameters
    ----------
    triangles : Triangles
        Of the meshes, in any frame.
    fields : sequence of HeightField
    spheres : Spheres
    attributes : Attributes
        Of the meshes.
    shapes : sequence of Shapes

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
        Meshes, then one row for each height field, one for all spheres, if there are any, and
        one for each of `shapes`.
    first_fields : ndarray of shape (K + 1,), int64
        See `PrimitiveStore`.
    first_shapes : ndarray of shape (K + 1,), int64
        The same of `shapes`.
    first_crossing, crossings : int
        The first number of the first shape, and the numbers that each has.

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
        shapes: Sequence[Shapes] = (),
    ) -> None:
        self._given = triangles, tuple(fields), spheres, attributes, tuple(shapes)
        self.fields, self.spheres, self.attributes = tuple(fields), spheres, attributes
        self.shapes = tuple(shapes)
        # Without any, that of an empty list of spheres.
        has_others = bool(fields or shapes)
        self.kinds = (
            *("fields",) * bool(fields),
            *("spheres",) * bool(len(spheres) or not has_others),
            *("shapes",) * bool(shapes),
            *("shapes without distance",) * any(not one.functions.has_distance for one in shapes),
        )
        counts = np.array([len(triangles), *map(len, fields)], np.int64)
        self.first_fields = np.cumsum(counts)
        self.first_shapes = np.array(self._first_shapes(), np.int64)
        self.crossings = max((one.functions.hits for one in shapes), default=1)
        self.first_crossing = int(self.first_shapes[0]) + len(spheres)
        kernel_count = self.first_crossing + self.crossings * self.shape_count
        if kernel_count > MAX_TRIANGLES:
            more = f" and {self.crossings} times {self.shape_count:,} shapes" if shapes else ""
            raise ValueError(
                f"scene: {int(self.first_fields[-1]):,} triangles (including height fields) and "
                f"twice {len(spheres):,} spheres{more} are more than {MAX_TRIANGLES:,}"
            )
        of_spheres = [int(self.first_shapes[0])] * bool(len(spheres))
        ends = [*self.first_fields[1:], *of_spheres, *self.first_shapes[1:]]
        self.mesh_splits = np.concatenate([triangles.mesh_splits, ends]).astype(np.int64)
        world = self._bounds(triangles)
        count = len(triangles.prim_ids) + len(spheres) + self.shape_count
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
        boxes += [one.bounds_of_all for one in self.shapes if len(one)]
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
        """The parts are the meshes, the height fields, the spheres, and those of `shapes`."""
        count = len(self.spheres)
        numbers = self.first_fields[-1] + 2 * np.arange(count)
        before = self.first_shapes[:-1] - self.first_shapes[0]
        of_shapes = self.first_crossing + self.crossings * before
        firsts = self.triangles.mesh_splits[:-1], self.first_fields[:-1], numbers, of_shapes
        return np.concatenate(firsts), np.concatenate(list(self.saved_masks().values()))

    def saved_masks(self) -> dict[str, NDArray[np.uint32]]:
        """See `Store.saved_masks`."""
        fields, shapes = (
            np.array([one.mask for one in given], np.uint32) for given in (self.fields, self.shapes)
        )
        held = {"fields": fields, "spheres": self.spheres.masks, "shapes": shapes}
        return super().saved_masks() | held

    def __len__(self) -> int:
        return int(self.first_shapes[-1])

    @property
    def shape_count(self) -> int:
        """How many shapes there are, of all kinds."""
        return int(self.first_shapes[-1] - self.first_shapes[0])

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
        shapes = sum(one.records.nbytes + one.bounds.nbytes for one in self.shapes)
        return self.triangles.byte_count + held + spheres + shapes

    def saved_arrays(self) -> dict[str, NDArray[Any]]:
        """See `Store.saved_arrays`: those of the triangles as they were given, and all others."""
        triangles, fields, spheres, *_ = self._given
        arrays = {f"triangles.{name}": one for name, one in triangles.saved_arrays().items()}
        for k, one in enumerate(fields):
            arrays |= {f"field{k}.heights": one.heights, f"field{k}.x": one.x, f"field{k}.y": one.y}
            arrays[f"field{k}.base"] = np.array([one.base, one.material_id], np.float64)
        for k, own in enumerate(self.shapes):
            text = own.functions.identity().encode()
            arrays[f"shapes{k}.records"] = np.frombuffer(own.records.tobytes() + text, np.uint8)
            arrays[f"shapes{k}.ids"] = own.material_ids
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
        if not len(self.spheres) and not self.shapes:
            return numbers, None
        ids = np.where(numbers < first, numbers, first + ((numbers - first) >> 1))
        if self.shapes:
            of_shapes = (numbers - self.first_crossing) // self.crossings + self.first_shapes[0]
            ids = np.where(numbers < self.first_crossing, ids, of_shapes).astype(np.int32)
        return ids, None

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

    # Geometry of hits. Spheres and shapes have no corners: NaN. On them, u and v are where the hit
    # is, see `core.spheres.directions_at` and `core.shapes`, and normals point outwards.

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

    def _curved(self, hits: HitColumns) -> _Curved:
        """The hits of spheres and shapes: where they are."""
        is_curved = self.is_curved(hits.prim_id)
        prims, u, v = hits.prim_id[is_curved], hits.u[is_curved], hits.v[is_curved]
        normals = directions_at(u, v)
        bases, (reaches, sizes, leaving) = np.zeros((len(prims), 3)), np.zeros((3, len(prims)))
        spheres = self.sphere_rows(prims)
        at = spheres >= 0
        own = spheres[at]
        bases[at], reaches[at] = self.spheres.centers[own], self.spheres.radii[own]
        sizes[at] = 2.0 * reaches[at]
        leaving[at] = LEAVING * (reaches[at] + np.abs(bases[at]).max(axis=1, initial=0.0))
        for shapes, rows, own in self.shape_rows(prims):
            bases[rows], normals[rows] = shapes.surface_at(own, u[rows], v[rows])
            boxes = shapes.bounds[own]
            sizes[rows] = (boxes[:, 1] - boxes[:, 0]).max(axis=1)
            far = np.abs(boxes).max(axis=(1, 2))
            leaving[rows] = LEAVING_SHAPE * sizes[rows] + LEAVING_FAR * far
        return _Curved(is_curved, bases, normals, reaches, sizes, leaving)

    def planes_at(self, hits: HitColumns) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """See `Store.planes_at`; of spheres and shapes, they touch them at the hit."""
        normals, sizes = super().planes_at(hits)
        found = self._curved(hits)
        sizes[found.is_curved] = found.sizes * self.scale
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
        positions, found = super().local_positions(hits), self._curved(hits)
        positions[found.is_curved] = found.positions(self.center) * self.scale
        return positions

    def local_normals(self, hits: HitColumns) -> NDArray[np.float64]:
        """Unit normals of hits, shape (..., 3), local frame; NaN for misses."""
        normals, found = super().local_normals(hits), self._curved(hits)
        normals[found.is_curved] = found.normals
        return normals

    def spawned(self, hits: HitColumns, directions: NDArray[Any]) -> NDArray[np.float64]:
        """Origins of rays that leave hits, world space; see `Hits.spawn`.

        A ray into a sphere or a shape does not meet the point that it leaves, but the other side.
        """
        origins, found = super().spawned(hits, directions), self._curved(hits)
        side = np.einsum("ij,ij->i", found.normals, directions[found.is_curved])
        side = np.where(side >= 0.0, 1.0, -1.0)
        away = (found.reaches + side * found.leaving)[:, None] * found.normals
        origins[found.is_curved] = found.bases + away
        return origins

    def flat_corners(self, hits: HitColumns) -> NDArray[np.float32]:
        """Corners of flat surfaces, shape (N, 3, 3), float32, local frame; 0 for misses.

        The triangles that are hit; for spheres and shapes, triangles in the plane that touches them
        at the hit, which is the first corner. Hits must have shape (N,).
        """
        corners = self.corners_at(hits.prim_id, hits.instance_id)
        found = self._curved(hits)
        first, normals = found.positions(self.center) * self.scale, found.normals
        # As large as the coordinates: rounding then turns the plane by some 2**-22.
        size = 0.25 * np.abs(first).max(axis=1, initial=0.0)
        size = np.where(size > 0.0, size, 1.0)[:, None]
        axis = np.eye(3)[np.abs(normals).argmin(axis=1)] if len(normals) else np.zeros((0, 3))
        across = np.cross(axis, normals)
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        second, third = first + size * across, first + size * np.cross(normals, across)
        corners[found.is_curved] = np.stack([first, second, third], axis=1)
        corners[hits.prim_id < 0] = 0.0
        return corners.astype(np.float32)

    def some(self, most: int) -> Triangles:
        """Some triangles near the primitives, to choose a camera by.

        Parameters
        ----------
        most : int
            How many of each kind, at most. Spheres and shapes stand as two triangles across their
            box.
        """
        count = int(self.first_fields[-1])
        numbers = np.arange(0, count, max(1, -(-count // most)), dtype=np.int32)
        corners = self.corners_at(numbers, numbers)
        points = [self.to_world(corners).reshape(-1, 3)]
        boxes = [(self.spheres.centers, self.spheres.radii[:, None])]
        boxes += [
            (one.bounds.mean(axis=1), 0.5 * np.ptp(one.bounds, axis=1)) for one in self.shapes
        ]
        for centers, reach in boxes:
            step = max(1, -(-2 * len(centers) // most))
            for corners in _ACROSS:
                across = [centers[::step] + reach[::step] * k for k in corners]
                points.append(np.stack(across, axis=1).reshape(-1, 3))
        vertices = np.concatenate(points)
        faces = np.arange(len(vertices), dtype=np.int32).reshape(-1, 3)
        return Triangles([(vertices, faces)])


#: Corners of two triangles across the unit cube.
_ACROSS = np.array(
    [[[-1, -1, -1], [1, 1, -1], [1, 1, 1]], [[1, -1, -1], [-1, 1, -1], [-1, 1, 1]]], np.float64
)
