"""The papers' scenes or substitutes for them, each with a camera."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.scene.camera import Camera
from raystream.scene.lights import PointLight
from raystream.scene.load import load
from raystream.scene.mesh import Mesh
from raystream.scene.procedural import building as _building
from raystream.scene.procedural import forest as _forest
from raystream.scene.scene import Scene
from raystream_lab.published import published

#: Triangles of generated scenes with ``quick``.
QUICK_TRIANGLES = 30_000

#: Views of Purcell 2002, Figure 6, in its order.
PURCELL_VIEWS = (
    "building outside",
    "building inside",
    "forest top",
    "forest inside",
    "bunny",
    "bunny on a floor",
)

#: Degrees; chosen so that as many rays hit as in Purcell's Figure 6.
_FLOOR_FOV = 33.0


class View(NamedTuple):
    """A scene with a camera.

    Attributes
    ----------
    name : str
        Its name in tables.
    scene_name : str
        Shared by all views of one scene.
    scene : Scene
    camera : Camera
        For square images.
    about : str
        What it is, and how it differs from the paper's scene; a sentence.
    """

    name: str
    scene_name: str
    scene: Scene
    camera: Camera
    about: str

    def rays(self, size: int) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
        """Origins and directions of a square image's rays, of shape (size, size, 3)."""
        origins, directions = self.camera.rays(size, size)
        return origins, directions

    def seen_from(self, camera: Camera, name: str) -> View:
        """The same scene from another camera."""
        return self._replace(camera=camera, name=name)


def view(name: str, *, quick: bool = False) -> View:
    """Make a view.

    Parameters
    ----------
    name : str
        A key of `VIEWS`, or a name for `load`, with that scene's own camera.
    quick : bool
        Reduce the triangles of generated scenes.

    Raises
    ------
    RaystreamError
        If the model is missing and cannot be fetched.
    """
    if name in VIEWS:
        return VIEWS[name](name, quick)
    scene = load(name)
    return View(name, name, scene, scene.camera_for(1.0), "")


def _building_scene(quick: bool) -> Scene:
    """The building with its lawn."""
    return _building.building(QUICK_TRIANGLES if quick else _building.DEFAULT_TRIANGLES)


def without_lawn(scene: Scene) -> Scene:
    """Remove the lawn: Soda Hall had none, or rays would not have missed its box."""
    return Scene(
        scene.meshes[1:],
        materials=scene.materials,
        lights=scene.lights,
        camera=scene.camera,
        background=scene.background,
        name=scene.name,
    )


def _building_outside(name: str, quick: bool) -> View:
    scene = _building_scene(quick)
    about = (
        "A generated office building replaces Soda Hall, of which no public copy is known. Its "
        "lawn is omitted: with it, 128 cells over the building's height would make a billion "
        "cells."
    )
    return View(name, "building", without_lawn(scene), scene.camera_for(1.0), about)


def _building_inside(name: str, quick: bool) -> View:
    scene = _building_scene(quick)
    return View(
        name,
        "building",
        without_lawn(scene),
        _building.inside_camera(scene),
        "The same building, seen along a corridor.",
    )


def _forest_scene(quick: bool) -> Scene:
    return _forest.forest(QUICK_TRIANGLES if quick else _forest.DEFAULT_TRIANGLES)


def _forest_top(name: str, quick: bool) -> View:
    scene = _forest_scene(quick)
    about = "A generated forest replaces Purcell's, which was not published; seen from above."
    return View(name, "forest", scene, _forest.top_camera(scene), about)


def _forest_inside(name: str, quick: bool) -> View:
    scene = _forest_scene(quick)
    return View(
        name,
        "forest",
        scene,
        _forest.inside_camera(scene),
        "The same forest, from a path between the trees.",
    )


def _bunny(name: str, quick: bool) -> View:  # noqa: ARG001 - as every view
    scene = load("bunny")
    about = "The Stanford bunny that both papers used, without a floor."
    return View(name, "bunny", scene, scene.camera_for(1.0), about)


def on_floor(scene: Scene, shape: Sequence[int]) -> Scene:
    """Add a floor as wide and deep as a grid with these cell counts.

    Parameters
    ----------
    scene : Scene
    shape : sequence of three int
        Cells of the grid along x, y and z; its height is the scene's.

    Returns
    -------
    Scene
        With an additional mesh of two triangles, and a light.
    """
    low, high = scene.bounds
    middle, height = (low + high) / 2, float(high[1] - low[1])
    corners = np.array([[-1, 0, -1], [-1, 0, 1], [1, 0, 1], [1, 0, -1]]) * height / 2
    corners = corners * [shape[0] / shape[1], 0.0, shape[2] / shape[1]]
    floor = Mesh(corners + [middle[0], low[1], middle[2]], [[0, 1, 2], [0, 2, 3]], name="floor")
    light = PointLight(tuple(middle + np.array([1, 2, 1]) * height), (6.0 * height**2,) * 3)
    return Scene([*scene.meshes, floor], materials=scene.materials, lights=[light])


def _bunny_on_floor(name: str, quick: bool) -> View:  # noqa: ARG001 - as every view
    alone = load("bunny")
    low, high = alone.bounds
    middle, height = (low + high) / 2, float(high[1] - low[1])
    eye = middle + np.array([0.2, 1.7, 1.3]) * height
    camera = Camera(tuple(eye), tuple(middle), fov=_FLOOR_FOV)
    cells = published("purcell", "grids").values["bunny"]
    about = (
        f"On a floor as wide and deep as Purcell's grid of {' x '.join(map(str, cells))} cells "
        "implies, from a camera for which about as many rays hit as in his figure."
    )
    return View(name, "bunny on a floor", on_floor(alone, cells), camera, about)


#: Views by name.
VIEWS: Mapping[str, Callable[[str, bool], View]] = MappingProxyType(
    {
        "building outside": _building_outside,
        "building inside": _building_inside,
        "forest top": _forest_top,
        "forest inside": _forest_inside,
        "bunny": _bunny,
        "bunny on a floor": _bunny_on_floor,
    }
)
