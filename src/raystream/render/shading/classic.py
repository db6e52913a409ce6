"""The classic lights: each sends light from one place, as the standard graphics pipeline has it.

Area lights count as one place each, see `render.lighting`: a flat patch, or a bulb.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.spawn import UNIT
from raystream.jit.cpu import device, device_call
from raystream.jit.simd import load
from raystream.render.lighting import PatchLight, area_patches, classic_lights
from raystream.render.shading.lights import LightSample
from raystream.render.shading.points import offset_at
from raystream.render.shading.sky import Sky, background_of
from raystream.render.shading.textures import place_of
from raystream.scene.camera import Camera
from raystream.scene.lights import DirectionalLight, EnvironmentLight
from raystream.scene.scene import Scene

__all__ = ["ClassicLights", "arriving", "classic_lights_of", "light_rows"]

# Kinds of lights: a point whose light falls with the square of the distance, one whose light
# does not, a sun, a flat patch, a bulb.
_POINT, _STEADY, _SUN, _PATCH, _BULB = range(5)

# Columns of a row: place or direction, colour, kind, normal, radius of a disc of as large an
# area, and how far the light's own triangles reach from the place.
_KIND, _NORMAL, _RADIUS, _CLEARANCE = 6, 7, 10, 11
_COLUMNS = 12
_ROW = np.uint64(8 * _COLUMNS)
_LONG = np.uint64(8)
_NOTHING = (0.0, 0.0, 0.0)

Vector = tuple[float, float, float]


class ClassicLights(NamedTuple):
    """Lights of a scene, by address; lengths and places in the local frame.

    Attributes
    ----------
    rows : uint64
        Of shape (light_count, 12), float64.
    light_count : uint64
    ambient : tuple of three float
        Radiance from everywhere, that nothing blocks.
    sky : Sky
        What rays that miss see: the background, and the image of an environment light.
    """

    rows: np.uint64
    light_count: np.uint64
    ambient: Vector
    sky: Sky


def classic_lights_of(scene: Scene, camera: Camera) -> tuple[ClassicLights, object]:
    """The lights of a scene, and what must be kept; see `lighting.classic_lights`."""
    table, ambient = light_rows(scene, camera)
    sky, kept_sky = background_of(scene)
    lights = ClassicLights(place_of(table), np.uint64(len(table)), _vector(ambient), sky)
    return lights, (table, kept_sky)


def light_rows(scene: Scene, camera: Camera) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rows of `ClassicLights`, shape (L, 12), and the ambient radiance, shape (3,)."""
    frame = scene.triangles
    scale = float(frame.scale)
    patches = area_patches(scene)
    ambient = np.zeros(3)
    rows: list[list[float]] = []
    for light in classic_lights(scene, camera, patches):
        row = [0.0] * _COLUMNS
        if isinstance(light, EnvironmentLight):
            ambient += light.radiance
            continue
        if isinstance(light, DirectionalLight):
            row[:3] = -np.array(light.direction) / np.linalg.norm(light.direction)
            row[3:6], row[_KIND] = light.irradiance, _SUN
        else:
            falls = light.falloff == "inverse_square"
            row[:3] = (np.array(light.position) - frame.center) * scale
            row[3:6] = np.array(light.intensity) * (scale * scale if falls else math.pi)
            row[_KIND] = _POINT if falls else _STEADY
        rows.append(row)
    rows += _patch_rows(scene, patches)
    return np.array(rows, np.float64).reshape(-1, _COLUMNS), ambient


def _vector(values: NDArray[np.float64] | Sequence[float]) -> Vector:
    red, green, blue = (float(value) for value in values)
    return red, green, blue


def _patch_rows(scene: Scene, patches: Sequence[PatchLight]) -> list[list[float]]:
    """Rows of area lights."""
    frame, rows = scene.triangles, []
    for patch in patches:
        row = [0.0] * _COLUMNS
        place = (patch.position - frame.center) * float(frame.scale)
        spread = frame.corners[patch.prim_ids].reshape(-1, 3).astype(np.float64) - place
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
def _none():
    return LightSample(_NOTHING, _NOTHING, True, _NOTHING, 0.0, False)


@device_call
def arriving(tables, lights, number, point):
    """What a light sends to a point, if nothing is in its way.

    Parameters
    ----------
    tables : SceneTables
    lights : ClassicLights
    number : uint64
    point : Point

    Returns
    -------
    LightSample
        Its density means nothing.
    """
    row = lights.rows + number * _ROW
    kind, place, color = np.int64(_double(row, _KIND)), _three(row, 0), _three(row, 3)
    if kind == _SUN:
        return LightSample(place, _NOTHING, True, color, np.inf, True)
    x, y, z = place[0] - point.x, place[1] - point.y, place[2] - point.z
    distance = math.sqrt(x * x + y * y + z * z)
    if not distance > 0.0:
        return _none()
    x, y, z = x / distance, y / distance, z / distance
    factor, target = 1.0, place
    if kind == _POINT:
        factor = 1.0 / (distance * distance)
    elif kind != _STEADY:
        radius, clearance = _double(row, _RADIUS), _double(row, _CLEARANCE)
        # As a disc seen from its axis, finite everywhere; a sphere shows a quarter of its area.
        ratio = distance / radius
        factor = 1.0 / (ratio * ratio + 1.0)
        reach = max(abs(place[0]), abs(place[1]), abs(place[2])) + radius + clearance
        away = clearance + offset_at(tables, 4.0 * (radius + clearance), reach)
        away += 2.0 * UNIT * distance
        if kind == _PATCH:
            nx, ny, nz = _three(row, _NORMAL)
            cosine = -(x * nx + y * ny + z * nz)
            if cosine <= 0.0:
                return _none()
            factor *= cosine
            target = place[0] + away * nx, place[1] + away * ny, place[2] + away * nz
        else:
            factor *= 0.25
            away = min(away, 0.999 * distance)
            target = place[0] - away * x, place[1] - away * y, place[2] - away * z
    color = color[0] * factor, color[1] * factor, color[2] * factor
    return LightSample((x, y, z), target, False, color, np.inf, True)
