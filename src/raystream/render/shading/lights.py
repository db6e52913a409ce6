"""Lights as tables, and samples of the light that reaches a point.

A sample chooses one light: points, suns and the sky by what they bring to the scene's middle,
area lights together, and among those a triangle by its power. Its density is known for every
direction, so that light found by chance, by a scattered ray, can be weighed against it (Veach
1997, section 9.2).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.spawn import UNIT
from raystream.jit.cpu import device, device_call
from raystream.jit.simd import load
from raystream.render.attributes import material_ids_of
from raystream.render.environment import image_light
from raystream.render.sampling.warp import sphere, triangle
from raystream.render.shading.points import material_color, material_of, offset_at
from raystream.render.shading.shares import chosen, double, running_sums
from raystream.render.shading.sky import Sky, map_sample, sky_of, sky_toward
from raystream.render.shading.tables import COLUMNS
from raystream.render.shading.textures import place_of
from raystream.render.shading.vertices import corner_of
from raystream.scene.lights import DirectionalLight, EnvironmentLight
from raystream.scene.scene import Scene

__all__ = ["LightSample", "LightTables", "lights_of", "sample_light", "triangle_pdf"]

_EMISSION = np.uint64(COLUMNS.emission)
_NONE = np.uint64(0)
_ONE = np.uint64(1)

# Bytes: of a number, of a row of points, and of one of suns.
_WORD = np.uint64(4)
_POINT = np.uint64(56)
_SUN = np.uint64(48)

_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])

Vector = tuple[float, float, float]


class LightTables(NamedTuple):
    """A scene's lights, by address; lengths and places in the local frame.

    `lights_of` makes it, with the arrays that its caller keeps.

    Attributes
    ----------
    point_count, sun_count, prim_count : uint64
    points : uint64
        Of shape (P, 7), float64: place; what a facing surface receives at a local distance of
        1; 1 if that falls with the square of the distance, 0 if it does not.
    suns : uint64
        Of shape (S, 6), float64: unit vector to the light; what a facing surface receives.
    sky : Sky
        What rays see that miss: the environment lights and the background.
    sky_density : float
        Mean density over solid angle with which the sky is sampled; see `sky.sky_pdf`.
    prims : uint64
        Of shape (A,), int32: triangles of the area lights.
    prim_ends : uint64
        Of shape (A,), float64: running sums of their shares of the area lights' power; the
        last is 1.
    density : uint64
        Of shape (M,), float64: density of samples on an emitting triangle over its area, by
        material; 0 where none of it is an area light.
    ends : uint64
        Of shape (P + S + 2,), float64: running sums of the shares of points, suns, sky and
        area lights; the last is 1.
    is_dark : bool
        Whether there is no light at all.
    """

    point_count: np.uint64
    sun_count: np.uint64
    prim_count: np.uint64
    points: np.uint64
    suns: np.uint64
    sky: Sky
    sky_density: float
    prims: np.uint64
    prim_ends: np.uint64
    density: np.uint64
    ends: np.uint64
    is_dark: bool


def lights_of(scene: Scene) -> tuple[LightTables, object]:
    """The lights of a scene, and what must be kept; one without any gets a white sky.

    Raises
    ------
    ValueError, FileFormatError, ImportError
        See `environment.image_light` and `environment.texels_of`.
    """
    points, suns, color = _far_lights(scene)
    prims = np.concatenate(
        [light.prim_ids for light in scene.area_lights] or [np.empty(0, np.int32)]
    )
    prims = np.intersect1d(prims, scene.triangles.prim_ids).astype(np.int32)
    if not (scene.lights or len(prims) or color.any()):
        color = np.ones(3)
    sky, sky_luminance, kept_sky = sky_of(color, image_light(scene.lights))
    powers, density = _area_powers(scene, prims)

    bounds = scene.triangles.bounds.astype(np.float64)
    radius = max(float(np.linalg.norm(bounds[1] - bounds[0])) / 2.0, 1e-30)
    far = np.maximum(np.linalg.norm(points[:, :3] - bounds.mean(axis=0), axis=1), radius / 2.0)
    far[points[:, 6] == 0.0] = 1.0
    shares = np.concatenate(
        [
            np.abs(points[:, 3:6]) @ _LUMINANCE / far**2,
            np.abs(suns[:, 3:6]) @ _LUMINANCE,
            [math.pi * sky_luminance, math.pi * float(powers.sum()) / radius**2],
        ]
    )
    # Without signs: a light may take light away, as some formats allow, but no share may.
    total = float(shares.sum())
    if total > 0.0:
        shares /= total
    density *= shares[-1]
    kept = points, suns, prims, running_sums(powers), density, running_sums(shares)
    point_rows, sun_rows, prim_ids, prim_ends, densities, ends = map(place_of, kept)
    tables = LightTables(
        np.uint64(len(points)),
        np.uint64(len(suns)),
        np.uint64(len(prims)),
        point_rows,
        sun_rows,
        sky,
        float(shares[-2]) / (4.0 * math.pi),
        prim_ids,
        prim_ends,
        densities,
        ends,
        not total > 0.0,
    )
    return tables, (kept, kept_sky)


def _far_lights(
    scene: Scene,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Rows of points and of suns, and the sky's radiance without an image."""
    frame = scene.triangles
    scale = float(frame.scale)
    points, suns, sky = np.empty((0, 7)), np.empty((0, 6)), np.array(scene.background, np.float64)
    for light in scene.lights:
        if isinstance(light, EnvironmentLight):
            sky = sky + light.radiance if light.image is None else sky
        elif isinstance(light, DirectionalLight):
            against = -np.array(light.direction) / np.linalg.norm(light.direction)
            suns = np.vstack([suns, [*against, *light.irradiance]])
        else:
            place = (np.array(light.position) - frame.center) * scale
            falls = light.falloff == "inverse_square"
            received = np.array(light.intensity) * (scale * scale if falls else math.pi)
            points = np.vstack([points, [*place, *received, float(falls)]])
    return points, suns, sky


