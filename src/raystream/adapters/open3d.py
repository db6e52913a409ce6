"""Open3D's queries: `RaycastingScene`, with NumPy arrays or Open3D's tensors."""

from __future__ import annotations

import operator
import threading
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from raystream.adapters.open3d_arrays import as_rays, hit_columns, mesh_arrays, results_like
from raystream.adapters.open3d_cameras import matrices_of_view, pinhole_rays
from raystream.adapters.open3d_points import PointMethods
from raystream.adapters.plane_points import unit_normals
from raystream.scene.mesh import Mesh
from raystream.scene.scene import Scene
from raystream.tracer import Tracer

__all__ = ["RaycastingScene"]

_PINHOLE = (
    ("intrinsic_matrix", "extrinsic_matrix", "width_px", "height_px"),
    ("fov_deg", "center", "eye", "up", "width_px", "height_px"),
)


class RaycastingScene(PointMethods):
    """Open3D's queries of rays and points, answered by a `Tracer`.

    It replaces ``open3d.t.geometry.RaycastingScene``, with the same methods, arguments and
    dictionaries. Open3D need not be installed.

    Parameters
    ----------
    nthreads : int
        No effect, here and in all methods: see `set_thread_count`.
    device : str or open3d.core.Device
        A device of `Tracer`, ``"cpu"``, ``"cuda"`` or ``"graphics"``; Open3D's ``"CPU:0"`` is
        ``"cpu"``.
    **options
        Options of the `Tracer`, such as ``structure``.

    Attributes
    ----------
    INVALID_ID : int
        Mesh number and triangle number of a ray that misses: 4294967295.

    Notes
    -----
    Rays are arrays of shape S + (6,): origins, then directions, which need not be of unit length.
    For arguments of type ``open3d.core.Tensor``, results are tensors; for any others, NumPy
    arrays, which also have the tensors' method ``numpy()``.

    Deliberate differences from Open3D:

    - Vertices and rays may be float64, and indices of any integer type. Scenes far from the origin
      are traced relative to their centre.
    - `list_intersections` is ordered by distance within each ray.
    - `count_intersections` and `list_intersections` have one intersection each time a ray passes
      through a surface, also exactly at an edge or a vertex; where it only grazes a surface, none
      or two. In `cast_rays` and `test_occlusions` a ray hits all triangles that it touches, never
      none; among equally near ones, `cast_rays` reports the first that was added.
    - All distances in [tnear, tfar] count, both ends included.
    - Distances of points are computed in float64, and inside tests count crossings correctly at
      edges and vertices, so that ``nsamples=1`` is enough for closed meshes.

    Examples
    --------
    >>> import numpy as np
    >>> from raystream.adapters.open3d import RaycastingScene
    >>> scene = RaycastingScene()
    >>> scene.add_triangles([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    0
    >>> rays = np.array([[0.25, 0.25, 2, 0, 0, -1], [5, 5, 2, 0, 0, -1]], np.float32)
    >>> found = scene.cast_rays(rays)
    >>> found["t_hit"].tolist(), found["primitive_ids"].tolist()
    ([2.0, inf], [0, 4294967295])
    """

    INVALID_ID: ClassVar[int] = 0xFFFFFFFF

    def __init__(self, nthreads: int = 0, device: Any = "cpu", **options: Any) -> None:
        operator.index(nthreads)
        name = str(device).partition(":")[0].lower()
        self._options = {"device": name if name == "cpu" else device, **options}
        self._meshes: list[Mesh] = []
        self._built: Tracer | None = None
        self._normals: NDArray[np.float32] | None = None
        self._lock = threading.Lock()

    def add_triangles(
        self, vertex_positions: Any = None, triangle_indices: Any = None, *, mesh: Any = None
    ) -> int:
        """Add a mesh.

        Parameters
        ----------
        vertex_positions : array_like or tensor of shape (V, 3), real; or a mesh
            The vertices; or an ``open3d.t.geometry.TriangleMesh`` or
            ``open3d.geometry.TriangleMesh``.
        triangle_indices : array_like or tensor of shape (F, 3), integer
            Not with a mesh.
        mesh : mesh, optional
            Another name for the first argument.

        Returns
        -------
        int
            The number of the mesh: 0 for the first.

        Raises
        ------
        ValueError, TypeError
            If the arrays' shapes, types or indices do not fit.
        """
        if mesh is not None:
            if vertex_positions is not None or triangle_indices is not None:
                raise TypeError("add_triangles: expected a mesh, or two arrays, not both")
            vertex_positions = mesh
        vertices, faces = mesh_arrays(vertex_positions, triangle_indices)
        with self._lock:
            self._meshes.append(Mesh(vertices, faces))
            self._built = None
            return len(self._meshes) - 1

    def cast_rays(self, rays: Any, nthreads: int = 0) -> dict[str, Any]:
        """Find the nearest triangle along each ray.

        Parameters
        ----------
        rays : array_like or tensor of shape S + (6,), real
        nthreads : int
            No effect.

        Returns
        -------
        dict
            - ``"t_hit"`` : shape S, float32; distance in direction lengths, inf for a miss.
            - ``"geometry_ids"`` : shape S, uint32; the mesh, or `INVALID_ID`.
            - ``"primitive_ids"`` : shape S, uint32; the triangle within its mesh, or `INVALID_ID`.
            - ``"primitive_uvs"`` : shape S + (2,), float32; weights of vertices 1 and 2, 0 for a
              miss.
            - ``"primitive_normals"`` : shape S + (3,), float32; unit normals, 0 for a miss.

        Raises
        ------
        ValueError, TypeError
            If the rays are not real numbers of shape (..., 6).
        """
        operator.index(nthreads)
        tracer = self._tracer()
        hits = tracer.first_hit(*as_rays(rays))
        columns = {"t_hit": hits.t, **hit_columns(hits, len(self._meshes))}
        columns["primitive_normals"] = self._normals_of(tracer)[hits.prim_id]
        like = results_like(rays)
        return {name: like(column) for name, column in columns.items()}

    def test_occlusions(
        self, rays: Any, tnear: float = 0.0, tfar: float = np.inf, nthreads: int = 0
    ) -> Any:
        """Find whether anything blocks each ray.

        Parameters
        ----------
        rays : array_like or tensor of shape S + (6,), real
        tnear, tfar : float
            Closed interval of distances, in direction lengths; arrays of shape S are also
            accepted.
        nthreads : int
            No effect.

        Returns
        -------
        array or tensor of shape S, bool

        Raises
        ------
        ValueError, TypeError
            If the rays are not real numbers of shape (..., 6).
        """
        operator.index(nthreads)
        seen = self._tracer().any_hit(*as_rays(rays), t_min=tnear, t_max=tfar)
        return results_like(rays)(seen)

    def count_intersections(self, rays: Any, nthreads: int = 0) -> Any:
        """Count how often each ray passes through the surfaces.

        Parameters
        ----------
        rays : array_like or tensor of shape S + (6,), real
        nthreads : int
            No effect.

        Returns
        -------
        array or tensor of shape S, int32
            Exactly at an edge or a vertex too: from outside, it is even for closed meshes. To
            count all triangles there, use ``count_hits`` of a `Tracer`.

        Raises
        ------
        ValueError, TypeError
            If the rays are not real numbers of shape (..., 6).
        """
        operator.index(nthreads)
        counts = self._tracer().count_hits(*as_rays(rays), crossings="surfaces")
        return results_like(rays)(counts.astype(np.int32))

    def list_intersections(self, rays: Any, nthreads: int = 0) -> dict[str, Any]:
        """Find all places where each ray passes through a surface; see `count_intersections`.

        Parameters
        ----------
        rays : array_like or tensor of shape S + (6,), real
        nthreads : int
            No effect.

        Returns
        -------
        dict
            N rays, numbered in C order, have K hits, by increasing distance within a ray.

            - ``"ray_splits"`` : shape (N + 1,), uint32 (int64 if K does not fit); ray i owns the
              rows ray_splits[i] to ray_splits[i + 1].
            - ``"ray_ids"`` : shape (K,), of the same type.
            - ``"t_hit"`` : shape (K,), float32.
            - ``"geometry_ids"``, ``"primitive_ids"`` : shape (K,), uint32.
            - ``"primitive_uvs"`` : shape (K, 2), float32.

        Raises
        ------
        ValueError, TypeError
            If the rays are not real numbers of shape (..., 6).
        MemoryError
            If the hits do not fit into memory.
        """
        operator.index(nthreads)
        many = self._tracer().multi_hit(*as_rays(rays), crossings="surfaces")
        like = results_like(rays)
        wide = np.uint32 if len(many.t) <= self.INVALID_ID else np.int64
        rows = {"ray_splits": many.ray_splits.astype(wide), "ray_ids": many.ray_id.astype(wide)}
        columns = rows | {"t_hit": many.t} | hit_columns(many, len(self._meshes))
        return {name: like(column) for name, column in columns.items()}

    @staticmethod
    def create_rays_pinhole(*args: Any, **kwargs: Any) -> Any:
        """Generate the rays of a pinhole camera.

        Parameters
        ----------
        intrinsic_matrix : array_like or tensor of shape (3, 3)
            In pixels; upper triangular.
        extrinsic_matrix : array_like or tensor of shape (4, 4)
            From world to camera: x to the right, y down, z forward.
        fov_deg : float
            Horizontal field of view in degrees, used with `center`, `eye` and `up` instead of the
            matrices.
        center, eye, up : array_like or tensor of shape (3,)
            The point that the camera looks at, its position, and the direction in which rows of
            pixels follow each other: as in Open3D, the first row is the lowest, and the first
            column is at the right.
        width_px, height_px : int
            Size of the image.

        Returns
        -------
        array or tensor of shape (height_px, width_px, 6), float32
            Directions have length 1 along the camera's axis, so that ``t_hit`` is the depth. A
            tensor, if the matrix or `center` is one.

        Raises
        ------
        ValueError, TypeError
            If an argument is missing or does not fit.
        """
        names = _PINHOLE[0] if _has_matrices(args, kwargs) else _PINHOLE[1]
        given = dict(zip(names, args, strict=False)) | kwargs
        if len(args) + len(kwargs) != len(names) or set(given) != set(names):
            expected = " or ".join(f"({', '.join(choice)})" for choice in _PINHOLE)
            raise TypeError(f"create_rays_pinhole: expected {expected}")
        width, height = (operator.index(given[name]) for name in names[-2:])
        if min(width, height) < 1:
            raise ValueError(f"width_px, height_px: expected at least 1, got {width}, {height}")
        like = results_like(given[names[1]])
        if names is _PINHOLE[1]:
            view = given["center"], given["eye"], given["up"]
            matrices = matrices_of_view(float(given["fov_deg"]), view, (width, height))
        else:
            matrices = given["intrinsic_matrix"], given["extrinsic_matrix"]
        return like(pinhole_rays(*matrices, width, height))

    def _tracer(self) -> Tracer:
        with self._lock:
            if self._built is None:
                self._built = Tracer(Scene(self._meshes), **self._options)
            return self._built

    def _normals_of(self, tracer: Tracer) -> NDArray[np.float32]:
        """Unit normals of all triangles, and a row of zeros, which -1 stands for."""
        with self._lock:
            if self._normals is None or len(self._normals) != len(tracer.structure.triangles) + 1:
                self._normals = unit_normals(tracer.structure.triangles.corners)
            return self._normals

    def __repr__(self) -> str:
        count = sum(len(mesh.faces) for mesh in self._meshes)
        return f"RaycastingScene({len(self._meshes):,} meshes, {count:,} triangles)"


def _has_matrices(args: tuple[Any, ...], kwargs: dict[str, Any]) -> bool:
    return "intrinsic_matrix" in kwargs or (bool(args) and np.ndim(args[0]) == 2)
