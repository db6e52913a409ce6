"""Contender: the interface of every ray tracer in a benchmark."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

Query = Literal["first", "any", "multi", "closest"]

#: Packages report a miss as infinity, float32's maximum or 1e37; no scene is this large.
MISS_T = 1e30


class UnavailableError(Exception):
    """A contender is not available; the message says why, and what to do."""


#: What is reported of a contender that has no instances, in a scene of them.
NO_INSTANCES = "no instances"


class Placed(NamedTuple):
    """The instances of a scene.

    Parameters
    ----------
    vertex_splits, face_splits : ndarray of shape (O + 1,), int64
        Object i has the vertices and faces from splits[i] to splits[i + 1]; its faces count from
        its own first vertex.
    object_ids : ndarray of shape (K,), int32
    transforms : ndarray of shape (K, 3, 4), float64
        Object to world space.
    """

    vertex_splits: NDArray[np.int64]
    face_splits: NDArray[np.int64]
    object_ids: NDArray[np.int32]
    transforms: NDArray[np.float64]


class Geometry(NamedTuple):
    """A scene's triangles, in a user's arrays.

    Parameters
    ----------
    vertices : ndarray of shape (V, 3), float32
    faces : ndarray of shape (F, 3), int32
    placed : Placed, optional
        Where the triangles are; None for once, in world space.
    """

    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]
    placed: Placed | None = None

    @property
    def triangle_count(self) -> int:
        """Triangles, in all instances."""
        if self.placed is None:
            return len(self.faces)
        return int(np.diff(self.placed.face_splits)[self.placed.object_ids].sum())

    def objects(self) -> Iterator[tuple[NDArray[np.float32], NDArray[np.int32]]]:
        """The vertices and faces of each object."""
        if self.placed is None:
            yield self.vertices, self.faces
            return
        splits = zip(
            pairwise(self.placed.vertex_splits), pairwise(self.placed.face_splits), strict=True
        )
        for (first, end), (first_face, end_face) in splits:
            yield self.vertices[first:end], self.faces[first_face:end_face]


def warmup_geometry() -> Geometry:
    """Generate triangles for a first build, which triggers the loading and compiling."""
    count = 20_000
    generator = np.random.default_rng(0)
    corners = generator.random((count, 1, 3)) + 0.01 * generator.normal(size=(count, 3, 3))
    faces = np.arange(3 * count, dtype=np.int32).reshape(-1, 3)
    return Geometry(corners.reshape(-1, 3).astype(np.float32), faces)


class Rays(NamedTuple):
    """Rays, in a user's plain C-contiguous NumPy arrays.

    Parameters
    ----------
    origins, directions : ndarray of shape S + (3,), float32
        World space; directions need not be unit length.
    t_max : float
        End of all rays, in direction lengths.
    """

    origins: NDArray[np.float32]
    directions: NDArray[np.float32]
    t_max: float

    def __len__(self) -> int:
        """Number of rays."""
        return self.origins.size // 3

    def rows(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return origins and directions of shape (N, 3), not copied."""
        return self.origins.reshape(-1, 3), self.directions.reshape(-1, 3)


class Points(NamedTuple):
    """Points, in a user's plain C-contiguous NumPy array.

    Parameters
    ----------
    points : ndarray of shape (N, 3), float32
        World space.
    unit : float
        Length in whose units distances are compared: the scene's diagonal.
    """

    points: NDArray[np.float32]
    unit: float

    def __len__(self) -> int:
        """Number of points."""
        return len(self.points)


class FirstHits(NamedTuple):
    """The nearest hit of each ray.

    Parameters
    ----------
    t : ndarray of N floats
        `MISS_T` or more for a miss.
    prim_id : ndarray of N ints
        Undefined for a miss.
    """

    t: NDArray[Any]
    prim_id: NDArray[Any]


class AllHits(NamedTuple):
    """All hits, by increasing t within each ray; as `MultiHits`."""

    ray_splits: NDArray[Any]
    t: NDArray[Any]
    prim_id: NDArray[Any]


class Closest(NamedTuple):
    """The nearest point of the triangles to each point.

    Parameters
    ----------
    distance : array_like of N floats or None
        World units. None if the package returns positions only: the distances that are compared
        follow from them, outside of the time.
    positions : ndarray of shape (N, 3) or None
    """

    distance: Any
    positions: NDArray[Any] | None = None


Result = FirstHits | AllHits | Closest | NDArray[np.bool_]


class Contender(ABC):
    """A ray tracer with one built structure.

    Every call starts from the user's arrays and ends with NumPy arrays: conversions that a
    package needs, such as to tensors of its own, happen within the call and count as time.

    Parameters
    ----------
    threads : int
        Number of threads to use, if the package has such a setting.
    options : mapping
        Options of the package.

    Attributes
    ----------
    modes : tuple of str
        Ways to run a query, all timed; the fastest counts.
    queries : frozenset of str
        Supported queries, each with its method.
    version : str
        The package's version.
    notes : str
        A note for readers of its figures.
    has_instances : bool
        Whether it builds scenes of instances.
    is_watertight : bool
        Whether its documentation says that no ray passes between two triangles at their edge.
    """

    modes: ClassVar[tuple[str, ...]] = ("",)
    queries: frozenset[Query] = frozenset(("first", "any", "multi"))
    notes: ClassVar[str] = ""
    has_instances: ClassVar[bool] = False
    is_watertight: bool = False
    version: str

    #: The package's structure; None before `build` and after `release`.
    _built: Any = None

    @abstractmethod
    def __init__(self, threads: int, options: Mapping[str, Any]) -> None:
        """Import the package."""

    @abstractmethod
    def build(self, geometry: Geometry) -> None:
        """Build the structure, replacing the previous one."""

    def release(self) -> None:
        """Free the structure."""
        self._built = None

    def first_hit(self, rays: Rays, mode: str) -> FirstHits:
        """Find the nearest hit of each ray."""
        raise NotImplementedError

    def any_hit(self, rays: Rays, mode: str) -> NDArray[np.bool_]:
        """Test whether each ray hits anything."""
        raise NotImplementedError

    def multi_hit(self, rays: Rays, mode: str) -> AllHits:
        """Find all hits of each ray, sorted."""
        raise NotImplementedError

    def closest_point(self, points: Points, mode: str) -> Closest:
        """Find the nearest point of the triangles to each point."""
        raise NotImplementedError

    def run(self, query: Query, rays: Rays | Points, mode: str) -> Result:
        """Run one of the queries.

        Parameters
        ----------
        query : {"first", "any", "multi", "closest"}
        rays : Rays or Points
            Points for ``"closest"``.
        mode : str
            One of `modes`.
        """
        if isinstance(rays, Points):
            return self.closest_point(rays, mode)
        if query == "first":
            return self.first_hit(rays, mode)
        if query == "any":
            return self.any_hit(rays, mode)
        return self.multi_hit(rays, mode)
