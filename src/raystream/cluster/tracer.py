"""Tracer: the queries of `raystream.Tracer` on a cluster."""

from __future__ import annotations

import operator
from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import dask
import dask.array as da
import numpy as np

from raystream.cluster.blocks import BLOCKS, record_of
from raystream.cluster.clients import client_of, close
from raystream.cluster.hits import LazyHits, LazyMultiHits
from raystream.cluster.rays import LazyRays
from raystream.cluster.tracer_bundles import geometry_of, pack_tracer
from raystream.cluster.uploader import uploader_of
from raystream.core.choices import DeviceOptions
from raystream.core.query import UNLIMITED, Crossings, counts_surfaces
from raystream.scene.scene import Scene
from raystream.structures import StructureOptions
from raystream.tracer import Tracer as LocalTracer

if TYPE_CHECKING:
    from distributed import Client


class Tracer:
    """Traces Dask arrays of rays against a scene on the workers of a cluster.

    The triangles and the built structure are sent to each worker once, when it first needs
    them: as memory-mapped files on this machine, otherwise through the scheduler. Workers
    that join later, or restart, fetch them in the same way.

    Parameters
    ----------
    scene : Scene or raystream.Tracer
        Passing a CPU tracer avoids rebuilding the structure.
    client : distributed.Client or str, optional
        The cluster: a client; the address of a scheduler; or ``"local:2"``, two workers started
        on this machine. Default: the most recently opened client.
    structure, device, machine, **options
        See `raystream.Tracer`. On devices other than the CPU, workers build the structure.

    Raises
    ------
    ClusterError
        If there is no cluster, or its scheduler does not answer or lacks raystream.
    ValueError, TypeError
        As `raystream.Tracer`; or if counters are requested, or the given tracer is on a GPU.

    Notes
    -----
    Results are in the order of the rays, with the bits of a single process, regardless of the
    number of workers and their failures. Nothing is traced before ``compute()``. Each task
    traces one chunk of rays with a share of its worker's threads.

    Results can be computed until `close` is called or the client disconnects.

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
            bundle = pack_tracer(scene, structure, device, options, for_rendering=False)
            self._uploader = uploader_of(self.client)
            self._digest = self._uploader.send(bundle)
        except BaseException:
            if self._is_own:
                close(self.client)
            raise
        self._header: Mapping[str, Any] = bundle.header
        self._triangles = geometry_of(scene, options)
        self._is_closed = False

    def first_hit(
        self, origins: Any, directions: Any, *, t_min: Any = 0.0, t_max: Any = np.inf
    ) -> LazyHits:
        """Find the nearest triangle along each ray, lazily.

        Parameters
        ----------
        origins, directions : dask.array.Array or array_like of shape S + (3,), real
            NumPy arrays become chunks of a million rays that are sent to the workers; large
            numbers of rays are better generated on the workers.
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
        records = self._map_query("first_hit", rays, {})
        return LazyHits(records, self._digest, self._triangles, self.client)

    def any_hit(
        self, origins: Any, directions: Any, *, t_min: Any = 0.0, t_max: Any = np.inf
    ) -> da.Array:
        """Test whether each ray hits anything; see `first_hit`.

        Returns
        -------
        dask.array.Array of shape S, bool
        """
        return self._map_query("any_hit", LazyRays.of(origins, directions, t_min, t_max), {})

    def count_hits(
        self,
        origins: Any,
        directions: Any,
        *,
        t_min: Any = 0.0,
        t_max: Any = np.inf,
        crossings: Crossings = "triangles",
    ) -> da.Array:
        """Count the hits of each ray; see `first_hit` and `raystream.Tracer.count_hits`.

        Returns
        -------
        dask.array.Array of shape S, int64
        """
        counts_surfaces(crossings)
        rays = LazyRays.of(origins, directions, t_min, t_max)
        return self._map_query("count_hits", rays, {"crossings": crossings})

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
            See `first_hit`. Rays with several leading axes are rechunked to whole rows, since
            hits are numbered in the order of the rays.
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
        found = self._map_query("multi_hit", flat, options)
        source = self._digest, self._triangles, self.client
        return LazyMultiHits(found, flat.chunks[0], rays.shape, *source)

    def _map_query(self, query: str, rays: LazyRays, options: Mapping[str, Any]) -> da.Array:
        """Build the Dask array of a query's results, chunk by chunk."""
        if self._is_closed:
            raise ValueError("tracer: is closed; create a new one")
        block, kind = BLOCKS[query]
        dtype = kind(self._triangles) if kind is record_of else kind
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
        """Release the tracer on the scheduler and the workers; pending results are lost.

        Also stops workers that were started for it.
        """
        if self._is_closed:
            return
        self._is_closed = True
        self._uploader.release(self._digest)
        if self._is_own:
            close(self.client)

    def __enter__(self) -> Tracer:
        return self

    def __exit__(self, *error: object) -> None:
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
