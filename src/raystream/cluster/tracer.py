"""Tracer: the queries of `raystream.Tracer`, on the workers of a cluster."""

from __future__ import annotations

import operator
from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import dask
import dask.array as da
import numpy as np

from raystream.cluster.blocks import BLOCKS
from raystream.cluster.clients import client_of, close
from raystream.cluster.hits import LazyHits, LazyMultiHits
from raystream.cluster.post import post_of
from raystream.cluster.rays import LazyRays
from raystream.cluster.tracers import pack_tracer
from raystream.core.choices import DeviceOptions
from raystream.core.query import UNLIMITED, Crossings, counts_surfaces
from raystream.scene.scene import Scene
from raystream.structures import StructureOptions
from raystream.tracer import Tracer as LocalTracer

if TYPE_CHECKING:
    from types import TracebackType

    from distributed import Client

__all__ = ["Tracer"]


class Tracer:
    """Traces Dask arrays of rays against a scene, on the workers of a cluster.

    The triangles and the built structure go to each worker once, when it first needs them: in
    files that are mapped into memory where a worker shares this machine, else by way of the
    scheduler. Workers that join later, or start again, fetch them likewise.

    Parameters
    ----------
    scene : Scene or raystream.Tracer
        A tracer of the CPU saves building the structure again.
    client : distributed.Client or str, optional
        The cluster: a client; the address of a scheduler; ``"local:2"``, two workers that are
        started on this machine; or without it, the client that was opened last.
    structure, device, machine, **options
        See `raystream.Tracer`. For devices other than the CPU, workers build the structure.

    Raises
    ------
    ClusterError
        If there is no cluster, or its scheduler does not answer or lacks raystream.
    ValueError, TypeError
        As `raystream.Tracer`; or if it is asked to count what rays meet, or the tracer given
        traces on a GPU.

    Notes
    -----
    Answers have the bits of one process, in the order of the rays, however many workers there
    are and whichever of them fail. Nothing is traced before ``compute()``. Each task traces one
    chunk of rays, with a share of its worker's threads.

    Answers can be computed until `close`, or until the client leaves.

    Examples
    --------
    >>> import dask.array as da
    >>> import raystream as rs
    >>> from distributed import Client
    >>> client = Client(n_workers=2, threads_per_worker=1)  # doctest: +SKIP
    >>> tracer = rs.cluster.Tracer(rs.load("cornell"), client)  # doctest: +SKIP
    >>> directions = da.random.normal(size=(10**8, 3), chunks=(10**6, 3))
    >>> hits = tracer.first_hit([278.0, 273.0, -800.0], directions)  # doctest: +SKIP
    >>> hits.is_hit.mean().compute()  # doctest: +SKIP
    """

    def __init__(
        self,
        scene: Scene | LocalTracer,
        client: Client | str | None = None,
        structure: str | StructureOptions = "bvh",
        device: str | DeviceOptions = "cpu",
        **options: Any,
    ) -> None:
        self.client = client_of(client, is_default=True)
        self._is_own = isinstance(client, str)
        try:
            parcel = pack_tracer(scene, structure, device, options, for_pictures=False)
            self._post = post_of(self.client)
            self._digest = self._post.send(parcel)
        except BaseException:
            if self._is_own:
                close(self.client)
            raise
        self._header: Mapping[str, Any] = parcel.header
        if isinstance(scene, LocalTracer):
            self._triangles = scene.structure.triangles
        else:
            self._triangles = scene.triangles
        self._is_closed = False

    def first_hit(
        self, origins: Any, directions: Any, *, t_min: Any = 0.0, t_max: Any = np.inf
    ) -> LazyHits:
        """Find the nearest triangle along each ray, when it is computed.

        Parameters
        ----------
        origins, directions : dask.array.Array or array_like of shape S + (3,), real
            Other arrays than Dask's become chunks of a million rays, which travel to the
            workers: many rays are better made there.
        t_min, t_max : float, or dask.array.Array or array_like that broadcasts to S
            Closed search interval, in direction lengths.

        Returns
        -------
        LazyHits
            In the chunks of the rays.

        Raises
        ------
        ValueError, TypeError
            As `raystream.Tracer.first_hit`; or if the size of a chunk is unknown.
        """
        rays = LazyRays.of(origins, directions, t_min, t_max)
        records = self._asked("first_hit", rays, {})
        return LazyHits(records, self._digest, self._triangles, self.client)

    def any_hit(
        self, origins: Any, directions: Any, *, t_min: Any = 0.0, t_max: Any = np.inf
    ) -> da.Array:
        """Find whether anything is in each ray's way; see `first_hit`.

        Returns
        -------
        dask.array.Array of shape S, bool
        """
        return self._asked("any_hit", LazyRays.of(origins, directions, t_min, t_max), {})

    def count_hits(
        self,
        origins: Any,
        directions: Any,
        *,
        t_min: Any = 0.0,
        t_max: Any = np.inf,
        crossings: Crossings = "triangles",
    ) -> da.Array:
        """Count what lies along each ray; see `first_hit` and `raystream.Tracer.count_hits`.

        Returns
        -------
        dask.array.Array of shape S, int64
        """
        counts_surfaces(crossings)
        rays = LazyRays.of(origins, directions, t_min, t_max)
        return self._asked("count_hits", rays, {"crossings": crossings})

    def multi_hit(
        self,
        origins: Any,
        directions: Any,
        *,
        t_min: Any = 0.0,
        t_max: Any = np.inf,
        max_hits: int | None = None,
        crossings: Crossings = "triangles",
    ) -> LazyMultiHits:
        """Find all hits of each ray, or the nearest few, by increasing distance.

        Parameters
        ----------
        origins, directions, t_min, t_max
            See `first_hit`. Rays of more than one leading axis are put into chunks of whole
            rows, since hits are numbered in the order of rays.
        max_hits, crossings
            See `raystream.Tracer.multi_hit`.

        Returns
        -------
        LazyMultiHits
        """
        counts_surfaces(crossings)
        limit = None if max_hits is None else min(operator.index(max_hits), UNLIMITED)
        if limit is not None and limit < 0:
            raise ValueError(f"max_hits: expected None or a number >= 0, got {max_hits}")
        rays = LazyRays.of(origins, directions, t_min, t_max)
        flat = rays.flat()
        options = {"crossings": crossings, "max_hits": limit}
        found = self._asked("multi_hit", flat, options)
        source = self._digest, self._triangles, self.client
        return LazyMultiHits(found, flat.chunks[0], rays.shape, *source)

    def _asked(self, query: str, rays: LazyRays, options: Mapping[str, Any]) -> da.Array:
        """A query's answers, chunk by chunk."""
        if self._is_closed:
            raise ValueError("tracer: was closed; make a new one")
        block, dtype = BLOCKS[query]
        given = {"t_min": rays.t_min, "t_max": rays.t_max}
        arrays = [v for v in given.values() if isinstance(v, da.Array)]
        limits = {name: None if isinstance(v, da.Array) else v for name, v in given.items()}
        settings = {"digest": self._digest, "limits": limits, "options": dict(options)}
        inputs = [rays.origins, rays.directions, *arrays]
        chunks = {}
        if query == "multi_hit":
            chunks = {"chunks": ((1,) * len(rays.chunks[0]),)}
        axes = len(rays.shape)
        return da.map_blocks(
            partial(block, **settings),
            *inputs,
            drop_axis=axes,
            dtype=dtype,
            meta=np.empty((0,) * axes, dtype),
            name=f"raystream-{query}-{dask.base.tokenize(query, settings, *inputs)}",
            **chunks,
        )

    def close(self) -> None:
        """Let the scheduler and the workers forget it: what was not computed never will be.

        Also ends workers that were started for it.
        """
        if self._is_closed:
            return
        self._is_closed = True
        self._post.release(self._digest)
        if self._is_own:
            close(self.client)

    def __enter__(self) -> Tracer:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        structure, device = (
            one if isinstance(one, str) else one["name"]
            for one in (self._header["structure"], self._header["device"])
        )
        return (
            f"cluster.Tracer({len(self._triangles):,} triangles, "
            f"structure={structure!r}, device={device!r}, {self.client!r})"
        )
