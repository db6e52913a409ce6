"""Relief of surfaces, by normal maps and bump maps: another normal for the light that they scatter.

A bitmap tells a normal in the surface's own frame: x along the texture's u, y along its v, z
along the smooth normal. Bump maps are heights; their slope across two texels makes the normal.

References
----------
Blinn, "Simulation of Wrinkled Surfaces", 1978. Khronos, "glTF 2.0 Specification", section
3.9.3. Keller et al., "The Iray Light Transport Simulation and Rendering System", 2017 (where a
mirror would look into the surface).
"""

from __future__ import annotations

import math

import numpy as np

from raystream.jit.cpu import device, device_call
from raystream.jit.simd import gather, maximum
from raystream.render.color import LUMINANCE
from raystream.render.shading.textures import ROLES, texture_color, texture_of, texture_size
from raystream.render.shading.vertices import attribute_pair, attribute_vector, vertices_of

__all__ = ["LEAST_COSINE", "has_relief", "relief_normal"]

#: Between a normal and the view, or the triangle's normal: less would put it on the other side
#: within float32's rounding.
LEAST_COSINE = 1e-3

_NORMAL = np.int32(ROLES.index("normal"))
_BUMP = np.int32(ROLES.index("bump"))
_RED, _GREEN, _BLUE = LUMINANCE

_0, _1, _2 = np.int32(0), np.int32(1), np.int32(2)
_RELIEF = np.int32(3)


@device
def has_relief(tables, material):
    """Whether a material, or each of 16, has a normal map or a bump map."""
    textures = tables.textures
    normal, bump = texture_of(textures, material, _NORMAL), texture_of(textures, material, _BUMP)
    return maximum(normal, bump) >= _0


@device
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@device
def _sum(a, b, factor):
    return a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2]


@device
def _unit(a):
    length = math.sqrt(_dot(a, a))
    return a[0] / length, a[1] / length, a[2] / length


@device
def _is_unit(a):
    """Whether `_unit` gave a direction: not of nothing, and not of what is too long."""
    return abs(_dot(a, a) - 1.0) < 0.5


@device
def _height(textures, texture, s, t):
    color = texture_color(textures, texture, s, t, textures.plain)
    return _RED * color[0] + _GREEN * color[1] + _BLUE * color[2]


@device_call
def _mapped(textures, material, s, t):
    """The normal in the surface's frame, of any length."""
    row = material * _RELIEF
    texture = texture_of(textures, material, _NORMAL)
    if texture >= 0:
        scale = np.float64(gather(np.float32, textures.reliefs, row))
        x, y, z = texture_color(textures, texture, s, t, textures.signed)
        return scale * x, scale * y, np.float64(z)
    texture = texture_of(textures, material, _BUMP)
    scale = 0.5 * np.float64(gather(np.float32, textures.reliefs, row + _1))
    width, height = texture_size(textures, texture)
    across, up = 1.0 / width, 1.0 / height
    x = _height(textures, texture, s - across, t) - _height(textures, texture, s + across, t)
    y = _height(textures, texture, s, t - up) - _height(textures, texture, s, t + up)
    return scale * x, scale * y, 1.0


@device
def _is_mirrored(tables, vertices):
    """Whether the texture covers the triangle's front as if seen in a mirror."""
    s, t = attribute_pair(tables.texcoords, vertices[0])
    s1, t1 = attribute_pair(tables.texcoords, vertices[1])
    s2, t2 = attribute_pair(tables.texcoords, vertices[2])
    return (s1 - s) * (t2 - t) - (s2 - s) * (t1 - t) < 0.0


@device
def _turned(normal, geometric, back, is_mirror):
    """The nearest normal that does not face away from the view, nor from the triangle.

    That of mirrors and gloss is turned until what they mirror is not below the triangle: there
    it would be lost, and the surface black.
    """
    cosine = _dot(normal, geometric)
    if cosine < LEAST_COSINE:
        normal = _unit(_sum(normal, geometric, LEAST_COSINE - cosine))
    cosine = _dot(normal, back)
    if cosine < LEAST_COSINE:
        normal = _unit(_sum(normal, back, LEAST_COSINE - cosine))
    if not is_mirror:
        return normal
    along = 2.0 * _dot(normal, back)
    toward = along * normal[0] - back[0], along * normal[1] - back[1], along * normal[2] - back[2]
    cosine = _dot(toward, geometric)
    if cosine >= LEAST_COSINE:
        return normal
    toward = _unit(_sum(toward, geometric, LEAST_COSINE - cosine))
    return _unit(_sum(back, toward, 1.0))


@device_call
def relief_normal(tables, prim, material, weights, texcoord, geometric, normal, is_front, back):
    """The shading normal of a surface with relief.

    Parameters
    ----------
    tables : SceneTables
    prim, material : int32
    weights, texcoord : tuple of two float64
        Of vertices 1 and 2; texture coordinates.
    geometric, normal : tuple of three float64
        Unit normals of the triangle and between its vertices, on the side of the view.
    is_front : bool
        Whether that is the triangle's front.
    back : tuple of three float64
        Unit vector to where the ray came from.

    Returns
    -------
    tuple of three float64
        Unit vector that faces the view, on the side of the triangle's normal. Without relief
        where there are no texture coordinates, or none that span a surface.
    """
    s, t = texcoord
    rows, hand = tables.tangents, 1.0
    vertices = vertices_of(tables, prim)
    if _is_mirrored(tables, vertices):
        rows, hand = tables.mirrored_tangents, -1.0
    across = attribute_vector(rows, vertices, weights[0], weights[1])
    across = _unit(_sum(across, normal, -_dot(across, normal)))
    if _is_unit(across) and abs(s) < np.inf and abs(t) < np.inf:
        # The frame is the front's; its back has the opposite normal, as bumps are dents there.
        if not is_front:
            hand = -hand
        up = (
            hand * (normal[1] * across[2] - normal[2] * across[1]),
            hand * (normal[2] * across[0] - normal[0] * across[2]),
            hand * (normal[0] * across[1] - normal[1] * across[0]),
        )
        x, y, z = _mapped(tables.textures, material, s, t)
        if not is_front:
            x, y = -x, -y
        bent = _sum(_sum(_sum((0.0, 0.0, 0.0), normal, z), across, x), up, y)
        bent = _unit(bent)
        if _is_unit(bent):
            normal = bent
    mirrors = gather(np.float32, tables.textures.reliefs, material * _RELIEF + _2)
    return _turned(normal, geometric, back, mirrors > np.float32(0.0))
