"""Arrays of hits, and the heap that keeps the nearest hits of a ray.

Hits are ordered by t, then prim_id, so the order never depends on the traversal.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.cpu import device, device_call, kernel
from raystream.jit.simd import address, load, store

__all__ = [
    "HitAddresses",
    "HitArrays",
    "aligned_rows",
    "copy_rows",
    "count_rows",
    "hit_addresses",
    "keep_hit",
    "place_rows",
    "sort_hits",
]

_ONE = np.uint64(1)
_WORD = np.uint64(2)  # a number's four bytes, as a shift


class HitArrays(NamedTuple):
    """Hits in memory, a column for each attribute.

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

    def copy_of(self, rows: slice) -> HitArrays:
        """Copies of some rows."""
        t, u, v, prim_id = self.part(rows)
        return HitArrays(t.copy(), u.copy(), v.copy(), prim_id.copy())

    @classmethod
    def empty(cls, count: int) -> HitArrays:
        """Uninitialised arrays for `count` hits, as parts of one allocation.

        NumPy requests huge pages for allocations above 4 MB only.
        """
        return cls.rows_of(np.empty((4, count), np.float32))

    @classmethod
    def rows_of(cls, memory: NDArray[np.float32]) -> HitArrays:
        """The rows of an array of shape (4, K) as t, u, v and prim_id."""
        t, u, v, bits = memory
        return cls(t, u, v, bits.view(np.int32))


#: Rows of at least this many hits are aligned to cache lines.
_LONG_ROWS = 4096


