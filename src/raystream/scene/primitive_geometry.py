"""Geometry of scenes with spheres, height fields or shapes, and how scenes are combined."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.height_field import HeightField
from raystream.core.primitives import Primitives
from raystream.core.shapes import Shapes
from raystream.core.spheres import NO_SPHERES, Spheres
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

    @property
    def material_ids(self) -> NDArray[np.int32]:
        """The material of each primitive, by prim_id, int32."""
        fields = (np.full(len(one), one.material_id, np.int32) for one in self.fields)
        shapes = (one.material_ids for one in self.shapes)
        return np.concatenate([super().material_ids, *fields, self.spheres.material_ids, *shapes])

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
    TypeError, ValueError
        If one is not a scene, or has instances.
    """
    meshes: list[Mesh] = []
    fields: list[HeightField] = []
    parts: list[Spheres] = [NO_SPHERES]
    shapes: list[Shapes] = []
    materials: list[Material] = []
    for index, one in enumerate(scenes):
        geometry = geometry_of(one)
        if geometry is None:
            raise TypeError(f"scenes[{index}]: expected a Scene, got {type(one).__name__}")
        if one.placements is not None:
            raise ValueError(
                f"scenes[{index}]: has instances, which cannot be combined; scene.flattened() is "
                "the same scene without them"
            )
        shift = len(materials)
        materials.extend(one.materials)
        meshes.extend(
            mesh.with_material_ids(mesh.material_ids + shift) if shift else mesh
            for mesh in one.meshes
        )
        fields.extend(field.with_material(field.material_id + shift) for field in geometry.fields)
        others: list[Any] = [geometry.spheres, *geometry.shapes]
        moved = [replace(one, material_ids=one.material_ids + np.int32(shift)) for one in others]
        parts.append(moved[0])
        shapes.extend(moved[1:])
    columns = ("centers", "radii", "material_ids", "masks")
    spheres = Spheres(*(np.concatenate([getattr(p, name) for p in parts]) for name in columns))
    return PrimitiveGeometry(meshes, fields, spheres, shapes), materials
