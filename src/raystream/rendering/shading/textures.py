"""Textures in one atlas, sampled bilinearly and decoded from sRGB."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import FileFormatError, RaystreamWarning
from raystream.jit.constants import INF_F32
from raystream.jit.cpu import device, device_call
from raystream.jit.simd import (
    absolute,
    any_lane,
    as_float32,
    as_int32,
    floor,
    gather,
    maximum,
    minimum,
    select,
    widen_number,
)
from raystream.rendering.color import LUMINANCE, decode_srgb
from raystream.scene.material import Material
from raystream.scene.texture import Texture

#: Properties of materials that have textures, in the order of `TextureTables.of_material`.
ROLES = (
    "diffuse",
    "specular",
    "emission",
    "metallic_roughness",
    "normal",
    "bump",
    "clearcoat",
    "clearcoat_roughness",
    "clearcoat_normal",
    "sheen_color",
    "sheen_roughness",
    "transmission",
    "reflectance",
)

_NORMAL, _BUMP = ROLES.index("normal"), ROLES.index("bump")

_NULL, _HALF, _WHOLE, _TWO = map(np.float32, (0.0, 0.5, 1.0, 2.0))
_ROLES = np.int32(len(ROLES))

_0, _1, _2, _3, _4, _5, _6, _7, _8, _9, _PLACE = (np.int32(k) for k in range(11))

#: Bits of a texture's row.
CLAMPED_U, _TRANSFORMED, CLAMPED_V, MIRRORED_U, MIRRORED_V = (np.int32(1 << k) for k in range(5))
MIRRORED = np.int32(MIRRORED_U | MIRRORED_V)
_OF_U, _OF_V = np.int32(CLAMPED_U | MIRRORED_U), np.int32(CLAMPED_V | MIRRORED_V)

#: Bits by `Texture.wraps`. Mirrored coordinates are folded into [0, 1], and then clamped: beyond
#: its first and its last texel, a mirrored image has the same texels again.
_WRAP_BITS = {
    "repeat": np.int32(0),
    "clamp": np.int32(CLAMPED_U | CLAMPED_V),
    "mirror": np.int32(CLAMPED_U | CLAMPED_V | MIRRORED),
}
_BYTE, _SHIFT_8, _SHIFT_16 = np.uint32(0xFF), np.uint32(8), np.uint32(16)

#: Most texels of a scene: kernels index them with int32.
_MAX_TEXELS = 2**31 - 1


class TextureTables(NamedTuple):
    """All textures of a scene, by address.

    Attributes
    ----------
    texels : uint64
        Of shape (K, 4), uint8: sRGB and an unused byte, row by row, the top one first. Bump maps
        have float32 heights in the same bytes.
    places : uint64
        Of shape (T, 10), int32: first texel, width, height, bits of what applies (1 and 4: clamped
        along u and v, 2: transformed, 8 and 16: mirrored along u and v, and then clamped), and the
        six numbers of `Texture.transform`, float32.
    of_material : uint64
        Of shape (M, 13), int32: each material's texture by role; -1 for none.
    normal_scales : uint64
        Of shape (M, 4), float32: factors of normals' x and y, and of heights; 1 for specular
        materials, 0 for diffuse ones; factors of a clear coat's normals.
    linear, plain, signed : uint64
        Of shape (256,), float32: decoded bytes of colours, of numbers in [0, 1], and of normals'
        components in [-1, 1], where 128 is 0, so that a flat normal map is flat.
    """

    texels: np.uint64
    places: np.uint64
    of_material: np.uint64
    normal_scales: np.uint64
    linear: np.uint64
    plain: np.uint64
    signed: np.uint64


def address_of(array: NDArray[Any] | None) -> np.uint64:
    """The address of a contiguous array; 0 for None or an empty array."""
    return np.uint64(0 if array is None or not array.size else array.ctypes.data)


def pack_textures(materials: Sequence[Material]) -> tuple[TextureTables, object]:
    """The textures of materials, and the arrays to keep alive; see `texture_arrays`."""
    kept = texture_arrays(materials)
    return TextureTables(*map(address_of, kept)), kept


def texture_arrays(materials: Sequence[Material]) -> tuple[NDArray[Any], ...]:
    """Decode the textures of materials into the arrays of `TextureTables`, each texture once.

    Warns
    -----
    RaystreamWarning
        For each texture that cannot be read; the material's constant is then used.
    """
    of_material = np.full((len(materials), len(ROLES)), -1, np.int32)
    normal_scales = np.array([_normal_scales_of(material) for material in materials], np.float32)
    atlas = Atlas()
    for row, material, relief in zip(of_material, materials, normal_scales, strict=True):
        for column, role in enumerate(ROLES):
            texture = material.textures.get(role)
            if texture is None or not _is_seen(material, role):
                continue
            if column != _BUMP:
                row[column] = atlas.place(texture)
            elif row[_NORMAL] < 0 and atlas.holds_normals(texture):
                row[_NORMAL], relief[0] = atlas.place(texture), material.bump_scale
            elif row[_NORMAL] < 0:  # normal maps take precedence
                row[_BUMP] = atlas.place(texture, are_heights=True)
    bytes_ = np.arange(256, dtype=np.uint8)
    return (
        *atlas.arrays(),
        of_material,
        normal_scales,
        decode_srgb(bytes_),
        bytes_ / np.float32(255.0),
        np.maximum((bytes_ - np.float32(128.0)) / np.float32(127.0), np.float32(-1.0)),
    )


def _is_seen(material: Material, role: str) -> bool:
    """Whether a texture has an effect: its factor is not 0."""
    if role == "metallic_roughness":
        return bool(material.roughness or material.metallic)
    if role in ("normal", "bump"):
        return bool(getattr(material, f"{role}_scale"))
    if role.startswith("clearcoat") and not material.is_coated:
        return False
    if role.startswith("sheen") and not material.has_sheen:
        return False
    if role == "clearcoat_normal":
        return bool(material.clearcoat_normal_scale)
    if role == "specular" and material.roughness is not None:
        return any(material.normal_reflectance)
    if role == "reflectance":
        return material.roughness is not None
    return bool(np.any(getattr(material, role)))


def _normal_scales_of(material: Material) -> tuple[float, float, float, float]:
    shines = material.roughness is not None or any(
        (*material.specular, *material.reflection, *material.transmission)
    )
    return (
        material.normal_scale,
        material.bump_scale,
        float(shines),
        material.clearcoat_normal_scale,
    )


def _holds_normals(texels: NDArray[np.uint8]) -> bool:
    """Whether a bump map holds normals, as in MTL files of some programs.

    Normals are unit vectors, most of them nearly upright: unlike a photograph's colours, and all
    greys but one.
    """
    some = texels[:: max(1, len(texels) // 4096), :3] / 127.5 - 1.0
    is_normal = (some[:, 2] > 0.0) & (abs(np.linalg.norm(some, axis=1) - 1.0) < 0.1)
    x, y, z = some.mean(axis=0)
    return bool(is_normal.mean() > 0.9 and max(abs(x), abs(y)) < 0.25 < 0.5 < z)


class Atlas:
    """Textures one after another, each stored once."""

    def __init__(self) -> None:
        self._pixels: dict[int, NDArray[np.uint8] | None] = {}
        self._numbers: dict[tuple[int, bool], int] = {}
        self._parts: list[NDArray[np.uint8]] = []
        self._places: list[NDArray[np.int32]] = []
        self._count = 0

    def place(self, texture: Texture, are_heights: bool = False) -> int:
        """Add a texture, as colours or heights; return its number, -1 if it cannot be read."""
        key = id(texture), are_heights
        if key not in self._numbers:
            pixels = self._rgb_of(texture)
            self._numbers[key] = -1
            if pixels is not None:
                texels = _heights_of(pixels) if are_heights else pixels
                self._numbers[key] = self.add(texels, texture)
        return self._numbers[key]

    def holds_normals(self, texture: Texture) -> bool:
        """See `_holds_normals`."""
        pixels = self._rgb_of(texture)
        return pixels is not None and _holds_normals(pixels.reshape(-1, 4))

    def arrays(self) -> tuple[NDArray[np.uint8], NDArray[np.int32]]:
        """Texels and places of `TextureTables`."""
        texels = np.concatenate(self._parts) if self._parts else np.empty((0, 4), np.uint8)
        return texels, np.array(self._places, np.int32).reshape(-1, int(_PLACE))

    def add(self, pixels: NDArray[np.uint8], texture: Texture) -> int:
        """Add a texture's texels, of shape (H, W, 4); return the texture's number."""
        height, width = pixels.shape[:2]
        if self._count + height * width > _MAX_TEXELS:
            raise MemoryError(f"textures: more than {_MAX_TEXELS:,} texels in one scene")
        row = np.zeros(int(_PLACE), np.int32)
        row[:4] = self._count, width, height, _wrap_bits(texture)
        if texture.transform is not None:
            row[3] |= _TRANSFORMED
            with np.errstate(over="ignore"):
                row[4:] = np.array(texture.transform, np.float32).view(np.int32)
        self._places.append(row)
        self._parts.append(pixels.reshape(-1, 4))
        self._count += height * width
        return len(self._places) - 1

    def _rgb_of(self, texture: Texture) -> NDArray[np.uint8] | None:
        if id(texture) not in self._pixels:
            self._pixels[id(texture)] = _rgb_of(texture)
        return self._pixels[id(texture)]


def _heights_of(texels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The luminance of texels, in [0, 1]: the four bytes of each a float32."""
    linear = texels.reshape(-1, 4)[:, :3] @ (np.array(LUMINANCE, np.float32) / np.float32(255.0))
    return linear.astype(np.float32).view(np.uint8).reshape(texels.shape)


