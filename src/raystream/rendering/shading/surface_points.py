"""Surface points at hits: positions, normals, texture coordinates and materials."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from raystream.core.spawn import EXTENT_UNITS, MOST_UNITS, REACH_UNITS, UNIT, WORLD_UNIT
from raystream.jit.constants import INF_F32, NULL
from raystream.jit.cpu import device, device_call
from raystream.jit.simd import (
    absolute,
    any_lane,
    as_int32,
    gather,
    minimum,
    narrow_lanes,
    select,
    square_root,
    widen,
    widen_number,
)
from raystream.rendering.shading.normal_maps import (
    BASE,
    COAT,
    has_coat_map,
    has_normal_map,
    mapped_normal,
)
from raystream.rendering.shading.tables import HAS_COAT
from raystream.rendering.shading.vectors import chosen, largest
from raystream.rendering.shading.vertices import (
    attribute_number,
    attribute_vector,
    corner_of,
    vertices_of,
)

_0, _1, _2 = np.int32(0), np.int32(1), np.int32(2)
_NULL, _WHOLE = np.float32(0.0), np.float32(1.0)
_NAN = np.float32(np.nan)


class Point(NamedTuple):
    """A surface point, or 16 of them.

    For one, numbers are float64. For 16 they are vectors: of float32, but `x`, `y`, `z` and
    `offset` of float64; `is_front` is then a mask.

    Attributes
    ----------
    x, y, z : float64
        Local frame, on the triangle.
    gx, gy, gz : float64
        Unit geometric normal, facing the ray's origin.
    nx, ny, nz : float64
        Unit shading normal, on the same side; the geometric normal where it would face away
        from the ray. With normal and bump maps, it always faces the ray's origin.
    cx, cy, cz : float64
        The same of a clear coat, which has its own normal map.
    offset : float64
        Distance from the triangle at which rays that leave it start, see `core.spawn`.
    is_front : bool
        Whether the ray came from the side where vertices are counterclockwise.
    u, v : float64
        Texture coordinates; NaN if missing.
    red, green, blue : float64
        Vertex colour.
    material : int32
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
    cx: float
    cy: float
    cz: float
    offset: float
    is_front: bool
    u: float
    v: float
    red: float
    green: float
    blue: float
    material: np.int32


@device
def material_of(tables, prim):
    """The material of a triangle, int32; or of 16."""
    return gather(np.int32, tables.material_ids, prim)


@device
def offset_at(tables, extent, reach):
    """Distance from a triangle at which rays must start or end to miss it; see `core.spawn`.

    Parameters
    ----------
    tables : SceneTables
    extent : float64
        The triangle's longest side along an axis, or an upper bound.
    reach : float64
        Largest absolute coordinate of the point.
    """
    offset = UNIT * minimum(
        EXTENT_UNITS * extent + REACH_UNITS * reach, MOST_UNITS * (tables.max_coordinate + reach)
    )
    return offset + WORLD_UNIT * tables.world_reach


@device
def _extent(a, b, c):
    return largest(a, b, c) - minimum(minimum(a, b), c)


@device
def _smooth_normal(tables, vertices, u, v, gx, gy, gz):
    """The interpolated vertex normal on the side of the geometric one, or that one if invalid."""
    if tables.normals == NULL:
        return gx, gy, gz
    x, y, z = attribute_vector(tables.normals, vertices, u, v)
    length = square_root(x * x + y * y + z * z)
    is_sound = (length > _NULL) & (length < INF_F32)
    scale = _WHOLE / select(x * gx + y * gy + z * gz < _NULL, -length, length)
    return (
        select(is_sound, x * scale, gx),
        select(is_sound, y * scale, gy),
        select(is_sound, z * scale, gz),
    )


