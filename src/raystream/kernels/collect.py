"""Keeping the nearest hits of a ray: a heap, sorted at the end.

Hits are ordered by t, then by prim_id, so that the order never depends on the traversal.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.cpu import device, device_call

__all__ = ["HitArrays", "keep_hit", "sort_hits"]


class HitArrays(NamedTuple):
    """Where hits are written.

    Attributes
    ----------
    t, u, v : ndarray of shape (K,), float32
    prim_id : ndarray of shape (K,), int32
    """

    t: NDArray[np.float32]
    u: NDArray[np.float32]
    v: NDArray[np.float32]
    prim_id: NDArray[np.int32]

    def part(self, rows: slice) -> HitArrays:
        """A view of some rows."""
        return HitArrays(self.t[rows], self.u[rows], self.v[rows], self.prim_id[rows])

    @classmethod
    def empty(cls, count: int) -> HitArrays:
        """Make arrays for `count` hits, not initialised."""
        t, u, v = (np.empty(count, np.float32) for _ in range(3))
        return cls(t, u, v, np.empty(count, np.int32))


@device
def _put(out, at, t, u, v, prim_id):
    out.t[at] = t
    out.u[at] = u
    out.v[at] = v
    out.prim_id[at] = prim_id


@device
def _move(out, to, source):
    _put(out, to, out.t[source], out.u[source], out.v[source], out.prim_id[source])


@device
def _before(t, prim_id, other_t, other_prim_id):
    return t < other_t or (t == other_t and prim_id < other_prim_id)


@device
def _sift_down(out, first, count, hole, t, u, v, prim_id):
    """Put a hit into a heap whose root is its last hit, starting at an empty place."""
    while True:
        child = 2 * hole + 1
        if child >= count:
            break
        left = first + child
        if child + 1 < count and _before(
            out.t[left], out.prim_id[left], out.t[left + 1], out.prim_id[left + 1]
        ):
            child += 1
        if not _before(t, prim_id, out.t[first + child], out.prim_id[first + child]):
            break
        _move(out, first + hole, first + child)
        hole = child
    _put(out, first + hole, t, u, v, prim_id)


@device_call
def keep_hit(out, first, count, capacity, t, u, v, prim_id):
    """Offer a hit to the nearest ones kept so far.

    Parameters
    ----------
    out : HitArrays
        Rows first to first + count hold the hits kept, as a heap with the last hit first
        once there are `capacity` of them, and in no order before.
    first, count, capacity : int
        Where the ray's rows begin, how many are used, and how many there are (at least 1).
    t, u, v : float32
    prim_id : int32

    Returns
    -------
    int
        How many are kept now.
    """
    if count == capacity:
        if _before(t, prim_id, out.t[first], out.prim_id[first]):
            _sift_down(out, first, count, 0, t, u, v, prim_id)
        return count
    _put(out, first + count, t, u, v, prim_id)
    count += 1
    if count == capacity:
        _make_heap(out, first, count)
    return count


@device
def _make_heap(out, first, count):
    for hole in range(count // 2 - 1, -1, -1):
        at = first + hole
        _sift_down(out, first, count, hole, out.t[at], out.u[at], out.v[at], out.prim_id[at])


@device_call
def sort_hits(out, first, count):
    """Sort rows first to first + count by t, then prim_id, whatever their order was."""
    _make_heap(out, first, count)
    for last in range(count - 1, 0, -1):
        at = first + last
        t, u, v, prim_id = out.t[at], out.u[at], out.v[at], out.prim_id[at]
        _move(out, at, first)
        _sift_down(out, first, last, 0, t, u, v, prim_id)
