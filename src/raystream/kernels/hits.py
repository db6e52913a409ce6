"""Keeping the nearest hits of a ray: a heap, sorted at the end.

Hits are ordered by t, then by prim_id, so that the order never depends on the traversal.
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

    def copy_of(self, rows: slice) -> HitArrays:
        """Some rows, in memory of their own."""
        t, u, v, prim_id = self.part(rows)
        return HitArrays(t.copy(), u.copy(), v.copy(), prim_id.copy())

    @classmethod
    def empty(cls, count: int) -> HitArrays:
        """Make arrays for `count` hits, not initialised, as parts of one piece of memory.

        NumPy asks for huge pages for pieces above 4 MB only.
        """
        return cls.rows_of(np.empty((4, count), np.float32))

    @classmethod
    def rows_of(cls, memory: NDArray[np.float32]) -> HitArrays:
        """The rows of an array of shape (4, K) as t, u, v and prim_id."""
        t, u, v, bits = memory
        return cls(t, u, v, bits.view(np.int32))


#: Rows of so many hits are made to begin at a cache line.
_LONG_ROWS = 4096


def aligned_rows(count: int) -> NDArray[np.float32]:
    """An array of shape (4, count), not initialised, for `HitArrays.rows_of`.

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
    """`HitArrays` as traversals take them: passing on an array costs two atomic operations.

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
        """Where hits are; the caller keeps them."""
        return cls(*np.array([one.ctypes.data for one in hits], np.uint64))

    @classmethod
    def of_rows(cls, address: np.uint64, count: int) -> HitAddresses:
        """Where the rows of an array of shape (4, count) at an address are."""
        return cls(*(address + np.uint64(4 * count * k) for k in range(4)))


@device
def hit_addresses(out):
    """Where a kernel's HitArrays are; its caller keeps them alive."""
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
    """Put a hit into a heap whose root is its last hit, starting at an empty place."""
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
    """Offer a hit to the nearest ones kept so far.

    Parameters
    ----------
    out : HitAddresses
        Rows first to first + count hold the hits kept, as a heap with the last hit first
        once there are `capacity` of them, and in no order before.
    first, count, capacity : uint64
        Where the ray's rows begin, how many are used, and how many there are (at least 1).
    t, u, v : float32
    prim_id : int32
    t_far : float32
        Hits beyond are not wanted even if there is room for them.

    Returns
    -------
    count : uint64
        How many are kept now.
    t_far : float32
        Hits beyond are no longer wanted.
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
    """Sort rows first to first + count by t, then prim_id, whatever their order was."""
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
    """Copy ``counts[i]`` rows from ``firsts[i]`` on to those of `out` from ``starts[i]`` on.

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
    """Add the numbers of rows of some rays to their counts.

    Parameters
    ----------
    splits : ndarray of shape (n + 1,), int64
        The i-th ray's rows are splits[i] to splits[i + 1].
    ids : ndarray of shape (n,), int64
        The rays' indices; empty if they follow each other.
    first : int
        The first one's index, if they follow each other.
    counts : ndarray of shape (N,), int64
        Changed.
    """
    for i in range(np.uint64(len(splits) - 1)):
        ray = np.uint64(ids[i]) if len(ids) else np.uint64(first) + i
        counts[ray] += splits[i + _ONE] - splits[i]


@kernel
def place_rows(rows, splits, ids, first, nexts, out):
    """Copy rows of some rays to those of their rays.

    Parameters
    ----------
    rows, out : HitArrays
    splits, ids, first
        See `count_rows`.
    nexts : ndarray of shape (N,), int64
        Where each ray's rows go in `out`; moved on behind them.
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
