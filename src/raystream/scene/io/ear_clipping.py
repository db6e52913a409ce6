"""Ear clipping: cuts polygons that are not convex into triangles, many polygons at once."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

#: Twice the area of a triangle, in a box of size 1, that counts as none: a few roundings.
_FLAT = 2.0**-49

#: Edges cross if their ends lie on either side of each other by more than this, as twice an area
#: in a box of size 1. Coordinates in files are rounded: a hole may touch the outline by 1e-7.
_TOUCH = 1e-6

#: Pairs of corners, or of edges, tested at a time.
_BLOCK = 1 << 20

#: Most pairs tested, besides 256 for each corner: seconds. Only polygons made for it need more.
_MAX_PAIRS = 1 << 26

Rows = NDArray[np.int64]
Array = NDArray[np.float64]


def clip_ears(points: Array, counts: Rows) -> tuple[Rows, NDArray[np.bool_]]:
    """Cut polygons into triangles, whatever their shape.

    Parameters
    ----------
    points : ndarray of shape (C, 3), float64
        The corners of all polygons, one polygon after another; finite. A hole is part of the
        outline: an edge leads to it, and the same edge back.
    counts : ndarray of shape (P,), int64
        Corners of each polygon, at least 3.

    Returns
    -------
    triangles : ndarray of shape (T, 3), int64
        Rows of `points`, wound as the polygons: n - 2 for each polygon that was cut, one polygon
        after another. Some have no area if corners are in line.
    is_cut : ndarray of shape (P,), bool
        False for polygons whose outline crosses itself, seen along their normal, and for those
        with no area.

    References
    ----------
    .. [1] Meisters, "Polygons have ears", American Mathematical Monthly 82(6), 1975.
    .. [2] Held, "FIST: Fast Industrial-Strength Triangulation of Polygons", Algorithmica 30, 2001.
    """
    outlines = _Outlines(points, counts)
    is_cut = outlines.has_area & ~outlines.cross_themselves()
    ears = outlines.clip(is_cut)  # clears is_cut where no ear is found
    ears = ears[is_cut[outlines.polygon[ears[:, 1]]]]
    order = np.argsort(outlines.polygon[ears[:, 1]], kind="stable")
    return ears[order], is_cut


class _Outlines:
    """Polygons in their planes: x and y within a box of size 1, counter-clockwise."""

    def __init__(self, points: Array, counts: Rows) -> None:
        firsts = np.cumsum(counts) - counts
        self.polygon = np.repeat(np.arange(len(counts)), counts)
        around = points - points[firsts][self.polygon]
        after = _next_in_run(self.polygon)
        # Newell's normal: twice the area of the outline's shadow on each plane of two axes.
        normals = np.add.reduceat(np.cross(around, around[after]), firsts)
        axis = np.abs(normals).argmax(axis=1)
        heights = np.take_along_axis(normals, axis[:, None], axis=1)[:, 0]
        # The shadow along the largest axis has the coordinates of the file, without rounding.
        turned = heights < 0.0
        first = np.where(turned, axis + 2, axis + 1)[self.polygon] % 3
        second = np.where(turned, axis + 1, axis + 2)[self.polygon] % 3
        rows = np.arange(len(points))
        plane = np.stack([points[rows, first], points[rows, second]])
        low = np.minimum.reduceat(plane, firsts, axis=1)
        size = (np.maximum.reduceat(plane, firsts, axis=1) - low).max(axis=0)
        with np.errstate(all="ignore"):
            self.has_area = np.abs(heights) > _FLAT * size * size
            plane = (plane - low[:, self.polygon]) / size[self.polygon]
        self.x, self.y = plane
        # Sorted by polygon, then by x.
        self.key = self.polygon + 0.25 + 0.5 * np.where(self.has_area[self.polygon], self.x, 0.0)
        self.pairs_left = _MAX_PAIRS + 256 * len(points)

    def turns(self, a: Rows, b: Rows, c: Rows) -> Array:
        """Twice the areas of triangles, above 0 if counter-clockwise."""
        x, y = self.x, self.y
        return (x[b] - x[a]) * (y[c] - y[a]) - (y[b] - y[a]) * (x[c] - x[a])

    def windows(self, keys: Array, low: Array, high: Array) -> tuple[Rows, Rows]:
        """First and last, exclusive, of the sorted keys from `low` to `high`, with a margin."""
        margin = 1e-15 * (1.0 + keys[-1]) if len(keys) else 0.0
        first = np.searchsorted(keys, low - margin, side="left")
        return first, np.searchsorted(keys, high + margin, side="right")

    def pairs(self, first: Rows, end: Rows) -> Iterator[tuple[Rows, Rows]]:
        """Pairs of i and each of first[i] .. end[i] - 1, in blocks; none if they are too many."""
        sizes = np.maximum(end - first, 0)
        before = np.cumsum(sizes)
        self.pairs_left -= int(before[-1]) if len(before) else 0
        if self.pairs_left < 0:
            return
        start = 0
        while start < len(sizes):
            done = int(before[start - 1]) if start else 0
            stop = max(start + 1, int(np.searchsorted(before, done + _BLOCK, side="right")))
            total = int(before[stop - 1]) - done
            part = slice(start, stop)
            own = np.repeat(np.arange(start, stop), sizes[part])
            yield own, np.arange(done, done + total) - (before - sizes)[own] + first[own]
            start = stop

    def cross_themselves(self) -> NDArray[np.bool_]:
        """Which polygons have two edges that cross; True if there are too many to test."""
        found = np.zeros(len(self.has_area), bool)
        begin = np.flatnonzero(self.has_area[self.polygon])
        end = _next_in_run(self.polygon)[begin]
        low, high = (pick(self.key[begin], self.key[end]) for pick in (np.minimum, np.maximum))
        order = np.argsort(low)
        begin, end, low, high = begin[order], end[order], low[order], high[order]
        _, last = self.windows(low, low, high)
        for i, j in self.pairs(np.arange(1, len(low) + 1), last):
            a, b, c, d = begin[i], end[i], begin[j], end[j]
            y = self.y
            meet = np.minimum(y[a], y[b]) <= np.maximum(y[c], y[d])
            meet &= np.minimum(y[c], y[d]) <= np.maximum(y[a], y[b])
            a, b, c, d = a[meet], b[meet], c[meet], d[meet]
            across = _are_opposite(self.turns(a, b, c), self.turns(a, b, d))
            across &= _are_opposite(self.turns(c, d, a), self.turns(c, d, b))
            found[self.polygon[a[across]]] = True
        return found | (self.pairs_left < 0)

    def clip(self, is_cut: NDArray[np.bool_]) -> Rows:
        """Clip ears, round by round, all that are not neighbours at once.

        A corner is an ear if its outline turns left there and no other corner lies in the triangle
        that it makes with its neighbours.
        """
        live = np.flatnonzero(is_cut[self.polygon])
        is_ear, is_new = np.zeros(len(self.x), bool), np.ones(len(self.x), bool)
        was_tried = np.zeros(len(is_cut), bool)
        found = [np.zeros((0, 3), np.int64)]
        while len(live):
            self.pairs_left -= 4 * len(live)  # a round costs as much
            polygon = self.polygon[live]
            after, firsts = _next_in_run(polygon), _run_starts(polygon)
            before = np.empty_like(after)
            before[after] = np.arange(len(after))
            a, c = live[before], live[after]
            turns = self.turns(a, live, c)
            # An ear changes only with its neighbours.
            new = is_new[live]
            is_ear[live[new]] = False
            new &= turns > _FLAT
            is_ear[live[new]] = self._are_empty(a[new], live[new], c[new], live[turns <= _FLAT])
            is_new[live] = False
            ears = is_ear[live]
            if self.pairs_left < 0:
                is_cut[polygon] = False
                break
            sizes = np.diff(firsts, append=len(live))
            run = np.repeat(np.arange(len(firsts)), sizes)
            lost = ~np.logical_or.reduceat(ears, firsts)
            if lost.any():
                # Rounding, or corners in line: all are tested once more, then corners without an
                # area are clipped, one at a time.
                again = lost & ~was_tried[polygon[firsts]]
                was_tried[polygon[firsts[again]]] = True
                is_new[live[again[run]]] = True
                lost &= ~again
                straight = np.flatnonzero(lost[run] & (np.abs(turns) <= _FLAT))
                of, place = np.unique(run[straight], return_index=True)
                ears[straight[place]] = True
                lost[of] = False
                is_cut[polygon[firsts[lost]]] = False
            # Every other ear of a row of ears, so that triangles are not all long and thin.
            rank = np.arange(len(live)) - firsts[run]
            is_last = (rank + 1 == sizes[run]) & (rank % 2 == 0)  # beside the first, also even
            is_even = (rank % 2 == 0) & ~(is_last & ears[after])
            chosen = ears & (is_even | ~(ears[before] | ears[after]))
            found.append(np.stack([a[chosen], live[chosen], c[chosen]], axis=1))
            is_new[a[chosen]] = is_new[c[chosen]] = True
            was_tried[polygon[chosen]] = False
            left = sizes - np.add.reduceat(chosen.astype(np.int64), firsts)
            live = live[~chosen & ((left > 2) & ~lost)[run]]
        return np.concatenate(found)

    def _are_empty(self, a: Rows, b: Rows, c: Rows, others: Rows) -> NDArray[np.bool_]:
        """Whether triangles contain none of the corners where outlines do not turn left.

        If any corner is inside, one of these is. Those at a corner of the triangle do not count:
        both edges that lead to a hole end there.
        """
        x, y, key = self.x, self.y, self.key
        others = others[np.argsort(key[others])]
        low, high = (pick(pick(key[a], key[b]), key[c]) for pick in (np.minimum, np.maximum))
        empty = np.ones(len(a), bool)
        for own, other in self.pairs(*self.windows(key[others], low, high)):
            p, i, j, k = others[other], a[own], b[own], c[own]
            within = (y[p] >= np.minimum(np.minimum(y[i], y[j]), y[k]) - _FLAT) & (
                y[p] <= np.maximum(np.maximum(y[i], y[j]), y[k]) + _FLAT
            )
            for corner in (i, j, k):
                within &= (x[p] != x[corner]) | (y[p] != y[corner])
            own, p, i, j, k = own[within], p[within], i[within], j[within], k[within]
            inside = self.turns(i, j, p) >= -_FLAT
            inside &= self.turns(j, k, p) >= -_FLAT
            inside &= self.turns(k, i, p) >= -_FLAT
            empty[own[inside]] = False
        return empty


def _run_starts(polygon: Rows) -> Rows:
    """Where the runs of equal numbers begin."""
    return np.flatnonzero(np.diff(polygon, prepend=-1))


def _next_in_run(polygon: Rows) -> Rows:
    """The next position of each, in its run; after the last comes the first."""
    after = np.arange(1, len(polygon) + 1)
    firsts = _run_starts(polygon)
    after[np.append(firsts[1:], len(polygon))[: len(firsts)] - 1] = firsts
    return after


def _are_opposite(one: Array, other: Array) -> NDArray[np.bool_]:
    """Whether two turns have different signs, beyond rounding."""
    return (np.minimum(one, other) < -_TOUCH) & (np.maximum(one, other) > _TOUCH)