def _wrap_bits(texture: Texture) -> np.int32:
    """The bits of a texture's behaviour outside [0, 1], of each axis."""
    along_u, along_v = (_WRAP_BITS[wrap] for wrap in texture.wraps)
    return np.int32((along_u & _OF_U) | (along_v & _OF_V))


def _rgb_of(texture: Texture) -> NDArray[np.uint8] | None:
    """Texels of shape (H, W, 4); None, with a warning, if they cannot be read."""
    try:
        pixels = texture.pixels()
    except FileFormatError as error:
        warnings.warn(f"texture left out: {error}", RaystreamWarning, stacklevel=7)
        return None
    padded: NDArray[np.uint8] = np.zeros((*pixels.shape[:2], 4), np.uint8)
    padded[:, :, :3] = pixels[:, :, :3]  # one channel is greyscale
    return padded


@device
def texture_of(tables, material, role):
    """A material's texture by its index in `ROLES`, int32; -1 for none."""
    return gather(np.int32, tables.of_material, as_int32(material * _ROLES + role))


@device
def _texture_size(tables, texture):
    """Width and height of a texture, in texels."""
    row = texture * _PLACE
    return (
        gather(np.int32, tables.places, as_int32(row + _1)),
        gather(np.int32, tables.places, as_int32(row + _2)),
    )


