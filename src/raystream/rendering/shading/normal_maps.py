"""Normal mapping: shading normals perturbed by normal maps and bump maps.

A normal map stores normals in tangent space: x along the texture's u, y along its v, z along the
interpolated normal. Bump maps store heights, whose slope over two texels gives the normal.

References
----------
Blinn, "Simulation of Wrinkled Surfaces", 1978. Khronos, "glTF 2.0 Specification", section
3.9.3. Keller et al., "The Iray Light Transport Simulation and Rendering System", 2017 (for mirror
directions below the surface).
"""

from __future__ import annotations

import numpy as np

from raystream.jit.constants import INF_F32
from raystream.jit.cpu import device, device_call
from raystream.jit.simd import (
    absolute,
    any_lane,
    as_int32,
    gather,
    maximum,
    select,
    square_root,
    widen_number,
)
from raystream.rendering.shading.bump_maps import bump_slopes
from raystream.rendering.shading.textures import ROLES, texture_color, texture_of
from raystream.rendering.shading.vectors import added, chosen, dot, mirrored, scaled
from raystream.rendering.shading.vertices import attribute_pair, attribute_vector, vertices_of

#: Layers of a surface that have normal maps: itself, and its clear coat.
BASE, COAT = np.int32(0), np.int32(1)

#: Between a normal and the view, or the geometric normal: smaller ones may change sign by
#: float32 rounding.
_LEAST_COSINE = np.float32(1e-3)

_NORMAL = np.int32(ROLES.index("normal"))
_BUMP = np.int32(ROLES.index("bump"))
_COAT_NORMAL = np.int32(ROLES.index("clearcoat_normal"))

_NULL, _HALF, _WHOLE = map(np.float32, (0.0, 0.5, 1.0))
_0, _1, _2, _3 = map(np.int32, range(4))

#: Numbers in a row of `TextureTables.normal_scales`; bytes of a row of tangents.
_RELIEF, _TANGENT = np.int32(4), np.uint64(12)


@device
def has_normal_map(tables, material):
    """Whether a material, or each of 16, has a normal map or a bump map."""
    textures = tables.textures
    normal, bump = texture_of(textures, material, _NORMAL), texture_of(textures, material, _BUMP)
    return maximum(normal, bump) >= _0


@device
def has_coat_map(tables, material):
    """Whether a material's clear coat, or each of 16, has a normal map."""
    return texture_of(tables.textures, material, _COAT_NORMAL) >= _0


@device
def _unit(a):
    return scaled(a, _WHOLE / square_root(dot(a, a)))


@device
def _is_unit(a):
    """Whether `_unit` returned a direction: its input was neither 0 nor overflowed."""
    return absolute(dot(a, a) - _WHOLE) < _HALF


@device
def _scale(textures, material, column):
    at = as_int32(material * _RELIEF + column)
    return widen_number(gather(np.float32, textures.normal_scales, at))


@device_call
def _mapped(textures, material, s, t, layer):
    """The normal in tangent space, of any length."""
    role, column = (_NORMAL, _0) if layer == BASE else (_COAT_NORMAL, _3)
    texture = texture_of(textures, material, role)
    is_mapped = texture >= _0
    x, y, z = s * _NULL, s * _NULL, s * _NULL + _WHOLE
    if any_lane(is_mapped):
        scale = _scale(textures, material, column)
        found = texture_color(textures, maximum(texture, _0), s, t, textures.signed)
        x, y, z = chosen(is_mapped, (scale * found[0], scale * found[1], found[2]), (x, y, z))
    if layer != BASE:
        return x, y, z
    texture = texture_of(textures, material, _BUMP)
    is_bumpy = texture >= _0
    if any_lane(is_bumpy):
        scale = _HALF * _scale(textures, material, _1)
        dx, dy = bump_slopes(textures, maximum(texture, _0), s, t)
        x, y = select(is_bumpy, scale * dx, x), select(is_bumpy, scale * dy, y)
    return x, y, z


@device
def _is_mirrored(tables, vertices):
    """Whether texture coordinates are mirrored on the triangle's front."""
    s, t = attribute_pair(tables.texcoords, vertices[0])
    s1, t1 = attribute_pair(tables.texcoords, vertices[1])
    s2, t2 = attribute_pair(tables.texcoords, vertices[2])
    return (s1 - s) * (t2 - t) - (s2 - s) * (t1 - t) < _NULL


@device
def _at_least(cosine, normal, toward):
    """Turn normals toward a direction, where their cosine to it is too small."""
    turned = _unit(added(normal, toward, _LEAST_COSINE - cosine))
    return chosen(cosine < _LEAST_COSINE, turned, normal)


@device
def _turned(normal, geometric, back, is_mirror):
    """Turn a normal until it faces the view and the geometric normal.

    Specular materials' is turned until the mirror direction is above the triangle: below it,
    light would be lost, and the surface black.
    """
    normal = _at_least(dot(normal, geometric), normal, geometric)
    normal = _at_least(dot(normal, back), normal, back)
    toward = mirrored(back, normal)
    cosine = dot(toward, geometric)
    toward = _unit(added(toward, geometric, _LEAST_COSINE - cosine))
    is_lost = is_mirror & (cosine < _LEAST_COSINE)
    return chosen(is_lost, _unit(added(back, toward, _WHOLE)), normal)


@device_call
def mapped_normal(tables, prim, material, place, geometric, normal, is_front, back, layer):
    """The shading normal of a normal-mapped surface, or of 16.

    Parameters
    ----------
    tables : SceneTables
    prim, material : int32
    place : tuple of two pairs of float64
        Barycentrics of vertices 1 and 2; texture coordinates.
    geometric, normal : tuple of three float64
        Unit geometric and interpolated normals, on the side of the view.
    is_front : bool
        Whether that is the triangle's front.
    back : tuple of three float64
        Unit vector to the ray's origin.
    layer : int32
        `BASE` or `COAT`.

    Returns
    -------
    tuple of three float64
        Unit vector that faces the view, on the side of the geometric normal. Not perturbed where
        texture coordinates are missing or degenerate.
    """
    weights, (s, t) = place
    vertices = vertices_of(tables, prim)
    is_mirrored = _is_mirrored(tables, vertices)
    # Mirrored tangents follow the others in memory.
    count = as_int32((tables.mirrored_tangents - tables.tangents) // _TANGENT)
    first = select(is_mirrored, count, as_int32(vertices[0] * _0))
    rows = (
        as_int32(vertices[0] + first),
        as_int32(vertices[1] + first),
        as_int32(vertices[2] + first),
    )
    across = attribute_vector(tables.tangents, rows, weights[0], weights[1])
    across = _unit(added(across, normal, -dot(across, normal)))
    is_mapped = _is_unit(across) & (absolute(s) < INF_F32) & (absolute(t) < INF_F32)
    # The frame is the front's; the back has the opposite normal, since bumps are dents there.
    side = select(is_front, _WHOLE, s * _NULL - _WHOLE)
    hand = select(is_mirrored, -side, side)
    up = (
        hand * (normal[1] * across[2] - normal[2] * across[1]),
        hand * (normal[2] * across[0] - normal[0] * across[2]),
        hand * (normal[0] * across[1] - normal[1] * across[0]),
    )
    x, y, z = _mapped(tables.textures, material, s, t, layer)
    x, y = side * x, side * y
    bent = _unit(added(added(scaled(normal, z), across, x), up, y))
    normal = chosen(is_mapped & _is_unit(bent), bent, normal)
    return _turned(normal, geometric, back, _scale(tables.textures, material, _2) > _NULL)
