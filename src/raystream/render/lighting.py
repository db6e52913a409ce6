"""Light that reaches a surface, as if nothing were in its way: the classic pipeline's lighting."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raystream.render.environment import image_light, mean_radiance
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


def arriving_light(
    positions: NDArray[np.float64], lights: Sequence[Light], patches: Sequence[PatchLight]
) -> Iterator[tuple[NDArray[np.float32] | None, NDArray[np.float32]]]:
    """Go through the lights, as seen from points and with nothing in between.

    Parameters
    ----------
    positions : ndarray of shape (N, 3), float64
        World space.
    lights : sequence of Light
    patches : sequence of PatchLight

    Yields
    ------
    toward : ndarray of shape (N, 3), float32, or None
        Unit vectors to the light; None for light from everywhere.
    irradiance : ndarray that broadcasts to (N, 3), float32
        What a surface receives that faces the light; for light from everywhere, what any
        surface receives. Nothing at the very place of a light.
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


def _from_point(positions: NDArray[np.float64], light: PointLight) -> Arriving:
    toward, distance = _toward(positions, np.array(light.position))
    if light.falloff == "none":
        received = np.pi * np.array(light.intensity)
    else:
        received = np.array(light.intensity) / distance / distance
    return toward, _as_float32(received)


def _from_patch(positions: NDArray[np.float64], patch: PatchLight) -> Arriving:
    toward, distance = _toward(positions, patch.position)
    # A disc of the same area seen from its axis receives L A / (r^2 + A / pi): right
    # there, and finite everywhere. In units of its radius, so that no square overflows.
    radius = math.sqrt(patch.area / math.pi)
    received = math.pi * patch.radiance / ((distance / radius) ** 2 + 1.0)
    if patch.normal is None:
        return toward, _as_float32(received / 4.0)  # a sphere shows a quarter of its area
    cosine = np.maximum(-(toward @ patch.normal.astype(np.float32)), np.float32(0.0))
    return toward, _as_float32(received * cosine[:, None])


def _toward(
    positions: NDArray[np.float64], target: NDArray[np.float64]
) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Unit vectors to a point, and distances of shape (N, 1); zero and inf at the point."""
    offset = target - positions
    largest = np.abs(offset).max(axis=1, keepdims=True)
    largest[largest == 0.0] = 1.0
    offset /= largest  # so that no square overflows or vanishes
    length = np.sqrt(np.einsum("nk,nk->n", offset, offset))[:, None]
    there = length == 0.0
    length[there] = np.inf
    return (offset / length).astype(np.float32), np.where(there, np.inf, length * largest)


def _as_float32(values: NDArray[np.float64]) -> NDArray[np.float32]:
    """Round to float32; what is too large becomes its largest number."""
    return np.minimum(values, np.finfo(np.float32).max).astype(np.float32)
