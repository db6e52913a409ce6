"""A query of rays in host memory, and the parts of its rays that are traced on a device."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.core.query import Query
from raystream.core.rays import RayBatch
from raystream.cuda.rays import place_rays
from raystream.jit.cuda import Gpu
from raystream.jit.threads import Progress
from raystream.kernels.hits import Sink
from raystream.kernels.ray import SceneFrame

__all__ = ["HostQuery", "QueryPart"]


class HostQuery(NamedTuple):
    """A query of rays in host memory.

    Attributes
    ----------
    query : Query
    batch : RayBatch
    frame : SceneFrame
    sink : Sink
        Status and tallies are written part by part.
    progress : callable or None
    """

    query: Query
    batch: RayBatch
    frame: SceneFrame
    sink: Sink
    progress: Progress | None


class QueryPart:
    """Some rays of a batch on a device.

    Parameters
    ----------
    job : HostQuery
    rows : slice
        Range of the batch.
    gpu : Gpu

    Attributes
    ----------
    rows : slice
    count : int
    status : uint64
        Address of the rays' status, one byte each.
    source : RaySource
    frame : SceneFrame
    tallies : uint64 or None
        Address of the rays' tallies, if they are counted.

    Raises
    ------
    CudaError
        If device memory runs out.
    """

    def __init__(self, job: HostQuery, rows: slice, gpu: Gpu) -> None:
        self.rows = rows
        self.count = rows.stop - rows.start
        self._job, self._gpu = job, gpu
        self._rays = place_rays(job.batch, rows, gpu.upload)
        self._status = gpu.upload("status", job.sink.status[rows])
        self.status = self._status.address
        self.source, self.frame = self._rays.source, job.frame
        self.tallies: np.uint64 | None = None
        if job.sink.tallies is not None:
            zeros = np.zeros((self.count, job.sink.tallies.shape[1]), np.uint32)
            self._tallies = gpu.upload("tallies", zeros)
            self.tallies = self._tallies.address

    def finish(self) -> None:
        """Wait for the device, then copy status and tallies to the host."""
        self._gpu.wait()
        self._job.sink.status[self.rows] = self._status.host()
        if self._job.sink.tallies is not None:
            self._job.sink.tallies[self.rows] += self._tallies.host()