@device
def wrapped(index, size, is_clamped):
    """Wrap an index of -1 to `size`, or any index if the texture is clamped."""
    last = as_int32(size - _1)
    around = select(index < _0, last, select(index > last, _0, index))
    return select(is_clamped, minimum(maximum(index, _0), last), around)


@device
def _texel(tables, values, first, width, column, row):
    texel = gather(np.uint32, tables.texels, as_int32(first + row * width + column))
    return (
        gather(np.float32, values, as_int32(texel & _BYTE)),
        gather(np.float32, values, as_int32((texel >> _SHIFT_8) & _BYTE)),
        gather(np.float32, values, as_int32((texel >> _SHIFT_16) & _BYTE)),
    )


@device
def _mixed(a, b, share):
    rest = _WHOLE - share
    return a[0] * rest + b[0] * share, a[1] * rest + b[1] * share, a[2] * rest + b[2] * share


@device
def _coefficient(tables, texture, column):
    at = as_int32(texture * _PLACE + column)
    return widen_number(gather(np.float32, tables.places, at))


@device
def _transformed(tables, texture, u, v, is_transformed):
    """Coordinates in a texture with a transform, where it has one; 0 where they overflow."""
    s = _coefficient(tables, texture, _4) * u + _coefficient(tables, texture, _5) * v
    t = _coefficient(tables, texture, _7) * u + _coefficient(tables, texture, _8) * v
    s, t = s + _coefficient(tables, texture, _6), t + _coefficient(tables, texture, _9)
    is_known = (absolute(s) < INF_F32) & (absolute(t) < INF_F32)
    s, t = select(is_known, s, u * _NULL), select(is_known, t, v * _NULL)
    return select(is_transformed, s, u), select(is_transformed, t, v)


