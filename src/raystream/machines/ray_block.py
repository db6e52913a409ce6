"""RayBlock: rays of a batch in the scene's local frame."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from raystream.core.rays import RayBatch
from raystream.jit.threads import Progress
from raystream.kernels.local_frame import LocalRays, TTransform, to_local_rays, to_world_t
from raystream.kernels.ray import SceneFrame
from raystream.kernels.ray_source import RaySource
from raystream.machines.batch import run_calls

#: Rays of a block: bounds all memory but the results, at about 100 bytes per ray.
RAYS_PER_BLOCK = 1 << 20

#: Rays per chunk of loops without traversal: about a millisecond.
LIGHT_CHUNK = 1 << 15


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
        Called with (rays of the batch done, rays of the batch).

    Attributes
    ----------
    rows : slice
    rays : LocalRays
    t_transform : TTransform
    progress : callable or None
        To be called with (rays of the block done, rays of the block).
    """

    def __init__(
        self,
        batch: RayBatch,
        rows: slice,
        frame: SceneFrame,
        status: NDArray[np.uint8],
        progress: Progress | None,
    ) -> None:
        self.rows = rows
        count = rows.stop - rows.start
        self.rays = LocalRays.empty(count)
        self.t_transform = TTransform(np.empty(count), np.empty(count))
        limits = batch.t_min[rows], batch.t_max[rows]
        source, kept = RaySource.of(batch.origins[rows], batch.directions[rows], limits)
        calls = to_local_rays, (source, frame, self.rays, self.t_transform, status[rows])
        run_calls(calls, (0, count), LIGHT_CHUNK, LIGHT_CHUNK)
        del kept  # the kernel reads it by address
        self.progress: Progress | None = None
        if progress is not None:
            self.progress = lambda done, _: progress(rows.start + done, len(batch))

    def part_of(self, tallies: NDArray[np.uint32] | None) -> NDArray[np.uint32] | None:
        """These rays' rows of the batch's tallies, if there are any."""
        return None if tallies is None else tallies[self.rows]

    def to_world(self, t: NDArray[np.float32], splits: NDArray[np.int64]) -> None:
        """Turn rows splits[i] to splits[i + 1] of t, which belong to ray i, to world distances."""
        calls = to_world_t, (splits, self.t_transform, t)
        run_calls(calls, (0, len(splits) - 1), LIGHT_CHUNK, LIGHT_CHUNK)


def blocks(
    batch: RayBatch,
    frame: SceneFrame,
    status: NDArray[np.uint8],
    progress: Progress | None,
    make: Callable[..., RayBlock] = RayBlock,
) -> Iterator[RayBlock]:
    """Turn a batch into blocks of local rays, one at a time; `make` is called as `RayBlock` is."""
    for first in range(0, len(batch), RAYS_PER_BLOCK):
        rows = slice(first, min(first + RAYS_PER_BLOCK, len(batch)))
        yield make(batch, rows, frame, status, progress)
