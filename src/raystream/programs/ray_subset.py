"""Rays of a program: a whole batch, a range of it, or a selection."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.rays import RayBatch
from raystream.kernels.ray_source import RaySource


class RaySubset(NamedTuple):
    """Rays of a batch.

    Attributes
    ----------
    batch : RayBatch
    ids : ndarray of shape (N,), int64, or None
        Their indices in the whole batch; None if they are consecutive.
    first : int
        Index of the first one, if they are consecutive.
    """

    batch: RayBatch
    ids: NDArray[np.int64] | None
    first: int

    @property
    def places(self) -> tuple[NDArray[np.int64] | None, int]:
        """Indices in the whole batch, or the first one's."""
        return self.ids, self.first

    def part(self, picked: NDArray[np.int64]) -> RaySubset:
        """Some of the rays, by their position among these."""
        ids = picked + self.first if self.ids is None else self.ids[picked]
        return RaySubset(_batch(self.batch, picked, (len(picked),)), ids, 0)

    def rows(self, rows: slice, shape: tuple[int, ...]) -> RaySubset:
        """A range of the rays, in the shape in which to trace them."""
        ids = None if self.ids is None else self.ids[rows]
        return RaySubset(_batch(self.batch, rows, shape), ids, self.first + rows.start)


class PendingRays(NamedTuple):
    """Rays that are being traced, and which of them are still open.

    Attributes
    ----------
    rays : RaySubset
    source : RaySource
        Their addresses.
    delivered : int
        Hits of each ray that the program has seen before.
    open_rays : ndarray of shape (N,), bool
        The rays that no program has ended.
    kept : object
        Keeps the memory at the source's addresses alive.
    """

    rays: RaySubset
    source: RaySource
    delivered: int
    open_rays: NDArray[np.bool_]
    kept: object

    @classmethod
    def of(cls, rays: RaySubset, delivered: int) -> PendingRays:
        """Make a value with all rays open."""
        batch = rays.batch
        source, kept = RaySource.of(batch.origins, batch.directions, batch.limits)
        return cls(rays, source, delivered, np.ones(len(batch), np.bool_), kept)


def _batch(batch: RayBatch, picked: Any, shape: tuple[int, ...]) -> RayBatch:
    """Some rays of a batch; values shared by all rays are not copied."""
    vectors = [_vectors(array, picked, shape) for array in (batch.origins, batch.directions)]
    limits = [
        limit.reshape(()) if len(limit) == 1 else limit[picked].reshape(shape)
        for limit in batch.exact_limits
    ]
    part = type(batch)(*vectors, *limits)
    part.worlds = None if batch.worlds is None else np.ascontiguousarray(batch.worlds[picked])
    masks = batch.masks
    part.masks = masks if masks is None or len(masks) == 1 else masks[picked]
    return part


def _vectors(array: NDArray[Any], picked: Any, shape: tuple[int, ...]) -> NDArray[Any]:
    if array.strides[0] == 0 or len(array) == 1:
        return np.broadcast_to(array[:1].reshape(3), (*shape, 3))
    return array[picked].reshape(*shape, 3)
