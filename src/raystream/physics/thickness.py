"""Thickness: the segments of rays inside closed meshes."""

from __future__ import annotations

import enum
from collections.abc import Sequence
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.hits import RayRows
from raystream.core.memory import check_memory
from raystream.core.rays import RayBatch, RayStatus
from raystream.kernels.solids import Solids

Grouping = Literal["mesh", "material"]

_SPLIT_BY = ("mesh", "material")


class UnpairedKind(enum.IntEnum):
    """The kind of an unpaired crossing.

    Attributes
    ----------
    ENTRY
        An entry without an exit: the ray's interval ends inside, or the mesh is open.
    EXIT
        An exit without an entry: the ray begins inside, or the mesh is open.
    """

    ENTRY = 0
    EXIT = 1


class Segments(NamedTuple):
    """Columns of segments of `Thickness`."""

    t_entry: NDArray[np.float32]
    t_exit: NDArray[np.float32]
    path_length: NDArray[np.float64]
    mesh_id: NDArray[np.int32]
    material_id: NDArray[np.int32]
    entry_prim_id: NDArray[np.int32]
    exit_prim_id: NDArray[np.int32]
    instance_id: NDArray[np.int32]


class Unpaired(NamedTuple):
    """Columns of unpaired crossings of `Thickness`."""

    ray: NDArray[np.int64]
    t: NDArray[np.float32]
    prim_id: NDArray[np.int32]
    mesh_id: NDArray[np.int32]
    kind: NDArray[np.uint8]
    instance_id: NDArray[np.int32]


class Thickness(RayRows):
    """Segments of rays inside closed meshes, as rows delimited by `ray_splits`.

    A segment extends from where a ray enters a mesh to where it has left all of it. Segments
    of different meshes may overlap, except with ``nested="inner"``.

    Attributes
    ----------
    ray_splits : ndarray of shape (N + 1,), int64
        Ray i owns the segments ray_splits[i] to ray_splits[i + 1]; rays are numbered in the
        C order of their leading shape S.
    t_entry, t_exit : ndarray of shape (K,), float32, or float64 of a tracer in float64
        Distances in direction lengths, in order of entry.
    path_length : ndarray of shape (K,), float64
        Scene units: (t_exit - t_entry) * length of the direction.
    mesh_id : ndarray of shape (K,), int32
    material_id : ndarray of shape (K,), int32
        Index in ``scene.materials``: the material of the entry triangle, or of the exit
        triangle if the ray began inside.
    entry_prim_id, exit_prim_id : ndarray of shape (K,), int32
        The triangles; -1 where ``ends="clip"`` clipped the segment. Where another mesh displaces
        it, that mesh's.
    instance_id : ndarray of shape (K,), int32
        The instance that the mesh is in; 0 in a scene without instances. Each instance of a mesh
        is a solid of its own.
    unpaired_ray : ndarray of shape (U,), int64
        The ray of each crossing that is not the end of a segment, in increasing order; within a
        ray by distance.
    unpaired_t, unpaired_prim_id, unpaired_mesh_id : ndarray of shape (U,)
        Distance, triangle and mesh of the crossing: of the type of `t_exit`, int32, int32.
    unpaired_kind : ndarray of shape (U,), uint8
        An `UnpairedKind`.
    unpaired_instance_id : ndarray of shape (U,), int32
    status : ndarray of shape S, uint8
        A `RayStatus` for each ray.
    mesh_is_closed, mesh_is_flipped : ndarray of shape (M,), bool
        Whether each mesh of the scene is closed, and whether its triangles face inward and
        were flipped.
    mesh_names, material_names : tuple of str
        Names of the scene's meshes and materials.
    """

    def __init__(
        self,
        ray_splits: NDArray[np.int64],
        segments: Segments,
        unpaired: Unpaired,
        status: NDArray[np.uint8],
        solids: Solids,
        names: tuple[Sequence[str], Sequence[str]],
    ) -> None:
        self.ray_splits = ray_splits
        self.t_entry, self.t_exit, self.path_length = segments[:3]
        self.mesh_id, self.material_id = segments.mesh_id, segments.material_id
        self.entry_prim_id, self.exit_prim_id = segments.entry_prim_id, segments.exit_prim_id
        self.instance_id = segments.instance_id
        self.unpaired_ray, self.unpaired_t = unpaired.ray, unpaired.t
        self.unpaired_prim_id, self.unpaired_mesh_id = unpaired.prim_id, unpaired.mesh_id
        self.unpaired_kind = unpaired.kind
        self.unpaired_instance_id = unpaired.instance_id
        self.status = status
        self.mesh_is_closed, self.mesh_is_flipped = solids.is_closed, solids.is_flipped
        self.mesh_names, self.material_names = tuple(names[0]), tuple(names[1])

    @cached_property
    def is_complete(self) -> NDArray[np.bool_]:
        """Whether each ray is valid and all its crossings are paired; of the leading shape."""
        complete = self.status.ravel() == RayStatus.VALID
        complete[self.unpaired_ray] = False
        return complete.reshape(self.status.shape)

    def total_length(self, by: Grouping | None = None) -> NDArray[np.float64]:
        """Sum up the lengths of each ray's segments.

        Parameters
        ----------
        by : {"mesh", "material"}, optional
            Give one sum per mesh or per material.

        Returns
        -------
        ndarray of shape S, S + (mesh count,) or S + (material count,), float64
            Scene units. Overlapping segments of different meshes both count; there are none with
            ``nested="inner"``. Where `is_complete` is False, lengths may be missing.

        Raises
        ------
        ValueError
            If `by` is unknown.
        MemoryError
            If there is not enough memory for the array.
        """
        ray_count, shape = len(self.ray_splits) - 1, self.status.shape
        if by is None:
            return _sums(self.ray_id, self.path_length, ray_count).reshape(shape)
        width = len(self.group_names(by))
        check_memory(ray_count * width * 8, f"total_length: {ray_count:,} x {width:,} sums would")
        cell = self.ray_id * width + self.group_ids(by)
        return _sums(cell, self.path_length, ray_count * width).reshape(*shape, width)

    def group_ids(self, by: Grouping) -> NDArray[np.int32]:
        """`mesh_id` or `material_id`."""
        if by not in _SPLIT_BY:
            raise ValueError(f"by: expected 'mesh' or 'material', got {by!r}")
        return self.mesh_id if by == "mesh" else self.material_id

    def group_names(self, by: Grouping) -> tuple[str, ...]:
        """`mesh_names` or `material_names`."""
        if by not in _SPLIT_BY:
            raise ValueError(f"by: expected 'mesh' or 'material', got {by!r}")
        return self.mesh_names if by == "mesh" else self.material_names

    def __repr__(self) -> str:
        return (
            f"Thickness({len(self.t_entry):,} segments of {len(self.ray_splits) - 1:,} rays, "
            f"{len(self.unpaired_t):,} unpaired crossings)"
        )


def _sums(cells: NDArray[np.int64], values: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    return np.asarray(np.bincount(cells, values, count), np.float64)


def direction_lengths(batch: RayBatch, rows: slice) -> NDArray[np.float64]:
    """Lengths of rays' directions, without overflow or underflow."""
    directions = batch.directions[rows].astype(np.float64)
    largest = np.abs(directions).max(axis=1, initial=0.0)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        scaled: Any = np.linalg.norm(directions / largest[:, None], axis=1)
        lengths: NDArray[np.float64] = scaled * largest
    return lengths
