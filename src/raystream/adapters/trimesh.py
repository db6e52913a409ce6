"""trimesh's ray queries: `RayMeshIntersector`, for ``mesh.ray``."""

from __future__ import annotations

import operator
import threading
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.adapters.plane_points import plane_points
from raystream.core.rays import as_real_array
from raystream.core.triangles import local_frame
from raystream.scene.scene import Scene
from raystream.tracer import Tracer

__all__ = ["RayMeshIntersector"]

#: Directions in which crossings are counted to find out whether a point is inside; the second
#: one where the mesh is open and the first contradicts itself.
_INSIDE = np.array([[0.4395, 0.6176, 0.6522], [-0.7071, 0.3015, 0.6396]])


class _Built(NamedTuple):
    """A tracer, and the hash of the mesh that it was made of."""

    version: int
    tracer: Tracer


class RayMeshIntersector:
    """trimesh's ray queries on a mesh, answered by a `Tracer`.

    It replaces ``trimesh.ray.ray_pyembree.RayMeshIntersector`` and
    ``trimesh.ray.ray_triangle.RayMeshIntersector``, with the same methods, arguments and results.

    Parameters
    ----------
    geometry : trimesh.Trimesh
        The mesh. Changes to it are detected: see Notes.
    scale_to_box : bool
        No effect; trimesh's own intersector needs it for large and small meshes.
    mesh : trimesh.Trimesh
        Another name for `geometry`, as in ``ray_triangle``.
    **options
        Options of the `Tracer`, such as ``structure`` and ``device``.

    Attributes
    ----------
    mesh : trimesh.Trimesh

    Raises
    ------
    TypeError
        If the mesh has no vertices and faces, or is given twice.

    Notes
    -----
    Deliberate differences from trimesh:

    - `intersects_id` and `intersects_location` find all hits, however close; `max_hits` limits
      them only if it is given. Rows are ordered by ray, then by distance.
    - With ``multiple_hits=True`` a ray through an edge or a vertex has one row each time it
      passes through the surface, so that the rows of a closed mesh can be counted; a ray that
      only grazes an edge has none or two, although `intersects_any` finds it. With
      ``multiple_hits=False``, and in `intersects_first` and `intersects_any`, a ray hits all
      triangles that it touches; of the nearest, the first in ``mesh.faces``.
    - Unknown arguments are errors; ``ray_triangle`` ignores them.
    - Hits begin at distance 0, inclusive; ``ray_triangle`` also reports those up to 1e-6 behind
      the origin.

    Before each query the mesh's hash is compared with that of the previous one, as trimesh's
    caches do. If only vertices have moved, the structure is refitted (`Tracer.update`), else it is
    rebuilt. Several threads may query a mesh while it does not change.

    Copies and pickles hold the mesh and the options; the structure is built again when needed.

    Examples
    --------
    >>> import trimesh
    >>> from raystream.adapters.trimesh import RayMeshIntersector
    >>> mesh = trimesh.creation.box()
    >>> mesh.ray = RayMeshIntersector(mesh)
    >>> locations, index_ray, index_tri = mesh.ray.intersects_location([[0, 0.1, 3]], [[0, 0, -1]])
    >>> locations.tolist(), index_ray.tolist()
    ([[0.0, 0.1, 0.5], [0.0, 0.1, -0.5]], [0, 0])
    >>> mesh.contains([[0, 0, 0], [0, 0, 2]]).tolist()
    [True, False]
    """

    mesh: Any
    _built: _Built | None
    _lock: threading.Lock

    def __init__(
        self, geometry: Any = None, scale_to_box: bool = True, *, mesh: Any = None, **options: Any
    ) -> None:
        if geometry is not None and mesh is not None:
            raise TypeError("geometry, mesh: two names for one argument; give only one")
        self.mesh = mesh if geometry is None else geometry
        # Of the class: primitives have no vertices yet when trimesh makes their intersector.
        kind = type(self.mesh)
        if not (hasattr(kind, "vertices") and hasattr(kind, "faces")):
            raise TypeError(
                f"geometry: expected a trimesh.Trimesh, got {kind.__name__}; "
                "convert a trimesh.Scene with to_mesh()"
            )
        self._scale_to_box = scale_to_box
        self._options = options
        self._reset()

    def intersects_location(
        self,
        ray_origins: Any,
        ray_directions: Any,
        multiple_hits: bool = True,
        max_hits: int | None = None,
    ) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
        """Find where rays hit the mesh.

        Parameters
        ----------
        ray_origins, ray_directions : array_like of shape (n, 3), real
            World space; directions need not be of unit length.
        multiple_hits : bool
            Find all hits of each ray, rather than the nearest one.
        max_hits : int, optional
            Maximum number of hits to keep per ray, the nearest ones [default: all].

        Returns
        -------
        locations : ndarray of shape (h, 3), float64
            Points on the rays, and on the planes of the triangles.
        index_ray : ndarray of shape (h,), int64
            The ray of each hit, in increasing order.
        index_tri : ndarray of shape (h,), int64
            The hit triangle: a row of ``mesh.faces``.

        Raises
        ------
        ValueError, TypeError
            If the rays are not two arrays of the same shape (n, 3), or `max_hits` is negative.
        """
        index_tri, index_ray, locations = self.intersects_id(
            ray_origins, ray_directions, multiple_hits, max_hits, return_locations=True
        )
        return locations, index_ray, index_tri

    def intersects_id(
        self,
        ray_origins: Any,
        ray_directions: Any,
        multiple_hits: bool = True,
        max_hits: int | None = None,
        return_locations: bool = False,
    ) -> tuple[Any, ...]:
        """Find the triangles that rays hit.

        Parameters
        ----------
        ray_origins, ray_directions, multiple_hits, max_hits
            See `intersects_location`. The order of arguments is that of ``ray_pyembree``.
        return_locations : bool
            Also return the locations.

        Returns
        -------
        index_tri, index_ray : ndarray of shape (h,), int64
        locations : ndarray of shape (h, 3), float64
            Only with `return_locations`.

        Raises
        ------
        ValueError, TypeError
            See `intersects_location`.
        """
        origins, directions = _rays(ray_origins, ray_directions)
        tracer = self._tracer()
        limit = None if max_hits is None else operator.index(max_hits)
        if multiple_hits:
            found: Any = tracer.multi_hit(origins, directions, max_hits=limit, crossings="surfaces")
            index_ray = found.ray_id
        else:
            if limit is not None and limit < 0:
                raise ValueError(f"max_hits: expected None or a number >= 0, got {limit}")
            nearest = tracer.first_hit(origins, directions)
            index_ray = np.flatnonzero(nearest.is_hit & (limit != 0))
            found = nearest[index_ray]
        index_tri = found.prim_id.astype(np.int64)
        if not return_locations:
            return index_tri, index_ray
        triangles = tracer.structure.triangles
        locations = plane_points(
            np.asarray(self.mesh.vertices)[np.asarray(self.mesh.faces)[index_tri]],
            (found.u, found.v),
            (origins[index_ray], directions[index_ray]),
            float(triangles.max_coordinate) / triangles.scale,
        )
        return index_tri, index_ray, locations

    def intersects_first(self, ray_origins: Any, ray_directions: Any) -> NDArray[np.int64]:
        """Find the nearest triangle along each ray.

        Parameters
        ----------
        ray_origins, ray_directions : array_like of shape (n, 3), real

        Returns
        -------
        ndarray of shape (n,), int64
            A row of ``mesh.faces``, or -1 for a miss.

        Raises
        ------
        ValueError, TypeError
            See `intersects_location`.
        """
        return (
            self._tracer().first_hit(*_rays(ray_origins, ray_directions)).prim_id.astype(np.int64)
        )

    def intersects_any(self, ray_origins: Any, ray_directions: Any) -> NDArray[np.bool_]:
        """Find whether each ray hits the mesh.

        Parameters
        ----------
        ray_origins, ray_directions : array_like of shape (n, 3), real

        Returns
        -------
        ndarray of shape (n,), bool

        Raises
        ------
        ValueError, TypeError
            See `intersects_location`.
        """
        return self._tracer().any_hit(*_rays(ray_origins, ray_directions))

    def contains_points(self, points: Any) -> NDArray[np.bool_]:
        """Find whether points are inside the mesh, by counting crossings.

        Parameters
        ----------
        points : array_like of shape (n, 3), real

        Returns
        -------
        ndarray of shape (n,), bool
            Undefined for points on the surface. False for points that are not finite.

        Raises
        ------
        ValueError, TypeError
            If the points are not an array of shape (n, 3).

        Notes
        -----
        Exact for a closed mesh: the number of crossings is also right where the ray passes through
        an edge or a vertex. In an open mesh a point is inside if the numbers in two opposite
        directions are odd; if they disagree and neither is 0, another direction decides in the
        same way.
        """
        array = _vectors("points", points)
        inside = np.zeros(len(array), np.bool_)
        bounds = self.mesh.bounds
        if bounds is None:
            return inside
        tracer = self._tracer()
        rows = np.flatnonzero(((array >= bounds[0]) & (array <= bounds[1])).all(axis=1))
        for direction in _INSIDE:
            counts = np.stack(
                [
                    tracer.count_hits(array[rows], side * direction, crossings="surfaces")
                    for side in (1.0, -1.0)
                ]
            )
            is_odd = counts % 2 == 1
            agree = is_odd[0] == is_odd[1]
            inside[rows[agree]] = is_odd[0][agree]
            rows = rows[~agree & counts.all(axis=0)]
        return inside

    def _tracer(self) -> Tracer:
        """The tracer of the mesh as it is now."""
        with self._lock:
            version = hash(self.mesh)
            if self._built is None or self._built.version != version:
                self._built = _Built(version, self._renewed())
            return self._built.tracer

    def _renewed(self) -> Tracer:
        """The earlier tracer, refitted, if that gives what a new one would; else a new one."""
        mesh = self.mesh
        vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
        if self._built is not None and mesh.bounds is not None:
            tracer = self._built.tracer
            before = tracer.scene.meshes[0]
            if before.vertices.shape == vertices.shape and np.array_equal(before.faces, faces):
                triangles = tracer.structure.triangles
                center, scale = local_frame(*np.asarray(mesh.bounds, np.float64))
                # A mesh that has moved far away needs another centre for its float32 coordinates.
                if scale == triangles.scale and np.array_equal(center, triangles.center):
                    tracer.update(vertices)
                    return tracer
        return Tracer(Scene.from_arrays(vertices, faces), **self._options)

    def _reset(self) -> None:
        self._built = None
        self._lock = threading.Lock()

    def __getstate__(self) -> dict[str, Any]:
        return {
            name: value for name, value in vars(self).items() if name not in ("_built", "_lock")
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._reset()

    def __copy__(self) -> RayMeshIntersector:
        return RayMeshIntersector(self.mesh, self._scale_to_box, **self._options)

    def __deepcopy__(self, memo: dict[int, Any]) -> RayMeshIntersector:
        """Of the same mesh, as trimesh's are: ``mesh.copy()`` gives its copy a new one."""
        return self.__copy__()

    def __repr__(self) -> str:
        return f"RayMeshIntersector({self.mesh!r})"


def _vectors(name: str, values: Any) -> NDArray[Any]:
    array = as_real_array(name, values)
    if array.size == 0 and array.ndim < 3:
        array = array.reshape(0, 3)
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"{name}: expected shape (n, 3), got {array.shape}")
    return array


def _rays(ray_origins: Any, ray_directions: Any) -> tuple[NDArray[Any], NDArray[Any]]:
    origins, directions = (
        _vectors("ray_origins", ray_origins),
        _vectors("ray_directions", ray_directions),
    )
    if origins.shape != directions.shape:
        raise ValueError(
            f"ray_origins, ray_directions: {len(origins):,} and {len(directions):,} rays; "
            "expected the same number"
        )
    return origins, directions
