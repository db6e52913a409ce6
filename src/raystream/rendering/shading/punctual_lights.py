"""Punctual lights: each sends light from one position, as in the standard graphics pipeline.

An area light counts as one flat patch or bulb, see `rendering.lighting`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.spawn import UNIT
from raystream.jit.cpu import device, device_call
from raystream.jit.simd import load, maximum, minimum, narrow_lanes, select, square_root
from raystream.rendering.lighting import (
    PatchLight,
    area_patches,
    punctual_lights,
    surrounding_radiance,
)
from raystream.rendering.shading.lights import LightSample
from raystream.rendering.shading.sky import Sky, background_of
from raystream.rendering.shading.surface_points import offset_at
from raystream.rendering.shading.textures import address_of
from raystream.rendering.shading.vectors import added, dot, scaled
from raystream.scene.camera import Camera
from raystream.scene.lights import DirectionalLight, EnvironmentLight, SpotLight
from raystream.scene.scene import Scene

# Kinds of lights: a point with inverse-square falloff, one without falloff, a directional light, a
# flat patch, a bulb, a spot.
_POINT, _STEADY, _SUN, _PATCH, _BULB, _SPOT = range(6)

# Columns of a row: position or direction, colour, kind, normal, radius of a disc of equal area, and
# the extent of the light's own triangles around the position. Spots have their direction as normal,
# and the scale and offset of `SpotLight.fading` in place of the last two.
_KIND, _NORMAL, _RADIUS, _CLEARANCE = 6, 7, 10, 11
_COLUMNS = 12
_ROW = np.uint64(8 * _COLUMNS)
_LONG = np.uint64(8)

Vector = tuple[float, float, float]


class PunctualLights(NamedTuple):
    """Punctual lights of a scene, by address; lengths and positions in the local frame.

    Attributes
    ----------
    rows : uint64
        Of shape (light_count, 12), float64.
    light_count : uint64
    ambient : tuple of three float
        Radiance from all directions, never blocked.
    surroundings : tuple of three float
        Radiance that rough metal reflects, see `lighting.surrounding_radiance`.
    sky : Sky
        Seen by rays that miss: the background, and the image of an environment light.
    """

    rows: np.uint64
    light_count: np.uint64
    ambient: Vector
    surroundings: Vector
    sky: Sky


def punctual_lights_of(
    scene: Scene, camera: Camera, chosen: str = "auto"
) -> tuple[PunctualLights, object]:
    """A scene's lights, and the arrays to keep alive; see `lighting.punctual_lights`."""
    table, ambient, surroundings = light_rows(scene, camera, chosen)
    sky, kept_sky = background_of(scene)
    lights = PunctualLights(
        address_of(table), np.uint64(len(table)), _vector(ambient), _vector(surroundings), sky
    )
    return lights, (table, kept_sky)


