"""Masks: which rays may hit which geometry."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.rays import as_integers, broadcast

#: The mask with all bits: that of geometry and rays without one.
ALL_BITS = 2**32 - 1


class MaskRuns(NamedTuple):
    """The masks of geometry, by kernels' numbers of triangles and other primitives.

    Attributes
    ----------
    starts : ndarray of shape (R,), int64
        Run k is of the numbers from starts[k] up to the next start; the first is 0.
    masks : ndarray of shape (R,), uint32
    """

    starts: NDArray[np.int64]
    masks: NDArray[np.uint32]

    @classmethod
    def of(cls, starts: NDArray[Any], masks: NDArray[np.uint32]) -> MaskRuns:
        """The runs of parts that begin at these numbers; adjacent ones of equal masks are one."""
        if not len(starts):
            return cls(np.zeros(1, np.int64), np.full(1, ALL_BITS, np.uint32))
        # Of parts that begin at the same number, all but the last are empty.
        is_held = np.append(starts[1:] != starts[:-1], True)
        starts, masks = starts[is_held].astype(np.int64), masks[is_held]
        is_first = np.append(True, masks[1:] != masks[:-1])
        return cls(starts[is_first], masks[is_first])

    def admit(self, masks: NDArray[np.uint32]) -> bool:
        """Whether rays of these masks have bits in common with which each may hit everything."""
        return bool((self.masks & np.bitwise_and.reduce(masks)).all())


def as_masks(name: str, values: Any) -> NDArray[np.uint32]:
    """View values as masks, of any shape.

    Raises
    ------
    TypeError
        If they are not integers.
    ValueError
        If one is negative, or has more than 32 bits.
    """
    array = as_integers(name, values)
    if array.dtype == np.uint32:  # nothing to check
        return array
    if array.size and not (array.min() >= 0 and array.max() <= ALL_BITS):
        raise ValueError(
            f"{name}: expected integers of 32 bits, 0 to {ALL_BITS:,}, got {array.min()} to "
            f"{array.max()}"
        )
    return array.astype(np.uint32)


def as_mask(name: str, value: Any) -> int:
    """The mask of one part of a scene.

    Raises
    ------
    TypeError
        If it is not an integer.
    ValueError
        If it is not one number from 1 to `ALL_BITS`.
    """
    array = as_masks(name, value)
    if array.ndim:
        raise ValueError(f"{name}: expected one integer, got shape {array.shape}")
    if not int(array):
        raise ValueError(f"{name}: 0 would be hit by no ray; leave the part out of the scene")
    return int(array)


def ray_masks(values: Any, shape: tuple[int, ...]) -> NDArray[np.uint32]:
    """The masks of rays of a leading shape, flat; one for all rays is not repeated."""
    array = as_masks("mask", values)
    if array.ndim == 0:
        return array.reshape(1)
    return broadcast("mask", array, shape).reshape(-1)
