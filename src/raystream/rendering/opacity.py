"""Opacity: cut-outs and partly transparent surfaces, as a filter of queries.

All queries of a renderer take `Opacity.filter` as ``on_hit``, so that rays pass through during
traversal. Scenes of opaque materials have no filter. Analyses do not leave anything to chance:
see `programs.cutouts`, and `Opacity.on_hit`.
"""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import FileFormatError, RaystreamWarning
from raystream.jit.threads import parallel_for
from raystream.programs.filters import Bound
from raystream.rendering.color import LUMINANCE
from raystream.rendering.shading.opacity import (
    MASKED,
    OPAQUE,
    PARTIAL,
    FilteredRays,
    OpacityTables,
    find_points,
    is_there,
    is_there_beside_spheres,
)
from raystream.rendering.shading.textures import Atlas, TextureTables, address_of
from raystream.rendering.vertex_attributes import VertexAttributes
from raystream.scene.material import Material
from raystream.scene.scene import Scene
from raystream.scene.texture import Texture

#: Points per call of a kernel: about a millisecond.
_CHUNK = 1 << 14

#: Analyses see a surface without a cut-off where its opacity is at least this.
_HALF = np.float32(0.5)


class Opacity:
    """The filter of a scene that is not opaque, made by `of`.

    Parameters
    ----------
    tables : OpacityTables
    seed : int or None
        Of the random numbers that decide on partly transparent surfaces.
    kept : object
        The arrays at the tables' addresses, to keep them alive.
    function : callable
        The filter's function.
    """

    def __init__(
        self,
        tables: OpacityTables,
        seed: int | None,
        kept: object,
        function: Callable[..., bool] = is_there,
    ) -> None:
        self._tables, self._function = tables, function
        self._seed = np.uint32((seed or 0) & 0xFFFFFFFF)
        self._kept = kept

    @classmethod
    def of(
        cls, scene: Scene, seed: int | None, is_solid: NDArray[np.bool_] | None = None
    ) -> Opacity | None:
        """The opacity of a scene; None if all materials in use, and vertices, are opaque.

        Parameters
        ----------
        scene : Scene
        seed : int or None
            None leaves nothing to chance: without a cut-off, surfaces have one of a half.
        is_solid : ndarray of shape (F,), bool, optional
            Primitives that are opaque, whatever their material.

        Warns
        -----
        RaystreamWarning
            For each texture that cannot be read; the material's constant is then used.
        """
        if scene.is_opaque:
            return None
        material_ids, materials = scene.geometry.material_ids, list(scene.materials)
        if is_solid is not None:  # one more material, which is opaque
            material_ids = np.where(is_solid, np.int32(len(materials)), material_ids)
            materials.append(Material())
        used = np.unique(material_ids)
        textures, kinds, kept = _pack(materials, used, scene.attributes.faint_materials)
        if not kinds[used].any():
            return None
        cutoffs = [material.alpha_cutoff or 0.0 for material in materials]
        numbers = np.array([[m.opacity for m in materials], cutoffs], np.float32)
        numbers = np.ascontiguousarray(numbers.T)
        if seed is None:
            is_partial = kinds == PARTIAL
            numbers[is_partial, 1], kinds[is_partial] = _HALF, MASKED
        vertices, alphas = VertexAttributes.of(scene), scene.attributes.alphas
        tables = OpacityTables(
            address_of(material_ids),
            address_of(vertices.faces),
            address_of(vertices.texcoords),
            np.int32(len(scene.attributes.material_ids)),
            address_of(alphas),
            address_of(kinds),
            address_of(numbers),
            textures,
        )
        function = is_there_beside_spheres if scene.has_primitives else is_there
        held = material_ids, vertices, alphas, kinds, numbers, kept
        return cls(tables, seed, held, function)

    def filter(self, origins: NDArray[np.float64], directions: NDArray[np.float32]) -> Bound:
        """The filter (``on_hit``) of queries for these rays, of shape (N, 3)."""
        origins = np.ascontiguousarray(origins, np.float64)
        directions = np.ascontiguousarray(directions, np.float32)
        places = address_of(origins), address_of(directions)
        rays = FilteredRays(self._tables, self._seed, *places)
        return Bound(self._function, rays, (self, origins, directions))

    @property
    def on_hit(self) -> Bound:
        """The filter for any rays, of an opacity without a seed."""
        return self.filter(*np.empty((2, 0, 3)))

    def at(self, prim_ids: NDArray[Any], u: NDArray[Any], v: NDArray[Any]) -> NDArray[np.bool_]:
        """Whether points of triangles are there, of an opacity without a seed.

        Parameters
        ----------
        prim_ids, u, v : ndarray of shape (N,)
            Triangles, not -1, and weights of vertices 1 and 2.

        Returns
        -------
        ndarray of shape (N,), bool
        """
        found = np.empty(len(prim_ids), np.bool_)
        points = np.ascontiguousarray(prim_ids, np.int32), u.astype(float), v.astype(float)
        bound = self.on_hit

        def body(begin: int, end: int) -> None:
            find_points(begin, end, *points, bound.constants, found)

        parallel_for(body, len(found), _CHUNK)
        return found

    def digest(self) -> str:
        """A hash of everything that decides what is there."""
        digest = hashlib.sha256()
        for array in _arrays_in(self._kept):
            digest.update(np.ascontiguousarray(array).data)
        return digest.hexdigest()


def filter_of(
    opacity: Opacity | None, origins: NDArray[np.float64], directions: NDArray[np.float32]
) -> Bound | None:
    """`Opacity.filter`, or None if there is no opacity."""
    return None if opacity is None else opacity.filter(origins, directions)


def _arrays_in(kept: object) -> Iterator[NDArray[Any]]:
    """The arrays of nested tuples."""
    if isinstance(kept, np.ndarray):
        yield kept
    elif isinstance(kept, tuple):
        for one in kept:
            yield from _arrays_in(one)


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
    return np.rint(pixels[:, :, :3] @ np.array(LUMINANCE)).astype(np.uint8)
