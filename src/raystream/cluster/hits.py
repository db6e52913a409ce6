"""LazyHits and LazyMultiHits: results of a cluster's queries before they are traced."""

from __future__ import annotations

import math
from functools import cached_property, partial
from typing import Any

import dask
import dask.array as da
import numpy as np
from distributed import Client

from raystream.cluster import blocks
from raystream.core.hits import Hits, MultiHits
from raystream.core.store import Store


class _LazyColumns:
    """Columns of hits in Dask arrays, and properties derived from them, in the same chunks."""

    u: da.Array
    v: da.Array
    prim_id: da.Array

    _digest: str
    _triangles: Store
    _client: Client

    def _compute_options(self, options: dict[str, Any]) -> dict[str, Any]:
        """Return options of Dask's ``compute``, by default on the tracer's cluster."""
        is_open = self._client.status == "running"
        return {"scheduler": self._client, **options} if is_open else options

    @cached_property
    def instance_id(self) -> da.Array:
        """Instance of the triangle, int32, of the hits' shape; a miss has -1."""
        if self._triangles.instances is None:
            return self._derived("instance_id", np.int32)
        return self._placed()

    def _placed(self) -> da.Array:
        """The instances of hits, of a scene that has some."""
        raise NotImplementedError

    @cached_property
    def mesh_id(self) -> da.Array:
        """Mesh of the triangle, int32, of the hits' shape; a miss has -1."""
        return self._derived("mesh_id", np.int32)

    @cached_property
    def mesh_prim_id(self) -> da.Array:
        """Triangle, counted within its mesh, int32, of the hits' shape; a miss has -1."""
        return self._derived("mesh_prim_id", np.int32)

    @cached_property
    def positions(self) -> da.Array:
        """Points on the triangles, shape (..., 3), float64, world space; a miss has NaN."""
        return self._derived("positions", np.float64, 3)

    @cached_property
    def normals(self) -> da.Array:
        """Unit normals of the triangles' planes, shape (..., 3), as t; a miss has NaN."""
        return self._derived("normals", self._triangles.number_type, 3)

    def _derived(self, name: str, dtype: type, width: int | None = None) -> da.Array:
        axes = {} if width is None else {"new_axis": self.prim_id.ndim}
        chunks = self.prim_id.chunks if width is None else (*self.prim_id.chunks, (width,))
        shape = (0,) * len(chunks)
        placed = () if self._triangles.instances is None else (self.instance_id,)
        return da.map_blocks(
            partial(blocks.derived, digest=self._digest, name=name),
            self.u,
            self.v,
            self.prim_id,
            *placed,
            chunks=chunks,
            meta=np.empty(shape, dtype),
            name=f"raystream-{name}-{dask.base.tokenize(self._digest, self.prim_id.name)}",
            **axes,
        )


class LazyHits(_LazyColumns):
    """The nearest hit of each ray, untraced, in the rays' leading shape S and chunks.

    Attributes
    ----------
    t, u, v : dask.array.Array of shape S, float32
        As `Hits`; float64 of a tracer in that precision.
    prim_id : dask.array.Array of shape S, int32
    status : dask.array.Array of shape S, uint8

    Notes
    -----
    Computing two columns together traces once: ``dask.compute(hits.t, hits.prim_id)``, or
    `compute` for all. Computing them separately traces twice, unless `persist` keeps them on
    the workers.
    """

    def __init__(self, records: da.Array, digest: str, triangles: Store, client: Client) -> None:
        self._records = records
        self._digest, self._triangles, self._client = digest, triangles, client
        self.t, self.u, self.v = (self._column(name) for name in ("t", "u", "v"))
        self.prim_id, self.status = self._column("prim_id"), self._column("status")

    def _column(self, name: str) -> da.Array:
        dtype = self._records.dtype[name]
        return da.map_blocks(
            blocks.column,
            self._records,
            name,
            meta=np.empty((0,) * self._records.ndim, dtype),
            dtype=dtype,
            name=f"raystream-{name}-{self._records.name}",
        )

    def _placed(self) -> da.Array:
        return self._column("instance_id")

    @property
    def shape(self) -> tuple[int, ...]:
        """The rays' leading shape."""
        return self._records.shape

    @property
    def is_hit(self) -> da.Array:
        """Whether each ray hit anything, shape S, bool."""
        return self.prim_id >= 0

    def compute(self, **options: Any) -> Hits:
        """Trace the rays and return the hits.

        Parameters
        ----------
        **options
            Options of Dask's ``compute``; runs on the tracer's cluster unless ``scheduler``
            is given.
        """
        (records,) = dask.compute(self._records, **self._compute_options(options))
        t, u, v, prim_id, *placed, status = (
            blocks.column(np.asarray(records), name) for name in self._records.dtype.names
        )
        instance_id = placed[0] if placed else None
        return Hits(t, u, v, prim_id, status, self._triangles, instance_id=instance_id)

    def persist(self, **options: Any) -> LazyHits:
        """Trace the rays and keep the hits on the workers."""
        (records,) = dask.persist(self._records, **self._compute_options(options))
        return LazyHits(records, self._digest, self._triangles, self._client)

    def __repr__(self) -> str:
        return f"LazyHits(shape={self.shape}, chunks={self._records.numblocks})"


