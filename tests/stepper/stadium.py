"""A flat scene for walks, seen from above: a stadium with gates, and one crowded corner."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

import raystream as rs

#: Height of walls relative to the longer side of the plan. With tall walls, a box's surface area is
#: about its perimeter in the plan times the height, so that trees are built as in two dimensions.
HEIGHT = 4.0

#: Costs for detailed trees, with cells of one or two walls.
TREE = {"traversal_cost": 2.0, "max_depth": 11, "max_leaf_size": 2}
GRAPH = {"crossing_cost": 2.0, "link_cost": 1.0, "max_depth": 11, "max_leaf_size": 2}


class Plan(NamedTuple):
    """Walls without floor or roof: wall i, of `walls` of shape (W, 2, 2), has triangles 2 i and
    2 i + 1. Rays run at height `z`."""

    scene: rs.Scene
    walls: NDArray[np.float64]
    z: float

    def ray(self, origin: ArrayLike, direction: ArrayLike) -> tuple[NDArray[np.float64], ...]:
        """Lift rays from the plan, both of shape S + (2,), into the scene: of shape S + (3,)."""
        start, way = np.asarray(origin, np.float64), np.asarray(direction, np.float64)
        height = np.full(start.shape[:-1] + (1,), self.z)
        flat = np.zeros(way.shape[:-1] + (1,))
        return np.concatenate([start, height], -1), np.concatenate([way, flat], -1)


def prisms(*outlines: ArrayLike) -> Plan:
    """Extrude polygons of shape (K, 2) to walls."""
    sides = [np.stack([one, np.roll(one, -1, axis=0)], axis=1) for one in outlines]
    walls = np.concatenate(sides).astype(np.float64)
    height = HEIGHT * float(np.ptp(walls.reshape(-1, 2), axis=0).max())
    ends = [np.insert(walls, 2, z, axis=2) for z in (0.0, height)]
    vertices = np.concatenate(ends, axis=1).reshape(-1, 3)  # a low, b low, a high, b high
    faces = np.array([[0, 1, 3], [0, 3, 2]])[None] + 4 * np.arange(len(walls))[:, None, None]
    return Plan(rs.Scene.from_arrays(vertices, faces.reshape(-1, 3)), walls, height / 2.0)


def stadium() -> Plan:
    """Four curved stands around an empty field, a few obstacles, and many small walls in one place.

    The worst case of uniform grids (Purcell 2002, section 5.1).
    """
    middle = np.array([8.0, 6.0])
    stands = []
    for quarter in range(4):
        around = _around(np.radians(90.0 * quarter + np.linspace(7.0, 83.0, 7)))
        stands.append(np.concatenate([around, 0.9 * around[::-1]]) * middle + middle)
    turns = (np.arange(36) + 0.35) * (2.0 * math.pi / 36)
    crowd = _around(turns) * (0.7 + 0.3 * np.sin(5.0 * turns))[:, None] + (12.05, 4.0)
    board = np.array([[4.7, 9.0], [7.2, 9.5], [7.15, 9.75], [4.65, 9.25]])
    lights = _ring(10.9, 8.7, 6), _ring(2.6, 7.3, 6), _ring(6.5, 7.3, 9)
    return prisms(*stands, board, *lights, crowd)


def rays() -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Origins and directions in the plan: chosen ones, and three fans."""
    ways = [
        ((2.2, 5.1), (12.05, 4.25)),  # across the empty field into the crowd
        ((-0.6, 5.9), (16.6, 6.15)),  # in at one gate and out at another
        ((7.9, 5.41), (12.05, 5.1)),  # past the crowd
        ((12.0, 4.0), (11.6, 4.2)),  # out of the crowd
        ((12.3, 9.4), (12.3, 1.0)),  # along an axis
        ((-0.8, 11.95), (3.0, 12.6)),  # misses the scene's box
    ]
    made = [(np.array(start), np.subtract(end, start)) for start, end in ways]
    for origin, count in (((9.3, 6.4), 11), ((4.0, 6.2), 7), ((12.0, 4.1), 5)):
        made += [
            (np.array(origin), way) for way in _around(np.arange(count) * (2.0 * math.pi / count))
        ]
    return made


def tracers(plan: Plan) -> dict[str, rs.Tracer]:
    """A grid, a kd-tree with three traversals, a graph and a BVH, with counters."""
    options = {
        "grid": rs.Grid(resolution=(16, 12, 1)),
        **{
            f"kdtree-{one}": rs.KdTree(traversal=one, **TREE)
            for one in ("stack", "restart", "backtrack")
        },
        "graph": rs.Graph(**GRAPH),
        "bvh": rs.Bvh(),
    }
    return {key: rs.Tracer(plan.scene, one, counters=True) for key, one in options.items()}


def _around(angles: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.column_stack([np.cos(angles), np.sin(angles)])


def _ring(x: float, y: float, count: int) -> NDArray[np.float64]:
    """A small regular polygon."""
    return 0.5 * _around((np.arange(count) + 0.35) * (2.0 * math.pi / count)) + (x, y)
