"""Scene tables of the surfaces that rays hit, where some are spheres, shapes or height fields.

As for instances (`placed_tables`), the batch has tables of its own: row i is the triangle that hit
i has, or for a sphere or shape a triangle in the plane that touches it there. The kernels are the
same for all scenes.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.spawn import plane_offset
from raystream.rendering.shading.tables import SceneArrays, SceneTables
from raystream.rendering.shading.textures import address_of


class MeshTables(NamedTuple):
    """Vertex attributes of the meshes; see `VertexAttributes`, None where no mesh has any.

    Attributes
    ----------
    faces : ndarray of shape (F, 3), int32
    normals, texcoords, colors, tangents, mirrored_tangents : ndarray or None
        Rows of vertices.
    """

    faces: NDArray[np.int32]
    normals: NDArray[np.float32] | None
    texcoords: NDArray[np.float32] | None
    colors: NDArray[np.float32] | None
    tangents: NDArray[np.float32] | None
    mirrored_tangents: NDArray[np.float32] | None

    @classmethod
    def of(cls, arrays: SceneArrays) -> MeshTables:
        """The attributes in a scene's tables."""
        vertices = arrays.vertices
        tangents, mirrored = (None, None) if arrays.tangents is None else arrays.tangents
        return cls(
            vertices.faces,
            vertices.normals,
            vertices.texcoords,
            vertices.colors,
            tangents,
            mirrored,
        )


_Vectors = NDArray[np.float32] | None


class _Placed(NamedTuple):
    """Hits of instances.

    Attributes
    ----------
    store : InstancedTriangles
    ids : ndarray of shape (N,), int32
        Their instances; 0 for misses.
    are_mirrored : ndarray of shape (N,), bool
    offsets : ndarray of shape (N,), float32
        See `placed_tables`.
    """

    store: Any
    ids: NDArray[np.int32]
    are_mirrored: NDArray[np.bool_]
    offsets: NDArray[np.float32]

    @classmethod
    def of(cls, store: Any, hits: Any) -> _Placed:
        """What shading needs of hits."""
        ids = np.maximum(hits.instance_id, 0)
        if not len(store.instances):
            return cls(store, ids, np.zeros(len(ids), bool), np.zeros(len(ids), np.float32))
        extent, far = store.reaches_at(ids)
        # As far as a point may be from its surface in object space, as long as it is in the scene.
        inside = plane_offset(extent, extent, (extent, far))
        offsets = store.world_lengths(inside, ids) * store.scale
        return cls(store, ids, store.are_mirrored(ids), offsets.astype(np.float32))

    def moved(
        self, normals: _Vectors, tangents: tuple[_Vectors, _Vectors]
    ) -> tuple[_Vectors, tuple[_Vectors, _Vectors]]:
        """The vectors of vertices, moved to the scene; tangents as seen from the front."""
        each = np.repeat(self.ids, 3)
        if normals is not None:
            moved = self.store.normals_to_world(normals.astype(np.float64), each)
            normals = moved.astype(np.float32)
        both = [None if one is None else self._turned(one, each) for one in tangents]
        if both[0] is not None and both[1] is not None:
            turned = np.repeat(self.are_mirrored, 3)[:, None]
            both = [np.where(turned, *two) for two in ((both[1], both[0]), (both[0], both[1]))]
        return normals, (both[0], both[1])

    def _turned(self, vectors: NDArray[np.float32], each: NDArray[np.int32]) -> NDArray[np.float32]:
        linear = self.store.instances.transforms[each, :, :3]
        moved: NDArray[np.float32] = np.einsum("kij,kj->ki", linear, vectors).astype(np.float32)
        return moved


def primitive_tables(
    tables: SceneTables, meshes: MeshTables, hits: Any
) -> tuple[SceneTables, Any, object]:
    """The tables of the surfaces of some hits; see `placed_tables`.

    Parameters
    ----------
    tables : SceneTables
        Of the scene, with the materials.
    meshes : MeshTables
    hits : Hits or MultiHits
        Of shape (N,).

    Returns
    -------
    tables : SceneTables
    columns : tuple of t, u, v, prim_id
        The hits, whose prim_id is their row in these tables; -1 for a miss.
    kept : object
        To be kept while the tables are used.
    """
    count = len(hits.t)
    store: Any = hits._triangles
    is_curved, corners = store.is_curved(hits.prim_id), store.flat_corners(hits)
    material_ids = np.maximum(hits.material_id, 0)
    rows = np.where(hits.prim_id >= 0, np.arange(count), -1).astype(np.int32)
    u, v = (np.where(is_curved, np.float32(0.0), one) for one in (hits.u, hits.v))
    found = np.flatnonzero((hits.prim_id >= 0) & (hits.prim_id < len(meshes.faces)))
    vertices = meshes.faces[hits.prim_id[found]]
    placed = None if store.instances is None else _Placed.of(store, hits)
    if placed is not None:
        # The front of a mirrored triangle stays in front: the order of its vertices is turned.
        turned = placed.are_mirrored[found]
        vertices[turned] = vertices[turned][:, [0, 2, 1]]
        u, v = (np.where(placed.are_mirrored, *two) for two in ((v, u), (u, v)))

    def spread(table: NDArray[np.float32] | None, missing: float) -> NDArray[np.float32] | None:
        """A table of the vertices of each hit's triangle."""
        if table is None:
            return None
        width = table.shape[-1]
        values = np.full((count, 3, width), missing, np.float32)
        values[found] = table[vertices]
        return values.reshape(3 * count, width)

    normals, texcoords = spread(meshes.normals, np.nan), spread(meshes.texcoords, np.nan)
    colors = spread(meshes.colors, 1.0)
    tangents = spread(meshes.tangents, np.nan), spread(meshes.mirrored_tangents, np.nan)
    if placed is not None:
        normals, tangents = placed.moved(normals, tangents)
    has_any = not all(one is None for one in (normals, texcoords, colors))
    faces = np.arange(3 * count, dtype=np.int32) if has_any else None
    changed = tables._replace(
        corners=address_of(corners),
        faces=address_of(faces),
        normals=address_of(normals),
        texcoords=address_of(texcoords),
        colors=address_of(colors),
        tangents=address_of(tangents[0]),
        mirrored_tangents=address_of(tangents[1]),
        material_ids=address_of(material_ids),
        offsets=address_of(None if placed is None else placed.offsets),
    )
    kept = corners, faces, normals, texcoords, colors, tangents, material_ids, placed
    return changed, (hits.t, u, v, rows), kept
