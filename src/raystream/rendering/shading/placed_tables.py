"""Scene tables of the triangles that rays hit in instances, moved to world space.

Shading kernels read triangles and vertex attributes from tables of a whole scene, in one local
frame. A scene with instances has no such tables. So before a batch of hits is shaded, the triangle
of each is copied to where it is, with the attributes of its vertices: row i of the batch's own
tables is the triangle of hit i. The kernels are the same for all scenes.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.instanced_triangles import InstancedTriangles
from raystream.core.spawn import EXTENT_UNITS, MOST_UNITS, REACH_UNITS, UNIT, WORLD_UNIT
from raystream.jit.cpu import device, kernel
from raystream.jit.threads import parallel_for
from raystream.rendering.shading.tables import SceneArrays, SceneTables
from raystream.rendering.shading.textures import address_of

#: Hits per call of the kernel.
_CHUNK = 4096

_NO_ROWS = np.zeros((0, 3), np.float32)


class ObjectTables(NamedTuple):
    """Triangles and attributes of all objects, and where the instances have them.

    Attributes
    ----------
    corners : ndarray of shape (F, 3, 3), float32
        In each object's local frame, by prim_id.
    to_scene : ndarray of shape (K, 3, 4), float64
        From an instance's object's local frame to the scene's.
    to_normal : ndarray of shape (K, 3, 3), float32
        The same for normals, of any length.
    is_mirrored : ndarray of shape (K,), bool
    lengths : ndarray of shape (K, 3), float64
        The most by which `to_scene` stretches; and the object's largest coordinate, and the length
        of the terms that `to_scene`'s inverse adds up, both in the object's local frame.
    faces, normals, texcoords, colors : ndarray
        See `VertexAttributes`; without rows if no mesh has them.
    tangents : ndarray of shape (2, V, 3), float32
        See `vertex_tangents`; without rows if they are not needed.
    material_ids : ndarray of shape (F,), int32
    """

    corners: NDArray[np.float32]
    to_scene: NDArray[np.float64]
    to_normal: NDArray[np.float32]
    is_mirrored: NDArray[np.bool_]
    lengths: NDArray[np.float64]
    faces: NDArray[np.int32]
    normals: NDArray[np.float32]
    texcoords: NDArray[np.float32]
    colors: NDArray[np.float32]
    tangents: NDArray[np.float32]
    material_ids: NDArray[np.int32]

    @classmethod
    def of(
        cls,
        triangles: InstancedTriangles,
        tables: SceneArrays,
    ) -> ObjectTables:
        """The tables of a scene's objects, with the arrays of its `SceneTables`."""
        vertices, tangents = tables.vertices, tables.tangents
        instances, ids = triangles.instances, triangles.instances.object_ids
        centers = np.array([one.center for one in triangles.objects]).reshape(-1, 3)
        scales = np.array([float(one.scale) for one in triangles.objects])
        linear = instances.transforms[:, :, :3]
        to_scene = np.empty_like(instances.transforms)
        ratio = (triangles.scale / scales[ids])[:, None, None] if len(ids) else 1.0
        to_scene[:, :, :3] = linear * ratio
        if len(ids):
            origin = np.einsum("kij,kj->ki", linear, centers[ids]) + instances.transforms[:, :, 3]
            to_scene[:, :, 3] = (origin - triangles.center) * triangles.scale
        turned = instances.inverses[:, :, :3].swapaxes(1, 2)
        sizes = np.abs(turned).max(axis=(1, 2), keepdims=True, initial=0.0)
        none = np.zeros((0, 2), np.float32)
        return cls(
            tables.corners,
            to_scene,
            np.ascontiguousarray(turned / sizes, np.float32),
            np.linalg.det(linear / np.abs(linear).max(axis=(1, 2), keepdims=True)) < 0.0,
            _lengths(triangles, to_scene),
            vertices.faces,
            _NO_ROWS if vertices.normals is None else vertices.normals,
            none if vertices.texcoords is None else vertices.texcoords,
            _NO_ROWS if vertices.colors is None else vertices.colors,
            np.zeros((2, 0, 3), np.float32) if tangents is None else tangents,
            tables.material_ids,
        )


def _lengths(triangles: InstancedTriangles, to_scene: NDArray[np.float64]) -> NDArray[np.float64]:
    reaches = triangles.reaches_at(np.arange(len(to_scene), dtype=np.int32))
    return np.stack([np.linalg.norm(to_scene[:, :, :3], axis=(1, 2)), *reaches], axis=1)


class _Placed(NamedTuple):
    """The triangles of hits: see `ObjectTables`. Vertices of row i are rows 3 i to 3 i + 2."""

    u: NDArray[np.float32]
    v: NDArray[np.float32]
    prim_id: NDArray[np.int32]
    corners: NDArray[np.float32]
    normals: NDArray[np.float32]
    texcoords: NDArray[np.float32]
    colors: NDArray[np.float32]
    tangents: NDArray[np.float32]
    material_ids: NDArray[np.int32]
    offsets: NDArray[np.float32]

    @classmethod
    def empty(cls, count: int, objects: ObjectTables) -> _Placed:
        """Room for some hits. What misses leave is zero: kernels read it, and use it nowhere."""

        def rows(table: NDArray[Any], *shape: int) -> NDArray[np.float32]:
            return np.zeros(shape if table.size else (*shape[:-2], 0, shape[-1]), np.float32)

        return cls(
            np.zeros(count, np.float32),
            np.zeros(count, np.float32),
            np.full(count, -1, np.int32),
            np.zeros((count, 3, 3), np.float32),
            rows(objects.normals, 3 * count, 3),
            rows(objects.texcoords, 3 * count, 2),
            rows(objects.colors, 3 * count, 3),
            rows(objects.tangents, 2, 3 * count, 3),
            np.zeros(count, np.int32),
            np.zeros(count, np.float32),
        )


