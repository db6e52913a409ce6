"""Points on surfaces, where rays hit, as shading kernels see them."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from raystream.core.spawn import EXTENT_UNITS, MOST_UNITS, REACH_UNITS, UNIT, WORLD_UNIT
from raystream.jit.cpu import device, device_call
from raystream.jit.simd import load
from raystream.render.shading.relief import has_relief, relief_normal
from raystream.render.shading.tables import WIDTH
from raystream.render.shading.vertices import (
    attribute_number,
    attribute_vector,
    corner_of,
    number_at,
)

__all__ = [
    "Point",
    "material_color",
    "material_number",
    "material_of",
    "offset_at",
    "spawned",
    "surface_point",
    "to_world",
]

_NONE = np.uint64(0)
_ONE = np.uint64(1)
_TWO = np.uint64(2)
_WORD = np.uint64(4)
_COLUMN_COUNT = np.uint64(WIDTH)


class Point(NamedTuple):
    """A point where a ray meets a surface.

    Attributes
    ----------
    x, y, z : float64
        Local frame, on the triangle.
    gx, gy, gz : float64
        Unit normal of the triangle, on the side that the ray came from.
    nx, ny, nz : float64
        Unit shading normal, likewise; where it would face away from the ray, the triangle's.
        With the relief of normal and bump maps; it then always faces the ray's origin.
    offset : float64
        How far from the triangle a ray must start that leaves it, see `core.spawn`.
    is_front : bool
        Whether the ray came from the side where vertices run counter-clockwise.
    u, v : float64
        Texture coordinates; NaN where there are none.
    red, green, blue : float64
        Colour of the vertices.
    material : uint64
    """

    x: float
    y: float
    z: float
    gx: float
    gy: float
    gz: float
    nx: float
    ny: float
    nz: float
    offset: float
    is_front: bool
    u: float
    v: float
    red: float
    green: float
    blue: float
    material: np.uint64


@device
def material_of(tables, prim):
    """The material of a triangle."""
    return np.uint64(load(np.int32, tables.material_ids + prim * _WORD))


@device
def material_color(tables, material, column):
    """A colour of a material, by its place in `Column`."""
    at = tables.materials + (material * _COLUMN_COUNT + column) * _WORD
    return number_at(at), number_at(at + _WORD), number_at(at + _WORD + _WORD)


@device
def material_number(tables, material, column):
    """A number of a material, by its place in `Column`."""
    return number_at(tables.materials + (material * _COLUMN_COUNT + column) * _WORD)


@device
def offset_at(tables, extent, reach):
    """How far from a triangle a ray must start or end that is not to hit it; see `core.spawn`.

    Parameters
    ----------
    tables : SceneTables
    extent : float64
        The triangle's longest side along an axis, or more.
    reach : float64
        Largest coordinate of the point.
    """
    offset = UNIT * min(
        EXTENT_UNITS * extent + REACH_UNITS * reach, MOST_UNITS * (tables.extreme + reach)
    )
    return offset + WORLD_UNIT * tables.world_reach


@device
def _smooth_normal(tables, prim, u, v, gx, gy, gz):
    """The vertices' normals between them, on the side of the triangle's, or that."""
    if tables.normals == _NONE:
        return gx, gy, gz
    x, y, z = attribute_vector(tables, tables.normals, prim, u, v)
    length = math.sqrt(x * x + y * y + z * z)
    if not (length > 0.0 and length < np.inf):
        return gx, gy, gz
    if x * gx + y * gy + z * gz < 0.0:
        length = -length
    return x / length, y / length, z / length


@device_call
def surface_point(tables, prim_id, u, v, dx, dy, dz):
    """The point of a hit.

    Parameters
    ----------
    tables : SceneTables
    prim_id : int
    u, v : float
        Weights of vertices 1 and 2.
    dx, dy, dz : float
        The ray's direction.

    Returns
    -------
    Point
    """
    prim = np.uint64(prim_id)
    u, v = np.float64(u), np.float64(v)
    ax, ay, az = corner_of(tables, prim, _NONE)
    bx, by, bz = corner_of(tables, prim, _ONE)
    cx, cy, cz = corner_of(tables, prim, _TWO)
    low = min(ax, bx, cx), min(ay, by, cy), min(az, bz, cz)
    high = max(ax, bx, cx), max(ay, by, cy), max(az, bz, cz)
    extent = max(high[0] - low[0], high[1] - low[1], high[2] - low[2])
    bx, by, bz, cx, cy, cz = bx - ax, by - ay, bz - az, cx - ax, cy - ay, cz - az
    x, y, z = ax + u * bx + v * cx, ay + u * by + v * cy, az + u * bz + v * cz
    gx, gy, gz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    # Scaled before it is measured: the square of a small area would vanish.
    most = max(abs(gx), abs(gy), abs(gz))
    gx, gy, gz = gx / most, gy / most, gz / most
    length = math.sqrt(gx * gx + gy * gy + gz * gz)
    is_front = gx * dx + gy * dy + gz * dz <= 0.0
    if not is_front:
        length = -length
    gx, gy, gz = gx / length, gy / length, gz / length
    nx, ny, nz = _smooth_normal(tables, prim, u, v, gx, gy, gz)
    s, t = np.nan, np.nan
    if tables.texcoords != _NONE:
        s = attribute_number(tables, tables.texcoords, _TWO, _NONE, prim, u, v)
        t = attribute_number(tables, tables.texcoords, _TWO, _ONE, prim, u, v)
    material = material_of(tables, prim)
    if has_relief(tables, material):
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        back = -dx / length, -dy / length, -dz / length
        triangle, smooth = (gx, gy, gz), (nx, ny, nz)
        nx, ny, nz = relief_normal(
            tables, prim, material, (u, v), (s, t), triangle, smooth, is_front, back
        )
    elif nx * dx + ny * dy + nz * dz >= 0.0:
        # Away from the ray, as near an outline, nothing sensible is reflected.
        nx, ny, nz = gx, gy, gz
    red, green, blue = 1.0, 1.0, 1.0
    if tables.colors != _NONE:
        red, green, blue = attribute_vector(tables, tables.colors, prim, u, v)
    offset = offset_at(tables, extent, max(abs(x), abs(y), abs(z)))
    return Point(
        x, y, z, gx, gy, gz, nx, ny, nz, offset, is_front, s, t, red, green, blue, material
    )


@device
def to_world(tables, x, y, z):
    """A point of the local frame in world space."""
    scale, center = tables.inverse_scale, tables.center
    return x * scale + center[0], y * scale + center[1], z * scale + center[2]


@device
def spawned(tables, point, toward):
    """The origin of a ray that leaves a point in a direction, world space; see `Hits.spawn`."""
    away = point.offset
    if point.gx * toward[0] + point.gy * toward[1] + point.gz * toward[2] < 0.0:
        away = -away
    return to_world(
        tables,
        point.x + away * point.gx,
        point.y + away * point.gy,
        point.z + away * point.gz,
    )
