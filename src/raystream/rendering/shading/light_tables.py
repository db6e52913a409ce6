"""Lights as tables for kernels, with the probability of sampling each.

Probabilities of point lights, directional lights, the sky, and all area lights together are
proportional to their light at the scene's centre; an emissive triangle's to its power.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.rendering.color import LUMINANCE
from raystream.rendering.emitters import Emitters, emitters_of, sampled_lights
from raystream.rendering.environment import image_light
from raystream.rendering.lighting import HEADLIGHT, SKY, added_sun, needs_light
from raystream.rendering.shading.discrete_distribution import running_sums
from raystream.rendering.shading.sky import Sky, sky_of
from raystream.rendering.shading.textures import address_of
from raystream.rendering.vertex_attributes import check_rows
from raystream.scene.camera import Camera
from raystream.scene.lights import (
    DirectionalLight,
    EnvironmentLight,
    Light,
    PointLight,
    SpotLight,
)
from raystream.scene.scene import Scene


class LightTables(NamedTuple):
    """A scene's lights, by address; lengths and positions in the local frame.

    Made by `lights_of`, with the arrays to keep alive.

    Attributes
    ----------
    point_count, sun_count, prim_count : uint64
    points : uint64
        Of shape (P, 12), float64: position; irradiance at normal incidence and a local distance
        of 1; 1 for inverse-square falloff, 0 for none, 2 for a spot, with inverse-square falloff;
        the spot's unit direction, and the scale and offset of its `SpotLight.fading`.
    suns : uint64
        Of shape (S, 6), float64: unit vector to the light; irradiance at normal incidence.
    sky : Sky
        Seen by rays that miss: the environment lights and the background.
    sky_density : float
        Mean density over solid angle with which the sky is sampled; see `sky.sky_pdf`.
    patches : uint64
        Of shape (A, 17), float32: the area lights' triangles. Corner 0, the edges from there
        to the others, unit normal, emitted radiance, density of samples over its area,
        longest side along an axis.
    prim_ends : uint64
        Of shape (A,), float64: cumulative shares of the area lights' power; the
        last is 1.
    density : uint64
        Of shape (M,), float64: density of samples on an emitting triangle over its area, by
        material; 0 where none of it is an area light.
    ends : uint64
        Of shape (P + S + 2,), float64: cumulative probabilities of points, suns, sky and
        area lights; the last is 1.
    is_dark : bool
        Whether the scene has no light at all.
    """

    point_count: np.uint64
    sun_count: np.uint64
    prim_count: np.uint64
    points: np.uint64
    suns: np.uint64
    sky: Sky
    sky_density: float
    patches: np.uint64
    prim_ends: np.uint64
    density: np.uint64
    ends: np.uint64
    is_dark: bool


def lights_of(
    scene: Scene, camera: Camera | None = None, chosen: str = "auto"
) -> tuple[LightTables, object]:
    """Make the tables of a scene's lights, with a sun and a sky if it needs light.

    Parameters
    ----------
    scene : Scene
    camera : Camera, optional
        Decides where lights are that are added: the sun and the light at the eye.
    chosen : {"auto", "file", "added"}
        See `lighting.needs_light`; ``"added"`` adds a light at the eye, too.

    Raises
    ------
    ValueError, FileFormatError, ImportError
        See `environment.image_light`, `environment.texels_of` and `check_rows`.
    """
    lights = scene.lights
    if chosen == "added" and camera is not None:
        lights = (*lights, PointLight(camera.eye, (HEADLIGHT,) * 3, falloff="none"))
    is_added = needs_light(scene, chosen, background=scene.background)
    if is_added and camera is not None:
        lights = (*lights, added_sun(camera))
    points, suns, color = _far_lights(scene, lights)
    emitters = emitters_of(scene, sampled_lights(scene))
    check_rows(len(emitters.prim_ids), 17, "triangles that emit light")
    if is_added:
        color = color + SKY
    sky, sky_luminance, kept_sky = sky_of(color, image_light(scene.lights))
    patches, powers, density = _area_patches(scene, emitters)

    bounds = scene.triangles.bounds.astype(np.float64)
    radius = max(float(np.linalg.norm(bounds[1] - bounds[0])) / 2.0, 1e-30)
    far = np.maximum(np.linalg.norm(points[:, :3] - bounds.mean(axis=0), axis=1), radius / 2.0)
    far[points[:, 6] == 0.0] = 1.0
    shares = np.concatenate(
        [
            np.abs(points[:, 3:6]) @ LUMINANCE / far**2,
            np.abs(suns[:, 3:6]) @ LUMINANCE,
            [math.pi * sky_luminance, math.pi * float(powers.sum()) / radius**2],
        ]
    )
    # Absolute values: some formats allow negative lights, but probabilities are not negative.
    total = float(shares.sum())
    if total > 0.0:
        shares /= total
    density *= shares[-1]
    patches[:, 15] *= shares[-1]
    rows = patches.astype(np.float32)
    kept = points, suns, rows, running_sums(powers), density, running_sums(shares)
    point_rows, sun_rows, patch_rows, prim_ends, densities, ends = (
        address_of(array) for array in kept
    )
    tables = LightTables(
        np.uint64(len(points)),
        np.uint64(len(suns)),
        np.uint64(len(emitters.prim_ids)),
        point_rows,
        sun_rows,
        sky,
        float(shares[-2]) / (4.0 * math.pi),
        patch_rows,
        prim_ends,
        densities,
        ends,
        not total > 0.0,
    )
    return tables, (kept, kept_sky)


def _far_lights(
    scene: Scene, lights: Sequence[Light]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Rows of point and of directional lights, and the sky's constant radiance."""
    frame = scene.triangles
    scale = float(frame.scale)
    points, suns, sky = np.empty((0, 12)), np.empty((0, 6)), np.array(scene.background, np.float64)
    for light in lights:
        if isinstance(light, EnvironmentLight):
            sky = sky + light.radiance if light.image is None else sky
        elif isinstance(light, DirectionalLight):
            against = -np.array(light.direction) / np.linalg.norm(light.direction)
            suns = np.vstack([suns, [*against, *light.irradiance]])
        else:
            place = (np.array(light.position) - frame.center) * scale
            kind, cone = 2.0, np.zeros(5)
            if isinstance(light, SpotLight):
                cone = np.array([*light.direction, *light.fading])
                cone[:3] /= np.linalg.norm(cone[:3])
            else:
                kind = float(light.falloff == "inverse_square")
            received = np.array(light.intensity) * (scale * scale if kind else math.pi)
            points = np.vstack([points, [*place, *received, kind, *cone]])
    return points, suns, sky


def _area_patches(
    scene: Scene, emitters: Emitters
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Rows of `LightTables.patches`, their powers, and the density of samples by material.

    Powers up to a constant factor; densities as if there were no other lights.
    """
    corners = emitters.corners
    emission = np.array([material.emission for material in scene.materials]).reshape(-1, 3)
    materials = scene.attributes.material_ids[emitters.prim_ids]
    edges = corners[:, 1:] - corners[:, :1]
    normals = np.cross(edges[:, 0], edges[:, 1])
    lengths = np.linalg.norm(normals, axis=1)
    normals /= np.maximum(lengths, 1e-300)[:, None]
    luminance = emission @ LUMINANCE
    powers = lengths / 2.0 * luminance[materials]
    density = np.zeros(len(scene.materials))
    if powers.sum() > 0.0:
        listed = np.unique(materials)
        density[listed] = luminance[listed] / powers.sum()
    patches = np.column_stack(
        [
            corners[:, 0] + normals * emitters.offsets[:, None],
            edges.reshape(-1, 6),
            normals,
            emission[materials],
            density[materials],
            np.ptp(corners, axis=1).max(axis=1, initial=0.0),
        ]
    )
    return patches, powers, density
