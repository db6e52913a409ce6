"""The compute machine: one ray from start to end in each invocation of a compute shader."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.graphics.adapters import OpenDevice
from raystream.graphics.buffers import Buffer, uniform, upload
from raystream.graphics.forms.base import numbers
from raystream.graphics.pipelines import bind_group, compute_pipeline
from raystream.graphics.queries import RAYS_AT_ONCE, GraphicsQueries
from raystream.graphics.records import RAY_BYTES, ROW, Query, packed_rays
from raystream.kernels.queries import LocalRays
from raystream.structures import Structure

__all__ = ["Compute"]

#: Invocations of a workgroup; see compute.wgsl.
_GROUP_SIZE = 64


class Compute(GraphicsQueries):
    """Traces rays with compute shaders.

    Parameters
    ----------
    structure : Structure
        Built on the CPU; its arrays are copied to the device.
    opened : OpenDevice
    rays_at_once : int
        Most rays of a dispatch.

    Raises
    ------
    GraphicsError
        If there are no shaders for the structure, they do not compile, or it is too large for
        the device.
    """

    def __init__(
        self, structure: Structure, opened: OpenDevice, *, rays_at_once: int = RAYS_AT_ONCE
    ) -> None:
        super().__init__(structure, opened, rays_at_once)
        self._source = self._form.source("compute.wgsl")
        names = (f"{self._form.name}, array {k}" for k in range(len(self._form.arrays)))
        self._arrays = upload(opened, zip(names, self._form.arrays, strict=True))
        self._buffers = {
            name: Buffer(opened, name) for name in ("rays", "wanted", "rows", "counts", "tallies")
        }
        self._pipeline(Query.FIRST_HIT, False, False)  # whatever is wrong is said now

    def _run(
        self,
        query: Query,
        surfaces: bool,
        rays: LocalRays,
        chunk: slice,
        wanted: NDArray[np.uint32],
        row_count: int,
        tallies: NDArray[np.uint32] | None,
    ) -> NDArray[np.uint32]:
        count = len(wanted)
        buffers = self._buffers
        for name, byte_count in (
            ("rays", RAY_BYTES * count),
            ("wanted", wanted.nbytes),
            ("rows", ROW.itemsize * row_count),
            ("counts", 4 * count),
            ("tallies", 0 if tallies is None else 32 * count),
        ):
            buffers[name].reserve(byte_count)
        buffers["rays"].write(packed_rays(rays, chunk))
        buffers["wanted"].write(wanted)
        self._dispatch(self._pipeline(query, surfaces, tallies is not None), count)
        counts = buffers["counts"].read(np.uint32, (count,))
        self._check_ended(counts)
        if tallies is not None:
            tallies[chunk] += buffers["tallies"].read(np.uint32, (count, 8))
        return counts

    def _rows(self, count: int) -> NDArray[Any]:
        return self._buffers["rows"].read(ROW, (count,))

    def _dispatch(self, pipeline: Any, count: int) -> None:
        groups = -(-count // _GROUP_SIZE)
        most = self.opened.limits["max-compute-workgroups-per-dimension"]
        columns = min(groups, most)
        params = numbers(
            self.structure.triangles.extreme, 0, count, columns * _GROUP_SIZE, self._form.budget
        )
        params += bytes(32 - len(params)) + self._form.tree
        shared = [self._buffers[name].binding for name in self._buffers]
        content = {"buffer": (buffer := uniform(self.opened, params)), "size": buffer.size}
        device = self.opened.device
        encoder = device.create_command_encoder()
        run = encoder.begin_compute_pass()
        run.set_pipeline(pipeline)
        run.set_bind_group(0, bind_group(self.opened, pipeline, 0, [content, *shared]))
        own = [buffer.binding for buffer in self._arrays]
        run.set_bind_group(1, bind_group(self.opened, pipeline, 1, own))
        run.dispatch_workgroups(columns, -(-groups // columns))
        run.end()
        device.queue.submit([encoder.finish()])

    def _pipeline(self, query: Query, surfaces: bool, counts: bool) -> Any:
        constants = {
            "QUERY": float(query),
            "SURFACES": float(surfaces),
            "COUNTS": float(counts),
            **self._form.constants,
        }
        name = f"{self._form.name}, {query.name}"
        return compute_pipeline(self.opened, self._source, name, constants)
