"""Bitmaps in one piece of memory, looked up bilinearly and decoded from sRGB."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import FileFormatError, RaystreamWarning
from raystream.jit.cpu import device, device_call
from raystream.jit.simd import load
from raystream.render.color import decode_srgb
from raystream.scene.material import Material
from raystream.scene.texture import Texture

__all__ = [
    "ROLES",
    "TextureTables",
    "pack_textures",
    "place_of",
    "texture_color",
    "texture_of",
    "texture_size",
]

#: What of a material a texture may multiply, or make, in the order of
#: `TextureTables.of_material`.
ROLES = ("diffuse", "specular", "emission", "metallic_roughness", "normal", "bump")

_NORMAL, _BUMP = ROLES.index("normal"), ROLES.index("bump")

_ONE = np.float32(1.0)
_ROLES = np.uint64(len(ROLES))

# Bytes: of a number, of a long one, of a texel, and of a row of `TextureTables.places`.
_WORD = np.uint64(4)
_LONG = np.uint64(8)
_TEXEL = np.uint64(3)
_PLACE = np.uint64(32)
_ONE_BYTE = np.uint64(1)
_TWO_BYTES = np.uint64(2)


class TextureTables(NamedTuple):
    """All bitmaps of a scene, by address.

    Attributes
    ----------
    texels : uint64
        Of shape (K, 3), uint8: sRGB, row after row, the top one first.
    places : uint64
        Of shape (T, 4), int64: first texel, width, height, and 1 for a texture that is clamped,
        0 if it repeats.
    of_material : uint64
        Of shape (M, 6), int32: each material's texture by role; -1 for none.
    reliefs : uint64
        Of shape (M, 3), float32: factors of normals' x and y and of heights, and 1 for
        materials that mirror or have a gloss, 0 for matte ones.
    linear, plain, signed : uint64
        Of shape (256,), float32: values of bytes, of colours, of numbers in [0, 1], and of
        normals' components in [-1, 1]: 128 is 0, so that a flat normal map is flat.
    """

    texels: np.uint64
    places: np.uint64
    of_material: np.uint64
    reliefs: np.uint64
    linear: np.uint64
    plain: np.uint64
    signed: np.uint64


def place_of(array: NDArray[Any] | None) -> np.uint64:
    """The address of a contiguous array's first number; 0 if it has none, or is none."""
    return np.uint64(0 if array is None or not array.size else array.ctypes.data)


def pack_textures(materials: Sequence[Material]) -> tuple[TextureTables, object]:
    """Decode the textures of materials, and say what must be kept; shared ones are kept once.

    Warns
    -----
    RaystreamWarning
        For each texture that cannot be read; the plain colour is then used.
    """
    of_material = np.full((len(materials), len(ROLES)), -1, np.int32)
    known: dict[int, int] = {}
    parts: list[NDArray[np.uint8]] = []
    places: list[tuple[int, int, int, int]] = []
    first = 0
    for row, material in zip(of_material, materials, strict=True):
        for column, role in enumerate(ROLES):
            texture = material.textures.get(role)
            if texture is None or not _is_seen(material, role):
                continue
            if id(texture) not in known:
                pixels = _rgb_of(texture)
                known[id(texture)] = -1
                if pixels is not None:
                    known[id(texture)] = len(places)
                    height, width = pixels.shape[:2]
                    places.append((first, width, height, int(texture.wrap == "clamp")))
                    parts.append(pixels.reshape(-1, 3))
                    first += height * width
            row[column] = known[id(texture)]
    reliefs = np.array([_relief_of(material) for material in materials], np.float32)
    for row, material, relief in zip(of_material, materials, reliefs, strict=True):
        if row[_BUMP] >= 0 and row[_NORMAL] < 0 and _holds_normals(parts[row[_BUMP]]):
            row[_NORMAL], relief[0] = row[_BUMP], material.bump_scale
    bytes_ = np.arange(256, dtype=np.uint8)
    kept: tuple[NDArray[Any], ...] = (
        np.concatenate(parts) if parts else np.empty((0, 3), np.uint8),
        np.array(places, np.int64).reshape(-1, 4),
        of_material,
        reliefs,
        decode_srgb(bytes_),
        bytes_ / np.float32(255.0),
        np.maximum((bytes_ - np.float32(128.0)) / np.float32(127.0), np.float32(-1.0)),
    )
    return TextureTables(*map(place_of, kept)), kept


