"""InstancedTriangles: the geometry of objects that are placed by instances."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.attributes import Attributes
from raystream.core.instances import Instances
from raystream.core.placed_hits import PlacedHits
from raystream.core.solid_parts import SolidPart
from raystream.core.spheres import Spheres
from raystream.core.store import Store
from raystream.core.triangles import MAX_TRIANGLES, Triangles, local_frame

#: Numbers that kernels have for a triangle of a mesh, for one of a height field, and for a sphere.
_NUMBERS = np.array([1, 1, 2])

#: Boxes of closed objects are grown by this much of their size: more than points round.
_BOX_GROWTH = 2.0**-20


class InstancedTriangles(PlacedHits):
    """The geometry of a scene's objects, each in a local frame of its own, and their instances.

    ``prim_id`` counts the triangles of the objects' meshes, then those of their height fields, then
    their spheres, however often they are placed. Kernels count the numbers of all instances, one
    instance after another: `split_ids` converts, and for many hits `geometry.instances.hit_ids`.

    Parameters
    ----------
    objects : sequence of Store
        Without instances.
    instances : Instances
    mesh_splits : ndarray of shape (M + 1,), int64
        Mesh i of the scene owns the prim_ids in [mesh_splits[i], mesh_splits[i + 1]); see
        `Primitives`.
    attributes : Attributes
        Of the meshes.

    Attributes
    ----------
    parts : ndarray of shape (O, 3, 2), int64
        Of the triangles of each object's meshes, those of its height fields, and its spheres: the
        first one's number in the object, and its prim_id.
    first_prims : ndarray of shape (O + 1,), int64
        Object i owns the triangles of meshes in [first_prims[i], first_prims[i + 1]).
    first_ids : ndarray of shape (K + 1,), int64
        Instance k owns the numbers in [first_ids[k], first_ids[k + 1]).

    Raises
    ------
    ValueError
        If an instance has an object that does not exist, or there are 2**31 triangles or more in
        all instances.
    """

    instances: Instances
    attributes: Attributes

    def __init__(
        self,
        objects: Sequence[Store],
        instances: Instances,
        mesh_splits: NDArray[np.int64],
        attributes: Attributes,
    ) -> None:
        self.objects, self.instances = tuple(objects), instances
        self.world_count = instances.world_count
        self.mesh_splits, self.attributes = mesh_splits, attributes
        held: list[Any] = [one for one in self.objects if one.has_primitives]
        self.has_primitives = bool(held)
        self.fields = tuple(field for one in held for field in one.fields)
        self.spheres = Spheres.joined(one.spheres for one in held)
        self.kinds = self._kinds()
        if any(one.number_type is np.float64 for one in self.objects):
            self.number_type = np.float64
        counts = np.array([one.part_counts for one in self.objects], np.int64).reshape(-1, 3)
        own, totals = counts * _NUMBERS, counts.sum(axis=0)
        numbers = np.cumsum(own, axis=1) - own
        prims = np.cumsum(counts, axis=0) - counts + np.cumsum(totals) - totals
        self.parts = np.stack([numbers, prims], axis=2)
        self.first_prims = np.concatenate([[0], np.cumsum(counts[:, 0])]).astype(np.int64)
        self.first_fields = np.cumsum([totals[0], *map(len, self.fields)]).astype(np.int64)
        ids = instances.object_ids
        if len(ids) and not (ids.min() >= 0 and ids.max() < len(counts)):
            bad = int(np.argmax((ids < 0) | (ids >= len(counts))))
            raise ValueError(
                f"object_ids: instance {bad} has object {ids[bad]}, but there are {len(counts):,}"
            )
        own_counts = own.sum(axis=1)[ids]
        self.first_ids = np.concatenate([[0], np.cumsum(own_counts)]).astype(np.int64)
        if self.first_ids[-1] > MAX_TRIANGLES:
            raise ValueError(
                f"scene: {self.first_ids[-1]:,} triangles in all instances are more than "
                f"{MAX_TRIANGLES:,}"
            )

    def _kinds(self) -> tuple[str, ...]:
        """Instances, and those of each kind of object."""
        placed = sorted({f"placed {kind}" for one in self.objects for kind in one.kinds})
        return ("instances", *["worlds"][: self.world_count], *placed)

    def mask_parts(self) -> tuple[NDArray[np.int64], NDArray[np.uint32]]:
        """The parts are the instances; or, where one has no mask, the parts of its object."""
        own = self.instances.masks
        if own is None:
            own = np.zeros(len(self.instances), np.uint32)
        if own.all():
            return self.first_ids[:-1], own
        held = [one.mask_parts() for one in self.objects]
        firsts, masks = (np.concatenate(column) for column in zip(*held, strict=True))
        sizes = np.array([len(first) for first, _ in held])
        ids = self.instances.object_ids
        counts = sizes[ids]
        instance = np.repeat(np.arange(len(ids)), counts)
        within = np.arange(len(instance)) - np.repeat(np.cumsum(counts) - counts, counts)
        row = (np.cumsum(sizes) - sizes)[ids][instance] + within
        chosen = np.where(own[instance] > 0, own[instance], masks[row])
        return self.first_ids[instance] + firsts[row], chosen

    def saved_masks(self) -> dict[str, NDArray[np.uint32]]:
        """See `Store.saved_masks`."""
        own = self.instances.masks
        return {
            **{
                f"object{k}.{name}": masks
                for k, one in enumerate(self.objects)
                for name, masks in one.saved_masks().items()
            },
            **({} if own is None else {"instances": own}),
        }

    @cached_property
    def instance_masks(self) -> NDArray[np.uint32]:
        """All bits of the masks in each instance, shape (K,)."""
        return self._instance_masks(np.bitwise_or)

    @cached_property
    def has_masks_by_instance(self) -> bool:  # type: ignore[override]
        """See `Store`."""
        return np.array_equal(self.instance_masks, self._instance_masks(np.bitwise_and))

    def _instance_masks(self, combine: np.ufunc) -> NDArray[np.uint32]:
        """Each instance's own mask, or those of its object's parts combined."""
        own = self.instances.masks
        of_objects = [combine.reduce(one.mask_runs.masks) for one in self.objects]
        found = np.array(of_objects, np.uint32)[self.instances.object_ids]
        return found if own is None else np.where(own > 0, own, found)

    def moved(self, instances: Instances) -> InstancedTriangles:
        """The same objects, with instances elsewhere."""
        return InstancedTriangles(self.objects, instances, self.mesh_splits, self.attributes)

    def __len__(self) -> int:
        return int(self.first_fields[-1]) + len(self.spheres)

    @property
    def number_count(self) -> int:
        """How many numbers kernels have for triangles: those of all instances."""
        return int(self.first_ids[-1])

    def __reduce__(self) -> tuple[Any, ...]:
        arguments = self.objects, self.instances, self.mesh_splits, self.attributes
        return InstancedTriangles, arguments

    @cached_property
    def _frame(self) -> tuple[NDArray[np.float64], float]:
        return local_frame(*self.world_bounds)

    @property
    def center(self) -> NDArray[np.float64]:  # type: ignore[override]
        """World position of the origin of the scene's local frame; see `Triangles`."""
        return self._frame[0]

    @property
    def scale(self) -> float:  # type: ignore[override]
        """Local units of the scene's local frame per world unit."""
        return self._frame[1]

    @property
    def bounds(self) -> NDArray[np.float32]:
        """`world_bounds` in the scene's local frame, shape (2, 3), float32."""
        return ((self.world_bounds - self.center) * self.scale).astype(np.float32)

    @property
    def max_coordinate(self) -> np.float32:  # type: ignore[override]
        """Largest absolute coordinate of `bounds`."""
        return np.float32(np.abs(self.bounds).max())

    def saved_arrays(self) -> dict[str, NDArray[Any]]:
        """See `Store.saved_arrays`."""
        held = self.instances
        arrays: dict[str, NDArray[Any]] = {
            "object_ids": held.object_ids,
            "transforms": held.transforms,
        }
        if held.worlds is not None:
            arrays["worlds"] = held.worlds
        for k, one in enumerate(self.objects):
            arrays |= {f"object{k}.{name}": array for name, array in one.saved_arrays().items()}
        return arrays | {"mesh_splits": self.mesh_splits}

    def object_corners(self) -> NDArray[np.float32]:
        """Corners of all triangles of meshes, by prim_id, shape (F, 3, 3), float32.

        Each object's in its own local frame.
        """
        none, held = np.zeros((0, 3, 3), np.float32), self.objects
        return np.concatenate([none, *(one.object_corners() for one in held)])

    def some(self, most: int) -> Triangles:
        """Some triangles where the instances are, in world space; all if they are few.

        Parameters
        ----------
        most : int
            How many, at most. They are spread evenly over the numbers of all triangles. Where
            there are spheres, some of some instances.
        """
        if self.has_primitives:
            return self._some_primitives(most)
        total = self.number_count
        numbers = np.arange(0, total, max(1, -(-total // most)), dtype=np.int32)
        prim_id, instance_id = self.split_ids(numbers)
        points = self.points_to_world(self.corners_at(prim_id, instance_id), instance_id)
        faces = np.arange(3 * len(numbers), dtype=np.int32).reshape(-1, 3)
        return Triangles([(points.reshape(-1, 3), faces)])

    def _some_primitives(self, most: int) -> Triangles:
        """Triangles near the primitives of instances, in world space."""
        placed, points = self.instances, [np.zeros((0, 3))]
        step = max(1, -(-2 * len(placed) // most))
        share = max(2, most // max(1, -(-len(placed) // step)))
        held = {k: self.objects[k] for k in set(placed.object_ids[::step].tolist())}
        some = {k: one.some(share) if one.has_primitives else one for k, one in held.items()}
        for k, matrix in zip(placed.object_ids[::step], placed.transforms[::step], strict=True):
            near: Any = some[int(k)]
            own = near.to_world(near.corners[:: max(1, len(near) // share)]).reshape(-1, 3)
            points.append(own @ matrix[:, :3].T + matrix[:, 3])
        vertices = np.concatenate(points)
        return Triangles([(vertices, np.arange(len(vertices), dtype=np.int32).reshape(-1, 3))])

    @property
    def degenerate_count(self) -> int:
        """Triangles of the objects without area."""
        return sum(one.degenerate_count for one in self.objects)

    @property
    def nonfinite_count(self) -> int:
        """Triangles of the objects with a vertex that is not finite."""
        return sum(one.nonfinite_count for one in self.objects)

    @property
    def byte_count(self) -> int:
        """Bytes of the objects' triangles and of the instances."""
        held = self.instances
        tables = held.object_ids.nbytes + held.transforms.nbytes + held.inverses.nbytes
        return sum(one.byte_count for one in self.objects) + tables

    @cached_property
    def world_bounds(self) -> NDArray[np.float64]:
        """The box around the instances' boxes, shape (2, 3), float64; zeros if all are empty."""
        low, high, is_empty = self.boxes()
        if is_empty.all():
            return np.zeros((2, 3))
        return np.array([low[~is_empty].min(axis=0), high[~is_empty].max(axis=0)])

    def boxes(
        self, grown: float = 0.0
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
        """World boxes around the instances.

        Parameters
        ----------
        grown : float
            Objects' boxes are grown by this fraction of their largest coordinate, local frame.

        Returns
        -------
        low, high : ndarray of shape (K, 3), float64
        is_empty : ndarray of shape (K,), bool
            Instances without a triangle that can be hit.
        """
        centers, halves = np.zeros((2, len(self.objects), 3))
        for k, one in enumerate(self.objects):
            margin = grown * float(one.max_coordinate)
            low, high = one.bounds.astype(np.float64) + [[-margin], [margin]]
            centers[k] = one.to_world((low + high) / 2)
            halves[k] = (high - low) / 2 / one.scale
        ids, transforms = self.instances.object_ids, self.instances.transforms
        center, half = transforms[:, :, 3].copy(), np.zeros((len(ids), 3))
        for k in range(3):  # einsum takes three times as long
            column = transforms[:, :, k]
            center += column * centers[ids, k, None]
            half += np.abs(column) * halves[ids, k, None]
        is_empty = np.array([one.is_empty for one in self.objects], bool)
        return center - half, center + half, is_empty[ids]

    def split_ids(self, numbers: NDArray[np.int32]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Split the numbers of triangles of all instances; -1 stays -1.

        Returns
        -------
        prim_id, instance_id : ndarray of the same shape, int32
        """
        instance_id = np.searchsorted(self.first_ids, numbers, side="right").astype(
            np.int32
        ) - np.int32(1)
        is_hit = numbers >= 0
        found = np.where(is_hit, instance_id, 0)
        if len(self.instances) == 0:
            return np.array(numbers), instance_id
        objects, own = self.instances.object_ids[found], numbers - self.first_ids[found]
        if not self.has_primitives:
            return np.where(is_hit, own + self.first_prims[objects], -1).astype(np.int32), (
                instance_id
            )
        part = (own >= self.parts[objects, 1, 0]).astype(np.int64)
        part += own >= self.parts[objects, 2, 0]
        numbers_before, prims_before = np.moveaxis(self.parts[objects, part], -1, 0)
        prims = prims_before + ((own - numbers_before) >> (part == 2))
        return np.where(is_hit, prims, -1).astype(np.int32), instance_id

    def numbers_of(
        self, prim_id: NDArray[np.int32], instance_id: NDArray[np.int32]
    ) -> NDArray[np.int64]:
        """The numbers of triangles, or of where rays enter spheres, of instances; of misses -1."""
        numbers = np.full(prim_id.shape, -1, np.int64)
        is_hit = prim_id >= 0
        ids, prims = instance_id[is_hit], prim_id[is_hit]
        part = self.parts_of(prims)
        places = self.parts[self.instances.object_ids[ids], part]
        within = (prims - places[:, 1]) * _NUMBERS[part]
        numbers[is_hit] = self.first_ids[ids] + places[:, 0] + within
        return numbers

    def are_of(
        self, prim_id: NDArray[np.int32], instance_id: NDArray[np.int32]
    ) -> NDArray[np.bool_]:
        """Whether primitives are of the objects of instances."""
        found = self.split_ids(self.numbers_of(prim_id, instance_id).astype(np.int32))
        return (found[0] == prim_id) & (found[1] == instance_id)

    def solid_numbers(self) -> NDArray[np.int64]:
        """The numbers of triangles that can be hit, increasing."""
        return self._placed_numbers([one.solid_numbers() for one in self.objects])

    def face_numbers(self) -> NDArray[np.int64]:
        """See `Store.face_numbers`; spheres have the number of where rays enter."""
        held = []
        for k, one in enumerate(self.objects):
            prims, first = one.face_numbers(), self.parts[k, 2, 0]
            held.append(prims + np.maximum(prims - first, 0))
        return self._placed_numbers(held)

    def _placed_numbers(self, held: Sequence[NDArray[Any]]) -> NDArray[np.int64]:
        """Numbers in objects, as those of all instances, increasing."""
        ids, parts = self.instances.object_ids, [np.zeros(0, np.int64)]
        for k, numbers in enumerate(held):
            firsts = self.first_ids[:-1][ids == k]
            parts.append((firsts[:, None] + numbers).reshape(-1))
        found = np.concatenate(parts)
        found.sort()
        return found

    def solid_parts(self) -> list[SolidPart]:
        """The parts of the object of each instance; see `Store`."""
        low, high, is_empty = self.boxes(_BOX_GROWTH)
        parts = [self._object_parts(k) for k in range(len(self.objects))]
        ids, inverses = self.instances.object_ids.tolist(), self.instances.inverses
        return [
            part._replace(inverse=inverse, box=np.array([below, above]))
            for k, inverse, below, above, hidden in zip(
                ids, inverses, low, high, is_empty, strict=True
            )
            if not hidden
            for part in parts[k]
        ]

    def _object_parts(self, k: int) -> list[SolidPart]:
        """The parts of an object, with the scene's meshes."""
        one, found = self.objects[k], []
        for part in one.solid_parts():
            number, prim_id = self.parts[k, int(part.open_kind is not None)]
            first = one.mesh_splits[part.first_mesh] - number + prim_id
            mesh = int(np.searchsorted(self.mesh_splits, first, side="right")) - 1
            found.append(part._replace(first_mesh=mesh))
        return found
