"""Float64Triangles: the triangles of a scene with their vertices in float64."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.solid_parts import SolidPart
from raystream.core.spawn import side_of, size_of
from raystream.core.triangles import (
    Triangles,
    finite_bounds,
    local_frame,
    splits_of,
    usable_vertices,
)

if TYPE_CHECKING:
    from raystream.core.hits import HitColumns

#: Triangles whose temporary arrays are made at a time.
_ROWS = 1 << 18

_UNIT = 2.0**-53

#: Rounding of positions, in units of `_UNIT`: three products and sums of numbers of the triangle's
#: size, and twice the position's own; doubled as a margin, and for the normal's rounding.
_SIZE_UNITS, _REACH_UNITS = 24.0, 8.0


class Float64Triangles(Triangles):
    """Triangles with vertices in float64, and the same rounded to float32 for boxes.

    What `Triangles` has in the local frame is for boxes: `corners` are rounded to nearest, and
    `bounds` outward. Hits refer to the vertices in world space. Every finite triangle is in
    `prim_ids`: one without an area is never hit, whatever its rounded corners are.

    Attributes
    ----------
    vertices : ndarray of shape (V, 3), float64
        Of all meshes, world space; those that are not finite, or beyond `MAX_COORDINATE`, NaN.
    faces : ndarray of shape (F, 3), int64
        Rows of `vertices`.
    """

    kinds = ("float64",)
    number_type = np.float64
    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]

    @classmethod
    def of(cls, meshes: Sequence[tuple[NDArray[Any], NDArray[np.int32]]]) -> Float64Triangles:
        """Make the store of meshes.

        Parameters
        ----------
        meshes : sequence of (vertices, faces)
            As in `Triangles`.
        """
        splits = splits_of(meshes)
        vertices = np.concatenate(
            [np.zeros((0, 3)), *(np.asarray(points, np.float64) for points, _ in meshes)]
        )
        firsts = np.cumsum([0, *(len(points) for points, _ in meshes)])
        faces = np.concatenate(
            [
                np.zeros((0, 3), np.int64),
                *(f.astype(np.int64) + n for (_, f), n in zip(meshes, firsts, strict=False)),
            ]
        )
        is_usable = usable_vertices(vertices)
        vertices[~is_usable] = np.nan
        is_finite = is_usable[faces].all(axis=1)
        box = finite_bounds([(vertices, faces)], is_finite, splits)
        made = cls.__new__(cls)
        made.vertices, made.faces, made.mesh_splits = vertices, faces, splits
        made.center, made.scale = local_frame(*box)
        made._restore = made._rounded
        made._corners = made._rounded()
        made.nonfinite_count = int(np.count_nonzero(~is_finite))
        # Rounding keeps the order of numbers: the box around rounded vertices is this one, rounded.
        outward = np.array([[-np.inf], [np.inf]], np.float32)
        made._set_solid(is_finite, np.nextafter(made.to_local(np.array(box)), outward))
        return made

    def _rounded(self) -> NDArray[np.float32]:
        """`corners`, from the vertices."""
        corners = np.empty((len(self.faces), 3, 3), np.float32)
        for first in range(0, len(corners), _ROWS):
            part = self.faces[first : first + _ROWS]
            corners[first : first + _ROWS] = self.to_local(self.vertices[part])
        return corners

    def saved_arrays(self) -> dict[str, NDArray[Any]]:
        """See `Store.saved_arrays`."""
        return {"vertices": self.vertices, "faces": self.faces, "mesh_splits": self.mesh_splits}

    def planes_at(self, hits: HitColumns) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """See `Store.planes_at`: corners are in world space."""
        normals, sizes = super().planes_at(hits)
        return normals, sizes * self.scale

    @cached_property
    def exact(self) -> Triangles:
        """The same triangles with corners in float64, local frame."""
        corners: Any = self.to_local(self.vertices[self.faces], np.float64)
        solid = np.zeros(len(self), np.bool_)
        solid[self.prim_ids] = True
        frame = self.mesh_splits, self.center, self.scale
        return Triangles.from_solid(corners, *frame, solid, self.nonfinite_count, self.bounds)

    def solid_parts(self) -> list[SolidPart]:
        """The triangles in float64; see `Store`."""
        return [SolidPart(self.exact)]

    def corners_at(
        self,
        prim_id: NDArray[np.int32],
        instance_id: NDArray[np.int32],  # noqa: ARG002
    ) -> NDArray[np.float64]:
        """Corners of triangles in world space, shape (..., 3, 3), float64; NaN for -1."""
        if len(self) == 0:
            return np.full((*prim_id.shape, 3, 3), np.nan)
        corners = self.vertices[self.faces[prim_id]]
        corners[prim_id < 0] = np.nan
        return corners

    def local_corners(self, numbers: NDArray[np.integer[Any]]) -> NDArray[np.float64]:
        """See `Store.local_corners`: not rounded to float32."""
        return (super().local_corners(numbers) - self.center) * self.scale

    def points_to_world(
        self,
        points: NDArray[np.float64],
        instance_id: NDArray[np.int32],  # noqa: ARG002
    ) -> NDArray[np.float64]:
        """Points on triangles are in world space already."""
        return points

    def spawned(self, hits: HitColumns, directions: NDArray[Any]) -> NDArray[np.float64]:
        """Origins of rays that leave hits, world space; see `Hits.spawn`.

        They lie off the triangles' planes by a bound of the rounding of float64: about 2**-49 of
        the triangle's size and of the distance from the world's origin.
        """
        offset = float64_offset(self.corners_at(hits.prim_id, hits.instance_id))
        side = side_of(hits.normals, directions)
        return hits.positions + (side * offset)[..., None] * hits.normals


def float64_offset(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """How far from triangles, by corners of shape (..., 3, 3), rays that leave them start."""
    reach = np.abs(corners).max(axis=(-2, -1))
    offset: NDArray[np.float64] = _UNIT * (_SIZE_UNITS * size_of(corners) + _REACH_UNITS * reach)
    return offset
