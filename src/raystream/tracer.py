"""Tracer: a structure on a machine on a device, answering the queries."""

from __future__ import annotations

import operator
from collections.abc import Iterator
from os import PathLike
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from raystream.core.hits import Hits, MultiHits
from raystream.core.memory import check_memory
from raystream.core.rays import RayBatch
from raystream.jit.threads import Progress
from raystream.kernels.collect import HitArrays
from raystream.kernels.local_frame import SceneFrame
from raystream.kernels.queries import UNLIMITED
from raystream.scene.scene import Scene
from raystream.structures import Structure
from raystream.structures.devices import build_on_device
from raystream.structures.ray_block import RayBlock
from raystream.structures.storage import load_structure, save_structure

__all__ = ["Crossings", "Tracer"]

Crossings = Literal["triangles", "surfaces"]

#: Rays that are traced at a time: bounds the memory of everything but the results, at about
#: 100 bytes a ray.
RAYS_PER_BLOCK = 1 << 20


class Tracer:
    """Traces rays against a scene.

    Parameters
    ----------
    scene : Scene
        Its triangles are copied: later changes of the scene's arrays have no effect.
    structure : {"bvh", "brute"}
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
        triangles = structure.triangles
        self._frame = SceneFrame(
            triangles.center, triangles.scale, triangles.bounds, triangles.extreme
        )

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
        out = HitArrays.empty(len(batch))
        status = np.empty(len(batch), np.uint8)
        for block in self._blocks(batch, status, progress):
            part = out.part(block.rows)
            self.structure.first_hit(block.rays, part, block.progress)
            block.to_world(part.t, np.arange(len(part.t) + 1))
        return Hits(
            out.t.reshape(batch.shape),
            out.u.reshape(batch.shape),
            out.v.reshape(batch.shape),
            out.prim_id.reshape(batch.shape),
            status.reshape(batch.shape),
            self.structure.triangles,
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
        seen = np.empty(len(batch), np.bool_)
        status = np.empty(len(batch), np.uint8)
        for block in self._blocks(batch, status, progress):
            seen[block.rows] = self.structure.any_hit(block.rays, block.progress)
        return seen.reshape(batch.shape)

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
        counts = np.empty(len(batch), np.int64)
        status = np.empty(len(batch), np.uint8)
        for block in self._blocks(batch, status, progress):
            counts[block.rows] = self.structure.count_hits(
                block.rays, surfaces, progress=block.progress
            )
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
            Called with (steps done, steps): every ray is traced twice, to count its hits
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
        Exact: rays are counted first, then their hits are written. Equal t, before it is
        rounded to float32: the lower prim_id comes first. No hit is found twice and none is
        lost between two others, however close.
        """
        batch = RayBatch(origins, directions, t_min, t_max)
        surfaces = _is_surfaces(crossings)
        limit = UNLIMITED if max_hits is None else min(operator.index(max_hits), UNLIMITED)
        if limit < 0:
            raise ValueError(f"max_hits: expected None or a number >= 0, got {max_hits}")
        splits = np.zeros(len(batch) + 1, np.int64)
        status = np.empty(len(batch), np.uint8)
        steps = _Steps(progress, 2 * len(batch))
        for block in self._blocks(batch, status, steps.part(0)):
            if limit:
                counts = self.structure.count_hits(block.rays, surfaces, limit, block.progress)
                splits[1:][block.rows] = counts
        np.cumsum(splits, out=splits)
        hit_count = int(splits[-1])
        remedy = "give max_hits, or fewer rays at a time"
        check_memory(hit_count * 16, f"multi_hit: {hit_count:,} hits would", remedy)
        out = HitArrays.empty(hit_count)
        for block in self._blocks(batch, status, steps.part(len(batch))):
            rows = splits[block.rows.start : block.rows.stop + 1]
            self.structure.multi_hit(block.rays, surfaces, rows, out, block.progress)
            block.to_world(out.t, rows)
        return MultiHits(splits, *out, status.reshape(batch.shape), self.structure.triangles)

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

    def _blocks(
        self, batch: RayBatch, status: NDArray[np.uint8], progress: Progress | None
    ) -> Iterator[RayBlock]:
        """Turn the batch into blocks of local rays, one at a time; writes their status."""
        for first in range(0, len(batch), RAYS_PER_BLOCK):
            rows = slice(first, min(first + RAYS_PER_BLOCK, len(batch)))
            yield RayBlock(batch, rows, self._frame, status, progress)

    def __repr__(self) -> str:
        triangle_count = len(self.structure.triangles)
        return f"Tracer({triangle_count:,} triangles, structure={self.structure.name!r})"


class _Steps:
    """One progress callback over several loops."""

    def __init__(self, progress: Progress | None, total: int) -> None:
        self._progress = progress
        self._total = total

    def part(self, first: int) -> Progress | None:
        progress = self._progress
        if progress is None:
            return None
        return lambda done, _: progress(first + done, self._total)


def _is_surfaces(crossings: str) -> bool:
    if crossings not in ("triangles", "surfaces"):
        raise ValueError(f"crossings: expected 'triangles' or 'surfaces', got {crossings!r}")
    return crossings == "surfaces"
