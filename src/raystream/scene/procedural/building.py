"""Building: furnished rooms along corridors on several storeys, with doors, windows and stairs."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from raystream.scene.camera import Camera
from raystream.scene.lights import DirectionalLight, EnvironmentLight, PointLight
from raystream.scene.material import Material
from raystream.scene.procedural.furnishings import furnishings
from raystream.scene.procedural.parts import Part, to_mesh
from raystream.scene.procedural.rooms import (
    BAY,
    BOOK,
    COLORS,
    DEPTH,
    STOREY,
    Plan,
    all_boxes,
)
from raystream.scene.procedural.shapes import boxes, patch
from raystream.scene.procedural.size import check_triangles
from raystream.scene.scene import Scene

__all__ = ["DEFAULT_TRIANGLES", "building", "inside_camera"]

DEFAULT_TRIANGLES = 1_500_000

#: Half the side of the lawn around the building, in building lengths.
LAWN = 4.0

MATTE, LAWN_MATERIAL, FIRST_FURNISHING = 0, 1, 2

MATERIALS = (
    Material("matte", diffuse=(1.0, 1.0, 1.0)),
    Material("lawn", diffuse=(0.13, 0.24, 0.06)),
    Material(
        "ceramic",
        diffuse=(1.0, 1.0, 1.0),
        specular=(0.35, 0.35, 0.35),
        shininess=90.0,
        reflection=(0.06, 0.06, 0.06),
    ),
    Material("cloth", diffuse=(1.0, 1.0, 1.0)),
    Material("foliage", diffuse=(1.0, 1.0, 1.0)),
)

BOOK_COLORS = np.array(
    [[0.5, 0.06, 0.05], [0.07, 0.16, 0.38], [0.1, 0.3, 0.14], [0.55, 0.4, 0.12], [0.6, 0.55, 0.45]]
)


def building(triangles: int = DEFAULT_TRIANGLES) -> Scene:
    """Make an office building, in place of Soda Hall in Purcell 2002.

    Walls are large boxes, furniture is small boxes, furnishings are very small triangles:
    a mixture of sizes with high depth complexity. A corridor runs through each storey;
    its doors stand open, and stairs join the storeys.

    Parameters
    ----------
    triangles : int
        Target count; the actual count differs by at most 10 below 10,000, where boxes are
        omitted, and by less than 5 % above.

    Returns
    -------
    Scene
        In metres, y up, with a sun, a sky, and lamps in the lowest corridor. The camera
        stands outside; see also `inside_camera`.

    Raises
    ------
    ValueError
        If the target is out of range.

    References
    ----------
    Purcell 2002, section 4 (Soda Hall Outside, Soda Hall Inside).
    """
    target = check_triangles(triangles) - 2
    plan = _plan(target)
    length, height = plan.bays * BAY, plan.storeys * STOREY
    generator = np.random.default_rng(1994)
    offices = generator.random(2 * plan.storeys * plan.bays) < 0.6

    listed = all_boxes(plan, offices)
    box_count = max(1, min(len(listed.lows), round(target / 12)))
    kinds = listed.kinds[:box_count]
    colors = COLORS[kinds] * generator.uniform(0.94, 1.0, (box_count, 1))
    book = BOOK_COLORS[generator.integers(0, len(BOOK_COLORS), box_count)]
    colors = np.where((kinds == BOOK)[:, None], book, colors)
    shell = boxes(listed.lows[:box_count], listed.highs[:box_count], MATTE)
    shell = replace(shell, colors=np.repeat(colors, 8, axis=0).astype(np.float32))
    meshes = [to_mesh(_lawn(length), "lawn"), to_mesh(shell, "walls and furniture")]
    left = target - 12 * len(listed.lows)
    if left >= 12:
        smooth = furnishings(left, plan, offices, FIRST_FURNISHING, generator)
        if smooth.triangle_count:
            meshes.append(to_mesh(smooth, "furnishings"))
    reach = max(length, 2.0 * height)
    return Scene(
        meshes,
        materials=MATERIALS,
        lights=(
            DirectionalLight((0.55, -0.6, -0.85), (4.2, 3.9, 3.3)),
            EnvironmentLight((0.38, 0.46, 0.58)),
            *(PointLight((x, 2.5, 0.0), (7.0, 6.5, 5.7)) for x in _lamps(length)),
        ),
        background=(0.5, 0.67, 0.88),
        camera=Camera(
            (-0.12 * reach, 0.12 * height + 2.5, DEPTH + 0.4 * reach + 8.0),
            (0.38 * length, 0.46 * height, 0.0),
            fov=50.0,
        ),
        name="building",
    )


def _lamps(length: float) -> list[float]:
    """Return the positions of lights in the lowest corridor: every second lamp of the first ten."""
    return [x for x in (2.1 + 2 * BAY * i for i in range(5)) if x < length]


def inside_camera(scene: Scene) -> Camera:
    """Return the view along the lowest corridor.

    Parameters
    ----------
    scene : Scene
        Made by `building`.
    """
    length = float(scene.meshes[1].vertices[:, 0].max())
    return Camera((0.5, 1.6, -0.35), (0.5 + 0.6 * length, 1.3, 0.15), fov=60.0)


def _plan(triangles: int) -> Plan:
    """Choose storeys and bays: more triangles give more rooms, and more objects per room."""
    rooms = max(2.0, 0.046 * triangles**0.6)
    storeys = max(1, round(math.sqrt(rooms / 2 / 2.4)))
    return Plan(storeys, max(1, round(rooms / 2 / storeys)))


def _lawn(length: float) -> Part:
    reach = LAWN * max(length, 20.0)
    middle = length / 2
    # Slightly below the lowest slab's top, inside of it.
    y = -0.1
    corners = [
        (middle - reach, y, reach),
        (middle + reach, y, reach),
        (middle + reach, y, -reach),
        (middle - reach, y, -reach),
    ]
    return patch(corners).painted(LAWN_MATERIAL)