def _area_powers(
    scene: Scene, prims: NDArray[np.int32]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Luminous power of triangles, without a factor; density of samples by material."""
    corners = scene.triangles.corners[prims].astype(np.float64)
    emission = np.array([material.emission for material in scene.materials]) @ _LUMINANCE
    materials = material_ids_of(scene)[prims]
    edges = corners[:, 1:] - corners[:, :1]
    areas = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1) / 2.0
    powers = areas * emission[materials]
    density = np.zeros(len(scene.materials))
    if powers.sum() > 0.0:
        listed = np.unique(materials)
        density[listed] = emission[listed] / powers.sum()
    return powers, density


class LightSample(NamedTuple):
    """Light from one direction.

    Attributes
    ----------
    toward : tuple of three float64
        Unit vector.
    target : tuple of three float64
        Where it comes from, local frame, off the light's own surface.
    is_far : bool
        Whether it comes from beyond the scene, and `target` means nothing.
    color : tuple of three float64
        What a facing surface receives, over the probability of the sample.
    pdf : float64
        Density over solid angle; inf for points and suns, which no ray finds by chance.
    is_valid : bool
        Whether there is any light.
    """

    toward: Vector
    target: Vector
    is_far: bool
    color: Vector
    pdf: float
    is_valid: bool


_NOTHING = (0.0, 0.0, 0.0)


@device
def _times(color, factor):
    return color[0] * factor, color[1] * factor, color[2] * factor


@device
def _none():
    return LightSample(_NOTHING, _NOTHING, True, _NOTHING, 0.0, False)


@device
def _color_of(row):
    """Of a point or a sun."""
    return double(row, np.uint64(3)), double(row, np.uint64(4)), double(row, np.uint64(5))


@device
def _from_point(row, point, share):
    target = double(row, _NONE), double(row, _ONE), double(row, np.uint64(2))
    x, y, z = target[0] - point.x, target[1] - point.y, target[2] - point.z
    distance = math.sqrt(x * x + y * y + z * z)
    if not distance > 0.0:
        return _none()
    factor = 1.0 / share
    if double(row, np.uint64(6)) != 0.0:
        factor /= distance * distance
    return LightSample(
        (x / distance, y / distance, z / distance),
        target,
        False,
        _times(_color_of(row), factor),
        np.inf,
        True,
    )


@device
def _from_sky(lights, share, u, v):
    if lights.sky.image != _NONE:
        toward, relative = map_sample(lights.sky, u, v)
    else:
        x, y, z = sphere(np.float32(u), np.float32(v))
        toward, relative = (np.float64(x), np.float64(y), np.float64(z)), 1.0
    pdf = share / (4.0 * math.pi) * relative
    color = sky_toward(lights, toward[0], toward[1], toward[2])
    return LightSample(toward, _NOTHING, True, _times(color, 1.0 / pdf), pdf, pdf > 0.0)


@device
def _from_triangle(tables, lights, point, within, u, v):
    """A point on an area light, spread evenly over a triangle."""
    number, _, _ = chosen(lights.prim_ends, lights.prim_count, within)
    prim = np.uint64(load(np.int32, lights.prims + number * _WORD))
    ax, ay, az = corner_of(tables, prim, _NONE)
    bx, by, bz = corner_of(tables, prim, _ONE)
    cx, cy, cz = corner_of(tables, prim, np.uint64(2))
    bx, by, bz, cx, cy, cz = bx - ax, by - ay, bz - az, cx - ax, cy - ay, cz - az
    first, second = triangle(np.float32(u), np.float32(v))
    px = ax + first * bx + second * cx
    py = ay + first * by + second * cy
    pz = az + first * bz + second * cz
    nx, ny, nz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    most = max(abs(nx), abs(ny), abs(nz))
    nx, ny, nz = nx / most, ny / most, nz / most
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    nx, ny, nz = nx / length, ny / length, nz / length
    x, y, z = px - point.x, py - point.y, pz - point.z
    square = x * x + y * y + z * z
    distance = math.sqrt(square)
    if not distance > 0.0:
        return _none()
    x, y, z = x / distance, y / distance, z / distance
    cosine = -(x * nx + y * ny + z * nz)
    material = material_of(tables, prim)
    pdf = double(lights.density, material) * square / max(cosine, 1e-300)
    if not (cosine > 0.0 and pdf > 0.0):
        return _none()
    # Off the light's own triangle, so that it does not block its light; also when the ray's
    # direction is rounded to float32.
    extent = max(abs(bx), abs(by), abs(bz), abs(cx), abs(cy), abs(cz))
    reach = max(abs(px), abs(py), abs(pz))
    away = offset_at(tables, 2.0 * extent, reach) + 2.0 * UNIT * distance
    return LightSample(
        (x, y, z),
        (px + away * nx, py + away * ny, pz + away * nz),
        False,
        _times(material_color(tables, material, _EMISSION), 1.0 / pdf),
        pdf,
        True,
    )


@device_call
def sample_light(tables, lights, point, choice, u, v):
    """Light that reaches a point from one of the lights, if nothing is in its way.

    Parameters
    ----------
    tables : SceneTables
    lights : LightTables
    point : Point
    choice, u, v : float64
        Random numbers in [0, 1).

    Returns
    -------
    LightSample
    """
    if lights.is_dark:
        return _none()
    count = lights.point_count + lights.sun_count + np.uint64(2)
    number, share, within = chosen(lights.ends, count, choice)
    if number < lights.point_count:
        return _from_point(lights.points + number * _POINT, point, share)
    number -= lights.point_count
    if number < lights.sun_count:
        row = lights.suns + number * _SUN
        toward = double(row, _NONE), double(row, _ONE), double(row, np.uint64(2))
        return LightSample(
            toward, _NOTHING, True, _times(_color_of(row), 1.0 / share), np.inf, True
        )
    if number == lights.sun_count:
        return _from_sky(lights, share, u, v)
    return _from_triangle(tables, lights, point, within, u, v)


@device
def triangle_pdf(lights, point, distance, cosine):
    """Density over solid angle with which a point of an area light is sampled.

    Parameters
    ----------
    lights : LightTables
    point : Point
        On the light.
    distance : float64
        From where it is seen, local.
    cosine : float64
        Between the ray and the light's normal.
    """
    return double(lights.density, point.material) * distance * distance / max(abs(cosine), 1e-300)
