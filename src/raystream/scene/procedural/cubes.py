"""Cubes: coloured and mirroring cubes distributed in a room."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raystream.scene.camera import Camera
from raystream.scene.lights import PointLight
from raystream.scene.material import Material
from raystream.scene.procedural.finishes import MIRROR, polished
from raystream.scene.procedural.parts import instance, to_mesh, yaw
from raystream.scene.procedural.shapes import box, room
from raystream.scene.procedural.size import check_triangles
from raystream.scene.scene import Scene

DEFAULT_TRIANGLES = 2064

#: Corners of the room, and of the part of it that has cubes, metres.
ROOM = ((-6.0, 0.0, -7.0), (6.0, 6.0, 6.5))
FILLED = ((-5.6, 0.2, -6.6), (5.6, 5.2, 1.6))

WALL, FLOOR, FIRST_CUBE = 0, 1, 2

#: Diffuse colours of the cubes that are not mirrors.
COLORS = ((0.7, 0.08, 0.06), (0.08, 0.22, 0.6), (0.85, 0.55, 0.08), (0.1, 0.45, 0.16))


def cubes(triangles: int = DEFAULT_TRIANGLES) -> Scene:
    """Make a room in which cubes float, for the scene B of Christen 2005.

    The thesis describes it as "cubes distributed in room" of 2,064 triangles, which are 172
    boxes: the room and 171 cubes by default. Places, sizes and materials are ours: two cubes in
    six are mirrors, the others are coloured and mirror 0.1 of the light.

    Parameters
    ----------
    triangles : int
        Target count; the actual count differs by at most 6. More triangles give more and
        smaller cubes.

    Returns
    -------
    Scene
        In metres, y up; two meshes (room, cubes), three point lights, one of them
        beside the camera.

    Raises
    ------
    ValueError
        If the target is out of range.

    References
    ----------
    Christen 2005, section 6.2.1, scene B.
    """
    count = max(1, round(check_triangles(triangles) / 12) - 1)
    generator = np.random.default_rng(2064)
    centres, spacing = _cells(count, generator)
    half = generator.uniform(0.16, 0.24, count) * spacing
    turns = yaw(generator.uniform(0.0, np.pi / 2, count), half)
    materials = _materials()
    ids = FIRST_CUBE + generator.permutation(count) % (len(materials) - FIRST_CUBE)
    return Scene(
        [
            to_mesh(room(*ROOM, WALL, FLOOR), "room"),
            to_mesh(instance(box(), turns, centres, material_ids=ids), "cubes"),
        ],
        materials=materials,
        lights=(
            PointLight((0.2, 3.5, 6.4), (82.0, 79.0, 76.0)),
            PointLight((-3.0, 5.6, 4.6), (60.0, 56.0, 50.0)),
            PointLight((3.5, 5.6, 2.5), (40.0, 44.0, 52.0)),
        ),
        camera=Camera((0.2, 3.2, 6.3), (0.0, 2.5, -2.0), fov=52.0),
        name="cubes",
    )


def _materials() -> tuple[Material, ...]:
    gold = Material(
        "gold mirror",
        diffuse=(0.08, 0.05, 0.02),
        specular=(0.8, 0.65, 0.4),
        shininess=200.0,
        reflection=(0.85, 0.68, 0.38),
    )
    return (
        Material("wall", diffuse=(0.72, 0.7, 0.66)),
        Material("floor", diffuse=(0.42, 0.4, 0.38), reflection=(0.08, 0.08, 0.08)),
        MIRROR,
        gold,
        *(
            polished("glossy", color, gloss=0.4, shininess=60.0, reflection=(0.1,) * 3)
            for color in COLORS
        ),
    )


def _cells(count: int, generator: np.random.Generator) -> tuple[NDArray[np.float64], float]:
    """Choose positions in the room, each in its own cell, and the shortest side of a cell."""
    low, high = np.asarray(FILLED)
    extent = high - low
    sides = np.ceil(extent / np.cbrt(extent.prod() / count)).astype(np.int64)
    chosen = np.sort(generator.permutation(sides.prod())[:count])
    cells = np.stack(np.unravel_index(chosen, sides), axis=1)
    spacing = float((extent / sides).min())
    wobble = generator.uniform(-0.15, 0.15, (count, 3)) * spacing
    return low + (cells + 0.5) * (extent / sides) + wobble, spacing
