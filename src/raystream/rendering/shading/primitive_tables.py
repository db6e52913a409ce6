"""Scene tables of the surfaces that rays hit, where some are spheres, shapes or height fields.

As for instances (`placed_tables`), the batch has tables of its own: row i is the triangle that hit
i has, or for a sphere or shape a triangle in the plane that touches it there. The kernels are the
same for all scenes.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

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
    is_curved = hits._triangles.is_curved(hits.prim_id)
    corners = hits._triangles.flat_corners(hits)
    material_ids = np.maximum(hits.material_id, 0)
    rows = np.where(hits.prim_id >= 0, np.arange(count), -1).astype(np.int32)
    u, v = (np.where(is_curved, np.float32(0.0), one) for one in (hits.u, hits.v))
    found = np.flatnonzero((hits.prim_id >= 0) & (hits.prim_id < len(meshes.faces)))
    vertices = meshes.faces[hits.prim_id[found]]

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
    )
    kept = corners, faces, normals, texcoords, colors, tangents, material_ids
    return changed, (hits.t, u, v, rows), kept
