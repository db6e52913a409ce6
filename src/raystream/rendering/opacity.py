"""Opacity: cut-outs and partly transparent surfaces, as a filter of queries.

All queries of a renderer take `Opacity.filter` as ``on_hit``, so that rays pass through during
traversal. Scenes of opaque materials have no filter.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import FileFormatError, RaystreamWarning
from raystream.programs.filters import Bound
from raystream.rendering.color import LUMINANCE
from raystream.rendering.shading.opacity import (
    MASKED,
    OPAQUE,
    PARTIAL,
    FilteredRays,
    OpacityTables,
    is_there,
)
from raystream.rendering.shading.textures import Atlas, TextureTables, address_of
from raystream.rendering.vertex_attributes import VertexAttributes
from raystream.scene.material import Material
from raystream.scene.scene import Scene
from raystream.scene.texture import Texture


class Opacity:
    """The filter of a scene that is not opaque, made by `of`.

    Parameters
    ----------
    tables : OpacityTables
    seed : int
        Of the random numbers that decide on partly transparent surfaces.
    kept : object
        The arrays at the tables' addresses, to keep them alive.
    """

    def __init__(self, tables: OpacityTables, seed: int, kept: object) -> None:
        self._tables = tables
        self._seed = np.uint32(seed & 0xFFFFFFFF)
        self._kept = kept

    @classmethod
    def of(cls, scene: Scene, seed: int) -> Opacity | None:
        """The opacity of a scene; None if all materials in use, and vertices, are opaque.

        Warns
        -----
        RaystreamWarning
            For each texture that cannot be read; the material's constant is then used.
        """
        if scene.is_opaque:
            return None
        material_ids = scene.attributes.material_ids
        used = np.unique(material_ids)
        textures, kinds, kept = _pack(scene.materials, used, scene.attributes.faint_materials)
        if not kinds[used].any():
            return None
        cutoffs = [material.alpha_cutoff or 0.0 for material in scene.materials]
        numbers = np.array([[m.opacity for m in scene.materials], cutoffs], np.float32)
        numbers = np.ascontiguousarray(numbers.T)
        vertices, alphas = VertexAttributes.of(scene), scene.attributes.alphas
        tables = OpacityTables(
            address_of(material_ids),
            address_of(vertices.faces),
            address_of(vertices.texcoords),
            address_of(alphas),
            address_of(kinds),
            address_of(numbers),
            textures,
        )
        return cls(tables, seed, (material_ids, vertices, alphas, kinds, numbers, kept))

    def filter(self, origins: NDArray[np.float64], directions: NDArray[np.float32]) -> Bound:
        """The filter (``on_hit``) of queries for these rays, of shape (N, 3)."""
        origins = np.ascontiguousarray(origins, np.float64)
        directions = np.ascontiguousarray(directions, np.float32)
        places = address_of(origins), address_of(directions)
        rays = FilteredRays(self._tables, self._seed, *places)
        return Bound(is_there, rays, (self, origins, directions))


def filter_of(
    opacity: Opacity | None, origins: NDArray[np.float64], directions: NDArray[np.float32]
) -> Bound | None:
    """`Opacity.filter`, or None if there is no opacity."""
    return None if opacity is None else opacity.filter(origins, directions)


def _pack(
    materials: Sequence[Material], used: NDArray[np.int32], faint: frozenset[int]
) -> tuple[TextureTables, NDArray[np.int32], object]:
    """Opacity textures, kinds of materials, and the arrays to keep alive; see `pack_textures`.

    Materials in `faint` have vertices that are not opaque.
    """
    kinds = np.full(len(materials), OPAQUE, np.int32)
    of_material = np.full(len(materials), -1, np.int32)
    known: dict[int, int] = {}
    atlas = Atlas()
    for index in used:
        material = materials[index]
        texture = material.textures.get("opacity")
        if texture is not None and id(texture) not in known:
            known[id(texture)] = -1
            grey = _opacity_of(texture)
            if grey is not None and not (grey == 255).all():
                texels = np.repeat(grey[:, :, None], 4, axis=2)
                known[id(texture)] = atlas.add(texels, texture)
        of_material[index] = -1 if texture is None else known[id(texture)]
        least = 1.0 if material.alpha_cutoff is None else material.alpha_cutoff
        varies = of_material[index] >= 0 or index in faint
        if material.opacity < least or (varies and least > 0.0):
            kinds[index] = PARTIAL if material.alpha_cutoff is None else MASKED
    kept: tuple[NDArray[Any], ...] = (
        *atlas.arrays(),
        of_material,
        np.arange(256, dtype=np.uint8) / np.float32(255.0),
    )
    colors, places, roles, plain = map(address_of, kept)
    none = np.uint64(0)
    return TextureTables(colors, places, roles, none, none, plain, none), kinds, kept


def _opacity_of(texture: Texture) -> NDArray[np.uint8] | None:
    """Opacity of texels, shape (H, W); None, with a warning, if they cannot be read."""
    try:
        pixels = texture.pixels()
    except FileFormatError as error:
        warnings.warn(f"texture left out: {error}", RaystreamWarning, stacklevel=5)
        return None
    if pixels.shape[2] == 1:
        return pixels[:, :, 0]
    if pixels.shape[2] == 4 and not (pixels[:, :, 3] == 255).all():
        return pixels[:, :, 3]
    grey: NDArray[np.uint8] = np.rint(pixels[:, :, :3] @ np.array(LUMINANCE)).astype(np.uint8)
    return grey
