"""Furnishings: smooth objects in a building, made of very small triangles."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.scene.procedural.parts import Part, PartCopies, yaw
from raystream.scene.procedural.rooms import BAY, STOREY, Plan
from raystream.scene.procedural.shapes import lathe, rounded_box, sphere, vertex_normals

#: Offsets from the first of the furnishings' materials.
CERAMIC, CLOTH, FOLIAGE = range(3)

Vector = tuple[float, float, float]


class Kind(NamedTuple):
    """Objects of one shape: its maker, share of triangles, and positions."""

    make: Callable[[int], Part]
    weight: float
    material: int
    colors: tuple[Vector, ...]
    office: tuple[Vector, ...] = ()
    meeting: tuple[Vector, ...] = ()
    outside: tuple[Vector, ...] = ()
    size: float = 1.0


def _turned(radii: tuple[float, ...], heights: tuple[float, ...]) -> Callable[[int], Part]:
    """Return a maker of surfaces of revolution with about a given number of triangles."""

    def make(triangles: int) -> Part:
        rings = max(1, round(math.sqrt(triangles / 3)))
        segments = max(3, round(triangles / (2 * rings)))
        place = np.linspace(0.0, 1.0, rings + 2)
        knots = np.linspace(0.0, 1.0, len(radii))
        radius = np.interp(place[1:-1], knots, radii)
        return lathe(radius, np.interp(place, knots, heights), segments)

    return make


def _cells(triangles: int) -> int:
    return max(1, round(math.sqrt(triangles / 12)))


def _cushion(triangles: int) -> Part:
    return rounded_box(_cells(triangles), (0.2, 0.05, 0.2), 0.045)


def _ball(triangles: int) -> Part:
    return sphere(_cells(triangles))


def _bush(triangles: int) -> Part:
    """A sphere with tufts."""
    ball = sphere(_cells(triangles))
    x, y, z = ball.vertices.astype(np.float64).T
    bumps = np.sin(9.0 * x + 2.0 * y) * np.sin(8.0 * y - 3.0 * z) * np.sin(10.0 * z + 4.0 * x)
    bumps = 1.0 + 0.16 * bumps + 0.05 * np.sin(31.0 * x) * np.sin(29.0 * y) * np.sin(30.0 * z)
    vertices = (ball.vertices * bumps[:, None]).astype(np.float32)
    return replace(ball, vertices=vertices, normals=vertex_normals(vertices, ball.faces))


CUPS = ((0.85, 0.84, 0.8), (0.7, 0.15, 0.1), (0.1, 0.35, 0.5))
GREENS = ((0.1, 0.27, 0.06), (0.16, 0.33, 0.08), (0.07, 0.22, 0.08))
REDS = ((0.55, 0.07, 0.06), (0.1, 0.2, 0.45), (0.6, 0.42, 0.08))
SEATS = tuple((x + 0.225, 0.5, z + 0.225) for x in (1.0, 1.85, 2.7) for z in (2.95, 4.5))

KINDS: tuple[Kind, ...] = (
    Kind(_cushion, 1.0, CLOTH, REDS, ((1.825, 0.5, 4.325),), SEATS),
    Kind(
        _turned((0.05, 0.11, 0.13, 0.08, 0.045, 0.06), (0.0, 0.08, 0.16, 0.25, 0.32, 0.36)),
        1.5,
        CERAMIC,
        CUPS,
        ((0.27, 2.01, 2.2), (0.27, 2.01, 2.7)),
        ((2.1, 0.74, 3.95),),
    ),
    Kind(
        _turned((0.03, 0.045, 0.045, 0.045), (0.0, 0.01, 0.06, 0.1)),
        0.6,
        CERAMIC,
        CUPS,
        ((2.35, 0.75, 4.95), (1.3, 0.75, 4.95)),
        tuple((x + 0.2, 0.74, z) for x in (1.0, 1.85, 2.7) for z in (3.5, 4.4)),
    ),
    Kind(
        _turned((0.13, 0.2, 0.22, 0.19, 0.17), (0.0, 0.02, 0.3, 0.4, 0.38)),
        1.0,
        CERAMIC,
        ((0.5, 0.25, 0.15), (0.6, 0.58, 0.55)),
        ((3.7, 0.012, 5.7),),
        ((3.7, 0.012, 5.7),),
        size=0.9,
    ),
    Kind(_bush, 6.0, FOLIAGE, GREENS, ((3.7, 0.75, 5.7),), ((3.7, 0.75, 5.7),), size=0.4),
    Kind(_ball, 1.0, CERAMIC, CUPS, ((2.5, 0.87, 5.35),), (), size=0.12),
    Kind(_bush, 4.0, FOLIAGE, GREENS, outside=((0.9, 0.45, 7.5), (2.9, 0.4, 7.7)), size=0.7),
)


def furnishings(
    triangles: int,
    plan: Plan,
    offices: NDArray[np.bool_],
    first_material: int,
    generator: np.random.Generator,
) -> Iterator[PartCopies]:
    """Furnish a building.

    Parameters
    ----------
    triangles : int
        Target count; with fewer than 12 per object, some objects are omitted.
    plan : Plan
    offices : ndarray of shape (R,), bool
        As for `rooms.all_boxes`.
    first_material : int
        Index of the first of three materials.
    generator : numpy.random.Generator
        Source of colours and rotations.

    Yields
    ------
    PartCopies
        Smooth; every object is closed.
    """
    spots = [_spots(kind, plan, offices) for kind in KINDS]
    load = [kind.weight * len(place) for kind, place in zip(KINDS, spots, strict=True)]
    left = float(triangles)
    for index, (kind, places) in enumerate(zip(KINDS, spots, strict=True)):
        # The following kinds compensate for rounding.
        share = left * load[index] / max(sum(load[index:]), 1e-9)
        count = min(len(places), int(share / 12))
        if count == 0:
            continue
        shape = kind.make(int(share / count))
        left -= shape.triangle_count * count
        size = kind.size * generator.uniform(0.85, 1.0, count)
        colors = np.asarray(kind.colors)[generator.integers(0, len(kind.colors), count)]
        turns = yaw(generator.uniform(0.0, 2 * np.pi, count) * (kind.make is not _cushion), size)
        yield PartCopies(
            shape.painted(first_material + kind.material), turns, places[:count], colors
        )


def _spots(kind: Kind, plan: Plan, offices: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the positions of a kind's objects, shape (N, 3)."""
    storey, rest = np.divmod(np.arange(len(offices)), 2 * plan.bays)
    bay, back = np.divmod(rest, 2)
    stairs = (rest == 1) & (plan.bays > 1)
    result = [np.zeros((0, 3))]
    for places, chosen in (
        (kind.office, offices & ~stairs),
        (kind.meeting, ~offices & ~stairs),
        (kind.outside, (storey == 0) & (back == 0)),
    ):
        for x, y, z in places:
            side = np.where(back[chosen] == 1, -1.0, 1.0)
            result.append(
                np.stack([x + bay[chosen] * BAY, y + storey[chosen] * STOREY, z * side], axis=1)
            )
    return np.concatenate(result)
