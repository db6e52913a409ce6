"""What a mailbox would save: tests of a triangle that the same ray has tested before."""

from __future__ import annotations

import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from raystream.jit.threads import Progress, parallel_for
from raystream.lab.walks.kernels.count_repeats import count_repeats
from raystream.lab.walks.memory_references import grid_of, roles_of
from raystream.lab.walks.walks import Walks

__all__ = ["RepeatedTests", "repeated_tests"]

#: Rays that a thread takes at a time.
_CHUNK = 1 << 16

#: Most entries of a mailbox.
_MAX_ENTRIES = 1 << 20


@dataclass(frozen=True)
class RepeatedTests:
    """Tests of all rays.

    Attributes
    ----------
    tests : int
    repeats : int
        Of a triangle that the same ray had tested before: all that any mailbox can save.
    saved : mapping of int to int
        Tests that a mailbox of so many entries for each ray saves.
    """

    tests: int
    repeats: int
    saved: Mapping[int, int]


def repeated_tests(
    walks: Walks, *, entries: Sequence[int] = (1, 4, 16, 64), progress: Progress | None = None
) -> RepeatedTests:
    """Count the tests that a mailbox for each ray would save.

    Parameters
    ----------
    walks : Walks
        Through a grid of one level, with visits.
    entries : sequence of int
        Sizes of mailboxes, powers of two. A triangle's result is kept in the entry of its
        prim_id modulo the size, and lost when another one comes there.
    progress : callable, optional
        Called with (rays done, rays).

    Returns
    -------
    RepeatedTests

    Raises
    ------
    ValueError
        If the walks are others, or a size is no power of two, up to 2**20.

    References
    ----------
    Amanatides and Woo, "A Fast Voxel Traversal Algorithm for Ray Tracing", Eurographics 1987;
    Purcell 2002, section 3.1.3, which does without.
    """
    grid = grid_of(walks)
    sizes = [operator.index(size) for size in entries]
    for size in sizes:
        if not 1 <= size <= _MAX_ENTRIES or size & (size - 1):
            raise ValueError(f"entries: expected powers of two up to {_MAX_ENTRIES:,}, got {size}")
    arrays = (
        *(walks.run_splits, walks.run_kernels, walks.run_lengths),
        *(walks.visit_splits, walks.visits),
    )
    counts = np.zeros((-(-len(walks) // _CHUNK) + 1, 2 + len(sizes)), np.int64)

    def count(begin: int, end: int) -> None:
        stamps = np.full(len(grid.triangles), -1, np.int64)
        boxes = tuple(np.empty(size, np.int32) for size in sizes)
        row = counts[begin // _CHUNK]
        count_repeats(begin, end, arrays, grid.lists, roles_of(walks), stamps, boxes, row)

    parallel_for(count, len(walks), _CHUNK, progress)
    tests, repeats, *saved = counts.sum(axis=0).tolist()
    return RepeatedTests(tests, repeats, MappingProxyType(dict(zip(sizes, saved, strict=True))))
