"""Lighting of a scene: area lights as patches, and lights added if a scene is too dark."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.rendering.emitters import emitters_of, sampled_lights
from raystream.rendering.environment import image_light, mean_radiance
from raystream.scene.camera import Camera
from raystream.scene.lights import (
    DirectionalLight,
    EnvironmentLight,
    Light,
    PointLight,
    SpotLight,
)
from raystream.scene.material import Color
from raystream.scene.scene import Scene

#: The scene's lights, with others if they are too weak or do not reach what the camera sees; the
#: scene's lights only; or the scene's lights and others in any case.
LIGHTS = ("auto", "file", "added")

#: As "auto", whatever the camera sees: for the frames of an animation, and views that move.
MEASURED = "measured"

#: Least mean radiance of white surfaces; below it, lights are too weak. A screen's white is about a
#: thousand times as bright as its black.
LEAST_LIGHT = 1e-3

#: Modes of paths, which see the background and the sky.
PATHS = ("kajiya", "path")

#: The light that modes add if lights are too weak. Other modes ignore lights.
ADDED = {
    **dict.fromkeys(("raycast", "shadow", "whitted"), "a light at the eye"),
    **dict.fromkeys(PATHS, "a sun and a sky"),
}

#: Radiance of the sky that is added, and of a white surface that faces the sun beside it, without
#: the sky: a white sky alone hardly shows the shape of white models, and they pale before it.
SKY, SUN = 0.3, 0.8

#: Direction of its light: to the right, down and forward in the image, in `Camera.basis`.
_SUN_DIRECTION = (0.5, -0.7, 0.7)

#: Radiance of a white surface that faces the light at the eye, which paths get beside the sky.
HEADLIGHT = 0.5

#: An area light in more instances than this is one patch, as that of a mesh of as many lamps.
MOST_PATCHES = 256

#: Emissive triangles count as one flat patch if their normals add up to this much of their
#: area, and as a light bulb otherwise.
_FLATNESS = 0.9


@dataclass(frozen=True)
class PatchLight:
    """An area light as a whole: a flat patch, or a bulb.

    Attributes
    ----------
    position : ndarray of shape (3,), float64
        Centre of the emissive triangles, world space.
    normal : ndarray of shape (3,), float64, or None
        Unit normal of a flat patch, which emits to that side only; None for a bulb.
    radiance : ndarray of shape (3,), float64
        Emitted radiance, linear RGB.
    area : float
    corners : ndarray of shape (K, 3, 3), float64
        Of its triangles, without degenerate ones, in the scene's local frame.
    """

    position: NDArray[np.float64]
    normal: NDArray[np.float64] | None
    radiance: NDArray[np.float64]
    area: float
    corners: NDArray[np.float64]


def area_patches(scene: Scene) -> list[PatchLight]:
    """Approximate each of a scene's area lights by one patch, in each instance."""
    patches = []
    for light in sampled_lights(scene):
        emitters = emitters_of(scene, [light])
        lit = np.unique(emitters.instance_ids)
        groups: list[Any]
        groups = [emitters.instance_ids == k for k in lit] if len(lit) <= MOST_PATCHES else [...]
        patches += [_patch(scene, emitters.corners[own], light.radiance) for own in groups]
    return patches


def _patch(scene: Scene, corners: NDArray[np.float64], radiance: Color) -> PatchLight:
    world = corners / scene.triangles.scale + scene.triangles.center
    edges = world[:, 1:] - world[:, :1]
    normals = np.cross(edges[:, 0], edges[:, 1]) / 2.0
    areas = np.linalg.norm(normals, axis=1)
    area = float(areas.sum())
    total = normals.sum(axis=0)
    flat = float(np.linalg.norm(total)) > _FLATNESS * area
    return PatchLight(
        position=np.average(world.mean(axis=1), axis=0, weights=areas),
        normal=total / np.linalg.norm(total) if flat else None,
        radiance=np.array(radiance),
        area=area,
        corners=corners,
    )


def check_lights(lights: str) -> None:
    """Raise ValueError if `lights` is not in `LIGHTS`."""
    if lights not in (*LIGHTS, MEASURED):
        known = " or ".join(map(repr, LIGHTS))
        raise ValueError(f"lights: expected {known}, got {lights!r:.40}")


def needs_light(
    scene: Scene,
    lights: str = "auto",
    *,
    background: Color = (0.0, 0.0, 0.0),
    patches: Sequence[PatchLight] | None = None,
) -> bool:
    """Whether a scene's lights are missing, or too weak to see anything.

    Parameters
    ----------
    scene : Scene
    lights : {"auto", "file", "added"}
        ``"file"`` never needs a light, ``"added"`` always does.
    background : Color
        Radiance of the background, for modes in which it lights the scene.
    patches : sequence of PatchLight, optional
        The scene's area lights [default: computed].

    Notes
    -----
    The criterion is the radiance of a white diffuse surface under the mean irradiance over the
    scene's bounding box, without shadows: the power of area lights and of point lights inside,
    over the area of the box; point lights outside by their distance from its centre; directional
    lights at normal incidence. It depends neither on the camera nor on the mode. Light is needed
    if it is below `LEAST_LIGHT` in all three channels.

    A scene whose lights are all black is meant to be dark, and needs no light.
    """
    if lights in ("file", "added"):
        return lights == "added"
    if is_dark_by_intent(scene):
        return False
    radiance = _listed_radiance(scene) + background
    if radiance.max() < LEAST_LIGHT:
        radiance = radiance + _area_radiance(
            scene, area_patches(scene) if patches is None else patches
        )
    return bool(radiance.max() < LEAST_LIGHT)


