"""Robots: a column of robots made of small parts, on the avenue of a huge, plain city."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from raystream.scene.camera import Camera
from raystream.scene.lights import DirectionalLight, EnvironmentLight
from raystream.scene.material import Material
from raystream.scene.procedural.city import city
from raystream.scene.procedural.finishes import polished
from raystream.scene.procedural.parts import Part, separate_copies, to_mesh
from raystream.scene.procedural.robot import PART_COUNT, robot_copies, robot_parts
from raystream.scene.procedural.shapes import patch
from raystream.scene.procedural.size import MAX_INSTANCED_TRIANGLES, check_triangles
from raystream.scene.scene import Scene

DEFAULT_TRIANGLES = 71_708

#: Half the side of the ground, metres; the robots are two metres tall.
REACH = 4000.0

#: First material index of the robots; the city has the lower ones.
ROBOT_MATERIALS = 5

MATERIALS = (
    Material("ground", diffuse=(0.2, 0.2, 0.21)),
    Material("stripe", diffuse=(0.75, 0.72, 0.6)),
    Material("stone", diffuse=(0.75, 0.75, 0.75)),
    Material("curb", diffuse=(0.42, 0.41, 0.4)),
    polished(
        "curtain wall", (0.22, 0.27, 0.32), gloss=0.3, shininess=90.0, reflection=(0.25, 0.27, 0.3)
    ),
    polished("paint", (0.8,) * 3, gloss=0.35, shininess=70.0, reflection=(0.05,) * 3),
    polished(
        "metal", (0.25, 0.26, 0.28), gloss=0.7, shininess=120.0, reflection=(0.35, 0.36, 0.38)
    ),
    polished(
        "visor", (0.015, 0.018, 0.022), gloss=0.8, shininess=250.0, reflection=(0.3, 0.3, 0.32)
    ),
    Material("eye", diffuse=(0.1, 0.85, 0.9), specular=(0.5, 0.5, 0.5), shininess=100.0),
    Material("rubber", diffuse=(0.05, 0.05, 0.055)),
)


def robots(triangles: int = DEFAULT_TRIANGLES) -> Scene:
    """Make robots in a city: the teapot in a stadium.

    In place of the Robots scene of the BART suite, which Foley 2005 measures: most of the
    triangles are concentrated in robots of two metres, the rest span kilometres.

    Parameters
    ----------
    triangles : int
        Target count; the actual count differs by at most 10. The default is the count of the
        BART scene. More triangles give more and finer robots and more towers; below about
        350 there is one robot without all its parts.

    Returns
    -------
    Scene
        In metres, y up, with a sun and a sky.

    Raises
    ------
    ValueError
        If the target is out of range.

    References
    ----------
    Foley 2005, section 4 (Robots); Lext, Assarsson and Möller, "BART: A Benchmark for
    Animated Ray Tracing", Chalmers, 2000.
    """
    plan = _Plan.of(check_triangles(triangles))
    generator = np.random.default_rng(2000)
    figures = robot_parts(*plan.crowd, ROBOT_MATERIALS, generator)
    towers = city(plan.city_count, generator)
    return Scene(
        [
            to_mesh(_ground(), "ground"),
            to_mesh(towers, "city"),
            to_mesh(figures, "robots"),
        ],
        materials=MATERIALS,
        **_surroundings(),
    )


def instanced_robots(triangles: int = DEFAULT_TRIANGLES) -> Scene:
    """Make the same scene with the robots' parts as instances.

    Parameters
    ----------
    triangles : int
        As of `robots`, in all instances.

    Returns
    -------
    Scene
        The city is an object of its own; each part of a robot is one, in each of the colours that
        robots have.

    Raises
    ------
    ValueError
        If the target is out of range.
    """
    plan = _Plan.of(check_triangles(triangles, MAX_INSTANCED_TRIANGLES))
    generator = np.random.default_rng(2000)
    parts = separate_copies(robot_copies(*plan.crowd, ROBOT_MATERIALS, generator))
    towers = city(plan.city_count, generator)
    return Scene.instances(
        [
            [to_mesh(_ground(), "ground"), to_mesh(towers, "city")],
            *([to_mesh(one, "robots")] for one in parts.objects),
        ],
        np.concatenate([np.eye(3, 4)[None], parts.transforms]),
        np.append(0, 1 + parts.object_ids),
        materials=MATERIALS,
        **_surroundings(),
    )


class _Plan(NamedTuple):
    """How many triangles go where.

    Attributes
    ----------
    city_count : int
        Boxes of the city.
    crowd : tuple of three int
        Divisions of each part, robots, and parts of a robot.
    """

    city_count: int
    crowd: tuple[int, int, int]

    @classmethod
    def of(cls, triangles: int) -> _Plan:
        """Plan a scene of a number of triangles."""
        # Every part of a robot has a multiple of 12 triangles, everything else 12.
        units = max(2, round((triangles - 2) / 12))
        city_count = max(1, int(min(0.35 * units, 6.5 * math.sqrt(units))))
        divisions, robot_count, part_count = _crowd(units - city_count)
        city_count = units - robot_count * part_count * divisions**2
        return cls(city_count, (divisions, robot_count, part_count))


def _ground() -> Part:
    return patch([(-REACH, 0, REACH), (REACH, 0, REACH), (REACH, 0, -REACH), (-REACH, 0, -REACH)])


def _surroundings() -> dict[str, Any]:
    """Lights, background, camera and name of the scene."""
    return {
        "lights": (
            DirectionalLight((0.34, -0.75, -0.9), (3.3, 3.0, 2.5)),
            EnvironmentLight((0.32, 0.4, 0.52)),
        ),
        "background": (0.42, 0.6, 0.86),
        "camera": Camera((1.7, 1.6, 8.0), (0.2, 1.95, -3.0), fov=40.0),
        "name": "robots",
    }


def _crowd(units: int) -> tuple[int, int, int]:
    """Choose divisions per part, robots, and parts per robot, given triangles / 12."""
    if units < PART_COUNT:
        return 1, 1, units
    divisions = max(1, round(units**0.175))
    while divisions > 1 and units < 3 * PART_COUNT * divisions**2:
        divisions -= 1
    return divisions, units // (PART_COUNT * divisions**2), PART_COUNT