@device
def _base_point(tables, prim, u, v, dx, dy, dz):
    """The point of a hit, or of 16, and its interpolated normal, without normal maps."""
    ax, ay, az = corner_of(tables, prim, _0)
    bx, by, bz = corner_of(tables, prim, _1)
    cx, cy, cz = corner_of(tables, prim, _2)
    extent = largest(_extent(ax, bx, cx), _extent(ay, by, cy), _extent(az, bz, cz))
    bx, by, bz, cx, cy, cz = bx - ax, by - ay, bz - az, cx - ax, cy - ay, cz - az
    first, second = widen(u), widen(v)
    x = ax + first * bx + second * cx
    y = ay + first * by + second * cy
    z = az + first * bz + second * cz
    gx, gy, gz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    # Scaled before its length is computed: the square of a small area would underflow.
    most = largest(absolute(gx), absolute(gy), absolute(gz))
    scale = 1.0 / most
    gx, gy, gz = narrow_lanes(gx * scale), narrow_lanes(gy * scale), narrow_lanes(gz * scale)
    length = square_root(gx * gx + gy * gy + gz * gz)
    is_front = gx * dx + gy * dy + gz * dz <= _NULL
    scale = _WHOLE / select(is_front, length, -length)
    gx, gy, gz = gx * scale, gy * scale, gz * scale

    u, v = widen_number(u), widen_number(v)
    vertices = vertices_of(tables, prim) if tables.faces != NULL else (prim, prim, prim)
    nx, ny, nz = _smooth_normal(tables, vertices, u, v, gx, gy, gz)
    s, t = u * _NAN, v * _NAN
    if tables.texcoords != NULL:
        s = attribute_number(tables.texcoords, _2, _0, vertices, u, v)
        t = attribute_number(tables.texcoords, _2, _1, vertices, u, v)
    red, green, blue = u * _NULL + _WHOLE, u * _NULL + _WHOLE, u * _NULL + _WHOLE
    if tables.colors != NULL:
        red, green, blue = attribute_vector(tables.colors, vertices, u, v)
    offset = offset_at(tables, extent, largest(absolute(x), absolute(y), absolute(z)))
    if tables.offsets != NULL:
        offset = offset + widen(gather(np.float32, tables.offsets, prim))
    # A normal that faces away, as near silhouettes, would reflect into the surface.
    is_away = nx * dx + ny * dy + nz * dz >= _NULL
    facing = chosen(is_away, (gx, gy, gz), (nx, ny, nz))
    point = Point(
        x,
        y,
        z,
        gx,
        gy,
        gz,
        facing[0],
        facing[1],
        facing[2],
        facing[0],
        facing[1],
        facing[2],
        offset,
        is_front,
        s,
        t,
        red,
        green,
        blue,
        material_of(tables, prim),
    )
    return point, (nx, ny, nz)


@device
def _with_normals(point, normal, coat):
    """The same point with other shading normals: of the surface, and of its clear coat."""
    return Point(
        point.x,
        point.y,
        point.z,
        point.gx,
        point.gy,
        point.gz,
        normal[0],
        normal[1],
        normal[2],
        coat[0],
        coat[1],
        coat[2],
        point.offset,
        point.is_front,
        point.u,
        point.v,
        point.red,
        point.green,
        point.blue,
        point.material,
    )


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
    prim = as_int32(prim_id)
    point, smooth = _base_point(tables, prim, u, v, dx, dy, dz)
    return with_normal_maps(tables, prim, (u, v), point, smooth, (dx, dy, dz), True)


@device
def with_normal_maps(tables, prim, weights, point, smooth, direction, is_hit):
    """Apply the normal and bump maps of points that have some."""
    if tables.tangents == NULL:
        return point
    normal, coat = (point.nx, point.ny, point.nz), (point.cx, point.cy, point.cz)
    is_bent = has_normal_map(tables, point.material) & is_hit
    if any_lane(is_bent):
        bent = _bent(tables, prim, weights, point, smooth, direction, BASE)
        normal = chosen(is_bent, bent, normal)
    if tables.kinds & HAS_COAT:
        is_bent = has_coat_map(tables, point.material) & is_hit
        if any_lane(is_bent):
            bent = _bent(tables, prim, weights, point, smooth, direction, COAT)
            coat = chosen(is_bent, bent, coat)
    return _with_normals(point, normal, coat)


@device
def _bent(tables, prim, weights, point, smooth, direction, layer):
    """The normals of points as if all had a normal map; `layer` is `BASE` or `COAT`."""
    dx, dy, dz = direction
    scale = -_WHOLE / square_root(dx * dx + dy * dy + dz * dz)
    weights = widen_number(weights[0]), widen_number(weights[1])
    return mapped_normal(
        tables,
        prim,
        point.material,
        (weights, (point.u, point.v)),
        (point.gx, point.gy, point.gz),
        smooth,
        point.is_front,
        (dx * scale, dy * scale, dz * scale),
        layer,
    )


@device_call
def surface_points(tables, prim_ids, u, v, dx, dy, dz, is_hit):
    """The points of 16 hits.

    Parameters
    ----------
    tables : SceneTables
    prim_ids : i32x16
        Valid triangles in all lanes, also for misses.
    u, v, dx, dy, dz : f32x16
        As of `surface_point`.
    is_hit : mask16
        Lanes in use.

    Returns
    -------
    Point
        Of vectors.
    """
    point, smooth = _base_point(tables, prim_ids, u, v, dx, dy, dz)
    return with_normal_maps(tables, prim_ids, (u, v), point, smooth, (dx, dy, dz), is_hit)


@device
def world_position(tables, x, y, z):
    """A point of the local frame in world space."""
    scale, center = tables.inverse_scale, tables.center
    return x * scale + center[0], y * scale + center[1], z * scale + center[2]


@device
def spawn_origin(tables, point, toward):
    """The origin of a ray that leaves a point, world space; see `Hits.spawn`."""
    is_below = point.gx * toward[0] + point.gy * toward[1] + point.gz * toward[2] < _NULL
    away = select(is_below, -point.offset, point.offset)
    return world_position(
        tables,
        point.x + away * widen(point.gx),
        point.y + away * widen(point.gy),
        point.z + away * widen(point.gz),
    )
