"""Scene tables of shading kernels: triangles, vertex attributes, materials and textures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.rendering.shading.sheen import sheen_table
from raystream.rendering.shading.tangents import vertex_tangents
from raystream.rendering.shading.textures import TextureTables, address_of, pack_textures
from raystream.rendering.vertex_attributes import VertexAttributes, check_rows
from raystream.scene.material import Material
from raystream.scene.scene import Scene


class Column(NamedTuple):
    """Columns of a material's row in `SceneTables.materials`."""

    diffuse: int
    specular: int
    reflection: int
    transmission: int
    emission: int
    shininess: int
    ior: int
    roughness: int
    metallic: int
    absorption: int
    clearcoat: int
    clearcoat_roughness: int
    sheen_color: int
    sheen_roughness: int


COLUMNS = Column(0, 3, 6, 9, 12, 15, 16, 17, 18, 19, 22, 23, 24, 27)
WIDTH = 28


#: Bits of `SceneTables.kinds`: features that some material has. Others are skipped.
HAS_SPECULAR, HAS_REFLECTION, HAS_TRANSMISSION, IS_ROUGH, EMITS, IS_TEXTURED, ABSORBS = (
    1 << k for k in range(7)
)
HAS_COAT, HAS_SHEEN = 1 << 7, 1 << 8


class SceneTables(NamedTuple):
    """A scene's data for shading, by address: passing arrays costs atomic operations.

    Made by `tables_of`, with the arrays to keep alive.

    Attributes
    ----------
    corners : uint64
        Address of triangles, shape (F, 3, 3), float32, local frame.
    center : tuple of three float
        The local frame's origin, world space.
    inverse_scale : float
        World units per local unit.
    max_coordinate, world_reach : float
        Largest absolute coordinate of a corner, and of the frame's origin, in local units.
    faces : uint64
        Address of rows of vertex attributes, shape (F, 3), int32; 0 if no mesh has any.
    normals : uint64
        Address of shape (V, 3), float32, NaN where a mesh has none; 0 if no mesh has any; the
        next two likewise.
    texcoords : uint64
        Of shape (V, 2), float32.
    tangents, mirrored_tangents : uint64
        Of shape (V, 3), float32, see `vertex_tangents`; 0 without normal and bump maps.
    colors : uint64
        Of shape (V, 3), float32: linear RGB, 1 where a mesh has none.
    material_ids : uint64
        Of shape (F,), int32.
    offsets : uint64
        Of shape (F,), float32, local frame: what is added to the distance from a triangle at which
        rays that leave it start; 0 for nothing. Instances need it, see `placed_tables`.
    materials : uint64
        Of shape (M, 28), float32. See `Column`; colours are three numbers. Roughness and
        metallic are -1 if a material has none; it has no clear coat and no sheen then. Otherwise
        it has its normal reflectance in place of specular, and its grazing reflectance in place of
        shininess.
    sheen_albedos : uint64
        Of the table of `sheen_table`; 0 if no material has sheen.
    kinds : int
        Bits: features that some material has.
    textures : TextureTables
    """

    corners: np.uint64
    center: tuple[float, float, float]
    inverse_scale: float
    max_coordinate: float
    world_reach: float
    faces: np.uint64
    normals: np.uint64
    texcoords: np.uint64
    tangents: np.uint64
    mirrored_tangents: np.uint64
    colors: np.uint64
    material_ids: np.uint64
    offsets: np.uint64
    materials: np.uint64
    sheen_albedos: np.uint64
    kinds: int
    textures: TextureTables


class SceneArrays(NamedTuple):
    """The arrays at the addresses of `SceneTables`, to be kept while they are used."""

    corners: NDArray[np.float32]
    vertices: VertexAttributes
    tangents: NDArray[np.float32] | None
    material_ids: NDArray[np.int32]
    others: object


