"""Numbers and colours of materials at surface points: constants times textures."""

from __future__ import annotations

import numpy as np

from raystream.jit.cpu import device
from raystream.jit.simd import any_lane, as_int32, gather, maximum, widen_number
from raystream.rendering.shading.tables import IS_TEXTURED, WIDTH
from raystream.rendering.shading.textures import texture_color, texture_of
from raystream.rendering.shading.vectors import chosen, times

_NULL, _WHOLE = np.float32(0.0), np.float32(1.0)
_0, _1, _2 = np.int32(0), np.int32(1), np.int32(2)
_COLUMN_COUNT = np.int32(WIDTH)


@device
def material_number(tables, material, column):
    """A number of a material, by its index in `Column`."""
    at = as_int32(material * _COLUMN_COUNT + column)
    return widen_number(gather(np.float32, tables.materials, at))


@device
def material_color(tables, material, column):
    """A colour of a material, by its index in `Column`."""
    return (
        material_number(tables, material, column),
        material_number(tables, material, as_int32(column + _1)),
        material_number(tables, material, as_int32(column + _2)),
    )


@device
def looked_up(tables, point, role, values):
    """A texture's RGB at a point; white without a texture."""
    white = point.nx * _NULL + _WHOLE
    color = white, white, white
    if tables.kinds & IS_TEXTURED:
        texture = texture_of(tables.textures, point.material, role)
        is_there = texture >= _0
        if any_lane(is_there):
            place = maximum(texture, _0)
            found = texture_color(tables.textures, place, point.u, point.v, values)
            color = chosen(is_there, found, color)
    return color


@device
def tinted(color, tables, point, role):
    """A material's colour times its texture."""
    return times(color, looked_up(tables, point, role, tables.textures.linear))


@device
def color_if(tables, kind, point, column):
    """A material's colour, if any material of the scene has one; else black."""
    nothing = point.nx * _NULL
    color = nothing, nothing, nothing
    if tables.kinds & kind:
        color = material_color(tables, point.material, column)
    return color
