"""The lights of the classic pipeline: each in one place, and those it adds so that all is seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raystream.render.environment import image_light, mean_radiance
from raystream.scene.camera import Camera
from raystream.scene.lights import EnvironmentLight, Light, PointLight
from raystream.scene.scene import Scene

__all__ = ["PatchLight", "area_patches", "classic_lights"]

#: Emissive triangles count as one flat patch if their normals add up to this much of their
#: area, and as a light bulb otherwise.
_FLATNESS = 0.9


@dataclass(frozen=True)
class PatchLight:
    """An area light taken together: a small flat patch, or a bulb.

    Attributes
    ----------
    position : ndarray of shape (3,), float64
        Centre of the emissive triangles, world space.
    normal : ndarray of shape (3,), float64, or None
        Unit normal of a flat patch, which emits to that side only; None for a bulb.
    radiance : ndarray of shape (3,), float64
        What each point of it emits, linear RGB.
    area : float
    prim_ids : ndarray of shape (K,), int32
        The triangles, which can be hit.
    """

    position: NDArray[np.float64]
    normal: NDArray[np.float64] | None
    radiance: NDArray[np.float64]
    area: float
    prim_ids: NDArray[np.int32]


def area_patches(scene: Scene) -> list[PatchLight]:
    """Turn a scene's area lights into one patch each."""
    patches = []
    for light in scene.area_lights:
        solid = np.unique(light.prim_ids)
        solid = solid[np.isin(solid, scene.triangles.prim_ids)]
        if not len(solid):
            continue
        corners = scene.triangles.to_world(scene.triangles.corners[solid])
        edges = corners[:, 1:] - corners[:, :1]
        normals = np.cross(edges[:, 0], edges[:, 1]) / 2.0
        areas = np.linalg.norm(normals, axis=1)
        area = float(areas.sum())
        total = normals.sum(axis=0)
        flat = float(np.linalg.norm(total)) > _FLATNESS * area
        patches.append(
            PatchLight(
                position=np.average(corners.mean(axis=1), axis=0, weights=areas),
                normal=total / np.linalg.norm(total) if flat else None,
                radiance=np.array(light.radiance),
                area=area,
                prim_ids=solid,
            )
        )
    return patches


def classic_lights(
    scene: Scene, camera: Camera, patches: Sequence[PatchLight]
) -> tuple[Light, ...]:
    """The scene's lights, and those that a classic pipeline adds so that all can be seen.

    Parameters
    ----------
    scene : Scene
    camera : Camera
    patches : sequence of PatchLight
        The scene's area lights.

    Returns
    -------
    tuple of Light
        The mean of an environment light's image takes its place. A scene without any light
        gets a white one at the eye. A scene with area lights gets an ambient one, for what its
        surfaces would reflect on each other: as much as a closed box of the scene's size
        would, every wall of which reflects half.

    Raises
    ------
    ValueError, FileFormatError, ImportError
        See `environment.image_light` and `environment.texels_of`.
    """
    image = image_light(scene.lights)
    lights = tuple(
        EnvironmentLight(mean_radiance(light)) if light is image else light
        for light in scene.lights
    )
    if patches:
        extent = scene.bounds[1] - scene.bounds[0]
        box_area = 2.0 * float(extent @ np.roll(extent, 1))
        # Of the power pi * radiance * area the walls send back 1/2 + 1/4 + ... = all, spread
        # evenly; a uniform radiance L gives each wall an irradiance of pi * L.
        radiance = sum((p.radiance * (p.area / box_area) for p in patches), np.zeros(3))
        ambient = float(radiance[0]), float(radiance[1]), float(radiance[2])
        return (*lights, EnvironmentLight(ambient))
    return lights or (PointLight(camera.eye, (1.0, 1.0, 1.0), falloff="none"),)
