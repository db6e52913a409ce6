"""RayBlock: rays of a batch in the scene's local frame."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from raystream.core.rays import RayBatch
from raystream.jit.threads import Progress, parts
from raystream.kernels.local_frame import LocalRays, TTransform, to_local_rays, to_world_t
from raystream.kernels.ray import SceneFrame
from raystream.kernels.ray_source import RaySource
from raystream.machines.batch import run_calls
from raystream.structures.batch_kernels import CallSize

#: Rays of a block: bounds all memory but the results, at about 100 bytes per ray.
RAYS_PER_BLOCK = 1 << 20

#: Calls of loops without traversal: about a millisecond.
LIGHT_CALLS = CallSize(1 << 15, 1 << 15)


class RayBlock:
    """Some rays of a batch in a scene's local frame, and the inverse transform of their distances.

    Parameters
    ----------
    batch : RayBatch
    rows : slice
        The range of its rays.
    frame : SceneFrame
    status : ndarray of shape (N,), uint8
        Status of the whole batch; the rows of these rays are written.
    progress : callable, optional
        To be called with (rays of the block done, rays of the block).

    Attributes
    ----------
    rows, progress
        As given.
    rays : LocalRays
    t_transform : TTransform
    """

    def __init__(
        self,
        batch: RayBatch,
        rows: slice,
        frame: SceneFrame,
        status: NDArray[np.uint8],
        progress: Progress | None,
    ) -> None:
        self.rows, self.progress = rows, progress
        count = rows.stop - rows.start
        self.rays = LocalRays.empty(count)
        self.t_transform = TTransform(np.empty(count), np.empty(count))
        limits = batch.t_min[rows], batch.t_max[rows]
        source, kept = RaySource.of(batch.origins[rows], batch.directions[rows], limits)
        calls = to_local_rays, (source, frame, self.rays, self.t_transform, status[rows])
        run_calls(calls, (0, count), LIGHT_CALLS)
        del kept  # the kernel reads it by address

    def part_of(self, tallies: NDArray[np.uint32] | None) -> NDArray[np.uint32] | None:
        """These rays' rows of the batch's tallies, if there are any."""
        return None if tallies is None else tallies[self.rows]

    def to_world(self, t: NDArray[np.float32], splits: NDArray[np.int64]) -> None:
        """Turn rows splits[i] to splits[i + 1] of t, which belong to ray i, to world distances."""
        calls = to_world_t, (splits, self.t_transform, t)
        run_calls(calls, (0, len(splits) - 1), LIGHT_CALLS)


def blocks(
    batch: RayBatch,
    frame: SceneFrame,
    status: NDArray[np.uint8],
    progress: Progress | None,
    make: Callable[..., RayBlock] = RayBlock,
) -> Iterator[RayBlock]:
    """Turn a batch into blocks of local rays, one at a time; `make` is called as `RayBlock` is."""
    for rows, report in parts(len(batch), RAYS_PER_BLOCK, progress):
        yield make(batch, rows, frame, status, report)
