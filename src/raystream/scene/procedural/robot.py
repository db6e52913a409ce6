"""Robot: the parts of one robot, and crowds of robots in different poses."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.scene.procedural.parts import Part, PartCopies, instance, merge_copies, yaw
from raystream.scene.procedural.shapes import rounded_box, sphere

#: Offsets from the first of the robots' materials.
PAINT, METAL, VISOR, EYE, RUBBER = range(5)

#: Heights of the joints about which limbs swing.
SHOULDER, HIP = 1.42, 0.74

#: Distance between neighbours, metres.
SPACING = 2.1

Vector = tuple[float, float, float]


class Piece(NamedTuple):
    """A part of a robot that faces +z and stands on y = 0.

    ``radius`` rounds the edges of a box of ``half_size``; 0 makes an ellipsoid. ``limb`` is
    0 for the body, 1 and 2 for the arms, 3 and 4 for the legs.
    """

    center: Vector
    half_size: Vector
    radius: float
    material: int
    limb: int = 0


def _pair(piece: Piece, first_limb: int) -> list[Piece]:
    """Return a piece on either side of the body."""
    x, y, z = piece.center
    return [piece._replace(limb=first_limb), piece._replace(center=(-x, y, z), limb=first_limb + 1)]


#: The pieces, most important first, in case there are triangles for a few only.
PIECES: tuple[Piece, ...] = (
    Piece((0.0, 1.2, 0.0), (0.29, 0.33, 0.18), 0.08, PAINT),
    Piece((0.0, 1.77, 0.0), (0.2, 0.17, 0.18), 0.07, PAINT),
    *_pair(Piece((0.14, 0.57, 0.0), (0.1, 0.19, 0.1), 0.05, METAL), 3),
    *_pair(Piece((0.14, 0.24, 0.0), (0.1, 0.17, 0.11), 0.05, PAINT), 3),
    *_pair(Piece((0.41, 1.2, 0.0), (0.075, 0.18, 0.075), 0.05, METAL), 1),
    *_pair(Piece((0.41, 0.9, 0.02), (0.085, 0.16, 0.085), 0.05, PAINT), 1),
    *_pair(Piece((0.14, 0.06, 0.05), (0.11, 0.06, 0.18), 0.04, RUBBER), 3),
    Piece((0.0, 0.78, 0.0), (0.22, 0.11, 0.15), 0.06, METAL),
    Piece((0.0, 1.79, 0.16), (0.16, 0.07, 0.045), 0.03, VISOR),
    *_pair(Piece((0.4, SHOULDER, 0.0), (0.12, 0.12, 0.12), 0.0, PAINT), 1),
    *_pair(Piece((0.41, 0.68, 0.03), (0.09, 0.09, 0.09), 0.0, RUBBER), 1),
    *_pair(Piece((0.075, 1.79, 0.2), (0.035, 0.035, 0.02), 0.0, EYE), 0),
    Piece((0.0, 1.57, 0.0), (0.08, 0.08, 0.08), 0.03, RUBBER),
    Piece((0.0, 1.28, 0.17), (0.19, 0.14, 0.04), 0.02, METAL),
    *_pair(Piece((0.14, 0.4, 0.02), (0.09, 0.09, 0.09), 0.0, RUBBER), 3),
    Piece((0.13, 1.99, -0.04), (0.012, 0.1, 0.012), 0.008, METAL),
    Piece((0.13, 2.1, -0.04), (0.03, 0.03, 0.03), 0.0, EYE),
)

PART_COUNT = len(PIECES)

PAINTS = np.array(
    [
        [0.85, 0.1, 0.06],
        [0.95, 0.52, 0.05],
        [0.08, 0.3, 0.75],
        [0.9, 0.9, 0.88],
        [0.12, 0.55, 0.28],
        [0.95, 0.78, 0.12],
    ]
)


def robot_parts(
    divisions: int,
    count: int,
    part_count: int,
    first_material: int,
    generator: np.random.Generator,
) -> Part:
    """Make a column of robots that walks towards +z.

    Parameters
    ----------
    divisions : int
        Each part has 12 divisions^2 triangles; every part is closed and smooth.
    count : int
        Number N of robots.
    part_count : int
        Number of parts per robot, at most `PART_COUNT`.
    first_material : int
        Index of the first of five materials.
    generator : numpy.random.Generator
        Source of the poses and colours.

    Returns
    -------
    Part
        Ordered by part, then by robot: N part_count 12 divisions^2 triangles.
    """
    return merge_copies(robot_copies(divisions, count, part_count, first_material, generator))


def robot_copies(
    divisions: int,
    count: int,
    part_count: int,
    first_material: int,
    generator: np.random.Generator,
) -> Iterator[PartCopies]:
    """The parts of robots and where they are; see `robot_parts` for the parameters."""
    turns = yaw(generator.normal(0.1, 0.25, count))
    paints = PAINTS[np.arange(count) % len(PAINTS)]
    swings = _swings(count, generator)
    # A swung leg is higher, but the tip of its foot is lower: lift the robot by the difference.
    stride = np.abs(swings[:, 3])
    lift = HIP * (np.cos(stride) - 1.0) + 0.24 * np.sin(stride)
    spots = _column(count, generator)
    base = np.stack([spots[:, 0], lift, spots[:, 1]], axis=1)
    for piece in PIECES[:part_count]:
        if piece.radius:
            shape = rounded_box(divisions, piece.half_size, piece.radius)
        else:
            shape = instance(sphere(divisions), [np.diag(piece.half_size)], [(0.0, 0.0, 0.0)])
        swing = _pitch(swings[:, piece.limb])
        height = 0.0 if piece.limb == 0 else SHOULDER if piece.limb < 3 else HIP
        joint = np.array([0.0, height, 0.0])
        centers = np.einsum("nij,j->ni", swing, piece.center - joint) + joint
        offsets = np.einsum("nij,nj->ni", turns, centers) + base
        matrices = np.einsum("nij,njk->nik", turns, swing)
        colors = paints if piece.material == PAINT else np.ones((count, 3))
        yield PartCopies(shape.painted(first_material + piece.material), matrices, offsets, colors)


def _column(count: int, generator: np.random.Generator) -> NDArray[np.float64]:
    """Return positions (x, z) in rows of five, alternately shifted by half a place."""
    row, place = np.divmod(np.arange(count), 5)
    across = np.array([0, -1, 1, -2, 2])[place] + 0.5 * (row % 2) - 0.25
    spots = np.stack([across * SPACING, -row * SPACING], axis=1)
    return spots + generator.uniform(-0.2, 0.2, (count, 2))


def _swings(count: int, generator: np.random.Generator) -> NDArray[np.float64]:
    """Return angles about the x axis of body, two arms and two legs; (N, 5), radians."""
    stride = generator.uniform(0.12, 0.4, count) * generator.choice([-1.0, 1.0], count)
    waves = generator.random(count) < 0.3
    left = np.where(waves, -2.7, -stride)
    return np.stack([np.zeros(count), left, stride, stride, -stride], axis=1)


def _pitch(angles: NDArray[np.float64]) -> NDArray[np.float64]:
    matrix = np.zeros((len(angles), 3, 3))
    matrix[:, 0, 0] = 1.0
    matrix[:, 1, 1] = matrix[:, 2, 2] = np.cos(angles)
    matrix[:, 2, 1] = np.sin(angles)
    matrix[:, 1, 2] = -matrix[:, 2, 1]
    return matrix
