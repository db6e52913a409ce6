"""Triangles with moved vertices, in their old local frame."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.triangles import MAX_COORDINATE, Triangles
from raystream.jit.cpu import device, kernel
from raystream.jit.threads import parallel_for

__all__ = ["MAX_LOCAL", "move_triangles"]

#: Local coordinates beyond this need a new frame: their float32 products would overflow.
MAX_LOCAL = 2.0**40

#: Faces that one call of the kernel moves.
_CHUNK = 1 << 15

# State of a triangle.
_SOLID, _DEGENERATE, _NONFINITE, _TOO_FAR = (np.uint8(kind) for kind in range(4))

_NAN = np.float32(np.nan)


def move_triangles(
    triangles: Triangles, meshes: Sequence[tuple[NDArray[Any], NDArray[np.int32]]]
) -> Triangles:
    """Copy a triangle store with other vertices.

    Parameters
    ----------
    triangles : Triangles
    meshes : sequence of (vertices, faces)
        As in `Triangles`, with the same numbers of faces.

    Returns
    -------
    Triangles
        With the centre and scale of `triangles`, or a new frame if float32 does not suffice for
        the vertices in the old one.
    """
    count = len(triangles)
    corners = np.empty((count, 3, 3), np.float32)
    kinds = np.empty(count, np.uint8)
    all_bounds = []
    x, y, z = triangles.center.tolist()
    for (vertices, faces), first in zip(meshes, triangles.mesh_splits, strict=False):
        rows = slice(first, first + len(faces))
        bounds = np.full((-(-len(faces) // _CHUNK), 2, 3), np.inf, np.float32)
        bounds[:, 1] = -np.inf
        arrays = vertices, faces, corners[rows], kinds[rows], bounds

        def body(begin: int, end: int, arrays: Any = arrays) -> None:
            _move(begin, end, (x, y, z), triangles.scale, *arrays)

        parallel_for(body, len(faces), _CHUNK)
        all_bounds.append(bounds)
    numbers = np.bincount(kinds, minlength=4)
    if numbers[_TOO_FAR]:
        return Triangles(meshes)
    joined = np.concatenate(all_bounds) if all_bounds else np.zeros((0, 2, 3), np.float32)
    ends = joined[:, 0].min(axis=0, initial=np.inf), joined[:, 1].max(axis=0, initial=-np.inf)
    return triangles.moved(corners, kinds == _SOLID, int(numbers[_NONFINITE]), np.array(ends))


@device
def _is_usable(x):
    return abs(np.float64(x)) <= MAX_COORDINATE  # not NaN, not infinite


@kernel
def _move(begin, end, center, scale, vertices, faces, corners, kinds, bounds):
    """Move faces begin to end, a chunk, and compute their bounds."""
    chunk = begin // _CHUNK
    low_x, low_y, low_z = np.float32(np.inf), np.float32(np.inf), np.float32(np.inf)
    high_x, high_y, high_z = -low_x, -low_y, -low_z
    for i in range(np.uint64(begin), np.uint64(end)):
        kind = _SOLID
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
                kind = max(kind, _NONFINITE)
                corners[i, k, 0] = corners[i, k, 1] = corners[i, k, 2] = _NAN
        if kind == _SOLID:
            ax, ay, az = corners[i, 0, 0], corners[i, 0, 1], corners[i, 0, 2]
            bx, by, bz = corners[i, 1, 0], corners[i, 1, 1], corners[i, 1, 2]
            cx, cy, cz = corners[i, 2, 0], corners[i, 2, 1], corners[i, 2, 2]
            if _has_area(ax, ay, az, bx, by, bz, cx, cy, cz):
                low_x, high_x = min(low_x, ax, bx, cx), max(high_x, ax, bx, cx)
                low_y, high_y = min(low_y, ay, by, cy), max(high_y, ay, by, cy)
                low_z, high_z = min(low_z, az, bz, cz), max(high_z, az, bz, cz)
            else:
                kind = _DEGENERATE
        kinds[i] = kind
    if begin < end:
        bounds[chunk, 0, 0], bounds[chunk, 0, 1], bounds[chunk, 0, 2] = low_x, low_y, low_z
        bounds[chunk, 1, 0], bounds[chunk, 1, 1], bounds[chunk, 1, 2] = high_x, high_y, high_z


@device
def _has_area(ax, ay, az, bx, by, bz, cx, cy, cz):
    """Whether the corners are not collinear: as in `core.triangles`, bit for bit."""
    x1 = np.float64(bx) - np.float64(ax)
    y1 = np.float64(by) - np.float64(ay)
    z1 = np.float64(bz) - np.float64(az)
    x2 = np.float64(cx) - np.float64(ax)
    y2 = np.float64(cy) - np.float64(ay)
    z2 = np.float64(cz) - np.float64(az)
    return y1 * z2 - z1 * y2 != 0.0 or z1 * x2 - x1 * z2 != 0.0 or x1 * y2 - y1 * x2 != 0.0
