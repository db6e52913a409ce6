"""Store: what the kinds of geometry share, for structures and for hits."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.attributes import Attributes
from raystream.core.instances import Instances
from raystream.core.masks import ALL_BITS, MaskRuns
from raystream.core.solid_parts import SolidPart
from raystream.core.spawn import plane_offset, side_of, size_of

if TYPE_CHECKING:
    from raystream.core.hits import HitColumns


class Store:
    """The geometry of a scene: the base of `Triangles`, `InstancedTriangles` and `Primitives`.

    A subclass says what it is, and overrides what is not as with triangles in one local frame.

    Attributes
    ----------
    kinds : tuple of str
        What it is besides triangles in float32; `scene_kinds` has what these kinds support.
    number_type : type
        Of t, u, v and normals of hits.
    has_primitives : bool
        Whether there may be spheres, height fields and shapes.
    fields : tuple of HeightField
    instances : Instances or None
    world_count : int
        0 without instances in worlds.
    attributes : Attributes or None
        Of the meshes, if the geometry comes from a scene: used by hits, not by queries.
    mesh_splits : ndarray of shape (M + 1,), int64
        Mesh i owns the prim_ids in [mesh_splits[i], mesh_splits[i + 1]).
    center : ndarray of shape (3,), float64
        World position of the local origin.
    scale : float
        Local units per world unit.
    max_coordinate : float32
        Largest absolute coordinate, local frame.
    """

    kinds: tuple[str, ...] = ()
    number_type: type[np.floating[Any]] = np.float32
    has_primitives: bool = False
    fields: tuple[Any, ...] = ()
    instances: Instances | None = None
    world_count: int = 0
    attributes: Attributes | None = None
    mesh_splits: NDArray[np.int64]
    center: NDArray[np.float64]
    scale: float
    max_coordinate: np.float32

    #: Whether nothing can be hit.
    is_empty: bool

    #: Corners of triangles by prim_id and instance_id, shape (..., 3, 3), float64, in the local
    #: frame; NaN for -1, and where there is no triangle.
    corners_at: Callable[[NDArray[np.int32], NDArray[np.int32]], NDArray[np.float64]]

    def saved_arrays(self) -> dict[str, NDArray[Any]]:
        """Arrays that describe the geometry, by name: for files, and to recognise it."""
        raise NotImplementedError

    @property
    def number_count(self) -> int:
        """How many numbers `numbers_of` may give."""
        return len(self)

    def __len__(self) -> int:
        raise NotImplementedError

    @property
    def part_counts(self) -> tuple[int, int, int]:
        """How many triangles of meshes, triangles of height fields, and spheres there are."""
        return len(self), 0, 0

    # Ids, and the numbers that kernels have for them.

    def split_ids(
        self, numbers: NDArray[np.int32]
    ) -> tuple[NDArray[np.int32], NDArray[np.int32] | None]:
        """The prim_ids, and with instances the instance_ids, of kernels' numbers; -1 stays -1."""
        return numbers, None

    def numbers_of(
        self,
        prim_id: NDArray[np.int32],
        instance_id: NDArray[np.int32],  # noqa: ARG002
    ) -> NDArray[Any]:
        """A number for each triangle of each instance; of misses -1."""
        return prim_id

    def solid_numbers(self) -> NDArray[np.integer[Any]]:
        """The numbers of the meshes' triangles that can be hit, increasing."""
        raise NotImplementedError

    def face_numbers(self) -> NDArray[np.integer[Any]]:
        """The numbers of all that can be hit, increasing."""
        return self.solid_numbers()

    def ids_of(
        self, numbers: NDArray[np.int32]
    ) -> tuple[NDArray[np.int32], NDArray[np.int32] | None]:
        """The prim_ids, and with instances the instance_ids, of `numbers_of`."""
        return self.split_ids(numbers)

    def sphere_rows(self, prim_id: NDArray[np.int32]) -> NDArray[np.int64]:
        """The spheres of hits, -1 for other primitives and misses."""
        return np.full(prim_id.shape, -1)

    def is_curved(self, prim_id: NDArray[np.int32]) -> NDArray[np.bool_]:
        """Whether hits are of spheres or shapes, on which u and v are no weights of vertices."""
        return np.zeros(prim_id.shape, np.bool_)

    def materials_at(self, prim_id: NDArray[np.int32]) -> NDArray[np.int32]:
        """Materials of hits, int32; -1 for misses, 0 if they are not known."""
        materials = np.where(prim_id < 0, np.int32(-1), np.int32(0))
        known = self.attributes
        return materials if known is None else put_known(materials, known.material_ids, prim_id)

    # Masks.

    @cached_property
    def mask_runs(self) -> MaskRuns:
        """The masks of the geometry, by kernels' numbers."""
        return MaskRuns.of(*self.mask_parts())

    @cached_property
    def mesh_masks(self) -> NDArray[np.uint32]:
        """The mask of each mesh, shape (M,), uint32."""
        known, count = self.attributes, len(self.mesh_splits) - 1
        return np.full(count, ALL_BITS, np.uint32) if known is None else known.masks

    def saved_masks(self) -> dict[str, NDArray[np.uint32]]:
        """The masks of parts of each kind, for files."""
        return {"meshes": self.mesh_masks}

    def mask_parts(self) -> tuple[NDArray[np.int64], NDArray[np.uint32]]:
        """The first numbers of the parts that have a mask each, and these masks."""
        return self.mesh_splits[:-1], self.mesh_masks

    #: Whether all that is in an instance has the same mask.
    has_masks_by_instance: bool = False

    # Solids.

    #: The triangles as parts, each in one frame.
    solid_parts: Callable[[], list[SolidPart]]

    # Frames.

    def to_world(self, points: NDArray[Any]) -> NDArray[np.float64]:
        """Move local points of shape (..., 3) into world space."""
        return np.asarray(points, np.float64) / self.scale + self.center

    def points_to_world(
        self,
        points: NDArray[np.float64],
        instance_id: NDArray[np.int32],  # noqa: ARG002
    ) -> NDArray[np.float64]:
        """Move points of shape (..., 3) on triangles from the local frame to world space."""
        return self.to_world(points)

    def normals_to_world(
        self,
        normals: NDArray[np.float64],
        instance_id: NDArray[np.int32],  # noqa: ARG002
    ) -> NDArray[np.float64]:
        """Unit normals of triangles in world space."""
        return normals

    def directions_to_local(
        self,
        directions: NDArray[Any],
        instance_id: NDArray[np.int32],  # noqa: ARG002
    ) -> NDArray[Any]:
        """World directions in the local frame, of any length."""
        return directions

    def reaches_at(
        self,
        instance_id: NDArray[np.int32],  # noqa: ARG002
    ) -> tuple[Any, Any]:
        """Largest coordinates near triangles, in local units.

        Returns
        -------
        extent, far : float
            `max_coordinate`; and the length of the numbers that world positions are rounded at.
        """
        return float(self.max_coordinate), np.abs(self.center).max() * self.scale

    def world_lengths(
        self,
        lengths: Any,
        instance_id: NDArray[np.int32],  # noqa: ARG002
    ) -> Any:
        """Lengths near hits in the local frame as the most that they are in world space."""
        return np.float64(lengths) / self.scale

    # Geometry of hits.

    def planes_at(self, hits: HitColumns) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Unit normals of hits in world space, NaN without an area; sizes in the local frame."""
        corners = self.corners_at(hits.prim_id, hits.instance_id)
        return self.normals_to_world(self.local_normals(hits), hits.instance_id), size_of(corners)

    def touching_corners(self, hits: HitColumns) -> NDArray[np.float64]:
        """Corners in world space, shape (..., 3, 3), of triangles with the slopes of hits.

        Of a triangle its own; of a sphere those of one in the plane that touches it at the hit:
        at u and v, it has the sphere's point and the slopes of that by u and v. 0 for misses.
        """
        corners = self.corners_at(hits.prim_id, hits.instance_id)
        corners = self.points_to_world(corners, hits.instance_id)
        corners[hits.prim_id < 0] = 0.0
        return corners

    def local_corners(self, numbers: NDArray[np.integer[Any]]) -> NDArray[np.float64]:
        """Corners of triangles in the scene's local frame, shape (N, 3, 3); NaN without any.

        Their numbers are those of `numbers_of`.
        """
        ids = numbers.astype(np.int32)
        return self.corners_at(ids, np.zeros_like(ids))

    def local_positions(self, hits: HitColumns) -> NDArray[np.float64]:
        """Points of hits, shape (..., 3), local frame; NaN for misses."""
        corners = self.corners_at(hits.prim_id, hits.instance_id)
        u, v = hits.u[..., None].astype(np.float64), hits.v[..., None].astype(np.float64)
        first = corners[..., 0, :]
        along_u, along_v = corners[..., 1, :] - first, corners[..., 2, :] - first
        return first + u * along_u + v * along_v

    def local_normals(self, hits: HitColumns) -> NDArray[np.float64]:
        """Unit normals of hits, shape (..., 3), local frame; NaN for misses."""
        corners = self.corners_at(hits.prim_id, hits.instance_id)
        first = corners[..., 0, :]
        normal = np.cross(corners[..., 1, :] - first, corners[..., 2, :] - first)
        # Scaled before it is measured: the square of a small area would vanish.
        with np.errstate(invalid="ignore", divide="ignore"):
            normal /= np.abs(normal).max(axis=-1, keepdims=True)
            normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
        return normal

    def spawned(self, hits: HitColumns, directions: NDArray[Any]) -> NDArray[np.float64]:
        """Origins of rays that leave hits, world space; see `Hits.spawn`."""
        ids = hits.instance_id
        positions, normals = self.local_positions(hits), self.local_normals(hits)
        size = size_of(self.corners_at(hits.prim_id, ids))
        offset = plane_offset(size, np.abs(positions).max(axis=-1), self.reaches_at(ids))
        side = side_of(normals, self.directions_to_local(directions, ids))
        return self.points_to_world(positions + (side * offset)[..., None] * normals, ids)


def put_known(
    values: NDArray[Any], table: NDArray[Any], prim_id: NDArray[np.int32]
) -> NDArray[Any]:
    """Write the rows of a table by prim_id to `values`, where it has one; returns them."""
    is_known = (prim_id >= 0) & (prim_id < len(table))
    values[is_known] = table[prim_id[is_known]]
    return values
