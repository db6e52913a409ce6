"""Functions that run on workers: trace a chunk of rays, and read columns of its hits."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.cluster.fetch import tracer_of
from raystream.cluster.thread_budget import shared_threads
from raystream.core.hits import Hits
from raystream.core.store import Store


def columns_of(triangles: Store) -> dict[str, Any]:
    """The columns of hits in transit, and their dtypes."""
    kinds: dict[str, Any] = dict.fromkeys("tuv", triangles.number_type)
    kinds["prim_id"] = np.int32
    if triangles.instances is not None:
        kinds["instance_id"] = np.int32
    return kinds


def record_of(triangles: Store) -> np.dtype[Any]:
    """A first hit in transit."""
    return np.dtype([*columns_of(triangles).items(), ("status", np.uint8)])


def _trace(digest: str, query: str, arrays: tuple[Any, ...], limits: Any, options: Any) -> Any:
    """Run a query of a bundle's tracer on a chunk of rays.

    Parameters
    ----------
    digest, query : str
    arrays : tuple of ndarray
        Origins, directions, and array-valued limits, which end in an axis of 1.
    limits : dict of str to float or None
        None for limits passed as arrays, in this order.
    options : dict
        Options of the query.
    """
    origins, directions, *rest = arrays
    given = iter(rest)
    asked = {name: next(given)[..., 0] if v is None else v for name, v in limits.items()}
    with shared_threads():
        return getattr(tracer_of(digest), query)(origins, directions, **asked, **options)


def first_block(*arrays: Any, digest: str, limits: Any, options: Any) -> NDArray[np.void]:
    """Trace the first hits of a chunk of rays; records of its leading shape."""
    hits = _trace(digest, "first_hit", arrays, limits, options)
    record = record_of(tracer_of(digest).structure.triangles)
    records = np.empty(hits.t.shape, record)
    for name in record.names or ():
        records[name] = getattr(hits, name)
    return records


def any_block(*arrays: Any, digest: str, limits: Any, options: Any) -> NDArray[np.bool_]:
    """Test whether anything is in the way of a chunk's rays."""
    return np.asarray(_trace(digest, "any_hit", arrays, limits, options))


def count_block(*arrays: Any, digest: str, limits: Any, options: Any) -> NDArray[np.int64]:
    """Count the hits of a chunk's rays."""
    return np.asarray(_trace(digest, "count_hits", arrays, limits, options))


def multi_block(*arrays: Any, digest: str, limits: Any, options: Any) -> NDArray[np.object_]:
    """Find all hits of a chunk of N rays: an array of one element, a dict of arrays."""
    many = _trace(digest, "multi_hit", arrays, limits, options)
    found = {n: getattr(many, n) for n in columns_of(tracer_of(digest).structure.triangles)}
    found |= {"counts": many.counts.reshape(-1), "status": many.status.reshape(-1)}
    block = np.empty(1, np.object_)
    block[0] = found
    return block


def column(records: NDArray[Any], name: str) -> NDArray[Any]:
    """Extract a column of first hits."""
    return np.ascontiguousarray(records[name]).reshape(records.shape)


def rows(block: NDArray[np.object_], name: str) -> NDArray[Any]:
    """Extract a column from the result of `multi_block`."""
    return block[0][name]


def derived(*columns: NDArray[Any], digest: str, name: str) -> NDArray[Any]:
    """Derive a property of hits from their columns and the triangles: positions, normals, ...

    Parameters
    ----------
    *columns : ndarray
        u, v and prim_id, and with instances instance_id.
    """
    u, v, prim_id, *placed = columns
    triangles = tracer_of(digest).structure.triangles
    status = np.empty(prim_id.shape, np.uint8)
    return getattr(Hits(u, u, v, prim_id, status, triangles, None, *placed), name)


#: The worker function of each query, and the dtype of its chunks, or a function of the geometry.
BLOCKS: dict[str, tuple[Callable[..., NDArray[Any]], Any]] = {
    "first_hit": (first_block, record_of),
    "any_hit": (any_block, np.dtype(np.bool_)),
    "count_hits": (count_block, np.dtype(np.int64)),
    "multi_hit": (multi_block, np.dtype(np.object_)),
}
