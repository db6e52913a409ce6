"""Sizes of triangles, and choices among them that do not depend on their order."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.triangles import Triangles

#: Triangles handled at once: their columns stay in the cache.
_BLOCK = 1 << 14

#: Odd multipliers of a corner's nine words.
_FACTORS = np.array(
    [
        0x9E3779B1, 0x85EBCA77, 0xC2B2AE3D, 0x27D4EB2F, 0x165667B1,
        0xD3A2646D, 0xFD7046C5, 0xB55A4F09, 0x8CB92BA7,
    ],
    np.uint32,
)  # fmt: skip

#: Which triangles are meant; None for all.
Mask = NDArray[np.bool_] | None


class TriangleSizes(NamedTuple):
    """Bounds and areas of the triangles that can be hit, in their local frame.

    Attributes
    ----------
    prim_ids : ndarray of shape (N,), int32
    low, high : ndarray of shape (3, N), float32
        Corners of each triangle's box.
    areas : ndarray of shape (N,), float32
    keys : ndarray of shape (N,), uint32
        Hashed from the corners: choices made with them do not depend on the triangles' order.
    """

    prim_ids: NDArray[np.int32]
    low: NDArray[np.float32]
    high: NDArray[np.float32]
    areas: NDArray[np.float32]
    keys: NDArray[np.uint32]

    def box(self, mask: Mask = None) -> NDArray[np.float32]:
        """Box around some triangles, at least one: shape (2, 3)."""
        if mask is None:
            return np.stack([self.low.min(axis=1), self.high.max(axis=1)])
        return np.stack(
            [
                np.min(self.low, axis=1, where=mask, initial=np.inf),
                np.max(self.high, axis=1, where=mask, initial=-np.inf),
            ]
        )

    def area(self, mask: Mask = None) -> float:
        """Sum of the areas of some triangles."""
        if mask is None:
            return float(self.areas.sum(dtype=np.float64))
        return float(self.areas.sum(dtype=np.float64, where=mask))

    def largest(self, count: int, mask: Mask = None) -> NDArray[np.float64]:
        """The largest areas of some triangles, at most `count` of them, in decreasing order."""
        kept = np.zeros(0, np.float32)
        for rows in _blocks(len(self.areas)):
            part = self.areas[rows] if mask is None else self.areas[rows][mask[rows]]
            if len(kept) == count:
                part = part[part > kept[-1]]
            if len(part):
                kept = np.sort(np.concatenate([kept, part]))[::-1][:count]
        return kept.astype(np.float64)

    def pick(
        self, rate: float, base: float, limit: float = np.inf, mask: Mask = None
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Pick some triangles, each ``base + rate * min(area, limit)`` times on average.

        Returns
        -------
        chosen, copies : ndarray of shape (K,), int64
            The triangles; and which pick of the same triangle it is, from 0.
        """
        picked, counts = [], []
        for rows in _blocks(len(self.areas)):
            numbers = np.minimum(self.areas[rows], np.float32(limit))
            numbers *= np.float32(rate)
            numbers += np.float32(base)
            numbers += _fractions(self.keys[rows])
            if mask is not None:
                numbers *= mask[rows]
            found = np.flatnonzero(numbers >= 1)
            picked.append(found + rows.start)
            counts.append(numbers[found].astype(np.int64))
        chosen, times = np.concatenate(picked), np.concatenate(counts)
        firsts = np.cumsum(times) - times
        return np.repeat(chosen, times), np.arange(times.sum()) - np.repeat(firsts, times)


def measure(triangles: Triangles) -> TriangleSizes:
    """Measure the triangles that can be hit."""
    prim_ids, corners = triangles.prim_ids, triangles.corners
    count = len(prim_ids)
    is_whole = count == len(corners)
    sizes = TriangleSizes(
        prim_ids,
        np.empty((3, count), np.float32),
        np.empty((3, count), np.float32),
        np.empty(count, np.float32),
        np.empty(count, np.uint32),
    )
    for rows in _blocks(count):
        part = corners[rows] if is_whole else corners[prim_ids[rows]]
        columns = np.ascontiguousarray(part.reshape(-1, 9).T)
        vertices = columns.reshape(3, 3, -1)
        a, b, c = vertices
        sizes.low[:, rows] = np.minimum(np.minimum(a, b), c)
        sizes.high[:, rows] = np.maximum(np.maximum(a, b), c)
        (x1, y1, z1), (x2, y2, z2) = b - a, c - a
        x, y, z = y1 * z2 - z1 * y2, z1 * x2 - x1 * z2, x1 * y2 - y1 * x2
        sizes.areas[rows] = 0.5 * np.sqrt(x * x + y * y + z * z)
        words = columns.view(np.uint32)
        keys = words[0] * _FACTORS[0]
        for word, factor in zip(words[1:], _FACTORS[1:], strict=True):
            keys += word * factor
        sizes.keys[rows] = _mixed(keys)
    return sizes


def fractions_of(keys: NDArray[np.uint32], salt: int) -> NDArray[np.float32]:
    """Turn keys into numbers in [0, 1), other ones for each salt."""
    return _fractions(_mixed(keys ^ np.uint32(salt)))


def _fractions(keys: NDArray[np.uint32]) -> NDArray[np.float32]:
    fractions: NDArray[np.float32] = (keys >> np.uint32(8)).astype(np.float32)
    fractions *= np.float32(2.0**-24)
    return fractions


def _mixed(keys: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """The final steps of MurmurHash3 (Austin Appleby, 2011): all bits depend on all bits."""
    keys = (keys ^ (keys >> np.uint32(16))) * np.uint32(0x85EBCA6B)
    keys = (keys ^ (keys >> np.uint32(13))) * np.uint32(0xC2B2AE35)
    return keys ^ (keys >> np.uint32(16))


def _blocks(count: int) -> list[slice]:
    return [slice(first, min(first + _BLOCK, count)) for first in range(0, count, _BLOCK)]
