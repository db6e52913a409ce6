"""Sampling lights (next-event estimation).

A sample chooses one light, with the probabilities of `light_tables`. Its density is known for every
direction, so that light hit by scattered rays can be weighted by multiple importance sampling
(Veach 1997, section 9.2).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from raystream.core.spawn import UNIT
from raystream.jit.constants import NULL, ZERO_U64
from raystream.jit.cpu import device, device_call
from raystream.jit.simd import (
    absolute,
    any_lane,
    as_int32,
    f32x16,
    f64x16,
    gather,
    maximum,
    minimum,
    narrow,
    select,
    square_root,
    widen,
)
from raystream.rendering.sampling.warp import sphere, triangle
from raystream.rendering.shading.discrete_distribution import sample_discrete_lanes
from raystream.rendering.shading.rows import floats_at
from raystream.rendering.shading.sky_lanes import sample_image_lanes, sky_radiance_lanes
from raystream.rendering.shading.surface_points import offset_at
from raystream.rendering.shading.vectors import chosen, dot, largest, scaled

_0, _1, _2, _3, _6, _7, _9, _10, _11, _12, _15, _16 = (
    np.int32(k) for k in (0, 1, 2, 3, 6, 7, 9, 10, 11, 12, 15, 16)
)
_NULL, _WHOLE, _INF, _TINY = map(np.float32, (0.0, 1.0, np.inf, 1e-37))
_INV_FOUR_PI = 0.25 / math.pi

# The kind of points that are spots.
_SPOT = 2.0

# Numbers in a row of points, of suns, and of patches.
_POINT, _SUN, _PATCH = np.int32(12), np.int32(6), np.int32(17)

Vector = tuple[float, float, float]


class LightSample(NamedTuple):
    """A sample of the lights, for a point or for 16 of them.

    For one, numbers are float64; for 16, vectors of float32, but `target` of float64.

    Attributes
    ----------
    toward : tuple of three float64
        Unit vector.
    target : tuple of three float64
        Where the shadow ray ends, local frame, off the light's own surface.
    is_far : bool
        Whether the light is infinitely far away, and `target` meaningless.
    color : tuple of three float64
        Irradiance at normal incidence over the probability of the sample.
    pdf : float64
        Density over solid angle; inf for point and directional lights, which no ray hits.
    is_valid : bool
        Whether there is light.
    """

    toward: Vector
    target: Vector
    is_far: bool
    color: Vector
    pdf: float
    is_valid: bool


@device
def _doubles(row, k):
    """Three float64 of a table from index k on."""
    return (
        gather(np.float64, row, k),
        gather(np.float64, row, k + _1),
        gather(np.float64, row, k + _2),
    )


@device
def _widened(a):
    return widen(a[0]), widen(a[1]), widen(a[2])


@device
def _narrowed(a):
    return narrow(a[0]), narrow(a[1]), narrow(a[2])


@device
def _toward(x, y, z):
    """Unit vectors of float64 vectors, and their lengths, in float32."""
    x, y, z = narrow(x), narrow(y), narrow(z)
    length = square_root(x * x + y * y + z * z)
    return scaled((x, y, z), _WHOLE / length), length


@device
def _from_sky(lights, is_sky, share, u, v):
    """Sample the sky: directions, densities, and radiance over density."""
    toward, pdf = sphere(u, v), narrow(share * _INV_FOUR_PI)
    if lights.sky.image != NULL:
        toward, relative = sample_image_lanes(lights.sky, u, v, is_sky)
        pdf = pdf * relative
    color = sky_radiance_lanes(lights, toward, is_sky)
    return toward, pdf, scaled(color, _WHOLE / pdf)


@device_call
def _from_points(lights, number, point, share, found):
    """Replace samples of lanes that chose a point light."""
    is_point = number < as_int32(lights.point_count)
    row = minimum(number, as_int32(as_int32(lights.point_count) - _1)) * _POINT
    target = _doubles(lights.points, row)
    toward, distance = _toward(target[0] - point.x, target[1] - point.y, target[2] - point.z)
    kind = gather(np.float64, lights.points, row + _6)
    square = widen(distance) * widen(distance)
    factor = 1.0 / (share * select(kind != 0.0, square, 1.0))
    is_valid, is_spot = is_point & (distance > _NULL), is_point & (kind == _SPOT)
    if any_lane(is_spot):
        cosine = -dot(_doubles(lights.points, row + _7), _widened(toward))
        scale = gather(np.float64, lights.points, row + _10)
        left = scale * cosine + gather(np.float64, lights.points, row + _11)
        left = minimum(maximum(left, 0.0), 1.0)
        factor = select(is_spot, factor * left * left, factor)
        is_valid &= ~is_spot | (left > 0.0)
    return LightSample(
        chosen(is_point, toward, found.toward),
        chosen(is_point, target, found.target),
        found.is_far & ~is_point,
        chosen(is_point, _narrowed(scaled(_doubles(lights.points, row + _3), factor)), found.color),
        select(is_point, _INF, found.pdf),
        found.is_valid | is_valid,
    )


@device_call
def _from_suns(lights, number, share, found):
    """Replace samples of lanes that chose a directional light."""
    number = number - as_int32(lights.point_count)
    is_sun = (number >= _0) & (number < as_int32(lights.sun_count))
    row = minimum(maximum(number, _0), as_int32(as_int32(lights.sun_count) - _1)) * _SUN
    toward = _narrowed(_doubles(lights.suns, row))
    color = _narrowed(scaled(_doubles(lights.suns, row + _3), 1.0 / share))
    return LightSample(
        chosen(is_sun, toward, found.toward),
        found.target,
        found.is_far,
        chosen(is_sun, color, found.color),
        select(is_sun, _INF, found.pdf),
        found.is_valid | is_sun,
    )


@device_call
def _from_triangles(tables, lights, is_area, point, within, u, v, found):
    """Replace samples of lanes that chose an area light: uniform points on triangles."""
    number, _, _ = sample_discrete_lanes(lights.prim_ends, lights.prim_count, widen(within))
    row = number * _PATCH
    corner, normal = floats_at(lights.patches, row), floats_at(lights.patches, row + _9)
    first, second = triangle(u, v)
    along, across = floats_at(lights.patches, row + _3), floats_at(lights.patches, row + _6)
    px = widen(corner[0]) + widen(first * along[0] + second * across[0])
    py = widen(corner[1]) + widen(first * along[1] + second * across[1])
    pz = widen(corner[2]) + widen(first * along[2] + second * across[2])
    toward, distance = _toward(px - point.x, py - point.y, pz - point.z)
    cosine = -dot(toward, normal)
    density = gather(np.float32, lights.patches, row + _15)
    # A light that faces away is seen at an angle of 0: reciprocals of huge densities would be
    # subnormal, for which processors take a hundred times as long.
    pdf = density * distance * distance / select(cosine > _NULL, cosine, _WHOLE)
    # Off the light's own triangle, so that it does not block its light, even when the ray's
    # direction is rounded to float32. Twice the extent covers the rounding of edges.
    extent = widen(gather(np.float32, lights.patches, row + _16))
    reach = largest(absolute(px), absolute(py), absolute(pz))
    away = offset_at(tables, 2.0 * extent, reach) + 2.0 * UNIT * widen(distance)
    target = (
        px + away * widen(normal[0]),
        py + away * widen(normal[1]),
        pz + away * widen(normal[2]),
    )
    is_lit = is_area & (distance > _NULL) & (cosine > _NULL) & (pdf > _NULL) & (pdf < _INF)
    color = scaled(floats_at(lights.patches, row + _12), _WHOLE / pdf)
    return LightSample(
        chosen(is_area, toward, found.toward),
        chosen(is_area, target, found.target),
        found.is_far & ~is_area,
        chosen(is_area, color, found.color),
        select(is_area, pdf, found.pdf),
        (found.is_valid & ~is_area) | is_lit,
    )


@device_call
def sample_light(tables, lights, point, choice, u, v):
    """Sample one light for each of 16 points.

    Parameters
    ----------
    tables : SceneTables
    lights : LightTables
    point : Point
        Of 16.
    choice, u, v : f32x16
        Random numbers in [0, 1).

    Returns
    -------
    LightSample
        Of vectors. Visibility is not tested.
    """
    count = lights.point_count + lights.sun_count + np.uint64(2)
    number, share, within = sample_discrete_lanes(lights.ends, count, widen(choice))
    is_sky = number == as_int32(lights.point_count + lights.sun_count)
    nothing, nowhere = f32x16(_NULL), f64x16(0.0)
    toward, pdf, color = (nothing, nothing, nothing), nothing, (nothing, nothing, nothing)
    if any_lane(is_sky):
        toward, pdf, color = _from_sky(lights, is_sky, share, u, v)
    is_found = is_sky & (pdf > _NULL)
    found = LightSample(toward, (nowhere, nowhere, nowhere), is_sky | ~is_sky, color, pdf, is_found)
    if lights.point_count != ZERO_U64:
        found = _from_points(lights, number, point, share, found)
    if lights.sun_count != ZERO_U64:
        found = _from_suns(lights, number, share, found)
    if lights.prim_count != ZERO_U64:
        is_area = number > as_int32(lights.point_count + lights.sun_count)
        if any_lane(is_area):
            found = _from_triangles(tables, lights, is_area, point, within, u, v, found)
    return found


@device
def triangle_pdf(lights, point, distance, cosine):
    """Density over solid angle of `sample_light` for points on area lights.

    Parameters
    ----------
    lights : LightTables
    point : Point
        Of 16, on lights.
    distance : f64x16
        From the shaded point, local frame.
    cosine : f32x16
        Between the rays and the lights' normals.
    """
    square = distance * distance / widen(maximum(absolute(cosine), _TINY))
    return narrow(gather(np.float64, lights.density, point.material) * square)