def light_rows(
    scene: Scene, camera: Camera, chosen: str = "auto"
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Rows of `PunctualLights`, shape (L, 12), its ambient radiance and its surroundings."""
    frame = scene.triangles
    scale = float(frame.scale)
    patches = area_patches(scene)
    ambient = np.zeros(3)
    rows: list[list[float]] = []
    found = punctual_lights(scene, camera, patches, chosen)
    for light in found:
        row = [0.0] * _COLUMNS
        if isinstance(light, EnvironmentLight):
            ambient += light.radiance
            continue
        if isinstance(light, DirectionalLight):
            row[:3] = -np.array(light.direction) / np.linalg.norm(light.direction)
            row[3:6], row[_KIND] = light.irradiance, _SUN
        else:
            row[:3] = (np.array(light.position) - frame.center) * scale
            if isinstance(light, SpotLight):
                row[_KIND], row[_RADIUS:] = _SPOT, light.fading
                row[_NORMAL:_RADIUS] = np.array(light.direction) / np.linalg.norm(light.direction)
            else:
                row[_KIND] = _POINT if light.falloff == "inverse_square" else _STEADY
            falls = row[_KIND] != _STEADY
            row[3:6] = np.array(light.intensity) * (scale * scale if falls else math.pi)
        rows.append(row)
    rows += _patch_rows(scene, patches)
    surroundings = surrounding_radiance(scene, found)
    return np.array(rows, np.float64).reshape(-1, _COLUMNS), ambient, surroundings


def _vector(values: NDArray[np.float64] | Sequence[float]) -> Vector:
    red, green, blue = (float(value) for value in values)
    return red, green, blue


def _patch_rows(scene: Scene, patches: Sequence[PatchLight]) -> list[list[float]]:
    """Rows of area lights."""
    frame, rows = scene.triangles, []
    for patch in patches:
        row = [0.0] * _COLUMNS
        place = (patch.position - frame.center) * float(frame.scale)
        spread = patch.corners.reshape(-1, 3) - place
        row[:3], row[3:6] = place, math.pi * patch.radiance
        row[_RADIUS] = math.sqrt(patch.area / math.pi) * float(frame.scale)
        if patch.normal is None:
            row[_KIND], row[_CLEARANCE] = _BULB, float(np.linalg.norm(spread, axis=1).max())
        else:
            row[_KIND], row[_NORMAL:_RADIUS] = _PATCH, patch.normal
            row[_CLEARANCE] = max(float((spread @ patch.normal).max()), 0.0)
        rows.append(row)
    return rows


@device
def _double(row, k):
    return load(np.float64, row + np.uint64(k) * _LONG)


@device
def _three(row, k):
    return _double(row, k), _double(row, k + 1), _double(row, k + 2)


@device
def _lanes(of, place):
    """A vector in all lanes: numbers of the type of `of`, float64 or f64x16."""
    zero = of * 0.0
    return zero + place[0], zero + place[1], zero + place[2]


@device
def _narrowed(a):
    return narrow_lanes(a[0]), narrow_lanes(a[1]), narrow_lanes(a[2])


@device_call
def incident_light(tables, lights, number, point):
    """Light from one light at a point, or at 16, if nothing blocks it.

    Parameters
    ----------
    tables : SceneTables
    lights : PunctualLights
    number : uint64
    point : Point

    Returns
    -------
    LightSample
        Its density is meaningless.
    """
    row = lights.rows + number * _ROW
    kind, place, color = np.int64(_double(row, _KIND)), _three(row, 0), _three(row, 3)
    # All lanes have the same light, so these are branches; lanes differ by selects.
    x, y, z = _lanes(point.x, place)
    target = x, y, z
    factor = point.x * 0.0 + 1.0
    is_far = factor < 0.0
    is_valid = factor > 0.0
    if kind == _SUN:
        is_far = is_valid
    else:
        x, y, z = x - point.x, y - point.y, z - point.z
        distance = square_root(x * x + y * y + z * z)
        is_valid = distance > 0.0
        distance = select(is_valid, distance, factor)
        x, y, z = x / distance, y / distance, z / distance
        if kind == _POINT:
            factor = 1.0 / (distance * distance)
        elif kind == _SPOT:
            cosine = -dot(_three(row, _NORMAL), (x, y, z))
            left = _double(row, _RADIUS) * cosine + _double(row, _CLEARANCE)
            left = minimum(maximum(left, 0.0), 1.0)
            factor = left * left / (distance * distance)
            is_valid &= left > 0.0
        elif kind != _STEADY:
            factor, away = _of_area(tables, row, kind, place, (x, y, z), distance)
            is_valid &= factor > 0.0
            if kind == _PATCH:
                normal = _three(row, _NORMAL)
                target = added(target, normal, away)
            else:
                target = added(target, (x, y, z), -away)
    return LightSample(
        _narrowed((x, y, z)),
        target,
        is_far,
        _narrowed(scaled(color, factor)),
        np.inf,
        is_valid,
    )


@device
def _of_area(tables, row, kind, place, toward, distance):
    """The share of a patch's or bulb's light that arrives, and the end of rays to it.

    Returns
    -------
    factor : float64
        0 behind a patch.
    away : float64
        Distance from the light's position: along a patch's normal, or back along the ray.
    """
    radius, clearance = _double(row, _RADIUS), _double(row, _CLEARANCE)
    # A disc seen from its axis, finite everywhere; a sphere shows a quarter of its area.
    ratio = distance / radius
    factor = 1.0 / (ratio * ratio + 1.0)
    reach = max(abs(place[0]), abs(place[1]), abs(place[2])) + radius + clearance
    away = clearance + offset_at(tables, 4.0 * (radius + clearance), reach)
    away = distance * (2.0 * UNIT) + away
    if kind == _PATCH:
        cosine = -dot(toward, _three(row, _NORMAL))
        return factor * maximum(cosine, 0.0), away
    return factor * 0.25, minimum(away, distance * 0.999)