def tables_of(scene: Scene) -> tuple[SceneTables, SceneArrays]:
    """The tables of a scene, and the arrays to keep alive while they are used.

    With instances, triangles are those of the objects, in their own frames: see `placed_tables`.
    With spheres or height fields, those of the meshes: see `primitive_tables`.

    Warns
    -----
    RaystreamWarning
        See `pack_textures`.

    Raises
    ------
    ValueError
        If the scene has too many triangles or vertices, see `check_rows`.
    """
    triangles: Any = scene.triangles
    corners = triangles.object_corners()
    check_rows(len(corners), 9, "triangles")
    vertices = VertexAttributes.of(scene)
    material_ids = scene.attributes.material_ids
    materials = material_rows(scene.materials)
    sheen = sheen_table() if any(m.has_sheen for m in scene.materials) else None
    textures, kept_textures = pack_textures(scene.materials)
    corners = np.ascontiguousarray(corners)
    tangents = _tangents(scene, corners, vertices, material_ids)
    upright, mirrored = (None, None) if tangents is None else tangents
    x, y, z = (float(c) for c in triangles.center)
    tables = SceneTables(
        address_of(corners),
        (x, y, z),
        1.0 / float(triangles.scale),
        float(triangles.max_coordinate),
        float(np.abs(triangles.center).max()) * float(triangles.scale),
        address_of(vertices.faces),
        address_of(vertices.normals),
        address_of(vertices.texcoords),
        address_of(upright),
        address_of(mirrored),
        address_of(vertices.colors),
        address_of(material_ids),
        np.uint64(0),
        address_of(materials),
        address_of(sheen),
        _kinds_of(scene.materials),
        textures,
    )
    others = materials, sheen, kept_textures
    return tables, SceneArrays(corners, vertices, tangents, material_ids, others)


def _kinds_of(materials: Sequence[Material]) -> int:
    """Bits of the features that materials have."""
    return sum(
        bit
        for bit, does in (
            (HAS_SPECULAR, any(any(m.specular) or m.roughness is not None for m in materials)),
            (HAS_REFLECTION, any(any(m.reflection) for m in materials)),
            (HAS_TRANSMISSION, any(any(m.transmission) for m in materials)),
            (IS_ROUGH, any(m.roughness is not None for m in materials)),
            (EMITS, any(m.emits for m in materials)),
            (IS_TEXTURED, any(m.textures for m in materials)),
            (ABSORBS, any(any(m.absorption) for m in materials)),
            (HAS_COAT, any(m.is_coated for m in materials)),
            (HAS_SHEEN, any(m.has_sheen for m in materials)),
        )
        if does
    )


def _has_normal_map(material: Material) -> bool:
    roles = {"normal", "bump", *(("clearcoat_normal",) if material.is_coated else ())}
    return not roles.isdisjoint(material.textures)


def _tangents(
    scene: Scene,
    corners: NDArray[np.float32],
    vertices: VertexAttributes,
    material_ids: NDArray[np.int32],
) -> NDArray[np.float32] | None:
    """Tangents where materials have normal or bump maps; None if they are not needed."""
    has_normal_map = np.array([_has_normal_map(material) for material in scene.materials])
    if vertices.texcoords is None or not has_normal_map[material_ids].any():
        return None
    check_rows(len(vertices.texcoords), 6, "vertices with normal maps")
    return vertex_tangents(corners, vertices, has_normal_map[material_ids])


def material_rows(materials: Sequence[Material]) -> NDArray[np.float32]:
    """Rows of `SceneTables.materials`."""
    rows = np.zeros((len(materials), WIDTH), np.float32)
    for row, material in zip(rows, materials, strict=True):
        for name, at in COLUMNS._asdict().items():
            value = getattr(material, name)
            row[at : at + np.size(value)] = -1.0 if value is None else value
        if material.roughness is None:
            row[COLUMNS.shininess] = max(row[COLUMNS.shininess], 1.0)
            row[COLUMNS.clearcoat] = row[COLUMNS.sheen_roughness] = 0.0
            row[COLUMNS.sheen_color : COLUMNS.sheen_color + 3] = 0.0
        else:
            row[COLUMNS.specular : COLUMNS.specular + 3] = material.normal_reflectance
            row[COLUMNS.shininess] = material.grazing_reflectance
    return rows
