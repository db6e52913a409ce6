"""Blocks: what a worker does with one chunk of rays, and with one chunk of what was found."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.cluster.fetching import tracer_of
from raystream.cluster.shares import own_share
from raystream.core.hits import Hits

__all__ = ["COLUMNS", "RECORD", "any_block", "count_block", "derived", "first_block", "many_block"]

#: A first hit, as it travels.
RECORD = np.dtype([("t", "f4"), ("u", "f4"), ("v", "f4"), ("prim_id", "i4"), ("status", "u1")])

#: The columns of rows of hits, and their dtypes.
COLUMNS = {"t": np.float32, "u": np.float32, "v": np.float32, "prim_id": np.int32}


def _ask(digest: str, query: str, arrays: tuple[Any, ...], limits: Any, options: Any) -> Any:
    """Ask a parcel's tracer about a chunk of rays.

    Parameters
    ----------
    digest, query : str
    arrays : tuple of ndarray
        Origins, directions, and the limits that are arrays, which end in an axis of 1.
    limits : dict of str to float or None
        None for those that come as arrays, in this order.
    options : dict
        Of the query.
    """
    origins, directions, *rest = arrays
    given = iter(rest)
    asked = {name: next(given)[..., 0] if v is None else v for name, v in limits.items()}
    with own_share():
        return getattr(tracer_of(digest), query)(origins, directions, **asked, **options)


def first_block(*arrays: Any, digest: str, limits: Any, options: Any) -> NDArray[np.void]:
    """Records of the first hits of a chunk of rays, of its leading shape."""
    hits = _ask(digest, "first_hit", arrays, limits, options)
    records = np.empty(hits.t.shape, RECORD)
    for name in RECORD.names or ():
        records[name] = getattr(hits, name)
    return records


def any_block(*arrays: Any, digest: str, limits: Any, options: Any) -> NDArray[np.bool_]:
    """Whether anything is in the way of a chunk's rays."""
    return np.asarray(_ask(digest, "any_hit", arrays, limits, options))


def count_block(*arrays: Any, digest: str, limits: Any, options: Any) -> NDArray[np.int64]:
    """Counts of the hits of a chunk's rays."""
    return np.asarray(_ask(digest, "count_hits", arrays, limits, options))


def many_block(*arrays: Any, digest: str, limits: Any, options: Any) -> NDArray[np.object_]:
    """All hits of a chunk of N rays: an array of one, a dict of arrays."""
    many = _ask(digest, "multi_hit", arrays, limits, options)
    found = {name: getattr(many, name) for name in COLUMNS}
    found |= {"counts": many.counts.reshape(-1), "status": many.status.reshape(-1)}
    block = np.empty(1, np.object_)
    block[0] = found
    return block


def column(records: NDArray[Any], name: str) -> NDArray[Any]:
    """A column of first hits."""
    return np.ascontiguousarray(records[name]).reshape(records.shape)


def rows(block: NDArray[np.object_], name: str) -> NDArray[Any]:
    """A column of what `many_block` found."""
    found: NDArray[Any] = block[0][name]
    return found


def derived(*columns: NDArray[Any], digest: str, name: str) -> NDArray[Any]:
    """What follows from hits' columns and the triangles: positions, normals, mesh_id, ...

    Parameters
    ----------
    *columns : ndarray
        u, v and prim_id.
    """
    u, v, prim_id = columns
    triangles = tracer_of(digest).structure.triangles
    nothing = np.empty(prim_id.shape, np.float32)
    hits = Hits(nothing, u, v, prim_id, np.empty(prim_id.shape, np.uint8), triangles)
    found: NDArray[Any] = getattr(hits, name)
    return found


#: What makes chunks of answers of each query, and of what dtype.
BLOCKS: dict[str, tuple[Callable[..., NDArray[Any]], np.dtype[Any]]] = {
    "first_hit": (first_block, RECORD),
    "any_hit": (any_block, np.dtype(np.bool_)),
    "count_hits": (count_block, np.dtype(np.int64)),
    "multi_hit": (many_block, np.dtype(np.object_)),
}