def aligned_rows(count: int) -> NDArray[np.float32]:
    """Uninitialised array of shape (4, count), for `HitArrays.rows_of`.

    Long rows begin at multiples of 64 bytes, so that kernels can write whole cache lines
    past the cache.
    """
    if count < _LONG_ROWS:
        return np.empty((4, count), np.float32)
    stride = -(-count // 16) * 16
    memory = np.empty(4 * stride + 16, np.float32)
    skipped = -memory.ctypes.data % 64 // 4
    return memory[skipped : skipped + 4 * stride].reshape(4, stride)[:, :count]


class HitAddresses(NamedTuple):
    """`HitArrays` for traversals, as addresses: passing an array costs two atomic operations.

    Attributes
    ----------
    t, u, v, prim_id : uint64
        Addresses of the first hit's numbers.
    """

    t: np.uint64
    u: np.uint64
    v: np.uint64
    prim_id: np.uint64

    @classmethod
    def of(cls, hits: HitArrays) -> HitAddresses:
        """Addresses of hits; the caller keeps the arrays alive."""
        return cls(*np.array([one.ctypes.data for one in hits], np.uint64))

    @classmethod
    def of_rows(cls, address: np.uint64, count: int) -> HitAddresses:
        """Addresses of the rows of an array of shape (4, count)."""
        return cls(*(address + np.uint64(4 * count * k) for k in range(4)))


@device
def hit_addresses(out):
    """`HitAddresses` of a kernel's `HitArrays`, which its caller keeps alive."""
    return HitAddresses(address(out.t), address(out.u), address(out.v), address(out.prim_id))


@device
def _t_of(out, row):
    return load(np.float32, out.t + (row << _WORD))


@device
def _prim_id_of(out, row):
    return load(np.int32, out.prim_id + (row << _WORD))


@device
def _put(out, row, t, u, v, prim_id):
    at = row << _WORD
    store(out.t + at, t)
    store(out.u + at, u)
    store(out.v + at, v)
    store(out.prim_id + at, prim_id)


@device
def _get(out, row):
    at = row << _WORD
    return (
        load(np.float32, out.t + at),
        load(np.float32, out.u + at),
        load(np.float32, out.v + at),
        load(np.int32, out.prim_id + at),
    )


@device
def _before(t, prim_id, other_t, other_prim_id):
    return t < other_t or (t == other_t and prim_id < other_prim_id)


@device
def _sift_down(out, first, count, hole, t, u, v, prim_id):
    """Insert a hit into a max-heap, starting at an empty node."""
    while True:
        child = hole + hole + _ONE
        if child >= count:
            break
        at = first + child
        if child + _ONE < count and _before(
            _t_of(out, at), _prim_id_of(out, at), _t_of(out, at + _ONE), _prim_id_of(out, at + _ONE)
        ):
            child += _ONE
            at += _ONE
        if not _before(t, prim_id, _t_of(out, at), _prim_id_of(out, at)):
            break
        t_, u_, v_, prim_id_ = _get(out, at)
        _put(out, first + hole, t_, u_, v_, prim_id_)
        hole = child
    _put(out, first + hole, t, u, v, prim_id)


@device_call
def keep_hit(out, first, count, capacity, t, u, v, prim_id, t_far):
    """Keep a hit if it is among the `capacity` nearest ones so far.

    Parameters
    ----------
    out : HitAddresses
        Rows first to first + count hold the hits kept: a max-heap once there are `capacity`
        of them, in no order before.
    first, count, capacity : uint64
        The ray's first row, its rows in use, and all its rows (at least 1).
    t, u, v : float32
    prim_id : int32
    t_far : float32
        Hits beyond are not wanted.

    Returns
    -------
    count : uint64
        Rows in use now.
    t_far : float32
        Hits beyond are not wanted any more.
    """
    if count == capacity:
        if _before(t, prim_id, _t_of(out, first), _prim_id_of(out, first)):
            _sift_down(out, first, count, np.uint64(0), t, u, v, prim_id)
        return count, _t_of(out, first)
    _put(out, first + count, t, u, v, prim_id)
    count += _ONE
    if count == capacity:
        _make_heap(out, first, count)
        t_far = _t_of(out, first)
    return count, t_far


@device
def _make_heap(out, first, count):
    hole = count >> _ONE
    while hole != np.uint64(0):
        hole -= _ONE
        t, u, v, prim_id = _get(out, first + hole)
        _sift_down(out, first, count, hole, t, u, v, prim_id)


@device_call
def sort_hits(out, first, count):
    """Sort rows first to first + count, in any order, by t, then prim_id."""
    _make_heap(out, first, count)
    last = count
    while last > _ONE:
        last -= _ONE
        t, u, v, prim_id = _get(out, first + last)
        t_, u_, v_, prim_id_ = _get(out, first)
        _put(out, first + last, t_, u_, v_, prim_id_)
        _sift_down(out, first, last, np.uint64(0), t, u, v, prim_id)


@kernel
def copy_rows(begin, end, rows, firsts, counts, starts, out):
    """Copy ``counts[i]`` rows, from row ``firsts[i]`` to row ``starts[i]`` of `out`.

    Parameters
    ----------
    begin, end : int
    rows, out : HitArrays
    firsts, counts, starts : ndarray of shape (N,), int64
    """
    for i in range(np.uint64(begin), np.uint64(end)):
        row, to = np.uint64(firsts[i]), np.uint64(starts[i])
        for _ in range(np.uint64(counts[i])):
            out.t[to] = rows.t[row]
            out.u[to] = rows.u[row]
            out.v[to] = rows.v[row]
            out.prim_id[to] = rows.prim_id[row]
            row += _ONE
            to += _ONE


@kernel
def count_rows(splits, ids, first, counts):
    """Add the hits of some rays to the rays' counts.

    Parameters
    ----------
    splits : ndarray of shape (n + 1,), int64
        The i-th ray's rows are splits[i] to splits[i + 1].
    ids : ndarray of shape (n,), int64
        The rays' indices; empty if they are consecutive.
    first : int
        The first one's index, if they are consecutive.
    counts : ndarray of shape (N,), int64
        Changed in place.
    """
    for i in range(np.uint64(len(splits) - 1)):
        ray = np.uint64(ids[i]) if len(ids) else np.uint64(first) + i
        counts[ray] += splits[i + _ONE] - splits[i]


@kernel
def place_rows(rows, splits, ids, first, nexts, out):
    """Scatter the hits of some rays to their rows of the whole result.

    Parameters
    ----------
    rows, out : HitArrays
    splits, ids, first
        See `count_rows`.
    nexts : ndarray of shape (N,), int64
        The next free row of each ray in `out`; advanced.
    """
    for i in range(np.uint64(len(splits) - 1)):
        ray = np.uint64(ids[i]) if len(ids) else np.uint64(first) + i
        to = np.uint64(nexts[ray])
        for row in range(np.uint64(splits[i]), np.uint64(splits[i + _ONE])):
            out.t[to] = rows.t[row]
            out.u[to] = rows.u[row]
            out.v[to] = rows.v[row]
            out.prim_id[to] = rows.prim_id[row]
            to += _ONE
        nexts[ray] = np.int64(to)
