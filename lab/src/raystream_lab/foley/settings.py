"""Settings that the paper leaves open, or that builders choose differently."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np

from raystream.scene.camera import Camera
from raystream.scene.scene import Scene
from raystream.structures.kdtree.options import KdTree

#: pbrt's bonus for empty space: Foley's builder is "based on" its first edition's.
PBRT_BONUS = 0.5

#: raystream's.
OWN_BONUS = KdTree().empty_bonus

#: ``kitchen.aff`` has a static view in its block ``v``, besides its moving camera.
_STILL_VIEWS = MappingProxyType(
    {
        "kitchen": Camera(
            (1.05369, 1.13876, 1.36377), (0.965979, 1.11824, 1.32034), (0.0, 1.0, 0.0), 40.0
        )
    }
)

_COSTS = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
_BONUSES = (0.0, OWN_BONUS, PBRT_BONUS, 0.8)
_DEPTHS = (16, 18, 20, 24, 64)
_LEAF_SIZES = (2, 4, 8, 16)
_ANGLES = (0.5, 0.75, 1.25, 1.5)
_SIZES = (64, 128, 256, 512)
_TIMES = 16


@dataclass(frozen=True)
class Setting:
    """One way to reproduce Table 2.

    Attributes
    ----------
    group : str
        What is changed.
    label : str
        The new value.
    time : float
        Time of the animation, for triangles and camera.
    camera : callable, optional
        Derives a camera from the scene's own.
    size : tuple of int, optional
        Width and height of the image.
    options : mapping
        Options of the tree.
    """

    group: str
    label: str
    time: float = 0.0
    camera: Callable[[Camera], Camera] | None = None
    size: tuple[int, int] | None = None
    options: Mapping[str, Any] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Group and label."""
        return f"{self.group}: {self.label}"

    @property
    def tree(self) -> tuple[float, str]:
        """A key shared by settings with the same tree."""
        return self.time, str(sorted(self.options.items()))


def settings_of(name: str, scene: Scene, size: int, quick: bool = False) -> Iterator[Setting]:
    """Yield the settings to try for a scene, one change at a time; the last group makes two.

    Parameters
    ----------
    name : str
        The scene's, of `scenes.SCENES`.
    scene : Scene
    size : int
        Default image size.
    quick : bool
        Only a few settings.
    """
    yield Setting("as in the lab", f"first frame, costs 8:1, bonus {PBRT_BONUS}")
    if name in _STILL_VIEWS:
        still = _STILL_VIEWS[name]
        yield Setting("camera", "the file's block v", camera=lambda _: still)
    for factor in _ANGLES[::3] if quick else _ANGLES:
        yield Setting("view angle", f"{factor:g} of the file's", camera=_widened(factor))
    wide = (round(size * 2 / 3**0.5), round(size * 3**0.5 / 2))
    yield Setting("shape of the image", "4:3", size=wide)
    for other in () if quick else _SIZES:
        yield Setting("resolution", f"{other} x {other}", size=(other, other))
    for cost in _COSTS[::3] if quick else _COSTS:
        yield Setting("cost of a step", f"{cost:g}:1", options={"traversal_cost": cost})
    for bonus in (OWN_BONUS,) if quick else _BONUSES:
        label = f"{bonus:g}" + (", raystream's" if bonus == OWN_BONUS else "")
        yield Setting("bonus for empty space", label, options={"empty_bonus": bonus})
    for depth in () if quick else _DEPTHS:
        yield Setting("depth", f"{depth} at most", options={"max_depth": depth})
    for leaf_size in () if quick else _LEAF_SIZES:
        label = f"at most {leaf_size} triangles not split"
        yield Setting("leaf size", label, options={"max_leaf_size": leaf_size})
    for overlap, label in (("exact", "clipped triangles"), ("box", "whole boxes, pbrt's")):
        yield Setting("lists", label, options={"overlap": overlap})
    yield from _frames("frame", scene, quick, {})
    own = {"empty_bonus": OWN_BONUS}
    yield from _frames("frame, with raystream's bonus", scene, quick, own)


def _frames(group: str, scene: Scene, quick: bool, options: Mapping[str, Any]) -> Iterator[Setting]:
    """Frames along the camera's path, with all animation."""
    if scene.camera_track is None:
        return
    first, last = scene.camera_track.times
    for moment in np.linspace(first, last, 2 if quick else _TIMES).tolist():
        yield Setting(group, f"t = {moment:.3g}", time=moment, options=options)


def _widened(factor: float) -> Callable[[Camera], Camera]:
    return lambda camera: dataclasses.replace(camera, fov=camera.fov * factor)
