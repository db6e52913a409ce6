"""Points spread over triangles, to estimate how much of a scene a camera sees."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raystream.core.triangles import Triangles
from raystream.scene.default_view.sizes import Mask, TriangleSizes, fractions_of

#: Expected numbers of points that count, and of others.
_TARGETS, _BLOCKERS = 1 << 13, 1 << 14

#: Steps of a sequence that covers the square evenly: powers of the inverse of the plastic number
#: (Martin Roberts, "The Unreasonable Effectiveness of Quasirandom Sequences", 2018).
_STEPS = 0.7548776662466927, 0.5698402909980532

#: Samples are in one surface if they are this far from each other's plane, in sizes of a cell.
_SAME_PLANE = 0.4

#: A cell is a hole if it is this much farther away, in sizes of a cell, than most of its eight
#: neighbours.
_HOLE_DEPTH = 1.0
_MAJORITY = 5


class SurfaceSamples(NamedTuple):
    """Points on triangles, each of which stands for the same share of the scene.

    Half of a scene is its area, and half the number of its triangles, which are small where
    there is something to see. More points, spread by area, only hide others.

    Attributes
    ----------
    positions : ndarray of shape (3, S), float32
        In the given box, whose centre is the origin, and whose longest side is 1. Those that
        count are the first.
    normals : ndarray of shape (3, S), float32
        Unit normals, on the side that sees the vertices counter-clockwise.
    target_count : int
        T, the number of points that count.
    """

    positions: NDArray[np.float32]
    normals: NDArray[np.float32]
    target_count: int

    def offsets(self, eye: ArrayLike) -> NDArray[np.float32]:
        """Vectors from an eye to the points, shape (3, S)."""
        return self.positions - np.asarray(eye, np.float32)[:, None]

    def cosines(self, offsets: NDArray[np.float32]) -> NDArray[np.float32]:
        """Cosines between the normals and the directions toward the eye, shape (T,)."""
        offsets = offsets[:, : self.target_count]
        along = np.einsum("ij,ij->j", self.normals[:, : self.target_count], offsets)
        return -along / np.sqrt(np.einsum("ij,ij->j", offsets, offsets))


def components(
    axes: NDArray[np.float64], vectors: NDArray[np.float32]
) -> tuple[NDArray[np.float32], ...]:
    """Components of vectors, shape (3, S), along three axes."""
    x, y, z = vectors
    return tuple(a * x + b * y + c * z for a, b, c in axes.astype(np.float32))


def visible(
    samples: SurfaceSamples,
    cells: NDArray[np.int32],
    distances: NDArray[np.float32],
    shape: tuple[int, int],
    size: float,
) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
    """Find the samples that are seen, in a depth image.

    Parameters
    ----------
    samples : SurfaceSamples
    cells : ndarray of shape (S,), int32
        The cell of the image in which each is.
    distances : ndarray of shape (S,), float32
        Distances from the eye.
    shape : (int, int)
        Rows and columns of the image.
    size : float
        Size of a cell at distance 1.

    Returns
    -------
    is_seen : ndarray of shape (T,), bool
        Whether the nearest sample of the cell lies in the same surface.
    nearest : ndarray of shape (C,), float32
        Distance to the nearest sample of each cell; inf without any.
    """
    nearest = np.full(shape[0] * shape[1], np.inf, np.float32)
    np.minimum.at(nearest, cells, distances)
    is_nearest = np.flatnonzero(distances == nearest[cells])
    first = np.zeros(len(nearest), np.int64)
    first[cells[is_nearest]] = is_nearest
    count = samples.target_count
    targets = cells[:count]
    others = first[targets]
    apart = samples.positions[:, :count] - np.take(samples.positions, others, axis=1)
    limits = distances[:count] * np.float32(_SAME_PLANE * size)
    # A slanted surface has many depths in a cell, all of them in its plane.
    is_seen = np.ones(count, bool)
    for normals in (samples.normals[:, :count], np.take(samples.normals, others, axis=1)):
        is_seen &= np.abs(np.einsum("ij,ij->j", normals, apart)) <= limits
    is_seen &= ~_is_hole(nearest.reshape(shape), size)[targets]
    return is_seen, nearest


def _is_hole(nearest: NDArray[np.float32], size: float) -> NDArray[np.bool_]:
    """Whether most neighbours of a cell show a nearer surface, of which it has no sample."""
    rows, columns = nearest.shape
    padded = np.full((rows + 2, columns + 2), np.inf, np.float32)
    padded[1:-1, 1:-1] = nearest * np.float32(1 + _HOLE_DEPTH * size)
    nearer = np.zeros(nearest.shape, np.int8)
    for row, column in itertools.product(range(3), repeat=2):
        nearer += padded[row : row + rows, column : column + columns] < nearest
    return (nearer >= _MAJORITY).ravel()


def sample_surfaces(
    triangles: Triangles, sizes: TriangleSizes, mask: Mask, box: NDArray[np.float32]
) -> SurfaceSamples:
    """Spread points over some triangles, independently of their order.

    Parameters
    ----------
    triangles : Triangles
    sizes : TriangleSizes
    mask : ndarray of shape (N,), bool, or None
        Those to sample: at least one.
    box : ndarray of shape (2, 3), float32
        Local frame.
    """
    count = len(sizes.areas) if mask is None else np.count_nonzero(mask)
    area = sizes.area(mask)

    per_area, each = (1.0 / area, 0.0) if area > 0.0 else (0.0, 1.0 / count)
    low, high = box.astype(np.float64)
    points, normals = [], []
    for rate, base in (
        (0.5 * _TARGETS * per_area, 0.5 * _TARGETS * (each + 1.0 / count)),
        (_BLOCKERS * per_area, _BLOCKERS * each),
    ):
        chosen, copies = sizes.pick(rate, base, mask=mask)
        corners = triangles.corners[sizes.prim_ids[chosen]].astype(np.float64)
        edges = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        across, along = (
            np.modf(fractions_of(sizes.keys[chosen], salt) + copies * step)[0][:, None]
            for salt, step in zip((2, 3), _STEPS, strict=True)
        )
        root = np.sqrt(across)  # uniform over the triangle
        spread = corners[:, 0] + root * (1.0 - along) * edges[0] + root * along * edges[1]
        points.append((spread - (low + high) / 2) / (high - low).max())
        normals.append(np.cross(*edges))
    columns = np.ascontiguousarray(np.concatenate(normals).T)
    lengths = np.sqrt(np.einsum("ij,ij->j", columns, columns))
    columns /= np.where(lengths > 0.0, lengths, 1.0)
    return SurfaceSamples(
        np.ascontiguousarray(np.concatenate(points).T, np.float32),
        columns.astype(np.float32),
        len(points[0]),
    )
