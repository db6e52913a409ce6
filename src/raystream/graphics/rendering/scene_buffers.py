"""Surfaces and lights of a scene, as buffers of fragment programs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.rendering.integrator import RenderContext
from raystream.rendering.shading.punctual_lights import light_rows
from raystream.rendering.shading.tables import (
    ABSORBS,
    COLUMNS,
    EMITS,
    HAS_REFLECTION,
    HAS_SPECULAR,
    HAS_TRANSMISSION,
    material_rows,
)
from raystream.rendering.shading.textures import ROLES, texture_arrays
from raystream.rendering.vertex_attributes import VertexAttributes
from raystream.scene.material import Material

#: Texture coordinates of a vertex without any; words of a material's texture.
_UNKNOWN, _TEXTURE_WORDS = 1e30, 10

#: Columns of materials that only count if the renderer has their kind of lobe.
_OF_KINDS = (
    (HAS_SPECULAR, COLUMNS.specular),
    (HAS_REFLECTION, COLUMNS.reflection),
    (HAS_TRANSMISSION, COLUMNS.transmission),
    (EMITS, COLUMNS.emission),
    (ABSORBS, COLUMNS.absorption),
)


def surface_arrays(context: RenderContext) -> list[tuple[str, NDArray[Any]]]:
    """The arrays of ``surface.wgsl``, ``bsdf.wgsl`` and ``textures.wgsl``, with their names."""
    scene = context.tracer.scene
    vertices = VertexAttributes.of(scene)
    return [
        ("the corners of triangles", scene.triangles.corners),
        ("the vertices of triangles", vertices.faces.astype(np.uint32)),
        ("the attributes of vertices", _vertex_rows(vertices)),
        ("the materials of triangles", scene.attributes.material_ids.astype(np.uint32)),
        ("materials", _material_rows(scene.materials, context.tables.kinds)),
        ("textures", _texels(scene.materials)),
    ]


def punctual_rows(context: RenderContext) -> NDArray[np.float32]:
    """Rows of ``punctual_lights.wgsl``, with what is left of positions: shape (L, 15), float32."""
    rows, _, _ = light_rows(context.tracer.scene, context.camera, context.chosen_lights)
    return np.column_stack([rows, _rest(rows[:, :3])]).astype(np.float32)


def light_samples(context: RenderContext) -> NDArray[np.float32]:
    """The tables of ``light_samples.wgsl``, one after the other."""
    kept: Any = context.kept[1]
    points, suns, patches, patch_ends, density, ends = kept[0]
    parts = (
        ends,
        np.diff(ends, prepend=0.0),
        np.column_stack([points[:, :7], _rest(points[:, :3])]),
        suns,
        patch_ends,
        patches,
        density,
    )
    return np.concatenate([np.ravel(part) for part in parts]).astype(np.float32)


def _rest(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """What rounding to float32 leaves."""
    return values - values.astype(np.float32)


def _material_rows(materials: Sequence[Material], kinds: int) -> NDArray[np.float32]:
    rows = np.ascontiguousarray(material_rows(materials)[:, : COLUMNS.clearcoat])  # WIDTH in WGSL
    for kind, column in _OF_KINDS:
        if not kinds & kind:
            rows[:, column : column + 3] = 0.0
    if not kinds & HAS_TRANSMISSION:
        rows[:, COLUMNS.ior] = 1.0
    return rows


def _vertex_rows(vertices: VertexAttributes) -> NDArray[np.float32]:
    """Normal, colour and texture coordinates of each vertex, shape (V, 8), without NaN."""
    count = int(vertices.faces.max(initial=-1)) + 1
    rows = np.zeros((count, 8), np.float32)
    rows[:, 3:6], rows[:, 6:] = 1.0, _UNKNOWN
    if vertices.normals is not None:
        rows[:, :3] = np.nan_to_num(vertices.normals[:count])
    if vertices.colors is not None:
        rows[:, 3:6] = vertices.colors[:count]
    if vertices.texcoords is not None:
        rows[:, 6:] = np.nan_to_num(vertices.texcoords[:count], nan=_UNKNOWN)
    return rows


def _texels(materials: Sequence[Material]) -> NDArray[np.uint32]:
    """The place of each material's diffuse texture, zeros without one, then all texels."""
    texels, places, of_material, *_ = texture_arrays(materials)
    rows = np.zeros((len(materials), _TEXTURE_WORDS), np.uint32)
    for row, texture in zip(rows, of_material[:, ROLES.index("diffuse")], strict=True):
        if texture >= 0:
            row[:] = places[texture].view(np.uint32)
    rows[:, 0] += _TEXTURE_WORDS * len(materials)
    return np.concatenate([rows.ravel(), texels.view(np.uint32).ravel()])
