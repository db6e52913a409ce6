"""Rays that need tables of the triangles they have met, in parts, until these are large enough."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from raystream.cuda.parts import GROWTH, NO_TABLES, TABLE_BYTES
from raystream.cuda.scan import is_any
from raystream.cuda.threads import RETRY, SeenTables
from raystream.jit.cuda import DeviceArray, StreamScope
from raystream.kernels.search import LEAST_ROOM

__all__ = ["with_tables"]


def with_tables(
    work: StreamScope,
    has_duplicates: bool,
    counts: DeviceArray,
    run: Callable[[SeenTables, int, int], None],
) -> None:
    """Run a kernel for all rays, in parts that have tables, until these are large enough.

    Parameters
    ----------
    work : StreamScope
    has_duplicates : bool
        Whether rays need any; else it runs once.
    counts : DeviceArray of shape (N,), int64
        What the kernel writes: `RETRY` for rays whose table was too small.
    run : callable
        Given the tables, the first ray of a part, and how many.
    """
    ray_count = len(counts)
    if not has_duplicates:
        run(NO_TABLES, 0, ray_count)
        return
    room = int(LEAST_ROOM)
    while True:
        most = max(TABLE_BYTES // (4 * room + 4), 1)
        shape = min(most, ray_count), room + 1
        memory = work.empty("tables of triangles seen", shape, np.int32)
        tables = SeenTables(memory.address, np.uint64(room))
        for first in range(0, ray_count, most):
            run(tables, first, min(most, ray_count - first))
        if not is_any(work, counts, RETRY):
            return
        room *= GROWTH