class LazyMultiHits(_LazyColumns):
    """All hits of each ray, untraced, as rows delimited by `ray_splits`.

    Attributes
    ----------
    ray_splits : dask.array.Array of shape (N + 1,), int64
        As `MultiHits`; rays are numbered in the C order of their leading shape.
    t, u, v : dask.array.Array of shape (nan,), float32 or float64
        One chunk per chunk of rays; their numbers of rows are unknown until computed.
    prim_id : dask.array.Array of shape (nan,), int32
    counts : dask.array.Array of shape S, int64
    status : dask.array.Array of shape S, uint8
    """

    def __init__(
        self,
        found: da.Array,
        lengths: tuple[int, ...],
        shape: tuple[int, ...],
        digest: str,
        triangles: Store,
        client: Client,
    ) -> None:
        self._found, self._lengths = found, lengths
        self._shape = shape
        self._digest, self._triangles, self._client = digest, triangles, client
        self._unknown, kind = (math.nan,) * len(lengths), triangles.number_type
        self.t, self.u, self.v = (self._rows(name, kind, self._unknown) for name in "tuv")
        self.prim_id = self._rows("prim_id", np.int32, self._unknown)
        counts = self._rows("counts", np.int64, lengths)
        zero = da.zeros(1, dtype=np.int64, chunks=1)
        self.ray_splits = da.concatenate([zero, da.cumsum(counts, axis=0, dtype=np.int64)])
        self.counts = counts.reshape(shape)
        self.status = self._rows("status", np.uint8, lengths).reshape(shape)

    def _rows(self, name: str, dtype: type, lengths: tuple[float, ...]) -> da.Array:
        return da.map_blocks(
            blocks.rows,
            self._found,
            name,
            chunks=(lengths,),
            meta=np.empty(0, dtype),
            dtype=dtype,
            name=f"raystream-{name}-{self._found.name}",
        )

    def _placed(self) -> da.Array:
        return self._rows("instance_id", np.int32, self._unknown)

    def compute(self, **options: Any) -> MultiHits:
        """Trace the rays and return the hits.

        Parameters
        ----------
        **options
            Options of Dask's ``compute``; runs on the tracer's cluster unless ``scheduler``
            is given.
        """
        (found,) = dask.compute(self._found, **self._compute_options(options))
        parts = list(found)
        counts = np.concatenate([part["counts"] for part in parts])
        splits = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        t, u, v, prim_id, *placed = (
            np.concatenate([part[name] for part in parts])
            for name in blocks.columns_of(self._triangles)
        )
        status = np.concatenate([part["status"] for part in parts]).reshape(self._shape)
        instance_id = placed[0] if placed else None
        return MultiHits(splits, t, u, v, prim_id, status, self._triangles, instance_id)

    def persist(self, **options: Any) -> LazyMultiHits:
        """Trace the rays and keep the hits on the workers."""
        (found,) = dask.persist(self._found, **self._compute_options(options))
        source = self._digest, self._triangles, self._client
        return LazyMultiHits(found, self._lengths, self._shape, *source)

    def __repr__(self) -> str:
        return f"LazyMultiHits(rays={self._shape}, chunks={len(self._lengths)})"
