"""The arrays of a scene and its structures, without what ``page/geometry.js`` computes again."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import RaystreamError
from raystream.core.triangles import Triangles
from raystream.graphics.structures import ShaderStructure
from raystream.graphics.structures.bvh import has_lost_triangles
from raystream.structures import Structure
from raystream.structures.bvh.structure import BvhStructure


def triangle_arrays(triangles: Triangles, faces: NDArray[np.int32]) -> dict[str, NDArray[Any]]:
    """Vertices in the local frame, and the triangles' indices.

    Parameters
    ----------
    triangles : Triangles
    faces : ndarray of shape (F, 3), int32
        Rows of vertices of all meshes.
    """
    vertices = np.zeros((int(faces.max(initial=-1)) + 1, 3), np.float32)
    corners = triangles.corners
    vertices[faces.reshape(-1)] = corners.reshape(-1, 3)
    if not np.array_equal(vertices[faces], corners, equal_nan=True):
        raise RaystreamError("export: triangles that share a vertex have it at different places")
    return {"vertices": vertices, "faces": faces.astype(np.int32)}


def structure_arrays(
    structure: Structure, shaders: ShaderStructure
) -> tuple[str, Mapping[str, NDArray[Any]]]:
    """A structure's arrays, and how the page makes those of its shaders.

    Returns
    -------
    how : {"bvh", "arrays"}
        For a BVH only the links of its nodes and the triangles of its leaves are kept: boxes and
        corners follow, bit for bit. Not for one with triangles that an update made unhittable.
    arrays : mapping of str to ndarray
    """
    if isinstance(structure, BvhStructure) and not has_lost_triangles(structure.tree):
        tree = structure.tree
        return "bvh", {"links": tree.children, "prim_ids": tree.prim_ids}
    names = (f"array {k}" for k in range(len(shaders.arrays)))
    return "arrays", {
        name: _words(array) for name, array in zip(names, shaders.arrays, strict=True)
    }


def _words(array: NDArray[Any]) -> NDArray[Any]:
    flat = np.ascontiguousarray(array).reshape(-1)
    return flat if flat.dtype.itemsize == 4 else flat.view(np.uint32)
