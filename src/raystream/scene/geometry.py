"""Geometry: meshes with what is derived from them, shared by scenes."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.attributes import Attributes
from raystream.core.height_field import HeightField
from raystream.core.instances import Instances
from raystream.core.shapes import Shapes
from raystream.core.spheres import NO_SPHERES, Spheres
from raystream.core.triangles import Triangles
from raystream.scene.mesh import Mesh

if TYPE_CHECKING:
    from raystream.scene.default_view.choice import DefaultView

#: Triangles of small scenes are made by NumPy: that is faster than to load a kernel.
_FEW = 1 << 14


def geometry_of(scene: Any) -> Geometry | None:
    """The geometry of a scene; None if it is not a scene."""
    geometry = getattr(scene, "geometry", None)
    return geometry if isinstance(geometry, Geometry) else None


class Geometry:
    """Meshes and their triangles, built once for all scenes that share the meshes.

    Attributes
    ----------
    meshes : tuple of Mesh
    attributes : Attributes
    instances : Instances or None
    has_primitives : bool
        Whether it was made for spheres, height fields and shapes.
    fields : tuple of HeightField
    spheres : Spheres
    shapes : tuple of Shapes
    """

    instances: Instances | None = None
    has_primitives = False
    fields: tuple[HeightField, ...] = ()
    spheres: Spheres = NO_SPHERES
    shapes: tuple[Shapes, ...] = ()

    def __init__(self, meshes: Iterable[Mesh], triangles: Triangles | None = None) -> None:
        self.meshes = tuple(meshes)
        self.attributes = Attributes(self.meshes)
        self._view: tuple[bytes, DefaultView] | None = None
        if triangles is not None:
            self.triangles = self._described(triangles)

    def with_materials_from(self, shift: int) -> Geometry:
        """The same with the numbers of materials increased."""
        return Geometry(self._shifted_meshes(shift)) if shift else self

    def _shifted_meshes(self, shift: int) -> list[Mesh]:
        return [mesh.with_material_ids(mesh.material_ids + shift) for mesh in self.meshes]

    @cached_property
    def triangles(self) -> Triangles:
        """The triangles of all meshes, in the form that structures are built from."""
        arrays = [(mesh.vertices, mesh.faces) for mesh in self.meshes]
        if sum(mesh.triangle_count for mesh in self.meshes) <= _FEW:
            return self._described(Triangles(arrays))
        # Here, not above: it loads the compiler.
        from raystream.kernels.move_triangles import make_triangles

        return self._described(make_triangles(arrays))

    @property
    def material_ids(self) -> NDArray[np.int32]:
        """The material of each primitive, by prim_id, int32."""
        fields = (np.full(len(one), one.material_id, np.int32) for one in self.fields)
        shapes = (one.material_ids for one in self.shapes)
        beside = (*fields, self.spheres.material_ids, *shapes)
        return np.concatenate([self.attributes.material_ids, *beside])

    def default_view(self, up: NDArray[np.float64]) -> DefaultView:
        """The view of a scene without a camera; kept, for the last up."""
        key, kept = up.tobytes(), self._view
        if kept is not None and kept[0] == key:
            return kept[1]
        # Here, not above: most scenes have cameras.
        from raystream.scene.default_view.choice import choose_view

        view = choose_view(self._seen(), up)
        self._view = key, view
        return view

    def _seen(self) -> Triangles:
        """The triangles that the view is chosen by."""
        return self.triangles

    def _described(self, triangles: Triangles) -> Triangles:
        if triangles.attributes is None:  # replacing them would change existing hits
            triangles.attributes = self.attributes
        return triangles
