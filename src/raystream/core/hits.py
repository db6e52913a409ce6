"""Hits and MultiHits: what the queries return."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.rays import as_real_array, broadcast
from raystream.core.store import Store, put_known


class HitColumns:
    """Columns of hits of one shape, and attributes derived from them."""

    #: Distance along the ray in direction lengths, float32. A miss has inf.
    t: NDArray[np.float32]
    #: Weight of vertex 1, float32; 0 for a miss.
    u: NDArray[np.float32]
    #: Weight of vertex 2, float32; vertex 0 has 1 - u - v. 0 for a miss.
    v: NDArray[np.float32]
    #: Triangle, counted over the whole scene, int32. A miss has -1.
    prim_id: NDArray[np.int32]

    _triangles: Store
    _instance_id: NDArray[np.int32] | None = None

    @cached_property
    def instance_id(self) -> NDArray[np.int32]:
        """Instance of the triangle, int32, of the hits' shape; a miss has -1.

        0 in a scene without instances.
        """
        if self._instance_id is not None:
            return self._instance_id
        return np.minimum(self.prim_id, 0)

    @cached_property
    def mesh_id(self) -> NDArray[np.int32]:
        """Mesh of the triangle, int32, of the hits' shape; a miss has -1."""
        mesh = np.searchsorted(self._triangles.mesh_splits, self.prim_id, side="right") - 1
        return np.where(self.prim_id < 0, -1, mesh).astype(np.int32)

    @cached_property
    def mesh_prim_id(self) -> NDArray[np.int32]:
        """Triangle, counted within its mesh, int32, of the hits' shape; a miss has -1."""
        first = self._triangles.mesh_splits[self.mesh_id]
        return np.where(self.prim_id < 0, -1, self.prim_id - first).astype(np.int32)

    @cached_property
    def face_id(self) -> NDArray[np.int32]:
        """Face of the mesh, int32, of the hits' shape; a miss has -1.

        The polygon that the triangle belongs to, in the order of the file: see `Mesh.face_ids`.
        `mesh_prim_id` where each triangle is a face, for spheres and height fields, and if the
        tracer's structure was loaded without a scene.
        """
        attributes = self._triangles.attributes
        table = None if attributes is None else attributes.face_ids
        if table is None:
            return self.mesh_prim_id
        return put_known(self.mesh_prim_id.copy(), table, self.prim_id)

    @cached_property
    def positions(self) -> NDArray[np.float64]:
        """Points on the triangles, shape (..., 3), float64, world space; a miss has NaN.

        Interpolated from the vertices, not stepped along the ray: they lie on the triangle
        however far away the ray began.
        """
        local = self._triangles.local_positions(self)
        return self._triangles.points_to_world(local, self.instance_id)

    @cached_property
    def normals(self) -> NDArray[np.floating[Any]]:
        """Unit normals of the surfaces, shape (..., 3), of the precision of t; a miss has NaN.

        Of a sphere they point away from the centre; of a triangle's plane, to the side from which
        the vertices run counter-clockwise, whichever side the ray came from. An instance that
        mirrors its object keeps the outside outside: there the vertices run clockwise, seen from
        that side.
        """
        return self._world_normals().astype(self._triangles.number_type)

    @cached_property
    def material_id(self) -> NDArray[np.int32]:
        """Material of the triangle in `Scene.materials`, int32, of the hits' shape; a miss has -1.

        0 if the tracer's structure was loaded without a scene.
        """
        return self._triangles.materials_at(self.prim_id)

    @property
    def is_on_sphere(self) -> NDArray[np.bool_]:
        """Whether each hit is one of a sphere, bool, of the hits' shape."""
        return self._triangles.sphere_rows(self.prim_id) >= 0

    @cached_property
    def texcoords(self) -> NDArray[np.float32]:
        """Texture coordinates, shape (..., 2), float32; (0, 0) is an image's lower left corner.

        Interpolated from the vertices. NaN for a miss, and for a mesh without texture coordinates.
        """
        attributes = self._triangles.attributes
        table = None if attributes is None else attributes.texcoords
        return self._interpolated(table, 2).astype(np.float32)

    @cached_property
    def shading_normals(self) -> NDArray[np.float32]:
        """Unit normals for shading, shape (..., 3), float32; a miss has NaN.

        Interpolated from the vertices' normals, on the side of `normals`: vertex normals that
        contradict the winding of the faces are flipped. Where a mesh has no vertex normals, or
        they cancel, these are `normals`. Normal and bump maps are not applied.
        """
        attributes = self._triangles.attributes
        plane = self._world_normals()
        smooth = self._interpolated(None if attributes is None else attributes.normals, 3)
        smooth = self._triangles.normals_to_world(smooth, self.instance_id)
        with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
            (x, y, z), (gx, gy, gz) = np.moveaxis(smooth, -1, 0), np.moveaxis(plane, -1, 0)
            length = np.sqrt(x * x + y * y + z * z)
            is_sound = (length > 0.0) & (length < np.inf)
            scale = 1.0 / np.where(x * gx + y * gy + z * gz < 0.0, -length, length)
            smooth = smooth * scale[..., None]
        return np.where(is_sound[..., None], smooth, plane).astype(np.float32)

    def _interpolated(self, table: NDArray[np.float32] | None, width: int) -> NDArray[np.float64]:
        """Interpolate a table of vertices, shape (..., width), float64; NaN for misses."""
        values = np.full((*self.prim_id.shape, width), np.nan)
        attributes = self._triangles.attributes
        if table is None or attributes is None:
            return values
        # Height fields and spheres have no vertices.
        is_known = (self.prim_id >= 0) & (self.prim_id < len(attributes.faces))
        vertices = attributes.faces[self.prim_id[is_known]]
        u, v = (weight[is_known].astype(np.float64)[:, None] for weight in (self.u, self.v))
        a, b, c = (table[vertices[:, k]] for k in range(3))
        values[is_known] = (1.0 - u - v) * a + u * b + v * c
        return values

    def _world_normals(self) -> NDArray[np.float64]:
        local = self._triangles.local_normals(self)
        return self._triangles.normals_to_world(local, self.instance_id)

    def spawn(self, directions: Any) -> tuple[NDArray[np.float64], NDArray[Any]]:
        """Make rays that leave the surfaces hit, without hitting the same triangles again.

        The origins lie off the hit triangles' planes, on the side to which the directions
        point, by a bound of the rounding errors (not a fixed epsilon), so no ``t_min`` is
        needed. They may lie behind *another* surface that is nearer to the hit than that bound,
        which is below 2**-20 of the scene's size.

        Parameters
        ----------
        directions : array_like that broadcasts to the hits' shape + (3,), real
            World space; need not be unit length.

        Returns
        -------
        origins : ndarray of the hits' shape + (3,), float64
            World space. NaN for misses: such a ray is INVALID and misses.
        directions : ndarray of the hits' shape + (3,), float32 or float64

        Raises
        ------
        ValueError
            If the shape of `directions` does not fit.

        Examples
        --------
        >>> import raystream as rs
        >>> tracer = rs.Tracer(rs.load("cornell"))
        >>> hits = tracer.first_hit([[278.0, 273.0, -800.0]], [[0.0, 0.0, 1.0]])
        >>> back = tracer.first_hit(*hits.spawn([0.0, 0.0, -1.0]))
        >>> bool(back.prim_id[0] == hits.prim_id[0])
        False
        """
        array = as_real_array("directions", directions)
        array = broadcast("directions", array, (*self.prim_id.shape, 3), "the hits'")
        return self._triangles.spawned(self, array), array