def is_dark_by_intent(scene: Scene) -> bool:
    """Whether a scene has lights, which are all off."""
    return bool(scene.lights) and not _listed_radiance(scene).any()


def has_visible_light(scene: Scene, lights: str = "auto") -> bool:
    """Whether rays can hit light: a surface that emits, the sky, or the one that is added.

    Points and directions have no extent: only shadow rays find them.

    Parameters
    ----------
    scene : Scene
    lights : {"auto", "file", "added"}
        See `needs_light`.
    """
    sky = np.array(scene.background)
    for light in _listed_lights(scene):
        if isinstance(light, EnvironmentLight):
            sky = sky + light.radiance
    emits = bool(scene.area_lights) or any(np.any(one.emission) for one in scene.materials)
    return emits or bool(sky.any()) or needs_light(scene, lights, background=scene.background)


def added_light(scene: Scene, mode: str, lights: str = "auto") -> str:
    """Name the light that a mode adds to a scene's own lights, if these do not suffice.

    Returns
    -------
    str
        A value of `ADDED`; empty if no light is added, or if the scene has no lights.
    """
    if mode not in ADDED or not (scene.lights or scene.area_lights):
        return ""
    seen = scene.background if mode in PATHS else (0.0, 0.0, 0.0)
    if not needs_light(scene, lights, background=seen):
        return ""
    has_all = lights == "added" and mode in PATHS
    return "a sun, a sky and a light at the eye" if has_all else ADDED[mode]


def added_sun(camera: Camera) -> DirectionalLight:
    """The sun that paths get beside a sky if a scene needs light: over the viewer's left shoulder.

    Whatever the camera sees from outside is lit, and shows its shape by shades and shadows.
    """
    direction = np.array(_SUN_DIRECTION) @ camera.basis()
    x, y, z = direction.tolist()
    return DirectionalLight((x, y, z), (math.pi * SUN,) * 3)


def punctual_lights(
    scene: Scene, camera: Camera, patches: Sequence[PatchLight], lights: str = "auto"
) -> tuple[Light, ...]:
    """The scene's lights with those that a rasterizer would add: ambient light and a headlight.

    Parameters
    ----------
    scene : Scene
    camera : Camera
    patches : sequence of PatchLight
        The scene's area lights.
    lights : {"auto", "file", "added"}
        See `needs_light`.

    Returns
    -------
    tuple of Light
        An environment light's image is replaced by its mean. A scene with area lights gets an
        ambient light, for interreflections: as much as in a closed box of the scene's size whose
        walls reflect half. A scene that needs light gets a white one at the camera.

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


def surrounding_radiance(scene: Scene, lights: Sequence[Light]) -> NDArray[np.float64]:
    """Radiance of what surrounds a surface, which rough metal reflects without rays, shape (3,).

    Parameters
    ----------
    scene : Scene
    lights : sequence of Light
        From `punctual_lights`.

    Returns
    -------
    ndarray of shape (3,), float64
        Of ambient light, and of grey surfaces (reflectance 1/2) under the mean irradiance of the
        others.
    """
    ambient = [light for light in lights if isinstance(light, EnvironmentLight)]
    others = [light for light in lights if not isinstance(light, EnvironmentLight)]
    sky: NDArray[np.float64] = sum((np.array(light.radiance) for light in ambient), np.zeros(3))
    return sky + 0.5 * _radiance_of(scene, others)


def _listed_lights(scene: Scene) -> tuple[Light, ...]:
    """The scene's lights, without area lights, and with images replaced by their means."""
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

    Their power is pi * radiance * area; under the irradiance pi * L a white surface has the
    radiance L. It is also the light that walls with reflectance 1/2 send back: 1/2 + 1/4 + ... = 1.
    """
    box_area = _box_area(scene) if patches else 1.0
    return sum((p.radiance * (p.area / box_area) for p in patches), np.zeros(3))


def _listed_radiance(scene: Scene) -> NDArray[np.float64]:
    """Radiance of a white surface under the mean irradiance of listed lights, shape (3,).

    Negative light does not count.
    """
    return _radiance_of(scene, _listed_lights(scene))


def _radiance_of(scene: Scene, lights: Sequence[Light]) -> NDArray[np.float64]:
    # A sphere with the box's area: all points inside give the same mean irradiance.
    near = max(_box_area(scene) / (4.0 * np.pi), 1e-30) if lights else 1.0
    radiance = np.zeros(3)
    for light in lights:
        if isinstance(light, EnvironmentLight):
            shown = np.array(light.radiance)
        elif isinstance(light, DirectionalLight):
            shown = np.array(light.irradiance) / np.pi
        else:
            shown = np.array(light.intensity)
            if isinstance(light, SpotLight) or light.falloff == "inverse_square":
                away = np.array(light.position) - scene.bounds.mean(axis=0)
                with np.errstate(over="ignore"):  # that far away, it adds nothing
                    shown = shown / np.pi / max(float(away @ away), near)
        radiance += np.maximum(shown, 0.0)
    return radiance
