"""Triangles of meshes, made on all threads: of a new scene, or with moved vertices."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.triangles import (
    MAX_COORDINATE,
    Triangles,
    keeps_frame,
    local_frame,
    splits_of,
)
from raystream.jit.cpu import device, kernel
from raystream.jit.threads import chunk_size, parallel_for
from raystream.kernels.vectors import corner_of, cross, minus

#: Local coordinates beyond this need a new frame: their float32 products would overflow.
MAX_LOCAL = 2.0**40

#: Most faces that one call of the kernel moves.
_MOST = 1 << 15

# State of a triangle.
_SOLID, _DEGENERATE, _NONFINITE, _TOO_FAR = (np.uint8(kind) for kind in range(4))

_NAN = np.float32(np.nan)

_Meshes = Sequence[tuple[NDArray[Any], NDArray[np.int32]]]


class _Placed(NamedTuple):
    """Triangles in a local frame."""

    corners: NDArray[np.float32]
    kinds: NDArray[np.uint8]
    bounds: NDArray[np.float32]  # of the solid ones, local
    reach: NDArray[np.float64]  # bounds of the finite ones, world space

    def store(
        self, meshes: _Meshes, splits: NDArray[np.int64], center: NDArray[Any], scale: float
    ) -> Triangles:
        """The triangle store of these; `center` and `scale` are the frame."""
        solid = self.kinds == _SOLID
        nonfinite_count = int(np.count_nonzero(self.kinds == _NONFINITE))
        return Triangles.from_solid(
            self.corners,
            splits,
            center,
            scale,
            solid,
            nonfinite_count,
            self.bounds,
            partial(_corners, meshes, splits, center, scale),
        )


def make_triangles(meshes: _Meshes) -> Triangles:
    """Make a triangle store on all threads.

    Parameters
    ----------
    meshes : sequence of (vertices, faces)
        As in `Triangles`, C-contiguous. The store keeps these arrays: they must not change.

    Returns
    -------
    Triangles
        As ``Triangles(meshes)``, bit for bit.
    """
    splits = splits_of(meshes)
    # Most scenes need no frame of their own: then one pass is enough.
    center, scale = np.zeros(3), 1.0
    placed = _place(meshes, splits, center, scale)
    found = np.isfinite(placed.reach).all()
    frame = local_frame(*placed.reach) if found else (center, scale)
    if frame[1] != scale or frame[0].any():
        center, scale = frame
        placed = _place(meshes, splits, center, scale)
    if (placed.kinds == _TOO_FAR).any():  # beside a vertex that is not finite
        return Triangles(meshes)
    return placed.store(meshes, splits, center, scale)


def move_triangles(triangles: Triangles, meshes: _Meshes) -> Triangles:
    """Copy a triangle store with other vertices.

    Parameters
    ----------
    triangles : Triangles
    meshes : sequence of (vertices, faces)
        As in `Triangles`, with the same numbers of faces. The store keeps these arrays.

    Returns
    -------
    Triangles
        With the centre and scale of `triangles`, or as `make_triangles` if float32 is too coarse
        for the vertices there; see `core.triangles.keeps_frame`.
    """
    splits, center, scale = triangles.mesh_splits, triangles.center, triangles.scale
    placed = _place(meshes, splits, center, scale)
    low, high = placed.reach
    if (placed.kinds == _TOO_FAR).any() or not keeps_frame(low, high, center, scale):
        return make_triangles(meshes)
    return placed.store(meshes, splits, center, scale)


def _place(
    meshes: _Meshes, splits: NDArray[np.int64], center: NDArray[Any], scale: float
) -> _Placed:
    count = int(splits[-1])
    corners = np.empty((count, 3, 3), np.float32)
    kinds = np.empty(count, np.uint8)
    chunks = [chunk_size(len(faces), _MOST) for _, faces in meshes]
    counts = [-(-len(mesh[1]) // chunk) for mesh, chunk in zip(meshes, chunks, strict=True)]
    # A box for each chunk of each mesh; the first stays empty, also without meshes.
    starts = list(accumulate(counts, initial=1))
    bounds, reaches = _nothing(starts[-1], np.float32), _nothing(starts[-1], np.float64)
    frame = (center[0].item(), center[1].item(), center[2].item()), scale
    for mesh, chunk, box, first in zip(meshes, chunks, starts, splits.tolist(), strict=False):
        length = len(mesh[1])
        arrays = *mesh, corners[first : first + length], kinds[first : first + length]

        def body(
            begin: int, end: int, arrays: Any = arrays, chunk: int = chunk, box: int = box
        ) -> None:
            at = box + begin // chunk
            written: Any = *arrays, bounds[at], reaches[at]
            _move(begin, end, frame, *written)

        parallel_for(body, length, chunk)
    return _Placed(corners, kinds, _union(bounds), _union(reaches))


def _corners(
    meshes: _Meshes, splits: NDArray[np.int64], center: NDArray[Any], scale: float
) -> NDArray[np.float32]:
    """The corners alone, to restore them: a function of the module, as it is pickled."""
    return _place(meshes, splits, center, scale).corners


def _nothing(count: int, dtype: type) -> NDArray[Any]:
    """Empty boxes."""
    boxes: NDArray[Any] = np.full((count, 2, 3), np.inf, dtype)
    boxes[:, 1] = -np.inf
    return boxes


def _union(boxes: NDArray[Any]) -> NDArray[Any]:
    return np.array([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])


@device
def _is_usable(x):
    return abs(np.float64(x)) <= MAX_COORDINATE  # not NaN, not infinite


@kernel
def _move(begin, end, frame, vertices, faces, corners, kinds, bounds, reaches):
    """Move faces begin to end, and compute their bounds; `frame` is its centre and its scale."""
    center, scale = frame
    low_x, low_y, low_z = np.float32(np.inf), np.float32(np.inf), np.float32(np.inf)
    high_x, high_y, high_z = -low_x, -low_y, -low_z
    west, south, down = np.inf, np.inf, np.inf
    east, north, up = -west, -south, -down
    for i in range(np.uint64(begin), np.uint64(end)):
        kind, is_finite = _SOLID, True
        for k in range(np.uint64(3)):
            vertex = np.uint64(faces[i, k])
            x, y, z = vertices[vertex, 0], vertices[vertex, 1], vertices[vertex, 2]
            if _is_usable(x) and _is_usable(y) and _is_usable(z):
                local_x = (np.float64(x) - center[0]) * scale
                local_y = (np.float64(y) - center[1]) * scale
                local_z = (np.float64(z) - center[2]) * scale
                if max(abs(local_x), abs(local_y), abs(local_z)) > MAX_LOCAL:
                    kind = max(kind, _TOO_FAR)
                corners[i, k, 0] = np.float32(local_x)
                corners[i, k, 1] = np.float32(local_y)
                corners[i, k, 2] = np.float32(local_z)
            else:
                kind, is_finite = max(kind, _NONFINITE), False
                corners[i, k, 0] = corners[i, k, 1] = corners[i, k, 2] = _NAN
        if is_finite:
            for k in range(np.uint64(3)):
                vertex = np.uint64(faces[i, k])
                x, y, z = vertices[vertex, 0], vertices[vertex, 1], vertices[vertex, 2]
                west, east = min(west, np.float64(x)), max(east, np.float64(x))
                south, north = min(south, np.float64(y)), max(north, np.float64(y))
                down, up = min(down, np.float64(z)), max(up, np.float64(z))
        if kind == _SOLID:
            a, b, c = corners[i, 0], corners[i, 1], corners[i, 2]
            if _has_area(corners, i):
                low_x, high_x = min(low_x, a[0], b[0], c[0]), max(high_x, a[0], b[0], c[0])
                low_y, high_y = min(low_y, a[1], b[1], c[1]), max(high_y, a[1], b[1], c[1])
                low_z, high_z = min(low_z, a[2], b[2], c[2]), max(high_z, a[2], b[2], c[2])
            else:
                kind = _DEGENERATE
        kinds[i] = kind
    if begin < end:
        bounds[0, 0], bounds[0, 1], bounds[0, 2] = low_x, low_y, low_z
        bounds[1, 0], bounds[1, 1], bounds[1, 2] = high_x, high_y, high_z
        reaches[0, 0], reaches[0, 1], reaches[0, 2] = west, south, down
        reaches[1, 0], reaches[1, 1], reaches[1, 2] = east, north, up


@device
def _has_area(corners, i):
    """Whether the corners are not collinear: as in `core.triangles`, bit for bit."""
    a = corner_of(corners, i, 0)
    x, y, z = cross(minus(corner_of(corners, i, 1), a), minus(corner_of(corners, i, 2), a))
    return x != 0.0 or y != 0.0 or z != 0.0
