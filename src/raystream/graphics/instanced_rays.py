"""Rays through instances on the compute machine: in world space, besides the scene's frame."""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.rays import RayBatch, RayStatus
from raystream.geometry.instances.traversal import MAX_LENGTH, MOST_FAR
from raystream.graphics.packing import FAR, RayKind, packed_rays
from raystream.jit.threads import Progress
from raystream.kernels.local_frame import LocalRays, TTransform
from raystream.kernels.ray import SceneFrame
from raystream.machines.ray_block import RayBlock

#: Rows of four words for each ray, see ``instances/ray_buffer.wgsl``.
_ROWS = 7

#: Bytes of a ray's row, and of the numbers that it is made of.
_PACKED_BYTES = 16 * _ROWS + 80


class PlacedRays(NamedTuple):
    """Rays in the frame of the tree over instances, and in world space.

    Attributes
    ----------
    origins, directions, t_min, t_max : ndarray
        As of `LocalRays`.
    batch : RayBatch
        With these rays, from `first` on.
    first : int
    t_transform : TTransform
        To world distances.
    top : tuple of (SceneFrame, float)
        The frame of the tree, and the boxes' additional padding; see `TopAddresses.far_unit`.
    """

    origins: NDArray[np.float32]
    directions: NDArray[np.float32]
    t_min: NDArray[np.float32]
    t_max: NDArray[np.float32]
    batch: RayBatch
    first: int
    t_transform: TTransform
    top: tuple[SceneFrame, float]

    def packed(self, rows: slice) -> NDArray[np.float32]:
        """Some rays as shaders read them, shape (N, 7, 4)."""
        batch, count = self.batch, rows.stop - rows.start
        whole = slice(self.first + rows.start, self.first + rows.stop)
        frame, far_unit = self.top
        words = np.zeros((count, 4 * _ROWS), np.float32)
        integers, doubles = words.view(np.int32), words.view(np.float64)
        words[:, :8] = packed_rays(LocalRays(*self[:4]), rows).reshape(count, 8)
        doubles[:, 4:7] = batch.origins[whole]
        doubles[:, 7:10] = batch.directions[whole]
        words[:, 20] = np.clip(batch.t_min[whole], -FAR, FAR)
        words[:, 21] = np.clip(batch.t_max[whole], -FAR, FAR)
        reach = np.abs(doubles[:, 4:7]).max(axis=1) * frame.scale
        words[:, 22] = frame.max_coordinate + np.minimum(far_unit * reach, MOST_FAR)
        integers[:, 23] = 0 if batch.worlds is None else batch.worlds[whole]
        doubles[:, 12] = self.t_transform.offset[rows]
        integers[:, 26] = power_of(self.t_transform.scale[rows])
        return words.reshape(count, _ROWS, 4)


class _PlacedBlock(RayBlock):
    """A block whose rays have their numbers in world space, where their hits' distances are."""

    def __init__(
        self,
        far_unit: float,
        batch: RayBatch,
        rows: slice,
        frame: SceneFrame,
        status: NDArray[np.uint8],
        progress: Progress | None,
    ) -> None:
        super().__init__(batch, rows, frame, status, progress)
        # To stay within float64 in all spaces.
        length = np.abs(batch.directions[rows]).max(axis=1).astype(np.float64)
        is_valid = (length >= 1.0 / MAX_LENGTH) & (length <= MAX_LENGTH)
        if not is_valid.all():
            status[rows][~is_valid] = RayStatus.INVALID
            self.rays.t_max[~is_valid] = -np.inf
        own = batch, rows.start, self.t_transform, (frame, far_unit)
        placed: Any = PlacedRays(*self.rays, *own)
        self.rays = placed

    def to_world(self, t: NDArray[np.float32], splits: NDArray[np.int64]) -> None:
        """Nothing: shaders report distances in world space."""


def placed_rays(far_unit: float) -> RayKind:
    """The kind of rays through instances; see `TopAddresses.far_unit`.

    World rays are moved to objects' spaces in float64, by integers: `shaders/float64.wgsl`.
    """
    return RayKind(partial(_PlacedBlock, far_unit), PlacedRays.packed, _PACKED_BYTES)


def power_of(scale: Any) -> NDArray[np.int32]:
    """The exponents of powers of two."""
    return np.asarray(np.frexp(scale)[1] - 1, np.int32)
