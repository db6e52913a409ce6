"""Solids within solids: which of them segments belong to where several overlap."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.cpu import kernel
from raystream.jit.threads import parallel_for
from raystream.physics.thickness import Segments

#: In place of a segment: none.
_NONE = -1

#: Rays per call of the kernel.
_CHUNK = 1 << 13

#: Pairs of meshes that a warning names.
_MOST_NAMED = 3


class _Pieces(NamedTuple):
    """What is left of segments where others displace them; ray i owns rows from 2 * splits[i].

    Attributes
    ----------
    counts : ndarray of shape (N,), int64
    owner : ndarray of shape (2 K,), int64
        The segment that a piece is a part of.
    after, before : ndarray of shape (2 K,), int64
        The segment at whose end the piece begins, and that at whose beginning it ends; -1 for the
        owner's own ends.
    active : ndarray of shape (K,), int64
        Scratch memory.
    """

    counts: NDArray[np.int64]
    owner: NDArray[np.int64]
    after: NDArray[np.int64]
    before: NDArray[np.int64]
    active: NDArray[np.int64]


def ranks_of(volumes: NDArray[np.float64]) -> NDArray[np.int64]:
    """Order solids: one of a higher rank displaces the others; smaller ones have higher ranks.

    Of equal volumes, rounded to float32, the later solid has the higher rank.
    """
    with np.errstate(over="ignore", under="ignore"):
        order = np.argsort(-volumes.astype(np.float32), kind="stable")
    ranks = np.empty(len(volumes), np.int64)
    ranks[order] = np.arange(len(volumes))
    return ranks


def displaced(
    segments: Segments,
    counts: NDArray[np.int64],
    ranks: NDArray[np.int64],
    overlaps: NDArray[np.uint8],
    lengths: NDArray[np.float64],
) -> tuple[NDArray[np.int64], Segments]:
    """Cut segments so that no two overlap.

    Parameters
    ----------
    segments : Segments
    counts : ndarray of shape (N,), int64
        Segments of each ray.
    ranks : ndarray of shape (K,), int64
        Of each segment's solid; see `ranks_of`.
    overlaps : ndarray of shape (N,), uint8
        The segments of rays where it is 0 stay as they are.
    lengths : ndarray of shape (N,), float64
        Of the rays' directions.

    Returns
    -------
    counts : ndarray of shape (N,), int64
    segments : Segments
    """
    splits = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    count = len(ranks)
    owners, afters, earlier = (np.empty(2 * count, np.int64) for _ in range(3))
    active = np.empty(count, np.int64)
    pieces = _Pieces(np.empty_like(counts), owners, afters, earlier, active)

    def body(begin: int, end: int) -> None:
        ends = segments.t_entry, segments.t_exit
        _displace(begin, end, splits, *ends, ranks, overlaps, pieces)

    parallel_for(body, len(counts), _CHUNK)
    ray = np.repeat(np.arange(len(counts)), pieces.counts)
    firsts = np.cumsum(pieces.counts) - pieces.counts
    rows = 2 * splits[ray] + np.arange(len(ray)) - firsts[ray]
    owner, after, before = pieces.owner[rows], pieces.after[rows], pieces.before[rows]
    t_entry = np.where(after < 0, segments.t_entry[owner], segments.t_exit[after])
    t_exit = np.where(before < 0, segments.t_exit[owner], segments.t_entry[before])
    return pieces.counts, Segments(
        t_entry,
        t_exit,
        (t_exit.astype(np.float64) - t_entry) * lengths[ray],
        segments.mesh_id[owner],
        segments.material_id[owner],
        np.where(after < 0, segments.entry_prim_id[owner], segments.exit_prim_id[after]),
        np.where(before < 0, segments.exit_prim_id[owner], segments.entry_prim_id[before]),
        segments.instance_id[owner],
    )


@kernel
def _displace(begin, end, splits, t_entry, t_exit, ranks, overlaps, pieces):
    """Write the pieces of rays begin to end, in order of entry.

    Parameters
    ----------
    begin, end : int
    splits : ndarray of shape (N + 1,), int64
    t_entry, t_exit : ndarray of shape (K,), float32
    ranks : ndarray of shape (K,), int64
    overlaps : ndarray of shape (N,), uint8
    pieces : _Pieces
        Written.
    """
    owner, after, before, active = pieces.owner, pieces.after, pieces.before, pieces.active
    for i in range(np.uint64(begin), np.uint64(end)):
        first, last = splits[i], splits[i + np.uint64(1)]
        at = 2 * first  # where the next piece goes
        if overlaps[i] == 0:
            for k in range(first, last):
                owner[at], after[at], before[at] = k, _NONE, _NONE
                at += 1
            pieces.counts[i] = last - first
            continue
        # Walk along the ray; `active` are the segments around the place that is reached, `top` is
        # the one of the highest rank, and `slot` its piece.
        top, slot, start, depth = _NONE, at, np.float32(0.0), 0
        k = first
        while k < last or depth > 0:
            leaving = _NONE
            for j in range(first, first + depth):
                if leaving == _NONE or t_exit[active[j]] < t_exit[leaving]:
                    leaving = active[j]
            if k < last and (leaving == _NONE or t_entry[k] < t_exit[leaving]):
                t, entering = t_entry[k], k
                k += 1
                if t_exit[entering] <= t:  # a graze displaces nothing, and stays
                    owner[at], after[at], before[at] = entering, _NONE, _NONE
                    at += 1
                    continue
                active[first + depth] = entering
                depth += 1
            else:
                t, entering = t_exit[leaving], _NONE
                kept = first
                for j in range(first, first + depth):
                    if t_exit[active[j]] > t:
                        active[kept] = active[j]
                        kept += 1
                depth = kept - first
            best = _NONE
            for j in range(first, first + depth):
                if best == _NONE or ranks[active[j]] > ranks[best]:
                    best = active[j]
            if best == top:
                continue
            if top != _NONE:
                before[slot] = entering
                if t <= start and slot == at - 1:
                    at -= 1  # nothing is left of it
            if best != _NONE:
                owner[at], after[at] = best, _NONE if best == entering else top
                slot, start = at, t
                at += 1
            top = best
        pieces.counts[i] = at - 2 * first


def overlap_text(overlaps: Iterable[tuple[int, int]], names: Sequence[str]) -> str:
    """Name pairs of meshes that overlap, some of them if they are many."""
    pairs = sorted(overlaps)

    def named(i: int) -> str:
        return f"{i} ({names[i]!r:.40})" if names[i] else str(i)

    shown = [
        f"{named(a)} and {named(b)}" if a != b else f"two instances of {named(a)}"
        for a, b in pairs[:_MOST_NAMED]
    ]
    if len(pairs) > len(shown):
        shown.append(f"{len(pairs) - len(shown):,} more pairs")
    return (
        f"thickness: meshes overlap, and the lengths in both count: {'; '.join(shown)}. "
        "nested='inner' counts only the smaller one there"
    )
