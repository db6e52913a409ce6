"""Cornell box: five walls, a light and two blocks, matte or polished."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from raystream.scene.camera import Camera
from raystream.scene.material import Material
from raystream.scene.mesh import Mesh
from raystream.scene.procedural.parts import Part, merge, to_mesh
from raystream.scene.procedural.shapes import box, patch
from raystream.scene.procedural.size import check_triangles, closest_divisions
from raystream.scene.scene import Scene

DEFAULT_TRIANGLES = 36

#: Blocks without bottoms have 10 triangles each.
OPEN_TRIANGLES = 32

WHITE, RED, GREEN, LIGHT, BLOCK = range(5)

MATERIALS = (
    Material("white", diffuse=(0.725, 0.71, 0.68)),
    Material("red", diffuse=(0.63, 0.065, 0.05)),
    Material("green", diffuse=(0.14, 0.45, 0.091)),
    Material("light", diffuse=(0.78, 0.78, 0.78), emission=(17.0, 12.0, 4.0)),
)

#: Mirror reflectance of polished walls and blocks.
WALL_SHARE, BLOCK_SHARE = 0.3, 0.8

#: Measured corners in millimetres, facing into the room: floor, ceiling, back, right, left.
WALLS = (
    (WHITE, ((552.8, 0, 0), (0, 0, 0), (0, 0, 559.2), (549.6, 0, 559.2))),
    (WHITE, ((556, 548.8, 0), (556, 548.8, 559.2), (0, 548.8, 559.2), (0, 548.8, 0))),
    (WHITE, ((549.6, 0, 559.2), (0, 0, 559.2), (0, 548.8, 559.2), (556, 548.8, 559.2))),
    (GREEN, ((0, 0, 559.2), (0, 0, 0), (0, 548.8, 0), (0, 548.8, 559.2))),
    (RED, ((552.8, 0, 0), (549.6, 0, 559.2), (556, 548.8, 559.2), (556, 548.8, 0))),
)

#: The measured light lies in the ceiling's plane; lowered, so that it can be seen.
LIGHT_HEIGHT = 548.3
LIGHT_CORNERS = (
    (343, LIGHT_HEIGHT, 227),
    (343, LIGHT_HEIGHT, 332),
    (213, LIGHT_HEIGHT, 332),
    (213, LIGHT_HEIGHT, 227),
)

CAMERA = Camera((278.0, 273.0, -800.0), (278.0, 273.0, 0.0), fov=39.3)

#: Footprint (x, z) in the order of a box's corners, and height, of the short and tall block.
BLOCKS = (
    (((130, 65), (290, 114), (82, 225), (240, 272)), 165.0),
    (((265, 296), (423, 247), (314, 456), (472, 406)), 330.0),
)


def cornell(triangles: int = DEFAULT_TRIANGLES) -> Scene:
    """Make the Cornell box.

    The measured corners, colours and camera are those of Cornell's program of computer
    graphics. The two blocks are closed and stand on the floor.

    Parameters
    ----------
    triangles : int
        Target count: 36 without subdivision, else every surface is divided evenly. The actual
        count differs by at most half the target below 36, by less than a third below 100, by
        less than 15 % above.

    Returns
    -------
    Scene
        In millimetres, y up, one mesh per surface; the light is an area light.

    Raises
    ------
    ValueError
        If the target is out of range.
    """
    return Scene(
        _surfaces(check_triangles(triangles), WHITE),
        materials=MATERIALS,
        camera=CAMERA,
        name="cornell",
    )


def cornell_open(triangles: int = OPEN_TRIANGLES) -> Scene:
    """Make the Cornell box with blocks without bottoms, in 32 triangles as in Foley 2005.

    Foley gives the count only: five walls and a light of 2 triangles, and two blocks of 10.

    Parameters
    ----------
    triangles : int
        Target count: 32 without subdivision, else every surface is divided evenly. The actual
        count comes as close as that of `cornell`.

    Returns
    -------
    Scene
        As `cornell`, without the triangles on which the blocks stand.

    Raises
    ------
    ValueError
        If the target is out of range.

    References
    ----------
    Foley 2005, section 4.
    """
    return Scene(
        _surfaces(check_triangles(triangles), WHITE, bottoms=False),
        materials=MATERIALS,
        camera=CAMERA,
        name="cornell_open",
    )


def cornell_mirrors(triangles: int = DEFAULT_TRIANGLES) -> Scene:
    """Make the Cornell box with walls that mirror 0.3 of the light, and blocks that mirror 0.8.

    For many bounces: opposite walls reflect each other.

    Parameters
    ----------
    triangles : int
        As for `cornell`.

    Returns
    -------
    Scene
        The triangles and the camera of `cornell`.

    Raises
    ------
    ValueError
        If the target is out of range.
    """
    white, red, green, light = MATERIALS
    walls = tuple(_polished(material, WALL_SHARE) for material in (white, red, green))
    return Scene(
        _surfaces(check_triangles(triangles), BLOCK),
        materials=(*walls, light, _polished(white, BLOCK_SHARE)),
        camera=CAMERA,
        name="cornell_mirrors",
    )


def _polished(material: Material, share: float) -> Material:
    """Make a material mirror a share of the light; its diffuse colour scales the rest."""
    red, green, blue = ((1.0 - share) * channel for channel in material.diffuse)
    return dataclasses.replace(
        material, diffuse=(red, green, blue), reflection=(share, share, share)
    )


def _surfaces(triangles: int, block_id: int, *, bottoms: bool = True) -> list[Mesh]:
    """Make the walls, the blocks of this material, and the light."""

    def count(across: int, along: int) -> int:
        closed = 12 * across * along + 8 * (2 * across * along + across * across)
        return closed if bottoms else closed - 4 * across * across

    across, along = closest_divisions(triangles, count)
    meshes = []
    names = ("floor", "ceiling", "back wall", "right wall", "left wall")
    for name, (material_id, corners) in zip(names, WALLS, strict=True):
        wall = patch(corners, (across, along)).painted(material_id)
        meshes.append(to_mesh(wall, name))
    for name, (footprint, height) in zip(("short block", "tall block"), BLOCKS, strict=True):
        block = _block(footprint, height, (across, along, across)).painted(block_id)
        if not bottoms:
            block = _without_bottom(block)
        meshes.append(to_mesh(block, name))
    light = patch(LIGHT_CORNERS, (across, along)).painted(LIGHT)
    meshes.append(to_mesh(merge([light]), "light"))
    return meshes


def _block(
    footprint: tuple[tuple[int, int], ...], height: float, divisions: tuple[int, int, int]
) -> Part:
    """Deform a divided box to a footprint that is not quite a rectangle."""
    part = box(divisions)
    unit = (part.vertices.astype(np.float64) + 1.0) / 2.0
    x, y, z = unit[:, 0, None], unit[:, 1], unit[:, 2, None]
    corner = np.asarray(footprint, np.float64)
    ground = (corner[0] * (1 - x) + corner[1] * x) * (1 - z)
    ground = ground + (corner[2] * (1 - x) + corner[3] * x) * z
    vertices: NDArray[np.float32] = np.stack([ground[:, 0], y * height, ground[:, 1]], axis=1)
    return Part(vertices.astype(np.float32), part.faces, part.material_ids)


def _without_bottom(block: Part) -> Part:
    """Drop the triangles on the floor, and the vertices that only they use."""
    standing = (block.vertices[block.faces, 1] > 0.0).any(axis=1)
    used, faces = np.unique(block.faces[standing], return_inverse=True)
    return Part(
        block.vertices[used], faces.reshape(-1, 3).astype(np.int32), block.material_ids[standing]
    )
