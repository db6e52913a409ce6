"""Triangles: the float32 triangle store that every structure is built from."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.solid_parts import SolidPart
from raystream.core.store import Store

if TYPE_CHECKING:
    from raystream.core.hits import HitColumns

#: Coordinates beyond this count as non-finite: products of three would leave float64.
MAX_COORDINATE = 2.0**200

#: prim_id is int32.
MAX_TRIANGLES = 2**31 - 2

#: A scene is recentred when it lies further from the origin than this many times its extent:
#: below, float32 loses at most 4 of its 24 bits to the distance.
RECENTRE_RATIO = 16.0

#: Local coordinates outside these powers of two are scaled, so that products of three
#: coordinates neither overflow nor vanish in float32.
SCALE_EXPONENTS = (-10, 20)


#: Held to keep restored corners, not while they are computed, which takes other threads.
_KEEPING = threading.Lock()


class Triangles(Store):
    """Triangles of a scene, in a local frame where float32 suffices.

    ``local = (world - center) * scale``. The centre is zero and the scale is one for
    ordinary scenes. Otherwise both are exact: the centre is a multiple of a power of two as large
    as the scene, the scale is a power of two, and the subtraction is done in float64.

    Parameters
    ----------
    meshes : sequence of (vertices, faces)
        Arrays of shape (V, 3), float, and (F, 3), int32, with indices in range.

    Attributes
    ----------
    corners : ndarray of shape (F, 3, 3), float32
        Vertices 0, 1, 2 of each triangle, local frame; row = `prim_id`. Structures with their own
        copy of the triangles free it, see `release`; the next access restores it. Who passes its
        address on holds the array itself, as another thread may free it here at any time.
    prim_ids : ndarray of shape (A,), int32
        The triangles that can be hit, in increasing order: the finite ones with an area.
    mesh_splits : ndarray of shape (M + 1,), int64
        Mesh i owns the prim_ids in [mesh_splits[i], mesh_splits[i + 1]).
    center : ndarray of shape (3,), float64
        World position of the local origin.
    scale : float
        Local units per world unit.
    bounds : ndarray of shape (2, 3), float32
        Low and high corner of the box around `prim_ids`, local frame; zeros without any.
    max_coordinate : float32
        Largest absolute coordinate of `prim_ids`, local frame.
    degenerate_count, nonfinite_count : int
        Triangles left out: without area, or with a vertex that is NaN, infinite or beyond
        `MAX_COORDINATE`.
    attributes : Attributes or None
        Of the meshes, if the triangles come from a scene: used by hits, not by queries.
    """

    bounds: NDArray[np.float32]
    degenerate_count: int
    nonfinite_count: int
    _corners: NDArray[np.float32] | None
    _prim_ids: NDArray[np.int32] | None  # None for all
    _restore: Callable[[], NDArray[np.float32]] | None = None

    def __init__(self, meshes: Sequence[tuple[NDArray[Any], NDArray[np.int32]]]) -> None:
        self.mesh_splits = splits_of(meshes)
        count = len(self)
        usable = [usable_vertices(vertices) for vertices, _ in meshes]
        finite = np.ones(count, bool)
        for (_, faces), good, first in zip(meshes, usable, self.mesh_splits, strict=False):
            if not good.all():
                finite[first : first + len(faces)] = good[faces].all(axis=1)
        self.nonfinite_count = count - int(np.count_nonzero(finite))

        low, high = finite_bounds(meshes, finite, self.mesh_splits)
        self.center, self.scale = local_frame(low, high)

        corners = np.empty((count, 3, 3), np.float32)
        for (vertices, faces), good, first in zip(meshes, usable, self.mesh_splits, strict=False):
            local = self.to_local(vertices)
            if not good.all():
                local[~good] = np.nan
            corners[first : first + len(faces)] = local[faces]

        self._corners = corners
        self._set_solid(*_solid(corners, finite))

    @classmethod
    def from_local(
        cls,
        corners: NDArray[np.float32],
        mesh_splits: NDArray[np.int64],
        center: NDArray[np.float64],
        scale: float,
    ) -> Triangles:
        """Make the store from corners that are in a local frame already, as from a file."""
        finite: NDArray[np.bool_] = np.all(np.isfinite(corners), axis=(1, 2))
        nonfinite_count = len(corners) - int(np.count_nonzero(finite))
        solid, bounds = _solid(corners, finite)
        frame = mesh_splits, center, scale
        return cls.from_solid(corners, *frame, solid, nonfinite_count, bounds)

    @classmethod
    def from_solid(
        cls,
        corners: NDArray[np.float32],
        mesh_splits: NDArray[np.int64],
        center: NDArray[np.float64],
        scale: float,
        solid: NDArray[np.bool_],
        nonfinite_count: int,
        bounds: NDArray[np.float32],
        restore: Callable[[], NDArray[np.float32]] | None = None,
    ) -> Triangles:
        """Make the store of triangles that were examined already.

        Parameters
        ----------
        corners : ndarray of shape (F, 3, 3), float32
            Local frame; NaN for vertices that are not finite.
        mesh_splits, center, scale
            See `Triangles`.
        solid : ndarray of shape (F,), bool
            The finite triangles that have an area.
        nonfinite_count : int
        bounds : ndarray of shape (2, 3), float32
            Of the solid triangles; ignored without any.
        restore : callable, optional
            Returns equal corners: then `release` may free these.

        Returns
        -------
        Triangles
            See `kernels.move_triangles`, which computes the arguments.
        """
        triangles = cls.__new__(cls)
        triangles._corners, triangles.mesh_splits = corners, mesh_splits
        triangles.center, triangles.scale = center, scale
        triangles.nonfinite_count = nonfinite_count
        triangles._restore = restore
        triangles._set_solid(solid, bounds)
        return triangles

    def _set_solid(self, solid: NDArray[np.bool_], bounds: NDArray[np.float32]) -> None:
        count = len(self.corners)
        self._prim_ids = None if solid.all() else np.flatnonzero(solid).astype(np.int32)
        solid_count = len(self.prim_ids)
        self.degenerate_count = count - self.nonfinite_count - solid_count
        self.bounds = bounds if solid_count else np.zeros((2, 3), np.float32)
        self.max_coordinate = np.float32(np.abs(self.bounds).max())

    @property
    def corners(self) -> NDArray[np.float32]:
        """Vertices 0, 1, 2 of each triangle, shape (F, 3, 3), float32, local frame."""
        corners = self._corners
        if corners is None:
            assert self._restore is not None
            restored = self._restore()
            with _KEEPING:  # threads that restore them at once share one array
                corners = self._corners
                if corners is None:
                    self._corners = corners = restored
        return corners

    @property
    def has_corners(self) -> bool:
        """Whether `corners` is kept now, rather than computed by the next access."""
        return self._corners is not None

    @property
    def prim_ids(self) -> NDArray[np.int32]:
        """The triangles that can be hit, shape (A,), int32, in increasing order."""
        if self._prim_ids is None:
            return np.arange(len(self), dtype=np.int32)
        return self._prim_ids

    @property
    def is_empty(self) -> bool:  # type: ignore[override]
        """Whether nothing can be hit."""
        return len(self.prim_ids) == 0

    def solid_numbers(self) -> NDArray[np.integer[Any]]:
        """The kernels' numbers of triangles that can be hit: `prim_ids`."""
        return self.prim_ids

    def release(self) -> None:
        """Free `corners` if they can be computed again: 36 bytes per triangle.

        Arrays that `corners` returned before stay valid.
        """
        if self._restore is not None:
            with _KEEPING:
                self._corners = None

    @property
    def byte_count(self) -> int:
        """Bytes of the arrays that are kept now, without the attributes."""
        arrays = (self._corners, self._prim_ids)
        return sum(array.nbytes for array in arrays if array is not None)

    def __len__(self) -> int:
        return int(self.mesh_splits[-1])

    def saved_arrays(self) -> dict[str, NDArray[Any]]:
        """See `Store.saved_arrays`."""
        return {
            "corners": self.corners,
            "mesh_splits": self.mesh_splits,
            "center": self.center,
            "scale": np.array(self.scale),
        }

    def solid_parts(self) -> list[SolidPart]:
        """The triangles themselves; see `Store`."""
        return [SolidPart(self)]

    def object_corners(self) -> NDArray[np.float32]:
        """`corners`; of `InstancedTriangles`, those of all objects."""
        return self.corners

    def to_local(self, points: NDArray[Any], number: Any = np.float32) -> NDArray[Any]:
        """Move world-space points of shape (..., 3) into the local frame, as a type of number."""
        with np.errstate(invalid="ignore", over="ignore"):
            if self.scale == 1.0 and not self.center.any():
                return np.array(points, number)
            return ((np.asarray(points, np.float64) - self.center) * self.scale).astype(number)

    def corners_at(
        self,
        prim_id: NDArray[np.int32],
        instance_id: NDArray[np.int32],  # noqa: ARG002
    ) -> NDArray[np.float64]:
        """Corners of triangles, shape (..., 3, 3), float64, local frame; NaN for -1."""
        if len(self) == 0:
            return np.full((*prim_id.shape, 3, 3), np.nan)
        corners = self.corners[prim_id].astype(np.float64)
        corners[prim_id < 0] = np.nan
        return corners

    def flat_corners(self, hits: HitColumns) -> NDArray[np.float32]:
        """Corners of the triangles that are hit, shape (N, 3, 3), float32, local frame."""
        return self.corners[hits.prim_id]

    @property
    def world_bounds(self) -> NDArray[np.float64]:
        """`bounds` in world space, shape (2, 3), float64."""
        return self.to_world(self.bounds) if len(self.prim_ids) else np.zeros((2, 3))


