"""Parts of a batch on the host: copied to a device, traced and copied back, by turns."""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.query import Query
from raystream.core.rays import RayBatch
from raystream.cuda.ray_order import sort_rays
from raystream.cuda.rays import place_rays
from raystream.cuda.staging import StagingStream, StagingStreams
from raystream.cuda.structures import Resident
from raystream.cuda.threads import SeenTables
from raystream.jit.cuda import DeviceArray, Gpu, RangeKernel
from raystream.jit.threads import Progress
from raystream.kernels.hits import Sink
from raystream.kernels.ray import SceneFrame
from raystream.kernels.search import LEAST_ROOM

__all__ = [
    "GROWTH",
    "NO_TABLES",
    "TABLE_BYTES",
    "Answer",
    "HostQuery",
    "Part",
    "parts_of",
    "trace_parts",
]

#: Hits of a part; a ray with more is traced by itself.
_ROWS_AT_ONCE = 1 << 22

#: Bytes of a part's tables of triangles seen.
TABLE_BYTES = 1 << 28

#: How much more room rays get whose table was too small.
GROWTH = 8

NO_TABLES = SeenTables(np.uint64(0), np.uint64(0))


class HostQuery(NamedTuple):
    """A query of rays in the host's memory.

    Attributes
    ----------
    query : Query
    batch : RayBatch
    frame : SceneFrame
    sink : Sink
        Its status and tallies are written part by part.
    progress : callable or None
    """

    query: Query
    batch: RayBatch
    frame: SceneFrame
    sink: Sink
    progress: Progress | None


class Part:
    """Some rays of a batch on a device: what is begun here is done after `finish`.

    Parameters
    ----------
    job : HostQuery
    rows : slice
        Which.
    gpu : Gpu
    resident : Resident
        The structure.
    staging : StagingStream
        Whose memory the rays and answers go through.
    is_sorted : bool
        Whether kernels take the rays in the order of their keys, see `ray_order`.

    Attributes
    ----------
    rows : slice
    count : int
    staging : StagingStream
    status : uint64
        Address of the rays' status, one byte each.

    Raises
    ------
    CudaError
        If there is no memory for them.
    """

    def __init__(
        self,
        job: HostQuery,
        rows: slice,
        gpu: Gpu,
        resident: Resident,
        staging: StagingStream,
        is_sorted: bool = False,
    ) -> None:
        self.rows = rows
        self.count = rows.stop - rows.start
        self.staging = staging
        self._job, self._gpu, self._resident = job, gpu, resident
        staging.begin()
        self._rays = place_rays(job.batch, rows, staging.upload)
        self._status = staging.upload("status", job.sink.status[rows])
        self.status = self._status.address
        self._tallies = None
        if job.sink.tallies is not None:
            shape = self.count, job.sink.tallies.shape[1]
            self._tallies = staging.cleared("tallies", shape, np.uint32)
        self._kept: list[DeviceArray] = []
        self._returned: list[NDArray[Any]] = []
        self._order: tuple[DeviceArray, ...] = ()
        if is_sorted:
            rays = self._rays.source, self.count, job.frame
            self._order = (sort_rays(gpu, *rays, staging.empty, staging.stream),)

    def empty(self, name: str, shape: Any, dtype: Any) -> DeviceArray:
        """Make an array on the device that exists as long as the part; not initialised."""
        made = self.staging.empty(name, shape, dtype)
        self._kept.append(made)
        return made

    def upload(self, name: str, array: NDArray[Any]) -> DeviceArray:
        """Copy an array to the device that exists as long as the part."""
        made = self.staging.upload(name, array)
        self._kept.append(made)
        return made

    def run(self, kernel: RangeKernel, *arguments: Any) -> None:
        """Run a kernel of `threads.ThreadQueries` for each ray; does not wait."""
        tallies = None if self._tallies is None else self._tallies.address
        order = (one.address for one in self._order)
        shared = *order, self._rays.source, self._job.frame, self._resident.tree, tallies
        stream = self.staging.stream.native
        kernel.launch(self._gpu, self.count, (*shared, *arguments), stream)

    def bring_back(self) -> None:
        """Begin to copy what became of the rays, and what they met, to the host."""
        self._returned = [
            self.staging.download(one) for one in (self._status, self._tallies) if one is not None
        ]

    def finish(self, take: Callable[[], bool]) -> bool:
        """Wait for the part, and hand over what was brought back.

        Parameters
        ----------
        take : callable
            Takes what was found; False if that is not all.
        """
        self.staging.finish()
        if not take():
            return False
        status, *tallies = self._returned
        self._job.sink.status[self.rows] = status
        for own in tallies:
            assert self._job.sink.tallies is not None
            self._job.sink.tallies[self.rows] += own
        return True


