"""Parts of a batch: rays that are on a device together."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.rays import RayBatch
from raystream.cuda.rays import place_rays
from raystream.cuda.structures import Resident
from raystream.cuda.threads import SeenTables
from raystream.jit.cuda import Gpu, RangeKernel
from raystream.jit.threads import Progress
from raystream.kernels.local_ray import SceneFrame
from raystream.kernels.seen import LEAST_ROOM

__all__ = ["Asked", "Part", "parts_of", "trace_parts"]

#: Hits that are on the device together; a ray with more is traced by itself.
_ROWS_AT_ONCE = 1 << 24

#: Bytes of the tables of triangles seen that are on the device together.
_TABLE_BYTES = 1 << 28

#: How much more room rays get whose table was too small.
_GROWTH = 8

_NO_TABLES = SeenTables(np.uint64(0), np.uint64(0))


class Asked(NamedTuple):
    """Rays of a query.

    Attributes
    ----------
    batch : RayBatch
    frame : SceneFrame
        Of the rays: the scene's, or the identity's for local ones.
    status : ndarray of shape (N,), uint8
        Is written.
    progress : callable or None
    tallies : ndarray of shape (N, 8), uint32, or None
        What rays meet is added.
    """

    batch: RayBatch
    frame: SceneFrame
    status: NDArray[np.uint8]
    progress: Progress | None
    tallies: NDArray[np.uint32] | None


class Part:
    """Some rays of a batch on a device.

    Parameters
    ----------
    asked : Asked
    rows : slice
        Which.
    gpu : Gpu
    resident : Resident
        The structure.

    Attributes
    ----------
    rows : slice
    count : int
    status : uint64
        Address of the rays' status, one byte each.

    Raises
    ------
    CudaError
        If there is no memory for them.
    """

    def __init__(self, asked: Asked, rows: slice, gpu: Gpu, resident: Resident) -> None:
        self.rows = rows
        self.count = rows.stop - rows.start
        self._asked, self._gpu, self._resident = asked, gpu, resident
        self._rays = place_rays(asked.batch, rows, gpu)
        self._status = gpu.upload("status", asked.status[rows])
        self.status = self._status.address
        self._tallies = None
        if asked.tallies is not None:
            zeros = np.zeros((self.count, asked.tallies.shape[1]), np.uint32)
            self._tallies = gpu.upload("tallies", zeros)

    def run(self, kernel: RangeKernel, *arguments: Any) -> None:
        """Run a kernel of `threads.ThreadQueries` for each ray; does not wait."""
        tallies = None if self._tallies is None else self._tallies.address
        shared = self._rays.source, self._asked.frame, self._resident.tree, tallies
        kernel.launch(self._gpu, self.count, (*shared, *arguments))

    def finish(self) -> None:
        """Hand over what became of the rays, and what they met."""
        self._gpu.wait()
        self._asked.status[self.rows] = self._status.host()
        if self._asked.tallies is not None and self._tallies is not None:
            self._asked.tallies[self.rows] += self._tallies.host()


def parts_of(rows: slice, most: int, splits: NDArray[np.int64] | None = None) -> Iterator[slice]:
    """Rows by so many; of rays with hits, so that these fit, or one ray that has too many."""
    begin = rows.start
    while begin < rows.stop:
        end = min(begin + most, rows.stop)
        if splits is not None:
            fits = int(np.searchsorted(splits, splits[begin] + _ROWS_AT_ONCE, "right")) - 1
            end = min(end, max(fits, begin + 1))
        yield slice(begin, end)
        begin = end


def trace_parts(
    asked: Asked,
    gpu: Gpu,
    resident: Resident,
    rays_at_once: int,
    answer: Callable[[Part, SeenTables], bool],
    *,
    lists_twice: bool = False,
    splits: NDArray[np.int64] | None = None,
) -> None:
    """Trace all rays of a query, some at a time.

    Parameters
    ----------
    asked : Asked
    gpu : Gpu
    resident : Resident
    rays_at_once : int
        Most rays of a part.
    answer : callable
        ``answer(part, tables)`` traces a part and keeps what it found; False if some ray's table
        was too small: the part is then traced again with larger ones.
    lists_twice : bool
        Whether rays need tables.
    splits : ndarray of shape (N + 1,), int64, optional
        Rows of hits for which there must be room.
    """

    def trace(rows: slice, room: int) -> None:
        most = rays_at_once if room == 0 else min(rays_at_once, _TABLE_BYTES // (4 * room + 4))
        for own in parts_of(rows, max(most, 1), splits):
            part = Part(asked, own, gpu, resident)
            tables, memory = _NO_TABLES, None
            if room:
                memory = gpu.empty("tables of triangles seen", (part.count, room + 1), np.int32)
                tables = SeenTables(memory.address, np.uint64(room))
            if answer(part, tables):
                part.finish()
            else:
                del part, memory
                trace(own, _GROWTH * room)
            if asked.progress:
                asked.progress(own.stop, len(asked.batch))

    trace(slice(0, len(asked.batch)), int(LEAST_ROOM) if lists_twice else 0)
