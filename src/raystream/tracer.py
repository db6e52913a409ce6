"""Tracer: a structure on a machine on a device, answering the queries."""

from __future__ import annotations

import operator
from os import PathLike
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from raystream.core.hits import Hits, MultiHits
from raystream.core.rays import RayBatch
from raystream.jit.threads import Progress
from raystream.kernels.moving import move_triangles
from raystream.kernels.queries import UNLIMITED
from raystream.scene.moving import moved_meshes
from raystream.scene.scene import Scene
from raystream.structures import Structure
from raystream.structures.base import UpdateReport
from raystream.structures.devices import build_on_device
from raystream.structures.storage import load_structure, save_structure

__all__ = ["Crossings", "Tracer"]

Crossings = Literal["triangles", "surfaces"]


class Tracer:
    """Traces rays against a scene.

    Parameters
    ----------
    scene : Scene
        Its triangles are copied: later changes of the scene's arrays have no effect.
    structure : {"bvh", "kdtree", "grid", "brute"}
        Acceleration structure. All return the same bits; ``"brute"`` tests every triangle.
    device : {"cpu"}
        Where rays are traced.
    progress : callable, optional
        Called with (triangles done, triangles) during a long build.
    **options
        Build options of the structure, such as ``max_leaf_size`` of ``"bvh"``.

    Raises
    ------
    ValueError
        If a name is unknown or an option is out of range.
    TypeError
        If `scene` is no scene, or the structure has no such option.

    Notes
    -----
    Every query takes rays of any leading shape S: `origins` and `directions` of shape
    S + (3,), which broadcast against each other, of any real dtype, as NumPy arrays or
    anything that converts to one without leaving the CPU (DLPack, ``__array_interface__``).
    World space, scene units; directions need not be unit length, and t counts in their
    lengths. `t_min` and `t_max` are numbers or arrays that broadcast to S; the interval is
    closed, and rounded to float32. A ray with a NaN, infinite or zero direction is no error:
    it misses, and its status is ``RayStatus.INVALID``.

    A ray through a shared edge hits both triangles, never neither [1]_. Degenerate
    triangles, and triangles with a NaN or infinite vertex, are never hit: where one of
    them is all that closes a mesh, the mesh is open.

    Rays are traced on all cores (``RAYSTREAM_THREADS``). Ctrl-C interrupts a query.

    References
    ----------
    .. [1] Woop, Benthin and Wald, "Watertight Ray/Triangle Intersection", Journal of
       Computer Graphics Techniques 2(1), 2013.

    Examples
    --------
    >>> import raystream as rs
    >>> scene = rs.Scene.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    >>> tracer = rs.Tracer(scene)
    >>> hits = tracer.first_hit([[0.25, 0.25, 1], [2, 2, 1]], [0, 0, -1])
    >>> hits.t.tolist(), hits.prim_id.tolist()
    ([1.0, inf], [0, -1])
    """

    structure: Structure

    def __init__(
        self,
        scene: Scene,
        structure: str = "bvh",
        device: str = "cpu",
        *,
        progress: Progress | None = None,
        **options: Any,
    ) -> None:
        if not isinstance(scene, Scene):
            raise TypeError(f"scene: expected a Scene, got {type(scene).__name__}; see rs.load")
        self._set(
            scene,
            build_on_device(device, structure, scene.triangles, progress=progress, **options),
        )

    def _set(self, scene: Scene | None, structure: Structure) -> None:
        self._scene = scene
        self.structure = structure

    @property
    def scene(self) -> Scene:
        """What rays are traced against; bare triangles after `load` without a scene."""
        if self._scene is None:
            self._scene = Scene.from_triangles(self.structure.triangles)
        return self._scene

    def first_hit(
        self,
        origins: Any,
        directions: Any,
        *,
        t_min: Any = 0.0,
        t_max: Any = np.inf,
        progress: Progress | None = None,
    ) -> Hits:
        """Find the nearest triangle along each ray.

        Parameters
        ----------
        origins, directions : array_like of shape S + (3,), real
        t_min, t_max : float or array_like that broadcasts to S
            Closed search interval, in direction lengths.
        progress : callable, optional
            Called with (rays done, rays).

        Returns
        -------
        Hits
            ``t``, ``u``, ``v`` of shape S, float32, and ``prim_id`` of shape S, int32. A
            miss has ``t = inf`` and ``prim_id = -1``.

        Raises
        ------
        ValueError, TypeError
            If shapes disagree or an array does not hold real numbers.

        Notes
        -----
        Equal t, before it is rounded to float32: the lowest prim_id wins, in every structure.
        """
        batch = RayBatch(origins, directions, t_min, t_max)
        structure = self.structure
        status = np.zeros(len(batch), np.uint8)
        t, u, v, prim_id = structure.first_hit_batch(batch, status, progress)
        shape = batch.shape
        return Hits(
            t.reshape(shape),
            u.reshape(shape),
            v.reshape(shape),
            prim_id.reshape(shape),
            status.reshape(shape),
            structure.triangles,
        )

    def any_hit(
        self,
        origins: Any,
        directions: Any,
        *,
        t_min: Any = 0.0,
        t_max: Any = np.inf,
        progress: Progress | None = None,
    ) -> NDArray[np.bool_]:
        """Find whether anything is in each ray's way; cheaper than the nearest hit.

        Parameters
        ----------
        origins, directions, t_min, t_max, progress
            See `first_hit`.

        Returns
        -------
        ndarray of shape S, bool
            Exactly where `first_hit` would report a hit.

        Raises
        ------
        ValueError, TypeError
            See `first_hit`.
        """
        batch = RayBatch(origins, directions, t_min, t_max)
        status = np.zeros(len(batch), np.uint8)
        return self.structure.any_hit_batch(batch, status, progress).reshape(batch.shape)

    def count_hits(
        self,
        origins: Any,
        directions: Any,
        *,
        t_min: Any = 0.0,
        t_max: Any = np.inf,
        crossings: Crossings = "triangles",
        progress: Progress | None = None,
    ) -> NDArray[np.int64]:
        """Count what lies along each ray.

        Parameters
        ----------
        origins, directions, t_min, t_max, progress
            See `first_hit`.
        crossings : {"triangles", "surfaces"}
            What a ray exactly through an edge or a vertex meets: every triangle there, or
            one triangle each time that it passes through the surface (none or two where it
            only grazes it), so that a closed mesh is crossed an even number of times by a
            ray from outside.

        Returns
        -------
        ndarray of shape S, int64

        Raises
        ------
        ValueError, TypeError
            As `first_hit`, or if `crossings` is unknown.
        """
        batch = RayBatch(origins, directions, t_min, t_max)
        surfaces = _is_surfaces(crossings)
        status = np.zeros(len(batch), np.uint8)
        counts = self.structure.count_hits_batch(batch, surfaces, UNLIMITED, status, progress)
        return counts.reshape(batch.shape)

    def multi_hit(
        self,
        origins: Any,
        directions: Any,
        *,
        t_min: Any = 0.0,
        t_max: Any = np.inf,
        max_hits: int | None = None,
        crossings: Crossings = "triangles",
        progress: Progress | None = None,
    ) -> MultiHits:
        """Find all hits of each ray, or the nearest few, by increasing distance.

        Parameters
        ----------
        origins, directions, t_min, t_max
            See `first_hit`.
        max_hits : int, optional
            Keep the nearest `max_hits` of each ray; without it all of them, however many.
        crossings : {"triangles", "surfaces"}
            See `count_hits`.
        progress : callable, optional
            Called with (steps done, steps): a ray may take two, to count its hits
            and to keep them.

        Returns
        -------
        MultiHits
            ``ray_splits`` of shape (N + 1,), int64, delimits each ray's rows of ``t``,
            ``u``, ``v`` (float32) and ``prim_id`` (int32).

        Raises
        ------
        ValueError, TypeError
            As `first_hit`, or if `crossings` is unknown or `max_hits` negative.
        MemoryError
            If all hits together need more memory than there is: nothing is cut off
            silently. Give `max_hits`, or fewer rays.

        Notes
        -----
        Exact: hits are counted before they are written, or kept in memory that grows. Equal
        t, before it is rounded to float32: the lower prim_id comes first. No hit is found
        twice and none is lost between two others, however close.
        """
        batch = RayBatch(origins, directions, t_min, t_max)
        surfaces = _is_surfaces(crossings)
        limit = UNLIMITED if max_hits is None else min(operator.index(max_hits), UNLIMITED)
        if limit < 0:
            raise ValueError(f"max_hits: expected None or a number >= 0, got {max_hits}")
        status = np.zeros(len(batch), np.uint8)
        structure = self.structure
        splits, hits = structure.multi_hit_batch(batch, surfaces, limit, status, progress)
        return MultiHits(splits, *hits, status.reshape(batch.shape), structure.triangles)

    def update(
        self,
        vertices: Any,
        *,
        max_cost_growth: float = 1.5,
        progress: Progress | None = None,
    ) -> UpdateReport:
        """Move the scene's vertices; which triangles they form stays as it is.

        Parameters
        ----------
        vertices : array_like of shape (V, 3), real; or a sequence of them
            New positions of all vertices, world space, scene units: an array for a scene of
            one mesh, else one for each mesh, or None for a mesh that stays where it is.
        max_cost_growth : float
            A tree is adjusted to moved triangles much faster than it is built, but rays take
            longer in it the further neighbours part. It is built anew when the expected cost
            of a ray is more than so many times what it was when it was last built; 0 builds
            it anew every time.
        progress : callable, optional
            Called with (triangles placed, triangles) if it is built anew.

        Returns
        -------
        UpdateReport
            Whether the structure was built anew, how long it took, and its costs.

        Raises
        ------
        ValueError
            If the number of meshes or of vertices of a mesh is another one, or
            `max_cost_growth` is negative or NaN. Nothing was moved then.
        TypeError
            If the positions are no real numbers.

        Notes
        -----
        Every query then answers as a tracer of the moved triangles would, in the frame that
        this one has: the centre and scale that float32 coordinates refer to stay the same,
        unless a coordinate grew to more than 2**40 times the scale of the scene. Triangles
        that have become degenerate, NaN or infinite are never hit, until they recover.

        `scene` becomes a scene with the moved vertices; shading normals do not follow. Hits
        found before still refer to the triangles as they were. No query may run in another
        thread meanwhile. An interrupt leaves everything as it was.

        Examples
        --------
        >>> import raystream as rs
        >>> vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], float)
        >>> tracer = rs.Tracer(rs.Scene.from_arrays(vertices, [[0, 1, 2]]))
        >>> report = tracer.update(vertices + [0, 0, 5])
        >>> report.rebuilt, tracer.first_hit([0.2, 0.2, 0], [0, 0, 1]).t.item()
        (False, 5.0)
        """
        if not max_cost_growth >= 0.0:
            raise ValueError(f"max_cost_growth: expected a number >= 0, got {max_cost_growth}")
        scene = self.scene
        meshes = moved_meshes(scene.meshes, vertices)
        parts = [(mesh.vertices, mesh.faces) for mesh in meshes]
        triangles = move_triangles(self.structure.triangles, parts)
        structure, report = self.structure.updated(triangles, max_cost_growth, progress)
        self._set(scene.moved(meshes, triangles), structure)
        return report

    def save(self, path: str | PathLike[str]) -> None:
        """Write the built structure and its triangles to a file.

        Parameters
        ----------
        path : str or path
            An ``.npz`` file, replaced as a whole when writing succeeded.

        Raises
        ------
        ValueError
            If the name does not end in ``.npz``.
        OSError
            If it cannot be written.
        """
        save_structure(path, self.structure)

    @classmethod
    def load(cls, path: str | PathLike[str], scene: Scene | None = None) -> Tracer:
        """Read a structure that `save` wrote.

        Parameters
        ----------
        path : str or path
        scene : Scene, optional
            The scene it was built of, for its materials, lights and camera. Without it, the
            tracer has a scene of bare triangles.

        Returns
        -------
        Tracer

        Raises
        ------
        FileFormatError
            If the file is damaged, of another version, or no such file at all; or if it was
            built of other triangles than `scene` has.
        """
        if scene is not None and not isinstance(scene, Scene):
            raise TypeError(f"scene: expected a Scene, got {type(scene).__name__}")
        structure = load_structure(path, None if scene is None else scene.triangles)
        tracer = cls.__new__(cls)
        tracer._set(scene, structure)
        return tracer

    def __repr__(self) -> str:
        triangle_count = len(self.structure.triangles)
        return f"Tracer({triangle_count:,} triangles, structure={self.structure.name!r})"


def _is_surfaces(crossings: str) -> bool:
    if crossings not in ("triangles", "surfaces"):
        raise ValueError(f"crossings: expected 'triangles' or 'surfaces', got {crossings!r}")
    return crossings == "surfaces"
