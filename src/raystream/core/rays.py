"""RayBatch: origins, directions and intervals, validated, as the caller gave them."""

from __future__ import annotations

import enum
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.arrays import as_real_array

__all__ = ["RayBatch", "RayStatus"]


class RayStatus(enum.IntEnum):
    """What became of a ray.

    Attributes
    ----------
    VALID
        It was traced.
    INVALID
        It was not, and misses: its direction is zero, or a number of it is NaN, infinite or
        (an origin's coordinate) beyond 2**200.
    """

    VALID = 0
    INVALID = 1


class RayBatch:
    """Rays of any leading shape, flattened.

    Parameters
    ----------
    origins, directions : array_like of shape (..., 3), real
        World space; the two shapes are broadcast against each other. Directions need not be
        unit length.
    t_min, t_max : float or array_like that broadcasts to the leading shape
        Closed interval, in direction lengths; rounded to float32.

    Attributes
    ----------
    shape : tuple of int
        The leading shape.
    origins, directions : ndarray of shape (N, 3), float32 or float64
        Views of the caller's arrays where that is possible.
    t_min, t_max : ndarray of shape (N,), float32

    Raises
    ------
    ValueError
        If shapes disagree.
    TypeError
        If an array does not hold real numbers.
    """

    shape: tuple[int, ...]
    origins: NDArray[Any]
    directions: NDArray[Any]
    t_min: NDArray[np.float32]
    t_max: NDArray[np.float32]

    def __init__(
        self, origins: Any, directions: Any, t_min: Any = 0.0, t_max: Any = np.inf
    ) -> None:
        origins = _vectors("origins", origins)
        directions = _vectors("directions", directions)
        try:
            shape = np.broadcast_shapes(origins.shape, directions.shape)
        except ValueError:
            raise ValueError(
                f"origins and directions: shapes {origins.shape} and {directions.shape} "
                "do not broadcast against each other"
            ) from None
        self.shape = shape[:-1]
        self.origins = _rows(origins, shape)
        self.directions = _rows(directions, shape)
        self.t_min = _limits("t_min", t_min, self.shape)
        self.t_max = _limits("t_max", t_max, self.shape)

    def __len__(self) -> int:
        return len(self.t_min)


def _vectors(name: str, values: Any) -> NDArray[Any]:
    array = as_real_array(name, values)
    if array.ndim == 1 and array.size == 0:
        array = array.reshape(0, 3)
    if array.ndim == 0 or array.shape[-1] != 3:
        raise ValueError(f"{name}: expected shape (..., 3), got {array.shape}")
    return array


def _rows(array: NDArray[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Broadcast to the shape, as rows of 3; one vector for all rays is not copied."""
    if array.size == 3:
        return np.broadcast_to(array.reshape(1, 3), (math.prod(shape[:-1]), 3))
    return np.broadcast_to(array, shape).reshape(-1, 3)


def _limits(name: str, values: Any, shape: tuple[int, ...]) -> NDArray[np.float32]:
    with np.errstate(over="ignore"):
        array = as_real_array(name, values).astype(np.float32, copy=False)
    try:
        return np.broadcast_to(array, shape).reshape(-1)
    except ValueError:
        raise ValueError(
            f"{name}: shape {array.shape} does not broadcast to the rays' shape {shape}"
        ) from None
