"""InstancedScene: what a scene has of instances, a base class of `Scene`."""

from __future__ import annotations

import operator
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, Self

from raystream.core.instances import Instances
from raystream.scene.geometry import Geometry
from raystream.scene.instancing import InstancedGeometry, Objects, flattened_geometry

if TYPE_CHECKING:
    from raystream.scene.material import Material
    from raystream.scene.mesh import Mesh
    from raystream.scene.scene import Scene


class InstancedScene:
    """Objects that are placed any number of times."""

    _geometry: Geometry

    @classmethod
    def instances(
        cls,
        objects: Mesh | Scene | Iterable[Mesh | Scene | Sequence[Mesh]],
        transforms: Any,
        object_ids: Any = None,
        *,
        worlds: Any = None,
        names: Sequence[str] | None = None,
        masks: Any = None,
        materials: Sequence[Material] = (),
        **parts: Any,
    ) -> Self:
        """Make a scene of objects that are placed any number of times.

        Memory grows with the objects, and by a few hundred bytes for each instance.

        Parameters
        ----------
        objects : Mesh, Scene, or sequence of them
            In their own space, object space. A list of meshes within the sequence is one object.
            Of a scene, the meshes, height fields, spheres and materials are used, not its lights
            and cameras; it cannot have shapes. A scene may have instances itself: each time it is
            placed, each of its instances becomes an instance of the new scene.
        transforms : array_like of shape (K, 3, 4) or (3, 4), real
            Object to world space: ``world = transforms[k, :, :3] @ point + transforms[k, :, 3]``,
            in float64. They may mirror, shear, and scale each axis differently.
        object_ids : array_like of shape (K,), int, optional
            The object of each instance [default: the only object].
        worlds : array_like of shape (K,), int, optional
            The world of each instance, from 0, or -1 for an instance in all worlds. Queries then
            take the world of each ray, and the ray ignores instances in other worlds: one batch of
            rays can query thousands of copies of a small scene in different states.
        names : sequence of str, optional
            Of each instance: in `placements`, and of the meshes that `flattened` makes.
        masks : array_like of shape (K,), int, optional
            The mask of each instance, 32 bits, unsigned, in place of the masks of its meshes; 0
            for these. See `Tracer.first_hit`.
        materials : sequence of Material, optional
            Materials of the objects that are meshes. Those of scenes follow.
        **parts
            ``lights``, ``camera`` and other parameters of `Scene`.

        Returns
        -------
        Scene
            Its `meshes` are those of the objects: ``prim_id``, ``mesh_id`` and ``material_id`` of
            hits refer to the objects' triangles, meshes and materials, however often they are
            placed; ``instance_id`` identifies the instance that is hit. Height fields and spheres
            of the objects follow, in the order of `combine`.

        Raises
        ------
        ValueError
            If an array's shape is wrong, an object does not exist or has shapes of `Scene.shapes`,
            or a transform is not finite, singular or nearly so (a condition number above 1e9).
            A tracer raises it for 2**31 triangles or more in all instances.
        TypeError
            If an object is neither a mesh nor a scene, or the numbers are of the wrong kind.
        MemoryError
            If the instances of instances do not fit into memory.

        Notes
        -----
        A ray is transformed to object space in float64 and traced there, so hits in an instance
        have the same bits as hits of the transformed ray in a tracer of the object alone. Hits of
        one ray at equal t, as reported, are ordered by instance_id, then by prim_id. A ray whose
        direction is longer than 2**500 or shorter than 2**-500 is INVALID.

        With ``precision="float64"``, a hit's t is the exact one of the moved ray, rounded; moving
        the ray rounds it by a few units of 2**-53 of the numbers that are summed.

        ``structure="bvh"`` and ``"brute"`` trace and render such scenes on the CPU, and those of
        triangles in float32 on CUDA and, with its machine ``"compute"``, ``device="graphics"``.
        For view factors and other machines, use `flattened` to make a plain scene.

        Examples
        --------
        >>> import numpy as np
        >>> import raystream as rs
        >>> places = np.zeros((100, 3, 4))
        >>> places[:, :, :3] = np.eye(3)
        >>> places[:, 0, 3] = 30.0 * np.arange(100)
        >>> row = rs.Scene.instances(rs.load("spheres"), places)
        >>> tracer = rs.Tracer(row)
        >>> hits = tracer.first_hit([[150.0, 50.0, 0.5], [180.0, 50.0, 0.5]], [0, -1, 0])
        >>> hits.instance_id.tolist(), bool(hits.prim_id[0] == hits.prim_id[1])
        ([5, 6], True)
        """
        made = Objects.of(objects, (object_ids, transforms, worlds, names, masks), materials)
        geometry = InstancedGeometry(made.objects, made.instances)
        scene = cls(geometry.meshes, materials=made.materials, **parts)  # type: ignore[call-arg]
        scene._geometry = geometry
        return scene

    @property
    def geometry(self) -> Geometry:
        """The meshes and the data derived from them, shared between scenes."""
        return self._geometry

    @property
    def placements(self) -> Instances | None:
        """The instances: ``object_ids``, ``transforms``, ``inverses`` and ``names``, or None."""
        return self._geometry.instances

    def has_objects_of(self, other: InstancedScene) -> bool:
        """Whether two scenes have instances of the same objects, or neither has instances."""
        own: Any = self._geometry
        others: Any = other._geometry
        if own.instances is None or others.instances is None:
            return type(own) is type(others)
        is_same = own.mesh_counts == others.mesh_counts and own.spheres.are_same(others.spheres)
        parts = zip((*own.meshes, *own.fields), (*others.meshes, *others.fields), strict=False)
        return is_same and all(one is other for one, other in parts)

    def in_world(self, world: int) -> Self:
        """Copy the scene with the instances of one world, and those in all; objects are shared.

        Parameters
        ----------
        world : int
            From 0; or -1 for the instances in all worlds.

        Returns
        -------
        Scene
            Without worlds. Its instance k is the k-th of these: number
            ``np.flatnonzero((worlds == world) | (worlds == -1))[k]`` of the scene, with
            ``worlds = scene.placements.worlds``.

        Raises
        ------
        ValueError
            If the scene has no worlds, or not this one.
        """
        geometry: Any = self._geometry
        if geometry.instances is None:
            raise ValueError("world: the scene has no instances; see Scene.instances")
        rows = geometry.instances.in_world(operator.index(world))
        return self._with(_geometry=geometry.moved(geometry.instances.picked(rows)))

    def with_transforms(self, transforms: Any) -> Self:
        """Copy the scene with its instances moved; the objects are shared.

        Parameters
        ----------
        transforms : array_like of shape (K, 3, 4), real
            As many as before.

        Raises
        ------
        ValueError, TypeError
            If there are no instances; otherwise as `instances`.
        """
        geometry: Any = self._geometry
        if geometry.instances is None:
            raise ValueError("transforms: the scene has no instances; see Scene.instances")
        moved = geometry.moved(geometry.instances.moved(transforms))
        return self._with(_geometry=moved)

    def flattened(self) -> Self:
        """The same scene without instances: the meshes of each are copied to its place.

        Height fields become meshes, and spheres remain spheres.

        Returns
        -------
        Scene
            Its meshes are those of the first instance, then those of the second, and so on. The
            scene itself if it has no instances.

        Raises
        ------
        ValueError
            If the instances are in worlds, or one makes ellipsoids of spheres.
        MemoryError
            If it does not fit into memory.
        """
        geometry: Any = self._geometry
        if geometry.instances is None:
            return self
        if geometry.instances.worlds is not None:
            raise ValueError("flattened: the instances are in worlds, which may overlap")
        return self._with(_geometry=flattened_geometry(geometry))

    def _with(self, **fields: Any) -> Self:
        scene = type(self).__new__(type(self))
        vars(scene).update(vars(self), **fields)
        return scene