def splits_of(meshes: Sequence[tuple[NDArray[Any], NDArray[np.int32]]]) -> NDArray[np.int64]:
    """The first prim_id of each mesh, and the number of triangles; see `Triangles.mesh_splits`.

    Raises
    ------
    ValueError
        If there are too many triangles.
    """
    splits = np.cumsum([0, *(len(faces) for _, faces in meshes)], dtype=np.int64)
    if splits[-1] > MAX_TRIANGLES:
        raise ValueError(f"scene: {splits[-1]:,} triangles are more than {MAX_TRIANGLES:,}")
    return splits


def local_frame(
    low: NDArray[np.float64], high: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float]:
    """Choose the centre and the power-of-two scale for a scene with these world bounds."""
    center = np.zeros(3)
    extent = float((high - low).max())
    reach = _reach(low, high, center)
    if extent > 0.0 and reach > RECENTRE_RATIO * extent:
        grid = 2.0 ** math.ceil(math.log2(extent))
        center = np.round((low + (high - low) / 2) / grid) * grid
        reach = _reach(low, high, center)
    exponent = math.frexp(reach)[1] if reach > 0.0 else 0
    ordinary = reach == 0.0 or SCALE_EXPONENTS[0] <= exponent <= SCALE_EXPONENTS[1]
    return center, 1.0 if ordinary else 2.0**-exponent


