"""Boxes: plain boxes and finely tessellated rounded ones in a room."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raystream.scene.camera import Camera
from raystream.scene.material import Material
from raystream.scene.mesh import Mesh
from raystream.scene.procedural.finishes import polished
from raystream.scene.procedural.layout import floor_cells
from raystream.scene.procedural.parts import Part, instance, merge, to_mesh, yaw
from raystream.scene.procedural.shapes import boxes as plain_boxes
from raystream.scene.procedural.shapes import patch, room, rounded_box
from raystream.scene.procedural.size import check_triangles
from raystream.scene.scene import Scene

DEFAULT_TRIANGLES = 61_562

#: Corners of the room, metres.
ROOM = ((-6.0, 0.0, -6.0), (6.0, 7.0, 9.0))

#: Half the side of the open square in the middle, where the rounded boxes lie.
CLEARING = 2.9

WALL, FLOOR, LAMP, FIRST_PLAIN, FIRST_ROUND = 0, 1, 2, 3, 7

MATERIALS = (
    Material("wall", diffuse=(0.7, 0.68, 0.64)),
    Material("floor", diffuse=(0.34, 0.27, 0.21), reflection=(0.06, 0.06, 0.06)),
    Material("lamp", diffuse=(0.8, 0.8, 0.8), emission=(17.0, 15.3, 12.5)),
    Material("sand", diffuse=(0.62, 0.5, 0.33)),
    Material("clay", diffuse=(0.5, 0.24, 0.15)),
    Material("slate", diffuse=(0.2, 0.26, 0.33)),
    Material("chalk", diffuse=(0.7, 0.7, 0.68)),
    Material("red", diffuse=(0.65, 0.05, 0.05), specular=(0.4, 0.4, 0.4), shininess=80.0),
    polished("steel", (0.06, 0.06, 0.07), gloss=0.7, shininess=150.0, reflection=(0.7, 0.72, 0.75)),
    Material("teal", diffuse=(0.03, 0.35, 0.37), specular=(0.4, 0.4, 0.4), shininess=80.0),
    Material("amber", diffuse=(0.8, 0.42, 0.04), specular=(0.4, 0.4, 0.4), shininess=80.0),
)


def boxes(triangles: int = DEFAULT_TRIANGLES) -> Scene:
    """Make a room of high- and low-polygon boxes, after the scene C of Christen 2005.

    By default there are 61,562 triangles, as many as in that scene: 12 for the room, 2 for
    its lamp, 12 rounded boxes of 4,800 and 329 plain boxes of 12.

    Parameters
    ----------
    triangles : int
        Target count; the actual count differs by at most 6, or 10 for the smallest targets.
        More triangles give more boxes of both kinds, and rounder ones.

    Returns
    -------
    Scene
        In metres, y up; the lamp in the ceiling is an area light.

    Raises
    ------
    ValueError
        If the target is out of range.

    References
    ----------
    Christen 2005, section 6.2.1, scene C.
    """
    # A plain box has 12 triangles, a rounded one a multiple of that.
    units = max(1, round((check_triangles(triangles) - 14) / 12))
    divisions = max(2, round(units**0.351))
    cells = divisions * divisions
    round_count = int(0.94 * units) // cells
    plain_count = units - round_count * cells

    generator = np.random.default_rng(2005)
    meshes = _room()
    meshes.append(to_mesh(_skyline(plain_count, generator), "plain boxes"))
    if round_count:
        meshes.append(to_mesh(_rounded(divisions, round_count, generator), "rounded boxes"))
    return Scene(
        meshes,
        materials=MATERIALS,
        camera=Camera((0.6, 4.3, 8.6), (0.0, 1.0, -0.6), fov=48.0),
        name="boxes",
    )


def _room() -> list[Mesh]:
    low, high = np.asarray(ROOM)
    y = high[1] - 0.01  # just below the ceiling
    corners = [(-2.0, y, 1.5), (2.0, y, 1.5), (2.0, y, 5.5), (-2.0, y, 5.5)]
    lamp = patch(corners).painted(LAMP)
    return [to_mesh(room(low, high, WALL, FLOOR), "room"), to_mesh(lamp, "lamp")]


def _skyline(count: int, generator: np.random.Generator) -> Part:
    """Boxes on the floor around the clearing, higher towards the walls."""
    low, high = np.asarray(ROOM)[:, [0, 2]]
    high = np.array([high[0], CLEARING])
    area = float(np.prod(high - low)) - (2 * CLEARING) ** 2
    whole = max(count, int(np.ceil(1.15 * count * np.prod(high - low) / area)) + 8)
    spots, spacing = floor_cells(whole, tuple(low), tuple(high), generator, jitter=0.03)
    # The clearing's cells are those nearest to it, so that exactly `count` remain.
    distance = np.abs(spots).max(axis=1)
    kept = np.sort(np.argsort(-distance, kind="stable")[:count])
    spots, distance = spots[kept], distance[kept]
    rise = np.clip((distance - CLEARING) / (6.0 - CLEARING), 0.0, 1.0)
    height = 0.15 + (0.25 + 2.6 * rise**1.5) * generator.uniform(0.35, 1.0, count)
    half = np.minimum(generator.uniform(0.36, 0.46, count) * spacing, 0.9)
    lows = np.stack([spots[:, 0] - half, np.zeros(count), spots[:, 1] - half], axis=1)
    highs = np.stack([spots[:, 0] + half, height, spots[:, 1] + half], axis=1)
    kinds = generator.integers(FIRST_PLAIN, FIRST_ROUND, count)
    return plain_boxes(lows, highs, kinds)


def _rounded(divisions: int, count: int, generator: np.random.Generator) -> Part:
    """Rounded boxes on the clearing's floor, about a third of them of each of three shapes."""
    edge = CLEARING - 0.2
    spots, spacing = floor_cells(count, (-edge, -edge), (edge, edge), generator, 0.1)
    shapes = (
        rounded_box(divisions, (1.0, 1.0, 1.0), 0.3),
        rounded_box(divisions, (1.0, 0.6, 1.0), 0.5),
        rounded_box(divisions, (0.7, 1.5, 0.7), 0.25),
    )
    kinds: NDArray[np.int64] = generator.permutation(count) % 3
    size = generator.uniform(0.25, 0.3, count) * spacing
    turns = yaw(generator.uniform(0.0, np.pi / 2, count), size)
    ids = FIRST_ROUND + generator.permutation(count) % (len(MATERIALS) - FIRST_ROUND)
    parts = []
    for kind, shape in enumerate(shapes):
        own = kinds == kind
        lift = float(shape.vertices[:, 1].max()) * size[own] + 1e-5
        offsets = np.stack([spots[own, 0], lift, spots[own, 1]], axis=1)
        parts.append(instance(shape, turns[own], offsets, material_ids=ids[own]))
    return merge(parts)
