"""Geometry of scenes with spheres, height fields or shapes, and how scenes are combined."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from raystream.core.height_field import HeightField
from raystream.core.primitives import Primitives
from raystream.core.shapes import Shapes
from raystream.core.spheres import Spheres
from raystream.scene.geometry import Geometry, geometry_of
from raystream.scene.material import Material
from raystream.scene.mesh import Mesh

if TYPE_CHECKING:
    from raystream.core.triangles import Triangles

#: Triangles that a camera is chosen by.
_SEEN = 50_000


class PrimitiveGeometry(Geometry):
    """Meshes, height fields, spheres and shapes.

    Parameters
    ----------
    meshes : sequence of Mesh
    fields : sequence of HeightField
    spheres : Spheres
    shapes : sequence of Shapes
    """

    has_primitives = True

    def __init__(
        self,
        meshes: Sequence[Mesh],
        fields: Sequence[HeightField],
        spheres: Spheres,
        shapes: Sequence[Shapes] = (),
    ) -> None:
        super().__init__(meshes)
        self.fields, self.spheres, self.shapes = tuple(fields), spheres, tuple(shapes)
        self._meshes_alone = Geometry(self.meshes)

    @cached_property
    def triangles(self) -> Any:
        """All primitives in one local frame."""
        others = self.fields, self.spheres, self.attributes, self.shapes
        return Primitives(self._meshes_alone.triangles, *others)

    def with_materials_from(self, shift: int) -> PrimitiveGeometry:
        """The same with the numbers of materials increased."""
        if not shift:
            return self
        fields = [field.with_material(field.material_id + shift) for field in self.fields]
        ids = self.spheres.material_ids + np.int32(shift)
        spheres = replace(self.spheres, material_ids=ids)
        shapes = [
            replace(one, material_ids=one.material_ids + np.int32(shift)) for one in self.shapes
        ]
        return PrimitiveGeometry(self._shifted_meshes(shift), fields, spheres, shapes)

    @property
    def highest_material(self) -> int:
        """The largest number of a material besides those of meshes; -1 without any."""
        ids = [field.material_id for field in self.fields]
        others: list[Any] = [self.spheres, *self.shapes]
        return max([-1, *ids, *(int(one.material_ids.max(initial=-1)) for one in others)])

    def _seen(self) -> Triangles:
        return self.triangles.some(_SEEN)


def combined(scenes: Iterable[Any]) -> tuple[PrimitiveGeometry, list[Material]]:
    """The primitives and materials of scenes, one after another.

    Raises
    ------
    TypeError
        If one is not a scene.
    """
    held: list[Geometry] = []
    materials: list[Material] = []
    for index, one in enumerate(scenes):
        geometry = geometry_of(one)
        if geometry is None:
            raise TypeError(f"scenes[{index}]: expected a Scene, got {type(one).__name__}")
        held.append(geometry.with_materials_from(len(materials)))
        materials.extend(one.materials)
    return joined(held), materials


def joined(parts: Sequence[Geometry]) -> PrimitiveGeometry:
    """The primitives of several geometries, one after another."""
    meshes = [mesh for one in parts for mesh in one.meshes]
    fields = [field for one in parts for field in one.fields]
    shapes = [own for one in parts for own in one.shapes]
    spheres = Spheres.joined(one.spheres for one in parts)
    return PrimitiveGeometry(meshes, fields, spheres, shapes)
