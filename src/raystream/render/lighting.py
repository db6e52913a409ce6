"""Light that reaches a surface, as if nothing were in its way: the classic pipeline's lighting."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raystream.scene.camera import Camera
from raystream.scene.lights import DirectionalLight, EnvironmentLight, Light, PointLight
from raystream.scene.scene import Scene

__all__ = ["PatchLight", "area_patches", "arriving_light", "classic_lights"]

#: Unit vectors to a light, and the irradiance that it gives to a facing surface.
Arriving = tuple[NDArray[np.float32], NDArray[np.float32]]

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
    power : ndarray of shape (3,), float64
        Radiance times area.
    area : float
    """

    position: NDArray[np.float64]
    normal: NDArray[np.float64] | None
    power: NDArray[np.float64]
    area: float


def area_patches(scene: Scene) -> list[PatchLight]:
    """Turn a scene's area lights into one patch each."""
    patches = []
    for light in scene.area_lights:
        solid = np.intersect1d(light.prim_ids, scene.triangles.prim_ids)
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
                power=np.asarray(light.radiance) * area,
                area=area,
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
        A scene without any light gets a white one at the eye. A scene with area lights gets
        an ambient one, for what its surfaces would reflect on each other: as much as a
        closed box of the scene's size would, every wall of which reflects half.
    """
    if patches:
        extent = scene.bounds[1] - scene.bounds[0]
        box_area = 2.0 * float(extent @ np.roll(extent, 1))
        # Of the power pi * radiance * area the walls send back 1/2 + 1/4 + ... = all, spread
        # evenly; a uniform radiance L gives each wall an irradiance of pi * L.
        radiance = sum((patch.power for patch in patches), np.zeros(3)) / box_area
        ambient = float(radiance[0]), float(radiance[1]), float(radiance[2])
        return (*scene.lights, EnvironmentLight(ambient))
    return scene.lights or (PointLight(camera.eye, (1.0, 1.0, 1.0), falloff="none"),)


def arriving_light(
    positions: NDArray[np.float32], lights: Sequence[Light], patches: Sequence[PatchLight]
) -> Iterator[tuple[NDArray[np.float32] | None, NDArray[np.float32]]]:
    """Go through the lights, as seen from points and with nothing in between.

    Parameters
    ----------
    positions : ndarray of shape (N, 3), float32
        World space.
    lights : sequence of Light
    patches : sequence of PatchLight

    Yields
    ------
    toward : ndarray of shape (N, 3), float32, or None
        Unit vectors to the light; None for light from everywhere.
    irradiance : ndarray that broadcasts to (N, 3), float32
        What a surface receives that faces the light; for light from everywhere, what any
        surface receives.
    """
    for light in lights:
        if isinstance(light, EnvironmentLight):
            yield None, np.float32(math.pi) * np.array(light.radiance, np.float32)
        elif isinstance(light, DirectionalLight):
            against = -np.array(light.direction) / np.linalg.norm(light.direction)
            toward = np.broadcast_to(against.astype(np.float32), positions.shape)
            yield toward, np.array(light.irradiance, np.float32)
        else:
            yield _from_point(positions, light)
    for patch in patches:
        yield _from_patch(positions, patch)


def _from_point(positions: NDArray[np.float32], light: PointLight) -> Arriving:
    toward, distance = _toward(positions, np.array(light.position))
    intensity = np.array(light.intensity, np.float32)
    if light.falloff == "none":
        return toward, np.float32(math.pi) * intensity
    return toward, intensity / np.maximum(distance, np.float32(1e-30)) ** 2


def _from_patch(positions: NDArray[np.float32], patch: PatchLight) -> Arriving:
    toward, distance = _toward(positions, patch.position)
    # A disc of the same area seen from its axis receives L A / (r^2 + A / pi): right
    # there, and finite everywhere.
    received = patch.power.astype(np.float32) / (distance**2 + np.float32(patch.area / math.pi))
    if patch.normal is None:
        return toward, received * np.float32(0.25)  # a sphere shows a quarter of its area
    cosine = np.maximum(-(toward @ patch.normal.astype(np.float32)), np.float32(0.0))
    return toward, received * cosine[:, None]


def _toward(
    positions: NDArray[np.float32], target: NDArray[np.float64]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Unit vectors to a point, and distances of shape (N, 1)."""
    offset = target.astype(np.float32) - positions
    distance = np.sqrt(np.einsum("nk,nk->n", offset, offset))[:, None]
    return offset / np.maximum(distance, np.float32(1e-30)), distance
