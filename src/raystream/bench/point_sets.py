"""The points of the ray sets that ask for closest points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raystream.core.scene_kinds import check_support
from raystream.core.triangles import Triangles

#: How far `near_points` are from the surface, relative to the scene's diagonal: the deviation of
#: each coordinate.
NEAR = 1e-3


def diagonal_of(bounds: NDArray[np.float64]) -> float:
    """Length of the diagonal of a box, its two corners; 1 for a box without extent."""
    return float(np.linalg.norm(np.subtract(bounds[1], bounds[0], dtype=np.float64))) or 1.0


def points_around(
    bounds: NDArray[np.float64], count: int, generator: np.random.Generator
) -> NDArray[np.float32]:
    """Uniform points in a box grown by half."""
    low, high = (np.asarray(one, np.float64) for one in bounds)
    size = high - low
    return (low - size / 4 + generator.random((count, 3)) * (1.5 * size)).astype(np.float32)


def near_points(
    triangles: Triangles, count: int, generator: np.random.Generator
) -> NDArray[np.float32]:
    """Points near uniform points of the surface, off it by some `NEAR` of the diagonal."""
    check_support("points near the surface", triangles)
    if not len(triangles.prim_ids):
        return np.empty((0, 3), np.float32)
    corners = triangles.corners[triangles.prim_ids]
    sides = corners[:, 1:] - corners[:, :1]
    areas = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1).astype(np.float64)
    chosen = corners[generator.choice(len(areas), count, p=areas / areas.sum())]
    on = np.einsum("nk,nkx->nx", generator.dirichlet([1.0, 1.0, 1.0], count), chosen)
    world = on / triangles.scale + triangles.center
    off = generator.normal(size=(count, 3)) * (NEAR * diagonal_of(triangles.world_bounds))
    return (world + off).astype(np.float32)


def grid_points(bounds: NDArray[np.float64], count: int) -> NDArray[np.float32]:
    """A grid of at most `count` points in a box, as many along each axis, the last fastest."""
    side = max(int(round(count ** (1 / 3), 6)), 1)
    lines = [np.linspace(low, high, side) for low, high in zip(*bounds, strict=True)]
    grid = np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1)
    return grid.reshape(-1, 3).astype(np.float32)
