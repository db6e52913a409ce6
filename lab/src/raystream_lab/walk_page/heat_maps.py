"""Heat maps of a plan: cost of rays by direction from a point, and by origin."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.tracer import Tracer
from raystream_lab.walk_page.flat_scene import FlatScene

__all__ = ["FanCost", "PlaceCost", "fan_cost", "place_cost"]


class FanCost(NamedTuple):
    """The cost of each direction from a point.

    Attributes
    ----------
    t : ndarray of shape (D,), float32
        Distance of the hit in direction 2 pi k / D; inf for a miss.
    steps, tests : ndarray of shape (D,), uint32
        Steps, including backtracking, and triangle tests; see `RayCounters`.
    """

    t: NDArray[np.float32]
    steps: NDArray[np.uint32]
    tests: NDArray[np.uint32]


class PlaceCost(NamedTuple):
    """The mean cost over all directions of rays from each position.

    Attributes
    ----------
    steps, tests : ndarray of shape (H, W), float64
        Row 0 is the lowest y; see `FanCost`.
    """

    steps: NDArray[np.float64]
    tests: NDArray[np.float64]


def fan_cost(tracer: Tracer, plan: FlatScene, origin: tuple[float, float], count: int) -> FanCost:
    """Count the work of rays in all directions from a point.

    Parameters
    ----------
    tracer : Tracer
        Of the plan's scene, with ``counters=True``.
    plan : FlatScene
    origin : tuple of two float
    count : int
        Number of directions.

    Returns
    -------
    FanCost
    """
    hits = tracer.first_hit(*plan.ray(np.array(origin), _directions(count)))
    counters = tracer.counters
    return FanCost(hits.t, counters.all_steps, counters.tests)


def place_cost(
    tracer: Tracer, plan: FlatScene, shape: tuple[int, int], directions: int
) -> PlaceCost:
    """Count the work of rays from each pixel of a small image of the plan.

    Parameters
    ----------
    tracer : Tracer
        Of the plan's scene, with ``counters=True``.
    plan : FlatScene
    shape : tuple of two int
        Rows and columns of the image, which covers the bounds of all walls.
    directions : int
        Rays from the centre of each pixel.

    Returns
    -------
    PlaceCost
    """
    low, high = plan.walls.min(axis=(0, 1)), plan.walls.max(axis=(0, 1))
    rows, columns = (
        low[axis] + (np.arange(count) + 0.5) * ((high[axis] - low[axis]) / count)
        for axis, count in ((1, shape[0]), (0, shape[1]))
    )
    places = np.stack(np.meshgrid(columns, rows), axis=-1)[:, :, None, :]
    ways = np.broadcast_to(_directions(directions), shape + (directions, 2))
    starts, ways = np.broadcast_arrays(places, ways)
    tracer.first_hit(*plan.ray(starts, ways))
    counters = tracer.counters
    return PlaceCost(counters.all_steps.mean(axis=2), counters.tests.mean(axis=2))


def _directions(count: int) -> NDArray[np.float64]:
    angles = np.arange(count) * (2.0 * math.pi / count)
    return np.column_stack([np.cos(angles), np.sin(angles)])
