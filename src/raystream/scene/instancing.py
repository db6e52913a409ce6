"""Scenes of instances: the objects' meshes and materials put together, and copies placed."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.height_field import HeightField
from raystream.core.instanced_triangles import InstancedTriangles
from raystream.core.instances import Instances
from raystream.core.memory import check_memory
from raystream.core.rays import as_host_array, as_real_array
from raystream.core.spheres import Spheres
from raystream.core.store import Store
from raystream.scene.geometry import Geometry, geometry_of
from raystream.scene.io.part_names import path_name
from raystream.scene.material import Material
from raystream.scene.mesh import Mesh
from raystream.scene.primitive_geometry import PrimitiveGeometry

if TYPE_CHECKING:
    from raystream.core.triangles import Triangles

#: Triangles that a camera is chosen by.
_SEEN = 200_000

#: Spheres remain spheres if the squares of lengths change by factors that differ by at most this.
_UNEVEN = 1e-12

#: Bytes of a triangle of a mesh of its own, with as many vertices: positions, normals, faces.
_TRIANGLE_BYTES = 24 + 12 + 12 + 4


class InstancedGeometry(Geometry):
    """Objects, and their instances.

    Parameters
    ----------
    objects : sequence of Geometry
        Without instances. They are shared by all scenes of them, wherever their instances are.
    instances : Instances
    """

    instances: Instances

    def __init__(self, objects: Sequence[Geometry], instances: Instances) -> None:
        super().__init__(mesh for one in objects for mesh in one.meshes)
        self.objects, self.instances = tuple(objects), instances
        self.mesh_counts = tuple(len(one.meshes) for one in objects)
        self.has_primitives = any(one.has_primitives for one in objects)
        self.fields = tuple(field for one in objects for field in one.fields)
        self.spheres = Spheres.joined(one.spheres for one in objects)

    @property
    def mesh_ranges(self) -> list[tuple[int, int]]:
        """First and last mesh, exclusive, of each object."""
        return list(itertools.pairwise([0, *itertools.accumulate(self.mesh_counts)]))

    @cached_property
    def triangles(self) -> Any:
        """The geometry of the objects, each in a frame of its own, and their instances."""
        return self.placed([one.triangles for one in self.objects])

    def placed(self, stores: Sequence[Store]) -> InstancedTriangles:
        """The instances of objects' geometry."""
        sizes = [mesh.triangle_count for mesh in self.meshes]
        sizes += [*map(len, self.fields), *[len(self.spheres)][: len(self.spheres)]]
        splits = np.cumsum([0, *sizes], dtype=np.int64)
        return InstancedTriangles(stores, self.instances, splits, self.attributes)

    def _seen(self) -> Triangles:
        return self.triangles.some(_SEEN)

    def moved(self, instances: Instances) -> InstancedGeometry:
        """The same objects, whose triangles are shared, with instances elsewhere."""
        moved = InstancedGeometry(self.objects, instances)
        moved.attributes = self.attributes
        return moved


