"""Colours from bitmaps where rays hit: bilinear, decoded from sRGB."""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import FileFormatError, RaystreamWarning
from raystream.render.color import decode_srgb
from raystream.scene.material import Material
from raystream.scene.texture import Texture

__all__ = ["MaterialColors"]


class MaterialColors:
    """One colour of every material, from its number and, where it has one, its texture.

    Parameters
    ----------
    materials : sequence of Material
    role : {"diffuse", "specular", "emission"}
        The material's attribute, and the texture that multiplies it.

    Warns
    -----
    RaystreamWarning
        For each texture that cannot be read; the plain colour is then used.
    """

    def __init__(self, materials: Sequence[Material], role: str) -> None:
        self._factors = np.array([getattr(m, role) for m in materials], np.float32)
        self._textures: dict[int, Texture] = {}
        for index, material in enumerate(materials):
            texture = material.textures.get(role)
            if texture is not None and self._factors[index].any():
                try:
                    texture.pixels()
                except FileFormatError as error:
                    warnings.warn(f"texture left out: {error}", RaystreamWarning, stacklevel=2)
                    continue
                self._textures[index] = texture

    @property
    def is_black(self) -> bool:
        """Whether it is zero for every material."""
        return not self._factors.any()

    @property
    def is_textured(self) -> bool:
        """Whether any material has a texture here."""
        return bool(self._textures)

    def at(
        self, material_ids: NDArray[np.int32], texcoords: NDArray[np.float32] | None
    ) -> NDArray[np.float32]:
        """Look up colours.

        Parameters
        ----------
        material_ids : ndarray of shape (N,), int32
        texcoords : ndarray of shape (N, 2), float32, or None
            NaN where a mesh has none: the texture then counts as white.

        Returns
        -------
        ndarray of shape (N, 3), float32
            Linear RGB.
        """
        colors: NDArray[np.float32] = self._factors[material_ids]
        if texcoords is None:
            return colors
        for index, texture in self._textures.items():
            rows = np.flatnonzero((material_ids == index) & np.isfinite(texcoords[:, 0]))
            if len(rows):
                colors[rows] *= _bilinear(texture, texcoords[rows])
        return colors


def _bilinear(texture: Texture, texcoords: NDArray[np.float32]) -> NDArray[np.float32]:
    """Linear RGB between the four nearest texels' centres, shape (N, 3)."""
    pixels = texture.pixels()
    height, width = pixels.shape[:2]
    uv = texcoords.astype(np.float64)
    uv = uv - np.floor(uv) if texture.wrap == "repeat" else np.clip(uv, 0.0, 1.0)
    x, y = uv[:, 0] * width - 0.5, (1.0 - uv[:, 1]) * height - 0.5
    left, top = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    across, down = (x - left)[:, None].astype(np.float32), (y - top)[:, None].astype(np.float32)

    def texel(row: NDArray[np.int64], column: NDArray[np.int64]) -> NDArray[np.float32]:
        if texture.wrap == "repeat":
            row, column = row % height, column % width
        else:
            row, column = row.clip(0, height - 1), column.clip(0, width - 1)
        linear = decode_srgb(pixels[row, column, :3])
        return linear if linear.shape[1] == 3 else np.repeat(linear, 3, axis=1)

    upper = texel(top, left) * (1 - across) + texel(top, left + 1) * across
    lower = texel(top + 1, left) * (1 - across) + texel(top + 1, left + 1) * across
    result: NDArray[np.float32] = upper * (1 - down) + lower * down
    return result
