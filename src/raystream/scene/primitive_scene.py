"""PrimitiveScene: spheres, height fields and shapes of a scene, a base class of `Scene`."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from raystream.core.height_field import HeightField
from raystream.core.masks import ALL_BITS
from raystream.core.shapes import Shapes
from raystream.core.spheres import NO_SPHERES, Spheres
from raystream.scene.instanced_scene import InstancedScene
from raystream.scene.primitive_geometry import PrimitiveGeometry, combined
from raystream.scene.shape import Shape

if TYPE_CHECKING:
    from raystream.scene.scene import Scene


class PrimitiveScene(InstancedScene):
    """Spheres, terrain without triangles, and shapes of users."""

    @classmethod
    def spheres(
        cls,
        centers: Any,
        radii: Any,
        *,
        material_ids: Any = 0,
        mask: int = ALL_BITS,
        **parts: Any,
    ) -> Self:
        """Make a scene of spheres, such as the points of a scan.

        Parameters
        ----------
        centers : array_like of shape (N, 3), real
            World space, scene units.
        radii : float or array_like of shape (N,), real
            Greater than 0.
        material_ids : int or array_like of shape (N,), int
            Material of each sphere.
        mask : int
            Of all of them, as of a `Mesh`.
        **parts
            ``materials``, ``camera`` and other parameters of `Scene`, except ``meshes``: `combine`
            puts spheres and meshes into one scene.

        Returns
        -------
        Scene

        Raises
        ------
        ValueError
            If a shape is wrong, a centre is not finite, or a radius is not finite or not above 0.
            A tracer raises it for 2**30 spheres or more.
        TypeError
            If the numbers are of the wrong kind.

        Notes
        -----
        A ray hits a sphere where it enters and where it leaves: two hits with the same prim_id,
        even where it only touches the sphere. Normals point outwards. u and v say where on the
        sphere a hit is, on the octahedron that the square [0, 1] x [0, 1] folds to (see
        `raystream.core.spheres.directions_at`); `positions` and `normals` follow from them.

        Spheres are tested in float64 with the ray's unrounded coordinates: the result is exact for
        a sphere whose radius differs by at most 2**-48 of (radius + distance from the ray's
        origin).

        ``structure="bvh"`` and ``"brute"`` on the CPU and CUDA answer `Tracer.first_hit`,
        `any_hit`, `multi_hit`, `count_hits` and `cast`.

        Examples
        --------
        >>> import raystream as rs
        >>> scene = rs.Scene.spheres([[0, 0, 5], [0, 0, 9]], radii=1.0)
        >>> tracer = rs.Tracer(scene)
        >>> hits = tracer.multi_hit([0, 0, 0], [0, 0, 1])
        >>> hits.t.tolist(), hits.prim_id.tolist()
        ([4.0, 6.0, 8.0, 10.0], [0, 0, 1, 1])
        >>> hits.normals[:2].tolist()
        [[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]
        """
        held = Spheres.of(centers, radii, material_ids, mask)
        return cls._of_primitives(PrimitiveGeometry((), (), held), parts)

    @classmethod
    def height_field(
        cls,
        heights: Any,
        *,
        origin: Any = (0.0, 0.0, 0.0),
        spacing: Any = 1.0,
        material_id: int = 0,
        mask: int = ALL_BITS,
        **parts: Any,
    ) -> Self:
        """Make a scene of terrain from an array of heights, without storing triangles.

        Parameters
        ----------
        heights : array_like of shape (H, W), real
            The z of samples on a grid of at least 2 x 2; NaN where there is no data. A NumPy array
            is not copied: do not change it.
        origin : array_like of shape (3,), real
            The x and y of the sample in row 0 and column 0, and an offset added to all heights.
        spacing : float or array_like of shape (2,), real
            Distance between columns along x, and between rows along y; may be negative.
        material_id, mask : int
            As of a `Mesh`.
        **parts
            As for `spheres`.

        Returns
        -------
        Scene
            Its up direction is z, unless `up` is given.

        Raises
        ------
        ValueError
            If there are fewer than 2 x 2 samples, a height is infinite, `origin` or `spacing` is
            not finite, or `spacing` is too small. A tracer raises it for 2**31 triangles or more.
        TypeError
            If the numbers are of the wrong kind.

        Notes
        -----
        Each cell between four samples consists of two triangles, split along the diagonal from the
        sample with the lower row and column; their fronts face up. Triangles with a corner without
        data are missing. Hits have the same bits as for a mesh of these triangles: prim_id is 2 *
        (row * (W - 1) + column) for the triangle at the lower row of a cell, and one more for the
        other; u and v are weights of vertices. The numbering includes missing triangles.

        A tracer takes about 5 bytes per sample, in addition to the given array. See `spheres` for
        what is supported.

        Examples
        --------
        >>> import numpy as np
        >>> import raystream as rs
        >>> heights = np.add.outer(np.arange(4.0), np.zeros(5))  # as high as y
        >>> tracer = rs.Tracer(rs.Scene.height_field(heights, spacing=10.0))
        >>> hits = tracer.first_hit([15.0, 25.0, 50.0], [0.0, 0.0, -1.0])
        >>> hits.t.item(), hits.prim_id.item(), hits.positions.tolist()
        (47.5, 18, [15.0, 25.0, 2.5])
        """
        return cls.of_field(HeightField.of(heights, origin, spacing, material_id, mask), **parts)

    @classmethod
    def of_field(cls, field: HeightField, **parts: Any) -> Self:
        """Make a scene of a height field; see `height_field`."""
        parts = {"up": (0.0, 0.0, 1.0), **parts}
        return cls._of_primitives(PrimitiveGeometry((), (field,), NO_SPHERES), parts)

    @classmethod
    def shapes(
        cls,
        shape: Shape,
        records: Any,
        *,
        material_ids: Any = 0,
        mask: int = ALL_BITS,
        **parts: Any,
    ) -> Self:
        """Make a scene of shapes whose geometry is written in Python; see `Shape`.

        Parameters
        ----------
        shape : Shape
            Their kind.
        records : array_like of shape (N,), structured
            The parameters of each shape, as the functions of `shape` read them. They are copied.
        material_ids, mask, **parts
            As for `spheres`.

        Returns
        -------
        Scene

        Raises
        ------
        ValueError
            If bounds are not finite, or a low corner is above the high one. A tracer raises it if
            all crossings together would be 2**31 or more.
        TypeError
            If the records are not structured, or a function cannot be compiled.
        RaystreamError
            If a function fails; queries raise it, too.

        Notes
        -----
        Each crossing of a ray with a shape is a hit. ``structure="bvh"`` and ``"brute"`` on the CPU
        answer all queries; :ref:`what-works` says what else is supported.
        """
        if not isinstance(shape, Shape):
            raise TypeError(f"shape: expected a Shape, got {type(shape).__name__}")
        held = Shapes.of(shape, records, material_ids, mask)
        return cls._of_primitives(PrimitiveGeometry((), (), NO_SPHERES, (held,)), parts)

    @classmethod
    def combine(cls, scenes: Iterable[Scene], **parts: Any) -> Self:
        """Combine the meshes, height fields, spheres and shapes of several scenes into one.

        Parameters
        ----------
        scenes : iterable of Scene
            Their lights and cameras are not used.
        **parts
            ``lights``, ``camera`` and other parameters of `Scene`, except ``meshes`` and
            ``materials``.

        Returns
        -------
        Scene
            ``prim_id`` counts the triangles of all meshes, then those of all height fields, then
            all spheres, then all shapes, scenes one after another; ``mesh_id`` counts each height
            field as a mesh, all spheres as one, and the shapes of each scene as one. Materials are
            those of the scenes, one after another. If one has instances, each of the others becomes
            an instance, see `Scene.instances`.

        Raises
        ------
        ValueError, TypeError
            If one is not a scene, or has instances in worlds.

        Examples
        --------
        >>> import raystream as rs
        >>> ball = rs.Scene.spheres([[278, 273, 280]], 100.0)
        >>> scene = rs.Scene.combine([rs.load("cornell"), ball])
        >>> hit = rs.Tracer(scene).first_hit([278, 273, -800], [0, 0, 1])
        >>> hit.t.item(), bool(hit.prim_id == rs.load("cornell").triangle_count)
        (980.0, True)
        """
        given = list(scenes)
        if any(getattr(one, "placements", None) is not None for one in given):
            at_rest = np.tile(np.eye(4)[:3], (len(given), 1, 1))
            return cls.instances(given, at_rest, np.arange(len(given)), **parts)
        geometry, materials = combined(given)
        return cls._of_primitives(geometry, {"materials": materials, **parts})

    @classmethod
    def _of_primitives(cls, geometry: PrimitiveGeometry, parts: dict[str, Any]) -> Self:
        for name in ("meshes", "animation"):
            if name in parts:
                raise TypeError(f"{name}: not supported here; see Scene.combine")
        scene = cls(geometry.meshes, **parts)  # type: ignore[call-arg]
        count = len(scene.materials)  # type: ignore[attr-defined]
        if geometry.highest_material >= count:
            raise ValueError(
                f"material_ids: expected 0 to {count - 1}, the materials given, got "
                f"{geometry.highest_material}"
            )
        scene._geometry = geometry
        return scene

    @property
    def has_primitives(self) -> bool:
        """Whether there are spheres, height fields or shapes, rather than triangles alone."""
        return self._geometry.has_primitives

    def mesh_name(self, mesh_id: int) -> str:
        """Name of a hit's mesh: that of the mesh or `Shape`, "height field" or "spheres"."""
        held = self._geometry
        names = [mesh.name for mesh in held.meshes] + ["height field"] * len(held.fields)
        names += ["spheres"] * bool(len(held.spheres))
        return (names + [one.functions.name for one in held.shapes])[mesh_id]

    @property
    def primitive_materials(self) -> frozenset[int]:
        """The materials of spheres, height fields and shapes."""
        geometry = self._geometry
        ids = {field.material_id for field in geometry.fields}
        others: list[Any] = [geometry.spheres, *geometry.shapes]
        return frozenset(ids.union(*(np.unique(one.material_ids).tolist() for one in others)))

    @property
    def primitive_counts(self) -> str:
        """Numbers of what is no mesh, as text to append; empty if there is nothing."""
        geometry = self._geometry
        fields = [f", a height field of {f.heights.shape}" for f in geometry.fields]
        count = len(geometry.spheres)
        shapes = [f", {len(one):,} of {one.functions.name}" for one in geometry.shapes]
        return "".join([*fields, *[f", {count:,} spheres"] * bool(count), *shapes])