class Objects(NamedTuple):
    """What a scene of instances is made of; see `Scene.instances`."""

    objects: list[Geometry]
    materials: list[Material]
    instances: Instances

    @classmethod
    def of(
        cls,
        objects: Any,
        placed: tuple[Any, Any, Any, Sequence[str] | None, Any],
        materials: Sequence[Material],
    ) -> Objects:
        """Put objects together; `placed` are object_ids, transforms, worlds, names, masks.

        Raises
        ------
        ValueError, TypeError
            See `Scene.instances`.
        """
        is_one = isinstance(objects, Mesh) or geometry_of(objects) is not None
        given = [objects] if is_one else list(objects)
        for index, one in enumerate(given):
            is_list = isinstance(one, list | tuple) and all(isinstance(m, Mesh) for m in one)
            geometry = geometry_of(one)
            if not (isinstance(one, Mesh) or is_list or geometry is not None):
                raise TypeError(
                    f"objects[{index}]: expected a Mesh, a Scene or a list of meshes, "
                    f"got {type(one).__name__}"
                )
        object_ids, transforms, worlds, names, masks = placed
        ids, matrices = _checked(len(given), transforms, object_ids)
        known = list(materials)
        if not known and not all(map(geometry_of, given)):
            known = [Material()]  # of the objects that are meshes
        found = cls([], known, Instances(ids, matrices, worlds, names, masks))
        # Each object is one after another's; one that is a scene of instances is several.
        below = [found._add(one, len(known)) for one in given]
        if all(inner is None for _, inner in below):
            firsts = np.array([first for first, _ in below], np.int32)
            outer = found.instances
            instances = outer
            if len(ids):
                rest = outer.worlds, outer.names, outer.masks
                instances = Instances(firsts[ids], matrices, *rest)
        else:
            instances = _flattened_instances(found.instances, below)
        if not found.materials:
            found.materials.append(Material())
        return found._replace(instances=instances)

    def _add(self, one: Any, given_count: int) -> tuple[int, Instances | None]:
        """Add an object; returns its number, or its first one and the instances of them.

        `given_count` materials are those of meshes.
        """
        first = len(self.objects)
        geometry = geometry_of(one)
        if geometry is None:
            parts = [one] if isinstance(one, Mesh) else one
            for mesh in parts:
                most = int(mesh.material_ids.max(initial=-1))
                if most >= given_count:
                    raise ValueError(
                        f"materials: mesh {mesh.name!r} uses material {most}, but {given_count} "
                        "are given"
                    )
            self.objects.append(Geometry(parts))
            return first, None
        shift = len(self.materials)
        self.materials.extend(one.materials)
        if geometry.shapes:
            raise ValueError(
                "objects: one is a scene with shapes of users, which cannot be instances; "
                "Scene.shapes places a shape by its record"
            )
        inner = geometry.instances
        if inner is not None and inner.worlds is not None:
            raise ValueError("objects: one is a scene whose instances are in worlds")
        held: Any = [geometry] if inner is None else geometry.objects  # type: ignore[attr-defined]
        self.objects.extend(object_.with_materials_from(shift) for object_ in held)
        return first, inner


def _checked(count: int, transforms: Any, object_ids: Any) -> tuple[NDArray[Any], NDArray[Any]]:
    """Ids within range, and transforms of shape (K, 3, 4)."""
    matrices = as_real_array("transforms", transforms)
    if matrices.shape == (3, 4):
        matrices = matrices[None]
    if object_ids is None:
        if count != 1 and len(matrices):
            raise ValueError(
                f"object_ids: expected the object of each instance, 0 to {count - 1}, since there "
                f"are {count} objects"
            )
        return np.zeros(len(matrices), np.int32), matrices
    ids = as_host_array("object_ids", object_ids)
    if ids.size and ids.dtype.kind in "iu" and not (ids.min() >= 0 and ids.max() < count):
        raise ValueError(f"object_ids: expected 0 to {count - 1}, got {ids.min()} to {ids.max()}")
    return ids, matrices


def _flattened_instances(
    outer: Instances, below: Sequence[tuple[int, Instances | None]]
) -> Instances:
    """The instances of objects that are instances themselves, one outer one after another."""
    counts = np.array([1 if inner is None else len(inner) for _, inner in below])[outer.object_ids]
    total = int(counts.sum())
    check_memory(total * 220, f"Scene.instances: {total:,} instances would", "place fewer")
    ids = np.empty(total, np.int32)
    matrices, masks = np.empty((total, 3, 4)), np.zeros(total, np.uint32)
    rows = np.cumsum(counts) - counts
    for k, (first, inner) in enumerate(below):
        chosen = np.flatnonzero(outer.object_ids == k)
        mine = outer.transforms[chosen]
        if inner is None:
            ids[rows[chosen]], matrices[rows[chosen]] = first, mine
            continue
        to = (rows[chosen][:, None] + np.arange(len(inner))).reshape(-1)
        ids[to] = np.tile(first + inner.object_ids, len(chosen))
        linear = np.einsum("aij,bjk->abik", mine[:, :, :3], inner.transforms)
        linear[..., 3] += mine[:, None, :, 3]
        matrices[to] = linear.reshape(-1, 3, 4)
        if inner.masks is not None:
            masks[to] = np.tile(inner.masks, len(chosen))
    worlds = None if outer.worlds is None else np.repeat(outer.worlds, counts)
    if outer.masks is not None:
        own = np.repeat(outer.masks, counts)
        masks = np.where(own > 0, own, masks)
    given = masks if masks.any() else None
    return Instances(ids, matrices, worlds, _names_within(outer, below), given)


