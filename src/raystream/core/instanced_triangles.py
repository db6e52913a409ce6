"""InstancedTriangles: the triangles of objects that are placed by instances."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.attributes import Attributes
from raystream.core.instances import Instances
from raystream.core.solid_parts import SolidPart
from raystream.core.store import Store
from raystream.core.triangles import MAX_TRIANGLES, Triangles, local_frame

#: Boxes of closed objects are grown by this much of their size: more than points round.
_BOX_GROWTH = 2.0**-20


class InstancedTriangles(Store):
    """The triangles of a scene's objects, each in a local frame of its own, and their instances.

    ``prim_id`` counts the triangles of the objects, however often they are placed. Kernels count
    those of all instances, one instance after another: `split_ids` converts, and for many hits
    `geometry.instances.hit_ids`.

    Parameters
    ----------
    objects : sequence of Triangles
    instances : Instances
    mesh_splits : ndarray of shape (M + 1,), int64
        Mesh i of the scene owns the prim_ids in [mesh_splits[i], mesh_splits[i + 1]).
    attributes : Attributes
        Of the meshes.

    Attributes
    ----------
    first_prims : ndarray of shape (O + 1,), int64
        Object i owns the prim_ids in [first_prims[i], first_prims[i + 1]).
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
        objects: Sequence[Triangles],
        instances: Instances,
        mesh_splits: NDArray[np.int64],
        attributes: Attributes,
    ) -> None:
        self.objects, self.instances = tuple(objects), instances
        self.world_count = instances.world_count
        self.kinds = ("instances", "worlds") if self.world_count else ("instances",)
        self.mesh_splits, self.attributes = mesh_splits, attributes
        counts = np.array([len(one) for one in self.objects], np.int64)
        self.first_prims = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        ids = instances.object_ids
        if len(ids) and not (ids.min() >= 0 and ids.max() < len(counts)):
            bad = int(np.argmax((ids < 0) | (ids >= len(counts))))
            raise ValueError(
                f"object_ids: instance {bad} has object {ids[bad]}, but there are {len(counts):,}"
            )
        self.first_ids = np.concatenate([[0], np.cumsum(counts[ids])]).astype(np.int64)
        if self.first_ids[-1] > MAX_TRIANGLES:
            raise ValueError(
                f"scene: {self.first_ids[-1]:,} triangles in all instances are more than "
                f"{MAX_TRIANGLES:,}"
            )

    def _mask_parts(self) -> tuple[NDArray[np.int64], NDArray[np.uint32]]:
        """The parts are the instances; or, where one has no mask, the meshes of its object."""
        own, masks = self.instances.masks, self.mesh_masks
        if own is None:
            own = np.zeros(len(self.instances), np.uint32)
        if own.all():
            return self.first_ids[:-1], own
        meshes = np.searchsorted(self.mesh_splits, self.first_prims)
        ids = self.instances.object_ids
        counts = np.diff(meshes)[ids]
        instance = np.repeat(np.arange(len(ids)), counts)
        within = np.arange(len(instance)) - np.repeat(np.cumsum(counts) - counts, counts)
        mesh = meshes[ids][instance] + within
        firsts = self.mesh_splits[mesh] - self.first_prims[ids][instance]
        chosen = np.where(own[instance] > 0, own[instance], masks[mesh])
        return self.first_ids[instance] + firsts, chosen

    def saved_masks(self) -> dict[str, NDArray[np.uint32]]:
        """See `Store.saved_masks`."""
        own = self.instances.masks
        return super().saved_masks() | ({} if own is None else {"instances": own})

    @cached_property
    def instance_masks(self) -> NDArray[np.uint32]:
        """All bits of the masks in each instance, shape (K,)."""
        return self._instance_masks(np.bitwise_or)

    @cached_property
    def has_masks_by_instance(self) -> bool:  # type: ignore[override]
        """See `Store`."""
        return np.array_equal(self.instance_masks, self._instance_masks(np.bitwise_and))

    def _instance_masks(self, combine: np.ufunc) -> NDArray[np.uint32]:
        """Each instance's own mask, or those of its object's meshes combined."""
        own, masks = self.instances.masks, self.mesh_masks
        meshes = np.searchsorted(self.mesh_splits, self.first_prims)
        of_objects = [
            combine.reduce(masks[first:end], initial=masks[first]) if end > first else 0
            for first, end in pairwise(meshes)
        ]
        found = np.array(of_objects, np.uint32)[self.instances.object_ids]
        return found if own is None else np.where(own > 0, own, found)

    def moved(self, instances: Instances) -> InstancedTriangles:
        """The same objects, with instances elsewhere."""
        return InstancedTriangles(self.objects, instances, self.mesh_splits, self.attributes)

    def __len__(self) -> int:
        return int(self.first_prims[-1])

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
        """Corners of all objects' triangles, by prim_id, shape (F, 3, 3), float32.

        Each object's in its own local frame.
        """
        none = np.zeros((0, 3, 3), np.float32)
        return np.concatenate([none, *(one.corners for one in self.objects)])

    def some(self, most: int) -> Triangles:
        """Some triangles where the instances are, in world space; all if they are few.

        Parameters
        ----------
        most : int
            How many, at most. They are spread evenly over the numbers of all triangles.
        """
        total = self.number_count
        numbers = np.arange(0, total, max(1, -(-total // most)), dtype=np.int32)
        prim_id, instance_id = self.split_ids(numbers)
        points = self.points_to_world(self.corners_at(prim_id, instance_id), instance_id)
        faces = np.arange(3 * len(numbers), dtype=np.int32).reshape(-1, 3)
        return Triangles([(points.reshape(-1, 3), faces)])

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
        is_empty = np.array([len(one.prim_ids) == 0 for one in self.objects], bool)
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
        offset = self.first_prims[self.instances.object_ids[found]] - self.first_ids[found]
        return np.where(is_hit, numbers + offset, -1).astype(np.int32), instance_id

    def numbers_of(
        self, prim_id: NDArray[np.int32], instance_id: NDArray[np.int32]
    ) -> NDArray[np.int64]:
        """The numbers of triangles among those of all instances; of misses -1."""
        numbers = np.full(prim_id.shape, -1, np.int64)
        is_hit = prim_id >= 0
        ids = instance_id[is_hit]
        first_prims = self.first_prims[self.instances.object_ids[ids]]
        numbers[is_hit] = prim_id[is_hit] - first_prims + self.first_ids[ids]
        return numbers

    def solid_numbers(self) -> NDArray[np.int64]:
        """The numbers of triangles that can be hit, increasing."""
        ids, none = self.instances.object_ids, np.zeros(0, np.int64)
        parts = [none]
        for k, one in enumerate(self.objects):
            firsts = self.first_ids[:-1][ids == k]
            parts.append((firsts[:, None] + one.prim_ids).reshape(-1))
        numbers = np.concatenate(parts)
        numbers.sort()
        return numbers

    def solid_parts(self) -> list[SolidPart]:
        """The object of each instance; see `Store`."""
        firsts = np.searchsorted(self.mesh_splits, self.first_prims[:-1], side="right") - 1
        low, high, is_empty = self.boxes(_BOX_GROWTH)
        ids, inverses = self.instances.object_ids.tolist(), self.instances.inverses
        return [
            SolidPart(self.objects[k], int(firsts[k]), inverse, np.array([below, above]))
            for k, inverse, below, above, hidden in zip(
                ids, inverses, low, high, is_empty, strict=True
            )
            if not hidden
        ]

    # Geometry of hits, each in the frame of its object.

    def corners_at(
        self, prim_id: NDArray[np.int32], instance_id: NDArray[np.int32]
    ) -> NDArray[np.float64]:
        """Corners of triangles in their objects' local frames; see `Store.corners_at`."""
        prims = prim_id.reshape(-1)
        corners = np.full((len(prims), 3, 3), np.nan)
        for k, rows in self._by_object(instance_id):
            corners[rows] = self.objects[k].corners[prims[rows] - self.first_prims[k]]
        return corners.reshape(*prim_id.shape, 3, 3)

    def local_corners(self, numbers: NDArray[np.integer[Any]]) -> NDArray[np.float64]:
        """See `Store.local_corners`."""
        prim_id, instance_id = self.split_ids(numbers.astype(np.int32))
        corners = self.points_to_world(self.corners_at(prim_id, instance_id), instance_id)
        return (corners - self.center) * self.scale

    def points_to_world(
        self, points: NDArray[np.float64], instance_id: NDArray[np.int32]
    ) -> NDArray[np.float64]:
        """Move points from objects' local frames to world space.

        Parameters
        ----------
        points : ndarray of shape S + (3,) or S + (k, 3), float64
        instance_id : ndarray of shape S, int32
        """
        ids = instance_id.reshape(-1)
        local = points.reshape(len(ids), points.size // max(1, 3 * len(ids)), 3)
        world = np.full(local.shape, np.nan)
        for k, rows in self._by_object(instance_id):
            matrices = self.instances.transforms[ids[rows]]
            inside = self.objects[k].to_world(local[rows])
            moved = np.einsum("kij,knj->kni", matrices[:, :, :3], inside)
            world[rows] = moved + matrices[:, None, :, 3]
        return world.reshape(points.shape)

    def normals_to_world(
        self, normals: NDArray[np.float64], instance_id: NDArray[np.int32]
    ) -> NDArray[np.float64]:
        """Unit normals of shape (..., 3) in world space, on the same side of the surface."""
        world = np.full(normals.shape, np.nan)
        is_hit = instance_id >= 0
        inverses = self.instances.inverses[instance_id[is_hit]][:, :, :3]
        with np.errstate(invalid="ignore", divide="ignore"):
            # Scaled before they are multiplied and measured: small numbers would vanish.
            inverses = inverses / np.abs(inverses).max(axis=(1, 2), keepdims=True, initial=0.0)
            moved = _product(inverses.swapaxes(1, 2), normals[is_hit])
            moved /= np.abs(moved).max(axis=-1, keepdims=True, initial=0.0)
            world[is_hit] = moved / np.linalg.norm(moved, axis=-1, keepdims=True)
        return world

    def directions_to_local(
        self, directions: NDArray[Any], instance_id: NDArray[np.int32]
    ) -> NDArray[np.float64]:
        """World directions of shape (..., 3) in the spaces of the hits' objects."""
        moved = np.full(directions.shape, np.nan)
        is_hit = instance_id >= 0
        inverses = self.instances.inverses[instance_id[is_hit]][:, :, :3]
        moved[is_hit] = _product(inverses, directions[is_hit].astype(np.float64))
        return moved

    def reaches_at(
        self, instance_id: NDArray[np.int32]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Largest coordinates of the hits' objects; see `Store.reaches_at`.

        The second is the length of the terms of ``inverse @ world``, each of which rounds.
        """
        ids = instance_id.reshape(-1)
        extent, far = np.zeros((2, len(ids)))
        for k, rows in self._by_object(instance_id):
            one = self.objects[k]
            matrices = np.abs(self.instances.transforms[ids[rows]])
            inverses = np.abs(self.instances.inverses[ids[rows]])
            inside = np.full((len(rows), 3), np.abs(one.world_bounds).max())
            world = _product(matrices[:, :, :3], inside) + matrices[:, :, 3]
            terms = _product(inverses[:, :, :3], world) + inverses[:, :, 3]
            extent[rows] = float(one.max_coordinate)
            far[rows] = (terms.max(axis=1) + np.abs(one.center).max()) * one.scale
        return extent.reshape(instance_id.shape), far.reshape(instance_id.shape)

    def _by_object(self, instance_id: NDArray[np.int32]) -> list[tuple[int, NDArray[np.int64]]]:
        """The objects that are hit, and the rows of the hits of each, in the flattened array."""
        ids = instance_id.reshape(-1)
        rows = np.flatnonzero(ids >= 0)
        objects = self.instances.object_ids[ids[rows]]
        order = np.argsort(objects, kind="stable")
        rows, objects = rows[order], objects[order]
        firsts = np.flatnonzero(np.diff(objects, prepend=-1))
        parts = np.split(rows, firsts[1:]) if len(rows) else []
        return [(int(objects[first]), part) for first, part in zip(firsts, parts, strict=True)]


def _product(matrices: NDArray[np.float64], vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Products of matrices of shape (N, 3, 3) and vectors of shape (N, 3)."""
    return np.einsum("kij,kj->ki", matrices, vectors)
