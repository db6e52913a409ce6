"""Built-in scenes: generated, deterministic, of any size."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import NamedTuple

from raystream.scene.procedural import boxes as _boxes
from raystream.scene.procedural import building as _building
from raystream.scene.procedural import cornell as _cornell
from raystream.scene.procedural import cubes as _cubes
from raystream.scene.procedural import forest as _forest
from raystream.scene.procedural import robots as _robots
from raystream.scene.procedural import spheres as _spheres
from raystream.scene.procedural import three_boxes as _three_boxes
from raystream.scene.procedural.size import (
    MAX_INSTANCED_TRIANGLES,
    MAX_TRIANGLES,
    MIN_TRIANGLES,
)
from raystream.scene.scene import Scene

__all__ = [
    "BUILTIN",
    "MAX_INSTANCED_TRIANGLES",
    "MAX_TRIANGLES",
    "MIN_TRIANGLES",
    "Builtin",
    "generate",
]


class Builtin(NamedTuple):
    """A built-in scene.

    Parameters
    ----------
    make : callable
        ``make(triangles)`` returns the `Scene`.
    description : str
        One line.
    triangles : int
        The default target count.
    make_instanced : callable, optional
        ``make_instanced(triangles)`` returns it with instances; None if it has no such form.
    """

    make: Callable[[int], Scene]
    description: str
    triangles: int
    make_instanced: Callable[[int], Scene] | None = None


#: The built-in scenes by name, in display order.
BUILTIN: Mapping[str, Builtin] = MappingProxyType(
    {
        "cornell": Builtin(
            _cornell.cornell,
            "the Cornell box: five walls, a light and two blocks",
            _cornell.DEFAULT_TRIANGLES,
        ),
        "cornell_mirrors": Builtin(
            _cornell.cornell_mirrors,
            "the Cornell box with polished walls and blocks, for many bounces",
            _cornell.DEFAULT_TRIANGLES,
        ),
        "cornell_open": Builtin(
            _cornell.cornell_open,
            "the Cornell box with blocks without bottoms (Foley's 32 triangles)",
            _cornell.OPEN_TRIANGLES,
        ),
        "three_boxes": Builtin(
            _three_boxes.three_boxes,
            "two boxes on a flat one, all of them mirrors (Christen's scene A)",
            _three_boxes.DEFAULT_TRIANGLES,
        ),
        "cubes": Builtin(
            _cubes.cubes,
            "coloured and mirroring cubes that float in a room (Christen's scene B)",
            _cubes.DEFAULT_TRIANGLES,
        ),
        "spheres": Builtin(
            _spheres.spheres,
            "mirrors, glass and cubes in a room",
            _spheres.DEFAULT_TRIANGLES,
        ),
        "boxes": Builtin(
            _boxes.boxes,
            "plain and rounded boxes in a room (after Christen's scene C)",
            _boxes.DEFAULT_TRIANGLES,
        ),
        "building": Builtin(
            _building.building,
            "an office building, outside and inside (for Purcell's Soda Hall)",
            _building.DEFAULT_TRIANGLES,
            _building.instanced_building,
        ),
        "forest": Builtin(
            _forest.forest,
            "trees of many tiny triangles on hilly ground (for Purcell's forest)",
            _forest.DEFAULT_TRIANGLES,
            _forest.instanced_forest,
        ),
        "robots": Builtin(
            _robots.robots,
            "detailed robots in a huge, plain city (for BART's robots)",
            _robots.DEFAULT_TRIANGLES,
            _robots.instanced_robots,
        ),
    }
)


def generate(name: str, triangles: int | None = None, instances: bool = False) -> Scene:
    """Make a built-in scene.

    The same arguments give the same arrays, bit for bit, on one machine and one version of
    NumPy; elsewhere, sines and cosines may differ in the last bit.

    Parameters
    ----------
    name : str
        A key of `BUILTIN`.
    triangles : int, optional
        Target count, `MIN_TRIANGLES` to `MAX_TRIANGLES` [default: the count of the paper's
        scene]. Each scene documents its tolerance, at most half the target.
    instances : bool
        Make it with instances; then it may have up to `MAX_INSTANCED_TRIANGLES`.

    Returns
    -------
    Scene
        With a camera, lights and materials, and without degenerate triangles.

    Raises
    ------
    ValueError
        If there is no such scene, it has no form with instances, or the target is out of range.
    TypeError
        If the target is not an integer.
    """
    if name not in BUILTIN:
        raise ValueError(f"no built-in scene {name!r}: expected one of {', '.join(BUILTIN)}")
    scene = BUILTIN[name]
    make = scene.make_instanced if instances else scene.make
    if make is None:
        with_instances = ", ".join(key for key, one in BUILTIN.items() if one.make_instanced)
        raise ValueError(
            f"instances: only for glTF files and the built-in scenes {with_instances}, not for "
            f"{name!r}"
        )
    return make(scene.triangles if triangles is None else triangles)
