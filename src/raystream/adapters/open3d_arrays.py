"""Arrays as Open3D has them: rays of six numbers, tensors, and meshes."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.hits import HitColumns
from raystream.core.rays import as_host_array, as_real_array


class TensorLike(np.ndarray[Any, Any]):
    """A NumPy array with the method `numpy` of Open3D's tensors, so that code for those works."""

    def numpy(self) -> NDArray[Any]:
        """The same array, as a plain one."""
        return self.view(np.ndarray)


def is_tensor(values: Any) -> bool:
    """Whether it is an ``open3d.core.Tensor``."""
    open3d = sys.modules.get("open3d")
    return open3d is not None and isinstance(values, open3d.core.Tensor)


def results_like(values: Any) -> Callable[[NDArray[Any]], Any]:
    """The function that turns arrays into tensors, if these values are one; else `TensorLike`."""
    if is_tensor(values):
        return _as_tensor
    return _as_tensor_like


def _as_tensor(array: NDArray[Any]) -> Any:
    return sys.modules["open3d"].core.Tensor.from_numpy(np.ascontiguousarray(array))


def _as_tensor_like(array: NDArray[Any]) -> TensorLike:
    return np.asarray(array).view(TensorLike)


def host_array(name: str, values: Any) -> NDArray[Any]:
    """A tensor or array-like object as a NumPy array."""
    return values.cpu().numpy() if is_tensor(values) else as_host_array(name, values)


def as_rays(rays: Any) -> tuple[NDArray[Any], NDArray[Any]]:
    """Origins and directions: views of the first and the last three numbers of each ray.

    Raises
    ------
    ValueError, TypeError
        If the shape is not (..., 6), or the values are not real numbers.
    """
    array = as_real_array("rays", host_array("rays", rays))
    if array.ndim == 0 or array.shape[-1] != 6:
        raise ValueError(f"rays: expected shape (..., 6), got {array.shape}")
    return array[..., :3], array[..., 3:]


def as_points(query_points: Any) -> NDArray[Any]:
    """Points of shape (..., 3).

    Raises
    ------
    ValueError, TypeError
        If the shape is another, or the values are not real numbers.
    """
    array = as_real_array("query_points", host_array("query_points", query_points))
    if array.ndim == 0 or array.shape[-1] != 3:
        raise ValueError(f"query_points: expected shape (..., 3), got {array.shape}")
    return array


def ids_of(ids: NDArray[np.int32]) -> NDArray[np.uint32]:
    """Numbers as uint32: -1, a miss, becomes ``INVALID_ID``."""
    return ids.view(np.uint32)


def mesh_arrays(positions: Any, indices: Any) -> tuple[NDArray[Any], NDArray[Any]]:
    """Vertices and faces of a mesh of Open3D, or given as two arrays.

    Raises
    ------
    TypeError
        If one of them is missing, or the first is not a mesh.
    """
    if indices is None:
        mesh = positions
        if hasattr(mesh, "vertex") and hasattr(mesh, "triangle"):
            positions, indices = mesh.vertex["positions"], mesh.triangle["indices"]
        elif hasattr(mesh, "vertices") and hasattr(mesh, "triangles"):
            positions, indices = np.asarray(mesh.vertices), np.asarray(mesh.triangles)
        else:
            raise TypeError(
                "add_triangles: expected a mesh of Open3D, or vertex_positions and "
                f"triangle_indices; got {type(mesh).__name__} alone"
            )
    return host_array("vertex_positions", positions), host_array("triangle_indices", indices)


def hit_columns(hits: HitColumns, mesh_count: int) -> dict[str, NDArray[Any]]:
    """Triangles and weights, of hits or of closest points."""
    if mesh_count == 1:
        geometry_ids, primitive_ids = np.minimum(hits.prim_id, 0), hits.prim_id
    else:
        geometry_ids, primitive_ids = hits.mesh_id, hits.mesh_prim_id
    weights = np.empty((*hits.u.shape, 2), np.float32)
    weights[..., 0], weights[..., 1] = hits.u, hits.v
    return {
        "geometry_ids": ids_of(geometry_ids),
        "primitive_ids": ids_of(primitive_ids),
        "primitive_uvs": weights,
    }
