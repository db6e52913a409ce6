"""Scenes of vertical walls, in which rays of a horizontal plane walk in two dimensions."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raystream.scene.scene import Scene

__all__ = ["HEIGHT", "FlatScene", "Outline", "prisms", "teaching_scene"]

#: Height of walls relative to the longer side of the plan. With tall walls, a box's surface area is
#: about its perimeter in the plan times the height, so that trees are built as in two dimensions.
HEIGHT = 4.0

#: Size of the teaching scene's plan, and width of the stands around it.
_SIZE = (16.0, 12.0)
_STANDS = 0.7


class Outline(NamedTuple):
    """A polygon in the plan.

    Attributes
    ----------
    name : str
    points : ndarray of shape (K, 2), float64
        At least three corners; the last one connects to the first.
    """

    name: str
    points: NDArray[np.float64]


class FlatScene(NamedTuple):
    """A scene of walls without floor or roof.

    Attributes
    ----------
    scene : Scene
        Two triangles per wall: wall i has 2 i and 2 i + 1.
    walls : ndarray of shape (W, 2, 2), float64
        Both ends of each wall in the plan: (x, y).
    owners : ndarray of shape (W,), int64
        The outline of each wall.
    names : tuple of str
        Names of the outlines.
    z : float
        The plane of the rays, at half height.
    """

    scene: Scene
    walls: NDArray[np.float64]
    owners: NDArray[np.int64]
    names: tuple[str, ...]
    z: float

    def ray(self, origin: ArrayLike, direction: ArrayLike) -> tuple[NDArray[np.float64], ...]:
        """Lift rays from the plan, both of shape S + (2,), into the scene: of shape S + (3,)."""
        start, way = np.asarray(origin, np.float64), np.asarray(direction, np.float64)
        height = np.full(start.shape[:-1] + (1,), self.z)
        flat = np.zeros(way.shape[:-1] + (1,))
        return np.concatenate([start, height], -1), np.concatenate([way, flat], -1)


def prisms(outlines: Iterable[Outline]) -> FlatScene:
    """Extrude polygons to walls.

    Parameters
    ----------
    outlines : iterable of Outline
        In the order of their walls.

    Returns
    -------
    FlatScene

    Raises
    ------
    ValueError
        If there is no outline, or one has too few or non-finite corners.
    """
    chosen = tuple(outlines)
    if not chosen:
        raise ValueError("outlines: expected at least one, got none")
    walls: list[NDArray[np.float64]] = []
    for one in chosen:
        points = np.asarray(one.points, np.float64)
        if points.ndim != 2 or points.shape[1:] != (2,) or len(points) < 3:
            shape = points.shape
            raise ValueError(
                f"outlines: {one.name!r} has points of shape {shape}, expected (K, 2) with K >= 3"
            )
        if not np.isfinite(points).all():
            raise ValueError(f"outlines: {one.name!r} has a corner that is not finite")
        walls.append(np.stack([points, np.roll(points, -1, axis=0)], axis=1))
    ends = np.concatenate(walls)
    height = HEIGHT * float(np.ptp(ends.reshape(-1, 2), axis=0).max())
    count = len(ends)
    low = np.concatenate([ends, np.zeros((count, 2, 1))], axis=2)
    high = np.concatenate([ends, np.full((count, 2, 1), height)], axis=2)
    vertices = np.concatenate([low, high], axis=1).reshape(-1, 3)  # a low, b low, a high, b high
    faces = np.array([[0, 1, 3], [0, 3, 2]])[None] + 4 * np.arange(count)[:, None, None]
    scene = Scene.from_arrays(vertices, faces.reshape(-1, 3), name="plan")
    owners = np.repeat(np.arange(len(chosen)), [len(wall) for wall in walls])
    return FlatScene(scene, ends, owners, tuple(one.name for one in chosen), height / 2.0)


def teaching_scene() -> FlatScene:
    """A teapot in a stadium: long walls, large empty space, and one crowded corner.

    The classic worst case of uniform grids: most cells are empty, and one cell holds most of the
    teapot (Purcell 2002, section 5.1).
    """
    return prisms(
        [
            *_stands(),
            Outline("scoreboard", _box((6.0, 9.3), 2.6, 0.25, 12.0)),
            Outline("dugout", _box((4.3, 3.1), 1.5, 0.7, -28.0)),
            Outline("floodlight", _ring((10.9, 8.7), 0.32, 0.32, 6)),
            Outline("floodlight", _ring((2.6, 7.3), 0.32, 0.32, 6)),
            Outline("fountain", _ring((6.5, 7.35), 0.75, 0.75, 9)),
            *_teapot((12.05, 4.0), 0.62),
        ]
    )


def _stands() -> list[Outline]:
    """Four curved blocks with gates between them."""
    x, y = _SIZE[0] / 2.0, _SIZE[1] / 2.0
    names = ("north-east stand", "north-west stand", "south-west stand", "south-east stand")
    made = []
    for quarter, name in enumerate(names):
        begin, end = (math.radians(90.0 * quarter + edge) for edge in (7.0, 83.0))
        angles = np.linspace(begin, end, 7)
        around = np.column_stack([np.cos(angles), np.sin(angles)])
        outer = around * (x, y)
        inner = around[::-1] * (x - _STANDS, y - _STANDS)
        made.append(Outline(name, np.concatenate([outer, inner]) + (x, y)))
    return made


def _ring(center: Sequence[float], width: float, height: float, count: int) -> NDArray[np.float64]:
    """A regular polygon, as an ellipse."""
    angles = (np.arange(count) + 0.35) * (2.0 * math.pi / count)
    return np.column_stack([np.cos(angles) * width, np.sin(angles) * height]) + center


def _box(
    center: Sequence[float], width: float, height: float, degrees: float
) -> NDArray[np.float64]:
    """A rotated rectangle."""
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * (width / 2.0, height / 2.0)
    turn = math.radians(degrees)
    cos, sin = math.cos(turn), math.sin(turn)
    return corners @ np.array([[cos, sin], [-sin, cos]]) + center


#: A teapot in profile, in units of its body's radius, without the hole of the handle.
_POT = (
    (-0.62, -0.8), (-0.2, -0.92), (0.25, -0.92), (0.66, -0.78), (0.92, -0.45), (1.12, -0.18),
    (1.42, 0.2), (1.6, 0.52), (1.86, 0.62), (1.8, 0.76), (1.5, 0.7), (1.24, 0.5), (0.98, 0.22),
    (0.86, 0.42), (0.62, 0.66), (0.3, 0.78), (0.14, 0.84), (0.2, 1.0), (0.1, 1.12), (-0.1, 1.12),
    (-0.2, 1.0), (-0.14, 0.84), (-0.4, 0.76), (-0.7, 0.62), (-1.05, 0.66), (-1.4, 0.52),
    (-1.56, 0.2), (-1.5, -0.1), (-1.3, -0.36), (-0.98, -0.5), (-0.84, -0.6),
)  # fmt: skip
_HOLE = (
    (-0.92, 0.38), (-1.12, 0.42), (-1.3, 0.32), (-1.36, 0.12), (-1.28, -0.1), (-1.1, -0.24),
    (-0.94, -0.22), (-0.9, 0.06),
)  # fmt: skip


def _teapot(center: Sequence[float], radius: float) -> list[Outline]:
    return [
        Outline("teapot", np.array(_POT) * radius + center),
        Outline("teapot's handle", np.array(_HOLE) * radius + center),
    ]