def parts_of(
    rows: slice,
    most: int,
    splits: NDArray[np.int64] | None = None,
    rows_at_once: int = _ROWS_AT_ONCE,
) -> Iterator[slice]:
    """Rows by so many; of rays with hits, so that these fit, or one ray that has too many."""
    begin = rows.start
    while begin < rows.stop:
        end = min(begin + most, rows.stop)
        if splits is not None:
            fits = int(np.searchsorted(splits, splits[begin] + rows_at_once, "right")) - 1
            end = min(end, max(fits, begin + 1))
        yield slice(begin, end)
        begin = end


#: Begins to trace a part, with tables of triangles seen, and returns what takes the answers when
#: they are there: False if some ray's table was too small.
Answer = Callable[[Part, SeenTables], Callable[[], bool]]


def trace_parts(
    job: HostQuery,
    gpu: Gpu,
    resident: Resident,
    staging_streams: StagingStreams,
    rays_at_once: int,
    answer: Answer,
    *,
    is_sorted: bool = False,
    has_duplicates: bool = False,
    splits: NDArray[np.int64] | None = None,
) -> None:
    """Trace all rays of a query, some at a time: while some are traced, others are copied.

    Parameters
    ----------
    job : HostQuery
    gpu : Gpu
    resident : Resident
    staging_streams : StagingStreams
        What they are copied through.
    rays_at_once : int
        Most rays that are on the device together.
    answer : Answer
        A part whose tables were too small is traced again with larger ones.
    is_sorted : bool
        See `Part`.
    has_duplicates : bool
        Whether rays need tables.
    splits : ndarray of shape (N + 1,), int64, optional
        Rows of hits for which there must be room.

    Raises
    ------
    CudaError
        If there is no memory, or the device fails.
    """

    def parts(rows: slice, room: int) -> Iterator[slice]:
        most = max(rays_at_once // len(turns), 1)
        if room:
            most = max(min(most, TABLE_BYTES // (4 * room + 4)), 1)
        return parts_of(rows, most, splits)

    def begin(
        rows: slice, room: int, staging: StagingStream
    ) -> tuple[Part, int, Callable[[], bool]]:
        part = Part(job, rows, gpu, resident, staging, is_sorted)
        tables = NO_TABLES
        if room:
            memory = part.empty("tables of triangles seen", (part.count, room + 1), np.int32)
            tables = SeenTables(memory.address, np.uint64(room))
        take = answer(part, tables)
        part.bring_back()
        return part, room, take

    def finish(part: Part, room: int, take: Callable[[], bool]) -> None:
        if not part.finish(take):
            for rows in parts(part.rows, GROWTH * room):
                finish(*begin(rows, GROWTH * room, part.staging))
        elif job.progress:
            job.progress(part.rows.stop, len(job.batch))

    with staging_streams.taken() as turns:
        begun: deque[tuple[Part, int, Callable[[], bool]]] = deque()
        room = int(LEAST_ROOM) if has_duplicates else 0
        for rows, staging in zip(
            parts(slice(0, len(job.batch)), room), itertools.cycle(turns), strict=False
        ):
            if len(begun) == len(turns):
                finish(*begun.popleft())
            begun.append(begin(rows, room, staging))
        while begun:
            finish(*begun.popleft())
