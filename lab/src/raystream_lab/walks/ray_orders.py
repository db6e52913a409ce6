"""Orders in which the rays of an image are traced."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Row by row, in tiles of 8 x 8 pixels, and along a Morton curve.
ORDERS = ("rows", "tiles", "morton")

#: log2 of a tile's side, in pixels.
_TILE_BITS = 3


def ray_order(order: str | Any, shape: tuple[int, ...]) -> NDArray[np.uint32]:
    """Ray indices in tracing order.

    Parameters
    ----------
    order : {"rows", "tiles", "morton"} or array_like of shape (N,), int
        A name, or the indices themselves.
    shape : tuple of int
        Shape of the rays; all orders except ``"rows"`` need two axes, rows and columns.

    Returns
    -------
    ndarray of shape (N,), uint32

    Raises
    ------
    ValueError
        If the order is unknown, does not fit the shape, or misses a ray.
    """
    count = int(np.prod(shape, dtype=np.int64))
    if not isinstance(order, str):
        given = np.asarray(order).reshape(-1)
        if given.dtype.kind not in "iu" or not np.array_equal(np.sort(given), np.arange(count)):
            raise ValueError(f"order: expected each of {count:,} rays once")
        return given.astype(np.uint32)
    if order not in ORDERS:
        known = ", ".join(map(repr, ORDERS))
        raise ValueError(f"order: expected one of {known}, or numbers of rays; got {order!r}")
    rays = np.arange(count, dtype=np.uint32)
    if order == "rows":
        return rays
    if len(shape) != 2:
        raise ValueError(f"order: {order!r} needs rays of shape (rows, columns), got {shape}")
    y, x = np.divmod(rays.astype(np.uint64), np.uint64(shape[1]))
    keys = _tiled(x, y, shape[1]) if order == "tiles" else _spread(x) | _spread(y) << np.uint64(1)
    return rays[np.argsort(keys, kind="stable")]


def _tiled(x: NDArray[np.uint64], y: NDArray[np.uint64], width: int) -> NDArray[np.uint64]:
    """Sort keys for tile by tile, and row by row within a tile."""
    bits = np.uint64(_TILE_BITS)
    tile = (y >> bits) * np.uint64((width >> _TILE_BITS) + 1) + (x >> bits)
    inner = np.uint64((1 << _TILE_BITS) - 1)
    return (tile << bits | y & inner) << bits | x & inner


def _spread(number: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Move bit k to bit 2 k (Morton 1966)."""
    for shift, mask in (
        (16, 0x0000FFFF0000FFFF),
        (8, 0x00FF00FF00FF00FF),
        (4, 0x0F0F0F0F0F0F0F0F),
        (2, 0x3333333333333333),
        (1, 0x5555555555555555),
    ):
        number = (number | number << np.uint64(shift)) & np.uint64(mask)
    return number
