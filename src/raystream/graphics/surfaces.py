"""Surfaces and lights of a scene, as buffers of fragment programs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from raystream.graphics.adapters import OpenDevice
from raystream.graphics.buffers import Buffer, upload
from raystream.graphics.structures.base import numbers
from raystream.rendering.environment import image_light
from raystream.rendering.shading.punctual_lights import light_rows
from raystream.rendering.shading.tables import material_rows
from raystream.rendering.shading.textures import ROLES, texture_arrays
from raystream.rendering.vertex_attributes import VertexAttributes
from raystream.scene.camera import Camera
from raystream.scene.material import Material
from raystream.scene.scene import Scene

__all__ = ["SurfaceArrays", "check_surfaces"]

#: Texture coordinates of a vertex without any; texture of a material without one.
_UNKNOWN, _NO_TEXTURE = 1e30, (0, 0, 0, 0)

#: Supported textures, and one that no renderer uses.
_DRAWN_ROLES = frozenset(["diffuse", "occlusion"])

_UNSUPPORTED = {
    "is not opaque": lambda one: not one.is_opaque,
    "transmits light": lambda one: any(one.transmission),
    "absorbs light": lambda one: any(one.absorption),
    "has textures beside a diffuse one": lambda one: not _DRAWN_ROLES.issuperset(one.textures),
    "has a roughness": lambda one: one.roughness is not None,
}


def check_surfaces(scene: Scene) -> None:
    """Raise ValueError for surfaces or lights that fragment programs do not support."""
    used = np.unique(scene.attributes.material_ids)
    for index in used.tolist():
        material: Material = scene.materials[index]
        for what, holds in _UNSUPPORTED.items():
            if holds(material):
                raise ValueError(
                    f"scene: material {index} ({material.name!r}) {what}: not supported "
                    "by render_bounces; use render(mode='whitted')"
                )
    if image_light(scene.lights) is not None:
        raise ValueError(
            "scene: has a light with an image: not supported by render_bounces; use "
            "render(mode='whitted')"
        )


class SurfaceArrays:
    """Buffers of ``surface.wgsl`` and ``lights.wgsl``.

    Parameters
    ----------
    scene : Scene
    camera : Camera
        A scene without lights gets one at the eye.
    opened : OpenDevice

    Attributes
    ----------
    surfaces, lit_surfaces : list of Buffer
        Without and with the lights.
    light_count : int
    """

    def __init__(self, scene: Scene, camera: Camera, opened: OpenDevice) -> None:
        self._triangles = scene.triangles
        self._background = np.array(scene.background, np.float32)
        lights, self._ambient = light_rows(scene, camera)
        self.light_count = len(lights)
        vertices = VertexAttributes.of(scene)
        self._attributes = len(vertices.faces) > 0
        self.lit_surfaces: list[Buffer] = upload(
            opened,
            [
                ("the corners of triangles", self._triangles.corners),
                ("the vertices of triangles", vertices.faces.astype(np.uint32)),
                ("the attributes of vertices", _vertex_rows(vertices)),
                ("the materials of triangles", scene.attributes.material_ids.astype(np.uint32)),
                ("materials", material_rows(scene.materials)),
                ("textures", _texels(scene.materials)),
                ("lights", lights.astype(np.float32)),
            ],
        )
        self.surfaces = self.lit_surfaces[:-1]

    def params(self, number: int, min_weight: float, view: bytes) -> bytes:
        """The uniform ``Params`` of ``bounces/params.wgsl``, for one light."""
        triangles = self._triangles
        world_reach = float(np.abs(triangles.center).max()) * float(triangles.scale)
        words = numbers(
            *(float(triangles.max_coordinate), 0, world_reach, float(min_weight)),
            *(*map(float, self._ambient), number),
            *(*map(float, self._background), self._attributes),
        )
        return words + view


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
    """The place of each material's diffuse texture, four words each, then all texels."""
    texels, places, of_material, *_ = texture_arrays(materials)
    rows = np.zeros((len(materials), 4), np.uint32)
    for row, texture in zip(rows, of_material[:, ROLES.index("diffuse")], strict=True):
        row[:] = places[texture] if texture >= 0 else _NO_TEXTURE
    rows[:, 0] += 4 * len(materials)
    return np.concatenate([rows.ravel(), texels.view(np.uint32).ravel()])
