"""Origins of rays that leave a surface: offset from the triangle's plane by an error bound."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

UNIT = 2.0**-24  # half a step of float32, relative

#: Rounding in the triangle test acts as if each vertex moved by at most about 6 units of the
#: vertices' distance from the origin, which is near the triangle (the weights that follow
#: are float64); more than doubled as a margin.
EXTENT_UNITS = 16.0

#: Rounding of the origin's three coordinates to float32: at most 1 unit each.
REACH_UNITS = 4.0

#: The boxes' padding is 16 units (`kernels.ray.PAD`). An origin within it is inside the
#: triangle's own padded box, whose interval then holds t < 0: the clamp cannot raise a
#: negative distance to a hit.
MOST_UNITS = 14.0

#: Rounding of a world position to float64, in its own length.
WORLD_UNIT = 2.0**-50


def plane_offset(
    size: NDArray[np.float64],
    reach: NDArray[np.float64],
    reaches: tuple[Any, Any],
    unit: float = UNIT,
) -> NDArray[np.float64]:
    """How far from a triangle's plane rays must start or end to miss it.

    Parameters
    ----------
    size : ndarray of shape (...), float64
        The triangle's longest side along an axis, local frame.
    reach : ndarray of shape (...), float64
        Largest absolute coordinate of the point on it.
    reaches : tuple of two float, or ndarray of shape (...)
        See `Store.reaches_at`.
    unit : float
        Rounding of the tests, relative.

    Notes
    -----
    A ray from there that points away has the triangle's plane behind it by the offset at t = 0.
    The test's rounding is that of a triangle whose vertices moved by less than the offset, so it
    finds the plane at t < 0.
    """
    extent, far = reaches
    offset: NDArray[np.float64] = unit * np.minimum(
        EXTENT_UNITS * size + REACH_UNITS * reach,
        MOST_UNITS * (extent + reach),
    )
    # Far from the origin, the rounding of the float64 world position may be larger.
    offset += WORLD_UNIT * far
    return offset


def size_of(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """The longest side of triangles along an axis, from corners of shape (..., 3, 3)."""
    return (corners.max(axis=-2) - corners.min(axis=-2)).max(axis=-1)


def side_of(normals: NDArray[Any], directions: NDArray[Any]) -> NDArray[np.float64]:
    """The side of planes that directions point to: 1 where the normal is, or along the plane."""
    side = np.sign(np.einsum("...k,...k->...", normals, directions))
    return np.where(side == 0.0, 1.0, side)
