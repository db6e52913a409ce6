"""Operations of filters on rows: skip, count, keep in order, copy to a ray's output."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.rays import as_host_array, as_integers
from raystream.jit.constants import BYTES_32, ONE_U64
from raystream.jit.cpu import device
from raystream.jit.simd import load, store
from raystream.kernels.search import ROW_NUMBER, ROW_SHIFT

_NOWHERE = np.uint64(0)
_LONG = np.uint64(8)


class SkipsAt(NamedTuple):
    """Address of the triangles that rays skip; the caller keeps them alive.

    Attributes
    ----------
    prim_ids : uint64
        Address of the first ray's, int32; -1 skips nothing. In a scene with instances, of pairs: a
        prim_id and an instance_id, where -1 is all instances.
    width : uint64
        Triangles, or pairs, per ray.
    """

    prim_ids: np.uint64
    width: np.uint64

    @classmethod
    def of(cls, prim_ids: NDArray[np.int32]) -> SkipsAt:
        """The address of an array of shape (N, k), or of pairs, (N, k, 2)."""
        return cls(np.uint64(prim_ids.ctypes.data), np.uint64(prim_ids.shape[1]))

    @classmethod
    def nowhere(cls) -> SkipsAt:
        """No triangles."""
        return cls(_NOWHERE, _NOWHERE)


def as_skips(values: Any, shape: tuple[int, ...], triangle_count: int) -> NDArray[np.int32]:
    """Check `skip_prim_ids` and turn it into an array of shape (N, k).

    Raises
    ------
    ValueError, TypeError
        If its shape is neither the rays' nor has one dimension more, or its values are neither
        triangles of the scene nor -1.
    """
    given = as_integers("skip_prim_ids", values)
    if given.shape != shape and given.shape[:-1] != shape:
        raise ValueError(
            f"skip_prim_ids: expected the rays' shape {shape}, or {shape} + (k,), got {given.shape}"
        )
    if given.size and not (given.min() >= -1 and given.max() < triangle_count):
        raise ValueError(
            f"skip_prim_ids: expected -1 or a prim_id below {triangle_count}, "
            f"got {given.min()} to {given.max()}"
        )
    width = 1 if given.shape == shape else given.shape[-1]
    count = int(np.prod(shape, dtype=np.int64))
    return np.ascontiguousarray(given, np.int32).reshape(count, width)


def prim_ids_of(skipped: Any) -> Any:
    """`skip_prim_ids` as an array: the triangles of hits, or what is given."""
    return skipped.prim_id if _are_hits(skipped) else skipped


def _are_hits(skipped: Any) -> bool:
    """Whether they are the nearest hits of rays, here, in another library or on a GPU."""
    return hasattr(skipped, "prim_id") and not hasattr(skipped, "ray_splits")


def skipped_triangles(
    skipped: Any, shape: tuple[int, ...], triangles: Any
) -> NDArray[np.int32] | None:
    """Check `skip_prim_ids` of a query of rays of a leading shape.

    Parameters
    ----------
    skipped : array_like of shape S or S + (k,), int, or Hits of shape S, or None
    shape : tuple of int
    triangles : Store

    Returns
    -------
    ndarray of shape (N, k), int32, or None
        Triangles; -1 skips nothing. With instances, of shape (N, k, 2): prim_id and instance_id,
        -1 for all instances.

    Raises
    ------
    ValueError, TypeError
        See `as_skips`; or if the instances of hits are not the scene's.
    """
    if skipped is None:
        return None
    prim_ids = as_skips(prim_ids_of(skipped), shape, len(triangles))
    if triangles.instances is None:
        return prim_ids
    pairs = np.full((*prim_ids.shape, 2), -1, np.int32)
    pairs[:, :, 0] = prim_ids
    if _are_hits(skipped):
        instance_id = as_host_array("skip_prim_ids", skipped.instance_id).reshape(prim_ids.shape)
        if instance_id.max(initial=-1) >= len(triangles.instances):
            raise ValueError("skip_prim_ids: the hits are of another scene than the tracer's")
        pairs[:, :, 1] = np.where(prim_ids < 0, -1, instance_id)
    return pairs


@device
def is_skipped(skips, ray, hit):
    """Whether a ray skips the triangle of a hit."""
    at = skips.prim_ids + ray * skips.width * BYTES_32
    end = at + skips.width * BYTES_32
    while at != end:
        if load(np.int32, at) == hit.prim_id:
            return True
        at += BYTES_32
    return False


@device
def _copy_row(rows, row, out, to):
    at, target = row << ROW_SHIFT, to << ROW_SHIFT
    store(out.t + target, load(ROW_NUMBER, rows.t + at))
    store(out.u + target, load(ROW_NUMBER, rows.u + at))
    store(out.v + target, load(ROW_NUMBER, rows.v + at))
    store(out.prim_id + to * BYTES_32, load(np.int32, rows.prim_id + row * BYTES_32))


@device
def put_row(out, ray, rows, row):
    """Copy a row to its ray's row of `HitAddresses`, unless it is that row."""
    if rows.prim_id + row * BYTES_32 != out.prim_id + ray * BYTES_32:
        _copy_row(rows, row, out, ray)


@device
def move_row(rows, row, to):
    """Copy a row to an earlier one."""
    if row != to:
        _copy_row(rows, row, rows, to)


@device
def add_one(counts, ray):
    """Add 1 to a ray's count and return it; `counts` is the address of the first ray's."""
    at = counts + ray * _LONG
    count = load(np.int64, at) + np.int64(1)
    store(at, count)
    return count


@device
def keep_row(out, splits, found, ray, rows, row):
    """Append a row to those of a ray in `HitAddresses`, and count it.

    Parameters
    ----------
    out : HitAddresses
    splits : uint64
        Address of the rays' first rows, int64; 0 if rows are only counted.
    found : uint64
        Address of the rays' counts, int64.

    Returns
    -------
    int64
        The new count.
    """
    count = add_one(found, ray)
    if splits != _NOWHERE:
        _copy_row(rows, row, out, np.uint64(load(np.int64, splits + ray * _LONG) + count) - ONE_U64)
    return count
