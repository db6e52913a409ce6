"""Tracer: turns arguments into a query, hands it to a backend, and gives back hits."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from raystream.core.checks import check_least
from raystream.core.choices import DeviceOptions, MachineOptions
from raystream.core.hits import Hits, MultiHits
from raystream.core.library_hits import in_library
from raystream.core.query import (
    UNLIMITED,
    Crossings,
    Kind,
    Order,
    Query,
    counts_surfaces,
    is_front_to_back,
)
from raystream.core.rays import RayArrays, RayBatch
from raystream.core.scene_kinds import check_support
from raystream.jit.threads import Progress
from raystream.programs.filters import Bound, Filter
from raystream.programs.payloads import as_payload, as_records, returned_payload
from raystream.programs.rows import prim_ids_of, skipped_triangles
from raystream.scene.scene import Scene
from raystream.structures import StructureOptions
from raystream.tracer.answers import RESULTS
from raystream.tracer.memory_needed import MemoryEstimator
from raystream.tracer.point_queries import PointQueries
from raystream.tracer.precision import triangles_of

__all__ = ["Crossings", "Tracer"]

#: Queries without options, made once: a small batch takes little more time than a value.
_PLAIN = [Query(kind) for kind in Kind]


class Tracer(MemoryEstimator, PointQueries):
    """Traces rays against a scene.

    Parameters
    ----------
    scene : Scene
        Its triangles are copied: later changes of the scene's arrays have no effect.
    structure : {"bvh", "kdtree", "graph", "grid", "brute"} or StructureOptions
        Acceleration structure, by name or as `Bvh`, `KdTree`, `Graph`, `Grid` or `Brute` with its
        options. All return the same bits; ``"brute"`` tests every triangle.
    device : {"cpu", "cuda", "graphics"} or DeviceOptions
        Where rays are traced, by name or as `Cpu`, `Cuda` or `Graphics` with its options: on the
        CPU's cores; on an NVIDIA GPU (``pip install raystream[cuda]``), chosen with ``gpu=`` if
        there are several; or on a GPU through Vulkan, Metal or Direct3D 12 (``pip install
        raystream[graphics]``).
    machine : {"branching", "multipass", "compute"} or MachineOptions, optional
        How the structure is traversed, by name or as `Branching`, `Multipass` or `Compute` with
        its options: each thread traces one ray from start to end; or all rays advance step by
        step, in passes (Purcell 2002, section 2.2). All return the same bits on one device;
        ``"multipass"`` is slower, reports its passes, and is not supported on ``"cuda"``. On
        ``"graphics"`` these two are fragment programs, and ``"compute"`` is faster [default:
        ``"compute"`` on ``"graphics"``, else ``"branching"``].
    precision : {"float32", "float64"}
        Precision of triangles, rays and results: ``"float64"`` is for scenes where float32
        distances are too coarse; supported by ``"bvh"`` and ``"brute"`` on the CPU and CUDA.
    counters : bool
        Count traversal steps, leaves and tests per ray: see `counters`. Rays are then traced one
        by one, without the many-ray kernels of ``"bvh"``. Disabled counters cost nothing.
    progress : callable, optional
        Called with (triangles done, triangles) during a long build.
    **options
        Options of the structure, device and machine that are given by name:
        ``Tracer(scene, "bvh", quality="fast")`` is ``Tracer(scene, Bvh(quality="fast"))``.

    Raises
    ------
    ValueError
        If a name is unknown or an option is out of range.
    TypeError
        If `scene` is not a scene, or the structure has no such option.
    RaystreamError
        If the device is not available, or its memory cannot hold the structure.

    Notes
    -----
    Every query takes rays of any leading shape S: `origins` and `directions` of shape
    S + (3,), which broadcast against each other, of any real dtype, as NumPy arrays or
    anything that converts to one without leaving the CPU (DLPack, ``__array_interface__``).
    For arrays of PyTorch, JAX, CuPy and xarray, results are arrays of the same library; see
    `raystream.core.library_hits.LibraryHits`. World space, scene units; directions need not be
    unit length, and t is measured in their lengths. `t_min` and `t_max` are numbers or arrays that
    broadcast to S; the interval is closed, and rounded to `precision`. A ray with a NaN, infinite
    or zero direction is no error: it misses, and its status is ``RayStatus.INVALID``.

    With ``device="cuda"`` rays may be arrays on the tracer's GPU, passed by DLPack or
    ``__cuda_array_interface__`` (CuPy, PyTorch, JAX, Numba), of float32 or float64; numbers and
    single vectors may still come from the host. They are read in place, on the CUDA stream that
    they name, or else on the default stream, and must not change until then. Results stay on the
    GPU, in arrays of that library or that it can view without a copy; ``host()`` copies them to
    NumPy. A query may return before they are filled.

    A ray through a shared edge hits both triangles, never neither [1]_. Degenerate
    triangles, and triangles with a NaN or infinite vertex, are never hit: a mesh that
    only such a triangle closes is open.

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

    def __init__(
        self,
        scene: Scene,
        structure: str | StructureOptions = "bvh",
        device: str | DeviceOptions = "cpu",
        *,
        machine: str | MachineOptions | None = None,
        precision: Literal["float32", "float64"] = "float32",
        counters: bool = False,
        progress: Progress | None = None,
        **options: Any,
    ) -> None:
        if not isinstance(scene, Scene):
            raise TypeError(f"scene: expected a Scene, got {type(scene).__name__}; see rs.load")
        configuration = self._configure(structure, device, machine, counters, options)
        triangles = triangles_of(scene, precision)
        self._set(scene, self._built(configuration, triangles, progress))

    def first_hit(
        self,
        origins: Any,
        directions: Any,
        *,
        t_min: Any = 0.0,
        t_max: Any = np.inf,
        on_hit: Callable[..., Any] | Bound | None = None,
        skip_prim_ids: Any = None,
        near: Any = None,
        worlds: Any = None,
        mask: Any = None,
        progress: Progress | None = None,
    ) -> Hits:
        """Find the nearest triangle along each ray.

        Parameters
        ----------
        origins, directions : array_like of shape S + (3,), real
        t_min, t_max : float or array_like that broadcasts to S
            Closed search interval, in direction lengths.
        on_hit : callable, optional
            A filter: ``on_hit(hit)`` receives a `Hit` and returns whether to accept it, as a
            boolean or as `Decision.CONTINUE` or `Decision.IGNORE`; `Decision.STOP` accepts it and
            ends the search. It may be called in any order, more than once, and at hits behind the
            nearest. See `trace` for what it may do. A `Bound` passes it constants.
        skip_prim_ids : array_like of shape S or S + (k,), int, or Hits of shape S, optional
            Triangles that each ray ignores, such as the one that it starts on, or spheres, of which
            it ignores both sides; -1 ignores nothing. The filter is not called for them. Given as
            numbers, triangles are ignored in all of their instances; given as hits, only in the
            instance that was hit. With rays in arrays on a GPU, it may be an array there, of int32
            or int64.
        near : array_like that broadcasts to S, int, optional
            The sectors in which rays start, for a graph: `Hits.sectors` of the hits that they
            leave; -1 where unknown. Searches begin there instead of at a bin; results are equal.
        worlds : array_like that broadcasts to S, int, optional
            In a scene whose instances are in worlds: the world of each ray; see `Scene.instances`.
            For rays in arrays on a GPU: an array on the host, or a contiguous one on the GPU.
        mask : int or array_like that broadcasts to S, int, optional
            32 bits, unsigned: a ray hits only what has one of its bits, see ``mask`` of `Mesh`, and
            ``masks`` of `Scene.instances` [default: all bits]. Not on ``device="graphics"``.
        progress : callable, optional
            Called with (rays done, rays).

        Returns
        -------
        Hits
            ``t``, ``u``, ``v`` of shape S, of `precision`, and ``prim_id`` of shape S, int32. A
            miss has ``t = inf`` and ``prim_id = -1``. For rays in arrays on a GPU:
            `raystream.cuda.device_hits.DeviceHits`, there.

        Raises
        ------
        ValueError, TypeError
            If shapes disagree or an array does not hold real numbers; if `near` is given where
            hits have no sectors, or is not a sector; and see `trace`.
        RuntimeError
            If the filter raises; the exception is the cause.

        Notes
        -----
        At equal t, before it is rounded to float32, the lowest prim_id wins, in every structure.
        """
        rays = self._rays(origins, directions, t_min, t_max, near, worlds, mask)
        query = self._query(Kind.FIRST_HIT, rays, on_hit, skip_prim_ids)
        return in_library(self._found(query, rays, progress), origins, directions)

    def any_hit(
        self,
        origins: Any,
        directions: Any,
        *,
        t_min: Any = 0.0,
        t_max: Any = np.inf,
        on_hit: Callable[..., Any] | Bound | None = None,
        skip_prim_ids: Any = None,
        near: Any = None,
        worlds: Any = None,
        mask: Any = None,
        progress: Progress | None = None,
    ) -> NDArray[np.bool_]:
        """Find whether anything blocks each ray; cheaper than the nearest hit.

        Parameters
        ----------
        origins, directions, t_min, t_max, on_hit, skip_prim_ids, near, worlds, mask, progress
            See `first_hit`.

        Returns
        -------
        ndarray of shape S, bool
            True exactly where `first_hit` would report a hit. For rays in arrays on a GPU: a
            `raystream.jit.cuda.DeviceArray` there.

        Raises
        ------
        ValueError, TypeError, RuntimeError
            See `first_hit`.
        """
        rays = self._rays(origins, directions, t_min, t_max, near, worlds, mask)
        query = self._query(Kind.ANY_HIT, rays, on_hit, skip_prim_ids)
        return in_library(self._found(query, rays, progress), origins, directions)

    def count_hits(
        self,
        origins: Any,
        directions: Any,
        *,
        t_min: Any = 0.0,
        t_max: Any = np.inf,
        crossings: Crossings = "triangles",
        on_hit: Callable[..., Any] | Bound | None = None,
        skip_prim_ids: Any = None,
        worlds: Any = None,
        mask: Any = None,
        progress: Progress | None = None,
    ) -> NDArray[np.int64]:
        """Count the hits along each ray.

        Parameters
        ----------
        origins, directions, t_min, t_max, on_hit, skip_prim_ids, worlds, mask, progress
            See `first_hit`.
        crossings : {"triangles", "surfaces"}
            What a ray that passes exactly through an edge or a vertex hits: every triangle there;
            or one triangle each time it passes through the surface (none or two where it only
            grazes it), so that a ray from outside crosses a closed mesh an even number of times.

        Returns
        -------
        ndarray of shape S, int64
            For rays in arrays on a GPU: a `raystream.jit.cuda.DeviceArray` there.

        Raises
        ------
        ValueError, TypeError, RuntimeError
            As `first_hit`, or if `crossings` is unknown.
        """
        rays = self._rays(origins, directions, t_min, t_max, None, worlds, mask)
        surfaces = counts_surfaces(crossings)
        query = self._query(Kind.COUNT_HITS, rays, on_hit, skip_prim_ids, surfaces)
        return in_library(self._found(query, rays, progress), origins, directions)

    def multi_hit(
        self,
        origins: Any,
        directions: Any,
        *,
        t_min: Any = 0.0,
        t_max: Any = np.inf,
        max_hits: int | None = None,
        crossings: Crossings = "triangles",
        on_hit: Callable[..., Any] | Bound | None = None,
        skip_prim_ids: Any = None,
        worlds: Any = None,
        mask: Any = None,
        progress: Progress | None = None,
    ) -> MultiHits:
        """Find all hits of each ray, or the nearest few, by increasing distance.

        Parameters
        ----------
        origins, directions, t_min, t_max, on_hit, skip_prim_ids, worlds, mask
            See `first_hit`.
        max_hits : int, optional
            Keep the nearest `max_hits` of each ray [default: all].
        crossings : {"triangles", "surfaces"}
            See `count_hits`.
        progress : callable, optional
            Called with (steps done, steps): a ray may take two steps, one to count its hits
            and one to store them.

        Returns
        -------
        MultiHits
            ``ray_splits`` of shape (N + 1,), int64, delimits each ray's rows of ``t``,
            ``u``, ``v`` (of `precision`) and ``prim_id`` (int32). For rays in arrays on a GPU:
            `raystream.cuda.device_hits.DeviceMultiHits`, there.

        Raises
        ------
        ValueError, TypeError, RuntimeError
            As `first_hit`, or if `crossings` is unknown or `max_hits` negative.
        MemoryError
            If the hits do not fit into memory: results are never truncated silently. Give
            `max_hits`, or fewer rays.

        Notes
        -----
        The result is exact: hits are stored in buffers that grow, or counted before they are
        written. At equal t, before it is rounded to float32, the lower prim_id comes first. No hit
        is reported twice, and none is lost between two others, however close.
        """
        most = UNLIMITED if max_hits is None else check_least("max_hits", max_hits, 0)
        limit, surfaces = min(most, UNLIMITED), counts_surfaces(crossings)
        rays = self._rays(origins, directions, t_min, t_max, None, worlds, mask)
        query = self._query(Kind.MULTI_HIT, rays, on_hit, skip_prim_ids, surfaces, limit)
        return in_library(self._found(query, rays, progress), origins, directions)

    def trace(
        self,
        origins: Any,
        directions: Any,
        *,
        on_hit: Callable[..., Any],
        payload: Any = None,
        order: Order = "front-to-back",
        t_min: Any = 0.0,
        t_max: Any = np.inf,
        crossings: str = "triangles",
        worlds: Any = None,
        mask: Any = None,
        progress: Progress | None = None,
    ) -> Any:
        """Run a function at the hits of each ray.

        Parameters
        ----------
        origins, directions, t_min, t_max, worlds, mask
            See `first_hit`.
        on_hit : callable
            ``on_hit(hit, payload)``, a Python function that Numba compiles. It receives a `Hit`
            and its ray's payload, which it changes in place, and returns `Decision.CONTINUE`,
            `Decision.STOP` (no more hits of this ray) or `Decision.IGNORE` (here the same as
            CONTINUE); returning nothing continues.
        payload : array or dtype, optional
            A writable array of the rays' shape S, of NumPy or of another library on the host,
            changed in place; a dtype allocates one of zeros. With a structured dtype, the function
            receives its ray's record, as in ``payload.depth += hit.t``; with plain numbers, of
            shape S or S + (k,), an array of one or k numbers, as in ``payload[0] += 1``; without a
            payload, None. For rays in arrays on a GPU: an array there is changed there, a dtype
            allocates one there with aligned fields, and a NumPy array is copied there and back.
        order : {"front-to-back", "any"}
            Whether the hits of a ray come by increasing t, then prim_id, or as they are found,
            which saves sorting them when the order does not matter.
        crossings : {"triangles", "surfaces"}
            See `count_hits`.
        progress : callable, optional
            Called with (rays done, rays).

        Returns
        -------
        array or None
            The payload: the given array, or the new one, in the library of the rays unless it has
            records. For rays in arrays on a GPU: a `raystream.jit.cuda.DeviceArray`.

        Raises
        ------
        ValueError
            If shapes disagree, `order` or `crossings` is unknown, the payload is read-only,
            or the tracer counts (``counters=True``).
        TypeError
            If the function cannot be compiled, takes other arguments or returns anything but a
            decision; if the payload is not an array or dtype of numbers or records; if rays are
            in arrays on a GPU, and the function cannot run there.
        RuntimeError
            If the function raises; the exception is the cause.

        Notes
        -----
        Rays are independent, and run on several threads. A new function is compiled when it is
        first used, in a second or two, and cached on disk if everything that it uses can be
        identified by its content (as for `raystream.streams.Kernel`). Variables from outside
        are constants. After an exception or Ctrl-C the payload of some rays has changed.

        Examples
        --------
        >>> import raystream as rs
        >>> tracer = rs.Tracer(rs.load("cornell"))
        >>> def farthest(hit, payload):
        ...     payload[0] = hit.t
        >>> far = tracer.trace([278, 273, -800], [0, 0, 1], on_hit=farthest, payload=float)
        >>> round(far.item(), 1)
        1359.2
        """
        surfaces = counts_surfaces(crossings)
        is_ordered = is_front_to_back(order)
        check_support("trace", self.structure.triangles)
        query = Query(Kind.TRACE, surfaces, is_ordered=is_ordered, on_hit=on_hit)
        rays = self._rays(origins, directions, t_min, t_max, None, worlds, mask)
        if isinstance(rays, RayArrays):
            changed = self._backend.answer_on_device(query, rays, progress, payload)
            return returned_payload(payload, changed, origins, directions)
        self._check_programs()
        if payload is None:
            self._answer(query, rays, progress)
            return None
        result = as_payload(payload, rays.shape)
        records = as_records(result, rays.shape)
        self._answer(query, rays, progress, records)
        if not np.shares_memory(result, records):
            result[...] = records.reshape(result.shape)
        return returned_payload(payload, result, origins, directions)

    def bands_on_device(self, context: Any) -> Any:
        """The renderer on the tracer's device; None if it cannot shade, or queries are needed.

        Parameters
        ----------
        context : rendering.integrator.RenderContext

        Returns
        -------
        rendering.device_bands.DeviceBands or None
        """
        if not self._backend.capabilities.shading or self._needs_queries():
            return None
        return self._backend.bands_on_device(context)

    @property
    def loop_machine(self) -> Any:
        """The machine that runs a renderer as one loop, or None; see `machines.ray_loop`."""
        loops = self._backend.capabilities.loops and not self._needs_queries()
        return self._backend if loops else None

    def _needs_queries(self) -> bool:
        """Whether a renderer must call the queries: they count, or a subclass overrides them."""
        queries = type(self).first_hit, type(self).any_hit
        return self._counts or queries != (Tracer.first_hit, Tracer.any_hit)

    def _found(self, query: Query, rays: RayBatch | RayArrays, progress: Progress | None) -> Any:
        """The result of a query, where the rays are."""
        if isinstance(rays, RayArrays):
            return self._backend.answer_on_device(query, rays, progress)
        sink = self._answer(query, rays, progress)
        return RESULTS[query.kind](sink, rays.shape, self.structure.triangles)

    def _query(
        self,
        kind: Kind,
        rays: RayBatch | RayArrays,
        on_hit: Any,
        skip_prim_ids: Any,
        surfaces: bool = False,
        limit: int = UNLIMITED,
    ) -> Query:
        if on_hit is None and skip_prim_ids is None:
            if limit == UNLIMITED and not surfaces:
                return _PLAIN[kind]
            return Query(kind, surfaces, limit)
        triangles = self.structure.triangles
        check_support("on_hit, skip_prim_ids", triangles)
        if isinstance(rays, RayArrays):
            skipped = prim_ids_of(skip_prim_ids)
        else:
            skipped = skipped_triangles(skip_prim_ids, rays.shape, triangles)
            if limit:
                self._check_programs()
        return Query(kind, surfaces, limit, on_hit=Filter.of(on_hit, skipped, triangles))

    def _check_programs(self) -> None:
        if self._counts:
            raise ValueError(
                "on_hit, skip_prim_ids: a tracer with counters=True counts whole queries, "
                "and programs take several; use another tracer"
            )
        if not self._backend.capabilities.programs:
            raise ValueError("on_hit, skip_prim_ids: programs do not run on this tracer's device")
