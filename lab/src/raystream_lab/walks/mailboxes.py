"""Savings of mailboxes: repeated tests of a triangle by the same ray."""

from __future__ import annotations

import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from raystream.jit.threads import Progress, parallel_for
from raystream_lab.walks.kernels.count_repeats import count_repeats
from raystream_lab.walks.memory_references import grid_of, roles_of
from raystream_lab.walks.walks import Walks

#: Rays per task of a thread.
_CHUNK = 1 << 16

#: Maximum entries of a mailbox.
_MAX_ENTRIES = 1 << 20


@dataclass(frozen=True)
class RepeatedTests:
    """Tests of all rays, and the repeated ones.

    Attributes
    ----------
    tests : int
    repeats : int
        Tests of a triangle that the same ray had tested before: the most that a mailbox can save.
    saved : mapping of int to int
        Tests saved per ray by mailboxes, by their number of entries.
    """

    tests: int
    repeats: int
    saved: Mapping[int, int]


def repeated_tests(
    walks: Walks, *, entries: Sequence[int] = (1, 4, 16, 64), progress: Progress | None = None
) -> RepeatedTests:
    """Count the tests that a mailbox per ray would save.

    Parameters
    ----------
    walks : Walks
        Through a one-level grid, recorded with visits.
    entries : sequence of int
        Sizes of mailboxes, powers of two. A triangle's result is stored in the entry prim_id modulo
        the size, and lost when another triangle overwrites it.
    progress : callable, optional
        Called with (rays done, rays).

    Returns
    -------
    RepeatedTests

    Raises
    ------
    ValueError
        If the walks are unsuitable, or a size is not a power of two up to 2**20.

    References
    ----------
    Amanatides and Woo, "A Fast Voxel Traversal Algorithm for Ray Tracing", Eurographics 1987;
    Purcell 2002, section 3.1.3, which has no mailbox.
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