def _names_within(
    outer: Instances, below: Sequence[tuple[int, Instances | None]]
) -> list[str] | None:
    """Names of instances of instances: ``outer/inner``; None if none of them has one."""
    inner_names = [[""] if one is None else one.names or [""] * len(one) for _, one in below]
    if outer.names is None and not any(map(any, inner_names)):
        return None
    outer_names = outer.names or [""] * len(outer)
    return [
        path_name(name, within)
        for name, k in zip(outer_names, outer.object_ids.tolist(), strict=True)
        for within in inner_names[k]
    ]


def flattened_geometry(geometry: InstancedGeometry) -> Geometry:
    """The geometry without instances; see `Scene.flattened`.

    Raises
    ------
    ValueError
        If an instance makes ellipsoids of spheres.
    MemoryError
        If the meshes do not fit into memory.
    """
    meshes = [[*one.meshes, *map(_field_mesh, one.fields)] for one in geometry.objects]
    placed = list(_placed_meshes(meshes, geometry.instances))
    if not len(geometry.spheres):
        return Geometry(placed)
    spheres = []
    for k, object_id in enumerate(geometry.instances.object_ids.tolist()):
        held = geometry.objects[object_id].spheres
        if len(held):
            spheres.append(_placed_spheres(held, geometry.instances, k))
    return PrimitiveGeometry(placed, (), Spheres.joined(spheres))


def _field_mesh(field: HeightField) -> Mesh:
    """The triangles of a height field."""
    x, y = np.meshgrid(field.x, field.y)
    vertices = np.stack([x, y, field.heights + np.float64(field.base)], axis=-1)
    rows, columns = field.samples_of(np.arange(len(field)))
    faces = (rows * len(field.x) + columns).astype(np.int32)
    ids = np.full(len(faces), field.material_id, np.int32)
    return Mesh(vertices.reshape(-1, 3), faces, material_ids=ids, mask=field.mask)


def _placed_spheres(held: Spheres, instances: Instances, k: int) -> Spheres:
    """The spheres of an object where an instance has it."""
    linear, shift = instances.transforms[k, :, :3], instances.transforms[k, :, 3]
    largest = np.abs(linear).max()
    square = (linear / largest).T @ (linear / largest)
    size = np.trace(square) / 3.0
    if np.abs(square - size * np.eye(3)).max() > _UNEVEN * size:
        raise ValueError(f"flattened: instance {k} makes ellipsoids of its object's spheres")
    own = 0 if instances.masks is None else instances.masks[k]
    masks = np.full_like(held.masks, own) if own else held.masks
    radii = held.radii * (largest * np.sqrt(size))
    return replace(held, centers=held.centers @ linear.T + shift, radii=radii, masks=masks)


def _placed_meshes(objects: Sequence[Sequence[Mesh]], instances: Instances) -> Iterator[Mesh]:
    """Copies of the objects' meshes where the instances are, one instance after another."""
    sizes = np.array([sum(mesh.triangle_count for mesh in meshes) for meshes in objects])
    count = int(sizes[instances.object_ids].sum()) if len(instances) else 0
    check_memory(count * _TRIANGLE_BYTES, f"flattened: {count:,} triangles would", "place fewer")
    names = instances.names or ("",) * len(instances)
    masks = np.zeros(len(instances), int) if instances.masks is None else instances.masks
    columns = instances.object_ids, instances.transforms, instances.inverses, masks.tolist()
    for name, object_id, matrix, inverse, mask in zip(names, *columns, strict=True):
        meshes = objects[object_id]
        for mesh in meshes:
            placed = _placed(mesh, matrix, inverse)
            placed.mask = mask or mesh.mask
            if name:
                placed.name = name if len(meshes) == 1 else path_name(name, mesh.name)
            yield placed


def _placed(mesh: Mesh, matrix: NDArray[np.float64], inverse: NDArray[np.float64]) -> Mesh:
    vertices = mesh.vertices.astype(np.float64) @ matrix[:, :3].T + matrix[:, 3]
    normals = None
    if mesh.normals is not None:
        turned = inverse[:, :3] / np.abs(inverse[:, :3]).max()
        normals = mesh.normals.astype(np.float64) @ turned
    faces = mesh.faces
    linear = matrix[:, :3] / np.abs(matrix[:, :3]).max()
    if np.linalg.det(linear) < 0.0:  # a mirror image: the front side stays in front
        faces = faces[:, [0, 2, 1]]
    return Mesh(
        vertices,
        faces,
        normals=normals,
        colors=mesh.colors,
        texcoords=mesh.texcoords,
        material_ids=mesh.material_ids,
        name=mesh.name,
        face_ids=mesh.face_ids,
    )