def placed_tables(
    tables: SceneTables, objects: ObjectTables, hits: Any
) -> tuple[SceneTables, Any, object]:
    """The tables of the triangles of some hits.

    Parameters
    ----------
    tables : SceneTables
        Of the scene, with the materials.
    objects : ObjectTables
    hits : Hits or MultiHits

    Returns
    -------
    tables : SceneTables
    columns : tuple of t, u, v, prim_id
        The hits, whose prim_id is their row in these tables; -1 for a miss.
    kept : object
        To be kept while the tables are used.
    """
    count = len(hits.t)
    placed = _Placed.empty(count, objects)
    found = hits.u, hits.v, hits.prim_id, hits.instance_id

    def place(begin: int, end: int) -> None:
        _place(begin, end, found, objects, placed)

    parallel_for(place, count, _CHUNK)
    has_attributes = max(map(len, (objects.normals, objects.texcoords, objects.colors))) > 0
    faces = np.arange(3 * count if has_attributes else 0, dtype=np.int32)
    tangents = placed.tangents
    changed = tables._replace(
        corners=address_of(placed.corners),
        faces=address_of(faces),
        normals=address_of(placed.normals),
        texcoords=address_of(placed.texcoords),
        colors=address_of(placed.colors),
        tangents=address_of(tangents[0]),
        mirrored_tangents=address_of(tangents[1]),
        material_ids=address_of(placed.material_ids),
        offsets=address_of(placed.offsets),
    )
    return changed, (hits.t, placed.u, placed.v, placed.prim_id), (placed, faces, found)


@device
def _dot(row, x, y, z):
    return row[0] * x + row[1] * y + row[2] * z


@device
def _place_vector(matrix, values, at, out, to):
    """Multiply a row of three numbers by a matrix."""
    x, y, z = values[at, 0], values[at, 1], values[at, 2]
    for axis in range(3):
        out[to, axis] = _dot(matrix[axis], x, y, z)


@device
def _offset(corners, prim, lengths):
    """The offset of rays that leave a triangle in object space, as long as it is in the scene.

    See `core.spawn`. Rays are tested in object space, where coordinates may be larger.
    """
    extent, reach = 0.0, 0.0
    for axis in range(3):
        a = np.float64(corners[prim, 0, axis])
        b = np.float64(corners[prim, 1, axis])
        c = np.float64(corners[prim, 2, axis])
        extent = max(extent, max(a, b, c) - min(a, b, c))
        reach = max(reach, abs(a), abs(b), abs(c))
    stretch, most, far = lengths[0], lengths[1], lengths[2]
    rounding = UNIT * min(EXTENT_UNITS * extent + REACH_UNITS * reach, MOST_UNITS * (most + reach))
    return np.float32(stretch * (rounding + WORLD_UNIT * far))


@kernel
def _place(begin, end, hits, objects, placed):
    """Copy the triangles of hits begin to end.

    A mirrored triangle has its second and third vertex exchanged, and their weights: its front
    stays in front. Then its texture coordinates are mirrored, if they were not.
    """
    us, vs, prim_ids, instance_ids = hits
    has_faces = len(objects.faces) > 0
    for i in range(np.uint64(begin), np.uint64(end)):
        prim, instance = prim_ids[i], instance_ids[i]
        if prim < 0:
            continue
        placed.prim_id[i] = i
        placed.material_ids[i] = objects.material_ids[prim]
        placed.offsets[i] = _offset(objects.corners, prim, objects.lengths[instance])
        matrix, is_mirrored = objects.to_scene[instance], objects.is_mirrored[instance]
        placed.u[i] = vs[i] if is_mirrored else us[i]
        placed.v[i] = us[i] if is_mirrored else vs[i]
        for k in range(3):
            corner = 3 - k if is_mirrored and k > 0 else k
            x = np.float64(objects.corners[prim, corner, 0])
            y = np.float64(objects.corners[prim, corner, 1])
            z = np.float64(objects.corners[prim, corner, 2])
            for axis in range(3):
                row = matrix[axis]
                placed.corners[i, k, axis] = np.float32(_dot(row, x, y, z) + row[3])
            if not has_faces:
                continue
            at, to = objects.faces[prim, corner], 3 * i + np.uint64(k)
            if len(objects.normals):
                _place_vector(objects.to_normal[instance], objects.normals, at, placed.normals, to)
            if len(objects.texcoords):
                placed.texcoords[to, 0] = objects.texcoords[at, 0]
                placed.texcoords[to, 1] = objects.texcoords[at, 1]
            if len(objects.colors):
                for axis in range(3):
                    placed.colors[to, axis] = objects.colors[at, axis]
            if objects.tangents.shape[1]:
                for kind in range(2):
                    source = 1 - kind if is_mirrored else kind
                    _place_vector(matrix, objects.tangents[source], at, placed.tangents[kind], to)