class Hits(HitColumns):
    """The nearest hit of each ray, in the rays' leading shape S.

    Attributes
    ----------
    t, u, v : ndarray of shape S, float32
        Distance in direction lengths (a miss has inf), and the weights of vertices 1 and 2
        (a miss has 0).
    prim_id : ndarray of shape S, int32
        Triangle, counted over the whole scene; a miss has -1.
    status : ndarray of shape S, uint8
        A `RayStatus` for each ray.
    sectors : ndarray of shape S, int32, or None
        With ``structure="graph"`` on the CPU's branching machine, and without a filter: the number
        of the sector that contains the hit; a miss has -1. To be passed as `near` with rays that
        leave the hits.
    """

    def __init__(
        self,
        t: NDArray[np.float32],
        u: NDArray[np.float32],
        v: NDArray[np.float32],
        prim_id: NDArray[np.int32],
        status: NDArray[np.uint8],
        triangles: Store,
        sectors: NDArray[np.int32] | None = None,
        instance_id: NDArray[np.int32] | None = None,
    ) -> None:
        self.t, self.u, self.v, self.prim_id, self.status = t, u, v, prim_id, status
        self.sectors = sectors
        self._triangles, self._instance_id = triangles, instance_id

    def __getitem__(self, index: Any) -> Hits:
        """Pick rays, with any index that NumPy takes for the leading shape."""
        return self._changed(lambda column: np.asarray(column[index]))

    def ravel(self) -> Hits:
        """The same hits in shape (N,)."""
        return self._changed(np.ravel)

    def _changed(self, change: Callable[[NDArray[Any]], NDArray[Any]]) -> Hits:
        """The hits with changed columns: of other rays, or in another shape."""
        held = self.t, self.u, self.v, self.prim_id, self.status, self.sectors, self._instance_id
        columns: list[Any] = [None if one is None else change(one) for one in held]
        t, u, v, prim_id, status, sectors, instance_id = columns
        return Hits(t, u, v, prim_id, status, self._triangles, sectors, instance_id)

    @property
    def is_hit(self) -> NDArray[np.bool_]:
        """Whether each ray hit anything, shape S, bool."""
        return self.prim_id >= 0

    def __repr__(self) -> str:
        hit_count = int(np.count_nonzero(self.is_hit))
        return f"Hits(shape={self.t.shape}, {hit_count:,} of {self.t.size:,} rays hit)"


