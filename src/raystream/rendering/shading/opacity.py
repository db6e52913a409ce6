"""The opacity filter of queries: whether a hit of a triangle counts.

References
----------
Enderton, Sintorn, Shirley and Luebke, "Stochastic Transparency", 2010: a partly transparent
surface is hit by a share of the samples, and not by the others.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from raystream.jit.cpu import device_call, kernel
from raystream.jit.simd import as_int32, as_uint32, float_as_bits, gather, load
from raystream.rendering.sampling.hashing import as_float, mix
from raystream.rendering.shading.surface_points import material_of
from raystream.rendering.shading.textures import TextureTables, texture_color
from raystream.rendering.shading.vertices import attribute_number, vertices_of

#: Kinds of materials: opaque, opaque where alpha reaches the cut-off, opaque by chance.
OPAQUE, MASKED, PARTIAL = np.int32(0), np.int32(1), np.int32(2)

_0, _1, _2, _3 = (np.int32(k) for k in range(4))
_NONE, _WORD, _LONG, _32 = np.uint64(0), np.uint64(4), np.uint64(8), np.uint64(32)

#: Rounding error of the weights of four texels in float32.
_ROUNDING = 2.0**-22

#: Keeps a seed of 0 from the hash's fixed point.
_OF_OPACITY = np.uint32(0xBB67AE85)

#: Instances of a triangle have numbers of their own.
_OF_INSTANCE = np.uint32(0x9E3779B9)


class OpacityTables(NamedTuple):
    """A scene's opacity, by address.

    Attributes
    ----------
    material_ids, faces, texcoords
        See `SceneTables`; faces and texcoords are 0 if missing. Materials are of all primitives.
    triangle_count : int32
        Triangles of meshes: what comes after them has neither texture coordinates nor vertices.
    alphas : uint64
        Of shape (V, 1), float32: the alpha of vertices; 0 if it is 1 everywhere.
    kinds : uint64
        Of shape (M,), int32: `OPAQUE`, `MASKED` or `PARTIAL`.
    numbers : uint64
        Of shape (M, 2), float32: opacity and cut-off.
    textures : TextureTables
        Of the role ``"opacity"``, with equal channels.
    """

    material_ids: np.uint64
    faces: np.uint64
    texcoords: np.uint64
    triangle_count: np.int32
    alphas: np.uint64
    kinds: np.uint64
    numbers: np.uint64
    textures: TextureTables


class FilteredRays(NamedTuple):
    """The filter's constants: tables and rays.

    Attributes
    ----------
    tables : OpacityTables
    seed : uint32
    origins : uint64
        Address of rows of three float64.
    directions : uint64
        Address of rows of three float32.
    """

    tables: OpacityTables
    seed: np.uint32
    origins: np.uint64
    directions: np.uint64


def is_there(hit: Any, rays: Any) -> bool:
    """Filter: whether a `Hit` counts."""
    kind = gather(np.int32, rays.tables.kinds, material_of(rays.tables, hit.prim_id))
    if kind == OPAQUE:
        return True
    return _is_there(hit.prim_id, hit.instance_id, hit.u, hit.v, hit.ray, kind, rays)


def is_there_beside_spheres(hit: Any, rays: Any) -> bool:
    """The same in a scene with spheres, of which each side is there or not by its own chance."""
    kind = gather(np.int32, rays.tables.kinds, material_of(rays.tables, hit.prim_id))
    if kind == OPAQUE:
        return True
    side = np.int32(hit.instance_id + hit.instance_id + (_0 if hit.is_entering else _1))
    return _is_there(hit.prim_id, side, hit.u, hit.v, hit.ray, kind, rays)


@kernel
def find_points(begin, end, prim_ids, u, v, rays, found):
    """Write whether points of triangles, rows begin to end, are there; none is left to chance."""
    for i in range(np.uint64(begin), np.uint64(end)):
        prim_id = prim_ids[i]
        kind = gather(np.int32, rays.tables.kinds, material_of(rays.tables, prim_id))
        found[i] = kind == OPAQUE or _is_there(prim_id, _0, u[i], v[i], i, kind, rays)


@device_call
def _is_there(prim_id, instance_id, u, v, ray, kind, rays):
    tables = rays.tables
    material = material_of(tables, prim_id)
    alpha = _alpha(tables, prim_id, material, np.float64(u), np.float64(v))
    if kind == MASKED:
        cutoff = gather(np.float32, tables.numbers, as_int32(material * _2 + _1))
        return alpha >= cutoff - _ROUNDING
    if alpha >= 1.0 - _ROUNDING:
        return True
    return _number(rays, np.uint64(ray), prim_id, instance_id) < alpha


@device_call
def _alpha(tables, prim, material, u, v):
    """Opacity at a point of a triangle, float64."""
    alpha = np.float64(gather(np.float32, tables.numbers, as_int32(material * _2)))
    texture = gather(np.int32, tables.textures.of_material, material)
    has_texture = texture >= _0 and tables.texcoords != _NONE
    if (not has_texture and tables.alphas == _NONE) or prim >= tables.triangle_count:
        return alpha
    vertices = vertices_of(tables, prim)
    if tables.alphas != _NONE:
        alpha = alpha * attribute_number(tables.alphas, _1, _0, vertices, u, v)
    if not has_texture:
        return alpha
    s = attribute_number(tables.texcoords, _2, _0, vertices, u, v)
    t = attribute_number(tables.texcoords, _2, _1, vertices, u, v)
    grey, _, _ = texture_color(tables.textures, texture, s, t, tables.textures.plain)
    return alpha * grey


@device_call
def _number(rays, ray, prim_id, instance_id):
    """A number in [0, 1), hashed from the ray's bits, the triangle, its instance and the seed.

    Of spheres, sides are in place of instances.
    """
    key = mix(rays.seed ^ _OF_OPACITY)
    at = rays.origins + ray * np.uint64(24)
    for k in range(np.uint64(3)):
        bits = np.uint64(float_as_bits(load(np.float64, at + k * _LONG)))
        key = mix(mix(key ^ as_uint32(bits)) ^ as_uint32(bits >> _32))
    at = rays.directions + ray * np.uint64(12)
    for k in range(np.uint64(3)):
        key = mix(key ^ as_uint32(float_as_bits(load(np.float32, at + k * _WORD))))
    of_instance = as_uint32(as_uint32(instance_id) * _OF_INSTANCE)  # 0 for the first
    return as_float(mix(key ^ as_uint32(prim_id) ^ of_instance))
