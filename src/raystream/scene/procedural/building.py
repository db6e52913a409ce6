"""Building: furnished rooms along corridors on several storeys, with doors, windows and stairs."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.scene.camera import Camera
from raystream.scene.lights import DirectionalLight, EnvironmentLight, PointLight
from raystream.scene.material import Material
from raystream.scene.mesh import Mesh
from raystream.scene.procedural.finishes import polished
from raystream.scene.procedural.furnishings import furnishings
from raystream.scene.procedural.parts import Part, merge_copies, separate_copies, to_mesh
from raystream.scene.procedural.rooms import (
    BAY,
    BOOK,
    COLORS,
    DEPTH,
    STOREY,
    BoxList,
    Plan,
    all_boxes,
    outer_boxes,
    room_boxes,
    rooms_of,
)
from raystream.scene.procedural.shapes import boxes, patch
from raystream.scene.procedural.size import MAX_INSTANCED_TRIANGLES, check_triangles
from raystream.scene.scene import Scene

DEFAULT_TRIANGLES = 1_500_000

#: Half the side of the lawn around the building, in building lengths.
LAWN = 4.0

MATTE, LAWN_MATERIAL, FIRST_FURNISHING = 0, 1, 2

#: Name of the mesh of boxes.
WALLS = "walls and furniture"

#: Most objects for rooms of one kind.
SHADES = 8

MATERIALS = (
    Material("matte", diffuse=(1.0, 1.0, 1.0)),
    Material("lawn", diffuse=(0.13, 0.24, 0.06)),
    polished("ceramic", (1.0,) * 3, gloss=0.35, shininess=90.0, reflection=(0.06,) * 3),
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
    generator = np.random.default_rng(1994)
    offices = _offices(plan, generator)
    meshes = [to_mesh(_lawn(plan), "lawn"), _all_walls(plan, offices, target, generator)]
    left = target - 12 * _box_count(plan, offices)
    if left >= 12:
        smooth = merge_copies(furnishings(left, plan, offices, FIRST_FURNISHING, generator))
        if smooth.triangle_count:
            meshes.append(to_mesh(smooth, "furnishings"))
    return Scene(meshes, materials=MATERIALS, **_surroundings(plan))


def instanced_building(triangles: int = DEFAULT_TRIANGLES) -> Scene:
    """Make the same building with rooms and furnishings as instances.

    Parameters
    ----------
    triangles : int
        As of `building`, in all instances.

    Returns
    -------
    Scene
        Rooms of a kind have one of a few shades. Where boxes are omitted, rooms are no instances.

    Raises
    ------
    ValueError
        If the target is out of range.
    """
    target = check_triangles(triangles, MAX_INSTANCED_TRIANGLES) - 2
    plan = _plan(target)
    generator = np.random.default_rng(1994)
    offices = _offices(plan, generator)
    box_count = _box_count(plan, offices)
    if 12 * box_count > target:
        objects = [[to_mesh(_lawn(plan), "lawn"), _all_walls(plan, offices, target, generator)]]
        rooms = np.zeros(0, np.int64), np.zeros((0, 3, 4))
    else:
        paints = _Paints.drawn(box_count, generator)
        walls = paints.boxes(outer_boxes(plan), 0)
        objects = [[to_mesh(_lawn(plan), "lawn"), to_mesh(walls, WALLS)]]
        rooms = _add_rooms(objects, plan, offices, paints)
    left = target - 12 * box_count
    copies = furnishings(left, plan, offices, FIRST_FURNISHING, generator) if left >= 12 else ()
    smooth = separate_copies(copies)
    ids = np.concatenate([np.zeros(1, np.int64), rooms[0], len(objects) + smooth.object_ids])
    objects += [[to_mesh(one, "furnishings")] for one in smooth.objects]
    transforms = np.concatenate([np.eye(3, 4)[None], rooms[1], smooth.transforms])
    return Scene.instances(objects, transforms, ids, materials=MATERIALS, **_surroundings(plan))


def _offices(plan: Plan, generator: np.random.Generator) -> NDArray[np.bool_]:
    return generator.random(2 * plan.storeys * plan.bays) < 0.6


def _box_count(plan: Plan, offices: NDArray[np.bool_]) -> int:
    """The number of `all_boxes`."""
    sizes = np.array([len(one.lows) for one in room_boxes()])
    return len(outer_boxes(plan).lows) + int(sizes[rooms_of(plan, offices)[0]].sum())


class _Paints(NamedTuple):
    """Shades of boxes, shape (N, 1), and the colours that they have if they are books, (N, 3)."""

    shades: NDArray[np.float64]
    books: NDArray[np.float64]

    @classmethod
    def drawn(cls, count: int, generator: np.random.Generator) -> _Paints:
        shades = generator.uniform(0.94, 1.0, (count, 1))
        return cls(shades, BOOK_COLORS[generator.integers(0, len(BOOK_COLORS), count)])

    def boxes(self, listed: BoxList, first: int) -> Part:
        """Boxes with the paints from `first` on."""
        own = slice(first, first + len(listed.kinds))
        plain = COLORS[listed.kinds] * self.shades[own]
        colors = np.where((listed.kinds == BOOK)[:, None], self.books[own], plain)
        made = boxes(listed.lows, listed.highs, MATTE)
        return replace(made, colors=np.repeat(colors, 8, axis=0).astype(np.float32))


def _all_walls(
    plan: Plan, offices: NDArray[np.bool_], target: int, generator: np.random.Generator
) -> Mesh:
    """The boxes of all rooms, or as many as there are triangles for."""
    listed = all_boxes(plan, offices)
    count = max(1, min(len(listed.lows), round(target / 12)))
    some = BoxList(listed.lows[:count], listed.highs[:count], listed.kinds[:count])
    return to_mesh(_Paints.drawn(count, generator).boxes(some, 0), WALLS)


def _add_rooms(
    objects: list[list[Mesh]], plan: Plan, offices: NDArray[np.bool_], paints: _Paints
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Append objects of the rooms; returns the object of each room, and its transform."""
    kinds, transforms = rooms_of(plan, offices)
    ids, first = np.zeros(len(kinds), np.int64), len(outer_boxes(plan).lows)
    for kind, listed in enumerate(room_boxes()):
        own = np.flatnonzero(kinds == kind)
        shades = min(SHADES, len(own))
        ids[own] = len(objects) + np.arange(len(own)) % max(shades, 1)
        for _ in range(shades):
            objects.append([to_mesh(paints.boxes(listed, first), WALLS)])
            first += len(listed.kinds)
    return ids, transforms


def _surroundings(plan: Plan) -> dict[str, Any]:
    """Lights, background, camera and name of the scene."""
    length, height = plan.bays * BAY, plan.storeys * STOREY
    reach = max(length, 2.0 * height)
    return {
        "lights": (
            DirectionalLight((0.55, -0.6, -0.85), (4.2, 3.9, 3.3)),
            EnvironmentLight((0.38, 0.46, 0.58)),
            *(PointLight((x, 2.5, 0.0), (7.0, 6.5, 5.7)) for x in _lamps(length)),
        ),
        "background": (0.5, 0.67, 0.88),
        "camera": Camera(
            (-0.12 * reach, 0.12 * height + 2.5, DEPTH + 0.4 * reach + 8.0),
            (0.38 * length, 0.46 * height, 0.0),
            fov=50.0,
        ),
        "name": "building",
    }


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


def _lawn(plan: Plan) -> Part:
    length = plan.bays * BAY
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