def _is_seen(material: Material, role: str) -> bool:
    """Whether it matters what a texture multiplies."""
    if role == "metallic_roughness":
        return bool(material.roughness or material.metallic)
    if role in ("normal", "bump"):
        return bool(getattr(material, f"{role}_scale"))
    return any(getattr(material, role))


def _relief_of(material: Material) -> tuple[float, float, float]:
    shines = material.roughness is not None or any(
        (*material.specular, *material.reflection, *material.transmission)
    )
    return material.normal_scale, material.bump_scale, float(shines)


def _holds_normals(texels: NDArray[np.uint8]) -> bool:
    """Whether a bitmap for bumps holds normals: MTL files of some programs name them so.

    Normals are unit vectors, most of them nearly upright: none of a photograph's colours, and
    of greys only one.
    """
    some = texels[:: max(1, len(texels) // 4096)] / 127.5 - 1.0
    is_normal = (some[:, 2] > 0.0) & (abs(np.linalg.norm(some, axis=1) - 1.0) < 0.1)
    x, y, z = some.mean(axis=0)
    return bool(is_normal.mean() > 0.9 and max(abs(x), abs(y)) < 0.25 < 0.5 < z)


def _rgb_of(texture: Texture) -> NDArray[np.uint8] | None:
    try:
        pixels = texture.pixels()
    except FileFormatError as error:
        warnings.warn(f"texture left out: {error}", RaystreamWarning, stacklevel=4)
        return None
    if pixels.shape[2] == 1:
        return np.repeat(pixels, 3, axis=2)
    return np.ascontiguousarray(pixels[:, :, :3])


@device
def texture_of(tables, material, role):
    """A material's texture by its position in `ROLES`; -1 for none."""
    return load(np.int32, tables.of_material + (material * _ROLES + role) * _WORD)


@device
def texture_size(tables, texture):
    """Width and height of a texture, in texels."""
    at = tables.places + np.uint64(texture) * _PLACE
    return load(np.int64, at + _LONG), load(np.int64, at + _LONG + _LONG)


@device
def _wrapped(index, size, is_clamped):
    if is_clamped:
        return min(max(index, 0), size - 1)
    return index % size


@device
def _texel(tables, values, bitmap, column, row):
    first, width, height, is_clamped = bitmap
    at = first + _wrapped(row, height, is_clamped) * width + _wrapped(column, width, is_clamped)
    texel = tables.texels + np.uint64(at) * _TEXEL
    return (
        load(np.float32, values + np.uint64(load(np.uint8, texel)) * _WORD),
        load(np.float32, values + np.uint64(load(np.uint8, texel + _ONE_BYTE)) * _WORD),
        load(np.float32, values + np.uint64(load(np.uint8, texel + _TWO_BYTES)) * _WORD),
    )


@device
def _mixed(a, b, share):
    rest = _ONE - share
    return a[0] * rest + b[0] * share, a[1] * rest + b[1] * share, a[2] * rest + b[2] * share


@device_call
def texture_color(tables, texture, u, v, values):
    """RGB between the four nearest texels' centres; white where u or v is NaN.

    Parameters
    ----------
    tables : TextureTables
    texture : int
        Its row of `places`.
    u, v : float64
        Texture coordinates; v points up.
    values : uint64
        `TextureTables.linear` of colours, ``plain`` of numbers, ``signed`` of normals.
    """
    if not (abs(u) < np.inf and abs(v) < np.inf):
        return _ONE, _ONE, _ONE
    at = tables.places + np.uint64(texture) * _PLACE
    width, height = texture_size(tables, texture)
    is_clamped = load(np.int64, at + _LONG + _LONG + _LONG) != 0
    bitmap = load(np.int64, at), width, height, is_clamped
    if is_clamped:
        u, v = min(max(u, 0.0), 1.0), min(max(v, 0.0), 1.0)
    else:
        u, v = u - np.floor(u), v - np.floor(v)
    x, y = u * width - 0.5, (1.0 - v) * height - 0.5
    column, row = np.int64(np.floor(x)), np.int64(np.floor(y))
    across, down = np.float32(x - column), np.float32(y - row)
    upper = _mixed(
        _texel(tables, values, bitmap, column, row),
        _texel(tables, values, bitmap, column + 1, row),
        across,
    )
    lower = _mixed(
        _texel(tables, values, bitmap, column, row + 1),
        _texel(tables, values, bitmap, column + 1, row + 1),
        across,
    )
    return _mixed(upper, lower, down)