@device
def _folded(place, is_mirrored):
    """A coordinate of a mirrored image, within [0, 1], where it is one; and 1 or -1, its slope."""
    within = place - _TWO * floor(place * _HALF)
    slope = place * _NULL + _WHOLE
    return (
        select(is_mirrored, minimum(within, _TWO - within), place),
        select(is_mirrored & (within > _WHOLE), -slope, slope),
    )


@device
def nearest_texels(tables, texture, u, v, beyond):
    """The four texels whose centres surround a point.

    Parameters
    ----------
    tables, texture, u, v
        See `texture_color`; finite.
    beyond : float32
        Distance from a clamped texture, in widths, to which points are clamped.

    Returns
    -------
    first, width, height, bits
        The texture's row of `places`.
    left, top : int32
        The texel at the upper left; from -1 on, unless the texture is clamped.
    across, down : float32
        The fraction between it and the next.
    slopes : tuple of two float32
        1 along u and v, -1 in the reversed copies of a mirrored image.
    """
    first = gather(np.int32, tables.places, as_int32(texture * _PLACE))
    width, height = _texture_size(tables, texture)
    bits = gather(np.int32, tables.places, as_int32(texture * _PLACE + _3))
    is_transformed = (bits & _TRANSFORMED) != _0
    if any_lane(is_transformed):
        u, v = _transformed(tables, texture, u, v, is_transformed)
    along_u, along_v = u * _NULL + _WHOLE, v * _NULL + _WHOLE
    if any_lane((bits & MIRRORED) != _0):
        u, along_u = _folded(u, (bits & MIRRORED_U) != _0)
        v, along_v = _folded(v, (bits & MIRRORED_V) != _0)
    most = _WHOLE + beyond
    u = select((bits & CLAMPED_U) != _0, minimum(maximum(u, -beyond), most), u - floor(u))
    v = select((bits & CLAMPED_V) != _0, minimum(maximum(v, -beyond), most), v - floor(v))
    x, y = u * as_float32(width) - _HALF, (_WHOLE - v) * as_float32(height) - _HALF
    left, top = floor(x), floor(y)
    across, down = as_float32(x - left), as_float32(y - top)
    slopes = as_float32(along_u), as_float32(along_v)
    return first, width, height, bits, as_int32(left), as_int32(top), across, down, slopes


@device_call
def texture_color(tables, texture, u, v, values):
    """Sample a texture bilinearly; white where u or v is NaN.

    Parameters
    ----------
    tables : TextureTables
    texture : int32, or i32x16
        Its row of `places`.
    u, v : float64, or f32x16
        Texture coordinates; v points up.
    values : uint64
        `TextureTables.linear` of colours, ``plain`` of numbers, ``signed`` of normals.

    Returns
    -------
    tuple of three float32, or f32x16
    """
    is_known = (absolute(u) < INF_F32) & (absolute(v) < INF_F32)
    first, width, height, bits, left, top, across, down, _ = nearest_texels(
        tables, texture, select(is_known, u, _HALF), select(is_known, v, _HALF), _NULL
    )
    is_clamped_u, is_clamped_v = (bits & CLAMPED_U) != _0, (bits & CLAMPED_V) != _0
    right = wrapped(as_int32(left + _1), width, is_clamped_u)
    bottom = wrapped(as_int32(top + _1), height, is_clamped_v)
    left, top = wrapped(left, width, is_clamped_u), wrapped(top, height, is_clamped_v)
    upper = _mixed(
        _texel(tables, values, first, width, left, top),
        _texel(tables, values, first, width, right, top),
        across,
    )
    lower = _mixed(
        _texel(tables, values, first, width, left, bottom),
        _texel(tables, values, first, width, right, bottom),
        across,
    )
    red, green, blue = _mixed(upper, lower, down)
    return (
        select(is_known, red, _WHOLE),
        select(is_known, green, _WHOLE),
        select(is_known, blue, _WHOLE),
    )