def keeps_frame(
    low: NDArray[np.float64], high: NDArray[np.float64], center: NDArray[np.float64], scale: float
) -> bool:
    """Whether moved vertices with these world bounds can stay in a frame.

    They can as long as float32 rounds them no more coarsely, relative to their extent, than in the
    worst frame that `local_frame` chooses, and no product leaves its range. So a scene that moves
    to and fro keeps its frame.
    """
    extent, reach = float((high - low).max()), _reach(low, high, center)
    if not extent > 0.0:  # nothing can be hit
        return True
    lowest, highest = SCALE_EXPONENTS
    is_ordinary = lowest <= math.frexp(reach * scale)[1] <= highest
    return is_ordinary and reach <= RECENTRE_RATIO * extent


def _reach(
    low: NDArray[np.float64], high: NDArray[np.float64], center: NDArray[np.float64]
) -> float:
    """Largest distance of a box from a centre along an axis."""
    return float(np.maximum(np.abs(low - center), np.abs(high - center)).max())


def usable_vertices(vertices: NDArray[Any]) -> NDArray[np.bool_]:
    """Which vertices are finite, and not beyond `MAX_COORDINATE`."""
    if vertices.dtype == np.float32:
        good = np.isfinite(vertices)  # MAX_COORDINATE is beyond float32
    else:
        with np.errstate(invalid="ignore"):
            good = np.abs(vertices) <= MAX_COORDINATE
    # The whole array first: along the short axis NumPy is ten times slower.
    return np.ones(len(vertices), bool) if good.all() else good.all(axis=1)


def _extremes(points: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Lowest and highest coordinates of points of shape (..., 3)."""
    axes = np.ascontiguousarray(points.reshape(-1, 3).T)  # reductions of rows are fast
    return axes.min(axis=1), axes.max(axis=1)


def finite_bounds(
    meshes: Sequence[tuple[NDArray[Any], NDArray[np.int32]]],
    finite: NDArray[np.bool_],
    splits: NDArray[np.int64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Corners of the box around the vertices that finite triangles use."""
    lows, highs = [], []
    for (vertices, faces), first in zip(meshes, splits, strict=False):
        kept = finite[first : first + len(faces)]
        if not kept.any():
            continue
        used = np.zeros(len(vertices), bool)
        used[faces if kept.all() else faces[kept]] = True
        low, high = _extremes(vertices if used.all() else vertices[used])
        lows.append(low.astype(np.float64))
        highs.append(high.astype(np.float64))
    if not lows:
        return np.zeros(3), np.zeros(3)
    return np.min(lows, axis=0), np.max(highs, axis=0)


def _solid(
    corners: NDArray[np.float32], finite: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
    """Which triangles can be hit, and the bounds of these."""
    solid = finite & _has_area(corners)
    bounds = np.zeros((2, 3), np.float32)
    if solid.any():
        bounds[:] = _extremes(corners if solid.all() else corners[solid])
    return solid, bounds


def _has_area(corners: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Whether the corners are not collinear.

    In float64 the differences of float32 numbers are exact (but for extreme ratios), and
    the two products of a collinear triangle are the same number, rounded the same way.
    """
    result = np.empty(len(corners), bool)
    block = 1 << 18  # keeps the float64 temporaries small
    for first in range(0, len(corners), block):
        part = corners[first : first + block].transpose(1, 2, 0).astype(np.float64, order="C")
        with np.errstate(invalid="ignore", over="ignore"):
            x1, y1, z1 = part[1] - part[0]
            x2, y2, z2 = part[2] - part[0]
            result[first : first + block] = (
                (y1 * z2 - z1 * y2 != 0.0) | (z1 * x2 - x1 * z2 != 0.0) | (x1 * y2 - y1 * x2 != 0.0)
            )
    return result