class RayRows:
    """Rows of any number per ray, delimited by `ray_splits`."""

    ray_splits: NDArray[np.int64]
    status: NDArray[np.uint8]

    @property
    def counts(self) -> NDArray[np.int64]:
        """Number of rows of each ray, in the rays' leading shape, int64."""
        return np.diff(self.ray_splits).reshape(self.status.shape)

    @cached_property
    def ray_id(self) -> NDArray[np.int64]:
        """Ray of each row, shape (K,), int64."""
        return np.repeat(np.arange(len(self.ray_splits) - 1), np.diff(self.ray_splits))


class MultiHits(RayRows, HitColumns):
    """All hits of each ray, by increasing distance, as rows delimited by `ray_splits`.

    Attributes
    ----------
    ray_splits : ndarray of shape (N + 1,), int64
        Ray i owns the rows ray_splits[i] to ray_splits[i + 1] of the other arrays; rays are
        numbered in the C order of their leading shape.
    t, u, v : ndarray of shape (K,), float32
        Distances in direction lengths, increasing within a ray; weights of vertices 1, 2.
    prim_id : ndarray of shape (K,), int32
        Triangles, counted over the whole scene; increasing within a ray where t is equal
        (before it was rounded to float32).
    status : ndarray of shape S, uint8
        A `RayStatus` for each ray, in the rays' leading shape.
    """

    def __init__(
        self,
        ray_splits: NDArray[np.int64],
        t: NDArray[np.float32],
        u: NDArray[np.float32],
        v: NDArray[np.float32],
        prim_id: NDArray[np.int32],
        status: NDArray[np.uint8],
        triangles: Store,
        instance_id: NDArray[np.int32] | None = None,
    ) -> None:
        self.ray_splits = ray_splits
        self.t, self.u, self.v, self.prim_id, self.status = t, u, v, prim_id, status
        self._triangles, self._instance_id = triangles, instance_id

    def part(self, rows: slice) -> MultiHits:
        """Some consecutive rows, as the hits of one ray without a status."""
        ids = None if self._instance_id is None else self._instance_id[rows]
        columns = self.t[rows], self.u[rows], self.v[rows], self.prim_id[rows]
        splits = np.array([0, len(columns[0])])
        return MultiHits(splits, *columns, np.zeros(1, np.uint8), self._triangles, ids)

    def __repr__(self) -> str:
        return f"MultiHits({len(self.t):,} hits of {len(self.ray_splits) - 1:,} rays)"
