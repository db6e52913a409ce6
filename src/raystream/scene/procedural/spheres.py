"""Spheres: low-polygon spheres and cubes spread over the floor of a room."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raystream.scene.camera import Camera
from raystream.scene.lights import PointLight
from raystream.scene.material import Material
from raystream.scene.mesh import Mesh
from raystream.scene.procedural.finishes import MIRROR, polished
from raystream.scene.procedural.layout import floor_cells
from raystream.scene.procedural.parts import Part, instance, to_mesh, yaw
from raystream.scene.procedural.shapes import box, room, sphere
from raystream.scene.procedural.size import check_triangles
from raystream.scene.scene import Scene
from raystream.scene.texture import Texture

DEFAULT_TRIANGLES = 2064

#: Corners of the room, metres.
ROOM = ((-6.0, 0.0, -7.0), (6.0, 6.0, 6.5))

WALL, FLOOR, FIRST_CUBE, FIRST_SPHERE = 0, 1, 2, 5


def spheres(triangles: int = DEFAULT_TRIANGLES) -> Scene:
    """Make a room with spheres and cubes.

    By default there are 2,064 triangles: 12 for the room, 10 spheres of 192, and 11 cubes. Some
    spheres are mirrors, some are glass. `cubes` has as many triangles in cubes only.

    Parameters
    ----------
    triangles : int
        Target count; the actual count differs by at most 6. More triangles give more and
        smoother spheres.

    Returns
    -------
    Scene
        In metres, y up; three meshes (room, cubes, spheres), two point lights.

    Raises
    ------
    ValueError
        If the target is out of range.
    """
    # A cube has 12 triangles, a sphere a multiple of that.
    units = max(1, round((check_triangles(triangles) - 12) / 12))
    divisions = max(2, round(units**0.27))
    cells = divisions * divisions
    sphere_count = (units - int(min(0.06 * units, cells))) // cells
    cube_count = units - sphere_count * cells

    generator = np.random.default_rng(1968)
    spots, spacing = floor_cells(
        sphere_count + cube_count, (-5.4, -6.4), (5.4, 1.9), generator, 0.1
    )
    is_sphere = np.zeros(len(spots), bool)
    is_sphere[generator.permutation(len(spots))[:sphere_count]] = True
    meshes = [_room_mesh()]
    meshes.append(to_mesh(_cubes(spots[~is_sphere], spacing, generator), "cubes"))
    if sphere_count:
        balls = _balls(divisions, spots[is_sphere], spacing, generator)
        meshes.append(to_mesh(balls, "spheres"))
    return Scene(
        meshes,
        materials=_materials(),
        lights=(
            PointLight((-3.0, 5.6, 4.6), (100.0, 93.0, 82.0)),
            PointLight((3.5, 5.2, 0.5), (46.0, 51.0, 62.0)),
        ),
        camera=Camera((0.2, 2.9, 6.3), (0.0, 0.6, -1.6), fov=48.0),
        name="spheres",
    )


def _materials() -> tuple[Material, ...]:
    cubes = ((0.75, 0.48, 0.18), (0.55, 0.56, 0.6), (0.16, 0.42, 0.42))
    glossy = ((0.7, 0.08, 0.06), (0.08, 0.22, 0.6), (0.85, 0.55, 0.08), (0.1, 0.45, 0.16))
    return (
        Material("wall", diffuse=(0.72, 0.7, 0.66)),
        Material("floor", diffuse=(0.8, 0.8, 0.8), textures={"diffuse": _tiles()}),
        *(Material("cube", diffuse=color) for color in cubes),
        *(
            polished("glossy", color, gloss=0.4, shininess=60.0, reflection=(0.08,) * 3)
            for color in glossy
        ),
        MIRROR,
        Material(
            "glass",
            diffuse=(0.01, 0.01, 0.01),
            specular=(0.6, 0.6, 0.6),
            shininess=200.0,
            reflection=(0.06, 0.06, 0.06),
            transmission=(0.9, 0.93, 0.92),
            ior=1.5,
        ),
    )


def _tiles() -> Texture:
    """A checkered floor of 12 by 12 tiles."""
    tile = np.arange(768) // 64
    dark = (tile[:, None] + tile[None, :]) % 2 == 1
    colors = np.array([[214, 208, 196], [92, 98, 110]], np.uint8)
    return Texture(colors[dark.astype(np.intp)], name="tiles")


def _room_mesh() -> Mesh:
    low, high = np.asarray(ROOM)
    inside = room(low, high, WALL, FLOOR)
    texcoords = ((inside.vertices - low) / (high - low))[:, [0, 2]]
    return to_mesh(inside, "room", texcoords=texcoords.astype(np.float32))


def _cubes(spots: NDArray[np.float64], spacing: float, generator: np.random.Generator) -> Part:
    count = len(spots)
    half = generator.uniform(0.17, 0.25, count) * spacing
    offsets = np.stack([spots[:, 0], half, spots[:, 1]], axis=1)
    ids = FIRST_CUBE + generator.integers(0, FIRST_SPHERE - FIRST_CUBE, count)
    turns = yaw(generator.uniform(0.0, np.pi / 2, count), half)
    return instance(box(), turns, offsets, material_ids=ids)


def _balls(
    divisions: int, spots: NDArray[np.float64], spacing: float, generator: np.random.Generator
) -> Part:
    count = len(spots)
    radius = generator.uniform(0.3, 0.4, count) * spacing
    offsets = np.stack([spots[:, 0], radius, spots[:, 1]], axis=1)
    kinds = len(_materials()) - FIRST_SPHERE
    ids = FIRST_SPHERE + generator.permutation(count) % kinds
    turns = yaw(generator.uniform(0.0, np.pi / 2, count), radius)
    return instance(sphere(divisions), turns, offsets, material_ids=ids)
