"""Lights of a scene: whether they are enough to see by, and each as one place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raystream.rendering.environment import image_light, mean_radiance
from raystream.scene.camera import Camera
from raystream.scene.lights import DirectionalLight, EnvironmentLight, Light, PointLight
from raystream.scene.material import Color
from raystream.scene.scene import Scene

__all__ = [
    "ADDED",
    "LEAST_LIGHT",
    "LIGHTS",
    "PatchLight",
    "added_light",
    "area_patches",
    "check_lights",
    "needs_light",
    "punctual_lights",
]

#: Choices of lights: the scene's own, with another one where those are too weak to see by; or
#: the scene's own alone.
LIGHTS = ("auto", "file")

#: Lights are too weak to see by if white surfaces would show less, on average: a screen's white
#: is about a thousand times as bright as its black.
LEAST_LIGHT = 1e-3

#: The light that modes add to lights that are too weak. Other modes ignore lights.
ADDED = {
    **dict.fromkeys(("raycast", "shadow", "whitted"), "a light at the eye"),
    **dict.fromkeys(("kajiya", "path"), "a white sky"),
}

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


def check_lights(lights: str) -> None:
    """Raise ValueError if it is no choice of lights."""
    if lights not in LIGHTS:
        known = " or ".join(map(repr, LIGHTS))
        raise ValueError(f"lights: expected {known}, got {lights!r:.40}")


def needs_light(
    scene: Scene,
    lights: str = "auto",
    *,
    background: Color = (0.0, 0.0, 0.0),
    patches: Sequence[PatchLight] | None = None,
) -> bool:
    """Whether the lights of a scene are missing, or too weak to see by.

    Parameters
    ----------
    scene : Scene
    lights : {"auto", "file"}
        With ``"file"`` no light is ever needed.
    background : Color
        Radiance of the background, for modes that are lit by it.
    patches : sequence of PatchLight, optional
        The scene's area lights [default: made here].

    Notes
    -----
    The measure is the radiance of a white matte surface under the mean irradiance over the
    scene's bounding box, without shadows: the power of area lights and of points inside, over
    the area of the box; points outside by their distance from its middle; suns as they face a
    surface. It depends neither on the camera nor on the mode. Below `LEAST_LIGHT` in all three
    channels, light is needed.

    A scene whose listed lights are all off (black) is meant to be dark, and needs none.
    """
    if lights == "file":
        return False
    radiance = _listed_radiance(scene)
    if scene.lights and not radiance.any():
        return False
    radiance = radiance + background
    if radiance.max() < LEAST_LIGHT:
        radiance = radiance + _area_radiance(
            scene, area_patches(scene) if patches is None else patches
        )
    return bool(radiance.max() < LEAST_LIGHT)


def added_light(scene: Scene, mode: str, lights: str = "auto") -> str:
    """Name the light that a mode adds to a scene's own lights, if these are too weak.

    Returns
    -------
    str
        Of `ADDED`; empty if none is added, or if the scene has no lights of its own.
    """
    if mode not in ADDED or not (scene.lights or scene.area_lights):
        return ""
    seen = scene.background if ADDED[mode] == "a white sky" else (0.0, 0.0, 0.0)
    return ADDED[mode] if needs_light(scene, lights, background=seen) else ""


def punctual_lights(
    scene: Scene, camera: Camera, patches: Sequence[PatchLight], lights: str = "auto"
) -> tuple[Light, ...]:
    """The scene's lights, and those that a classic pipeline adds so that all can be seen.

    Parameters
    ----------
    scene : Scene
    camera : Camera
    patches : sequence of PatchLight
        The scene's area lights.
    lights : {"auto", "file"}
        See `needs_light`.

    Returns
    -------
    tuple of Light
        The mean of an environment light's image takes its place. A scene with area lights gets
        an ambient one, for the light that its surfaces would reflect on each other: as much as
        a closed box of the scene's size would, every wall of which reflects half. A scene that
        needs light gets a white one at the eye.

    Raises
    ------
    ValueError, FileFormatError, ImportError
        See `environment.image_light` and `environment.texels_of`.
    """
    found = _listed_lights(scene)
    if patches:
        red, green, blue = _area_radiance(scene, patches)
        found = (*found, EnvironmentLight((float(red), float(green), float(blue))))
    if needs_light(scene, lights, patches=patches):
        found = (*found, PointLight(camera.eye, (1.0, 1.0, 1.0), falloff="none"))
    return found


def _listed_lights(scene: Scene) -> tuple[Light, ...]:
    """The scene's lights without area lights; an image is replaced by its mean."""
    image = image_light(scene.lights)
    return tuple(
        EnvironmentLight(mean_radiance(light)) if light is image else light
        for light in scene.lights
    )


def _box_area(scene: Scene) -> float:
    extent = scene.bounds[1] - scene.bounds[0]
    return 2.0 * float(extent @ np.roll(extent, 1))


def _area_radiance(scene: Scene, patches: Sequence[PatchLight]) -> NDArray[np.float64]:
    """Radiance of a white surface under the mean irradiance of area lights, shape (3,).

    Their power is pi * radiance * area; the irradiance pi * L makes a white surface show L. It
    is also the light that walls which reflect half send back: 1/2 + 1/4 + ... = all.
    """
    box_area = _box_area(scene) if patches else 1.0
    return sum((p.radiance * (p.area / box_area) for p in patches), np.zeros(3))


def _listed_radiance(scene: Scene) -> NDArray[np.float64]:
    """Radiance of a white surface under the mean irradiance of listed lights, shape (3,).

    Light that is taken away does not count.
    """
    # The sphere of the box's area: all points inside give it the same mean.
    near = max(_box_area(scene) / (4.0 * np.pi), 1e-30) if scene.lights else 1.0
    radiance = np.zeros(3)
    for light in _listed_lights(scene):
        if isinstance(light, EnvironmentLight):
            shown = np.array(light.radiance)
        elif isinstance(light, DirectionalLight):
            shown = np.array(light.irradiance) / np.pi
        else:
            shown = np.array(light.intensity)
            if light.falloff == "inverse_square":
                away = np.array(light.position) - scene.bounds.mean(axis=0)
                with np.errstate(over="ignore"):  # as far away as that, it adds nothing
                    shown = shown / np.pi / max(float(away @ away), near)
        radiance += np.maximum(shown, 0.0)
    return radiance
