"""Whether meshes are closed, where they are not, and which side of their triangles is inside."""

from __future__ import annotations

from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from raystream.core.triangles import Triangles
from raystream.jit.cpu import device, kernel
from raystream.jit.simd import float_as_bits
from raystream.jit.threads import parallel_for
from raystream.kernels.vectors import corner_of, cross, dot

#: Triangles per call of the kernel: some milliseconds.
_CHUNK = 1 << 16

# Constants of the mixing steps of splitmix64 (Steele, Lea and Flood, "Fast Splittable
# Pseudorandom Number Generators", OOPSLA 2014).
_FIRST = np.uint64(0xBF58476D1CE4E5B9)
_SECOND = np.uint64(0x94D049BB133111EB)
_STEP = np.uint64(0x9E3779B97F4A7C15)


class Solids(NamedTuple):
    """Properties of M meshes as solids.

    Attributes
    ----------
    is_closed : ndarray of shape (M,), bool
        Whether the triangles that can be hit traverse every edge as often in one direction as in
        the other; or else, whether all finite triangles do. Vertices with equal positions count as
        one.
    is_flipped : ndarray of shape (M,), bool
        Whether it is closed and its normals point inward: its signed volume is negative.
    is_empty : ndarray of shape (M,), bool
        Whether no triangle of it can be hit; then it is not closed.
    has_slivers : ndarray of shape (M,), bool
        Whether triangles without area are needed to close it. They cannot be hit, so that a ray
        within rounding errors of one may miss the mesh there, or cross it twice.
    volumes : ndarray of shape (M,), float64
        Absolute volumes in world units; infinite for meshes that are not closed.
    is_closed_together : bool
        Whether all meshes as one are closed: those of a file may be parts of one surface. True
        without any triangle.
    """

    is_closed: NDArray[np.bool_]
    is_flipped: NDArray[np.bool_]
    is_empty: NDArray[np.bool_]
    has_slivers: NDArray[np.bool_]
    volumes: NDArray[np.float64]
    is_closed_together: bool


class OpenEdges(NamedTuple):
    """Edges that triangles traverse more often in one direction than in the other.

    Attributes
    ----------
    mesh_ids : ndarray of shape (M,), int64
        The meshes with triangles at those edges, in increasing order.
    ends : ndarray of shape (K, 2, 3), float64
        World space, in order of the first triangle of each.
    """

    mesh_ids: NDArray[np.int64]
    ends: NDArray[np.float64]


_known: WeakKeyDictionary[Triangles, Solids] = WeakKeyDictionary()


def solids_of(triangles: Triangles) -> Solids:
    """Analyse each mesh of a triangle store, once.

    Notes
    -----
    Edges are not matched one by one: each adds a hash to a sum, and its reverse subtracts it.
    Hashes have 64 bits, so a sum that is zero by chance is as unlikely as a collision.
    """
    found = _known.get(triangles)
    if found is None:
        found = _known[triangles] = _analyse(triangles)
    return found


def open_edges(triangles: Triangles) -> OpenEdges:
    """Find the edges at which the meshes that are not closed, as one, are open."""
    meshes = np.repeat(np.arange(len(triangles.mesh_splits) - 1), np.diff(triangles.mesh_splits))
    is_open = ~solids_of(triangles).is_closed[meshes]
    solid, slivers = triangles.prim_ids, _slivers(triangles)
    solid, slivers = solid[is_open[solid]], slivers[is_open[slivers]]
    found = _unmatched(triangles, solid, meshes)
    if len(slivers):  # they close some edges, or they are what is left over
        both = _unmatched(triangles, np.sort(np.concatenate([solid, slivers])), meshes)
        found = min(found, both, key=lambda edges: len(edges.ends))
    return found


def _unmatched(
    triangles: Triangles, prim_ids: NDArray[np.int32], meshes: NDArray[np.int64]
) -> OpenEdges:
    corners = triangles.corners[prim_ids]
    # Numbers of positions: hashes, as sorting the positions themselves takes ten times as long.
    zero, kind = corners.dtype.type(0.0), f"u{corners.itemsize}"
    bits = (corners + zero).view(kind).astype(np.uint64)  # -0 becomes 0
    ids = bits[:, :, 0] * _STEP
    for axis in (1, 2):
        ids = ((ids ^ (ids >> np.uint64(29))) + bits[:, :, axis]) * _FIRST
    starts, ends = ids.ravel(), np.roll(ids, -1, axis=1).ravel()
    low, high = np.minimum(starts, ends), np.maximum(starts, ends)
    edges = (low ^ (low >> np.uint64(31))) * _SECOND + high
    _, firsts, which = np.unique(edges, return_index=True, return_inverse=True)
    excess = np.bincount(which, (starts < ends).astype(float) - (starts > ends))
    is_open = excess != 0.0
    row, side = np.divmod(np.sort(firsts[is_open]), 3)
    local = np.stack([corners[row, side], corners[row, (side + 1) % 3]], axis=1)
    owners = prim_ids[np.flatnonzero(is_open[which]) // 3]
    return OpenEdges(np.unique(meshes[owners]), triangles.to_world(local))


def _slivers(triangles: Triangles) -> NDArray[np.int32]:
    """The triangles that are finite and have no area."""
    if not triangles.degenerate_count:
        return np.zeros(0, np.int32)
    rest = np.ones(len(triangles), bool)
    rest[triangles.prim_ids] = False
    ids = np.flatnonzero(rest)
    return ids[np.isfinite(triangles.corners[ids]).all(axis=(1, 2))].astype(np.int32)


def _analyse(triangles: Triangles) -> Solids:
    count = len(triangles.mesh_splits) - 1
    edges, volumes, filled = _sums(triangles, triangles.prim_ids)
    is_closed = filled & (edges == 0)
    has_slivers = np.zeros(count, bool)
    is_closed_together = bool(edges.sum() == 0)
    if not is_closed[filled].all():
        slivers = _slivers(triangles)
        if len(slivers):
            all_edges = edges + _sums(triangles, slivers)[0]
            has_slivers = filled & ~is_closed & (all_edges == 0)
            is_closed |= has_slivers
            is_closed_together |= bool(all_edges[~is_closed].sum() == 0)
    sizes = np.where(is_closed, np.abs(volumes) / (6.0 * triangles.scale**3), np.inf)
    is_flipped = is_closed & (volumes < 0.0)
    return Solids(is_closed, is_flipped, ~filled, has_slivers, sizes, is_closed_together)


def _sums(
    triangles: Triangles, prim_ids: NDArray[np.int32]
) -> tuple[NDArray[np.uint64], NDArray[np.float64], NDArray[np.bool_]]:
    """Sums of hashes and volumes of some triangles of each mesh; whether it has any of them."""
    edges = np.empty(len(prim_ids), np.uint64)
    volumes = np.empty(len(prim_ids))

    def body(begin: int, end: int) -> None:
        _hash_and_measure(begin, end, triangles.corners, prim_ids, edges, volumes)

    parallel_for(body, len(prim_ids), _CHUNK)
    splits = np.searchsorted(prim_ids, triangles.mesh_splits)
    filled = np.diff(splits) > 0
    sums = np.zeros(len(filled), np.uint64), np.zeros(len(filled))
    if filled.any():
        firsts = splits[:-1][filled]
        for total, parts in zip(sums, (edges, volumes), strict=True):
            total[filled] = np.add.reduceat(parts, firsts)
    return *sums, filled


@kernel
def _hash_and_measure(begin, end, corners, prim_ids, edges, volumes):
    """Write what triangles begin to end contribute to the sums of their mesh.

    Parameters
    ----------
    begin, end : int
    corners : ndarray of shape (F, 3, 3), float32
    prim_ids : ndarray of shape (A,), int32
    edges : ndarray of shape (A,), uint64
        Written: sums of the hashes of their three edges.
    volumes : ndarray of shape (A,), float64
        Written: six times the signed volume between the triangle and the local origin.
    """
    for i in range(np.uint64(begin), np.uint64(end)):
        prim_id = prim_ids[i]
        a, b = corner_of(corners, prim_id, 0), corner_of(corners, prim_id, 1)
        c = corner_of(corners, prim_id, 2)
        hash_a, hash_b, hash_c = _hash_point(a), _hash_point(b), _hash_point(c)
        edges[i] = (
            _hash_edge(hash_a, hash_b) + _hash_edge(hash_b, hash_c) + _hash_edge(hash_c, hash_a)
        )
        volumes[i] = dot(a, cross(b, c))


@device
def _mix(bits):
    bits = (bits ^ (bits >> np.uint64(30))) * _FIRST
    bits = (bits ^ (bits >> np.uint64(27))) * _SECOND
    return bits ^ (bits >> np.uint64(31))


@device
def _hash_point(point):
    bits = _STEP
    for axis in range(3):
        number = point[axis] + 0.0  # turns -0 into 0, the same position
        bits = _mix(bits + _STEP + np.uint64(float_as_bits(number)))
    return bits


@device
def _hash_edge(hash_a, hash_b):
    """The hash of an edge; the reverse edge has its negative, modulo 2**64."""
    return _mix(hash_a + _mix(hash_b)) - _mix(hash_b + _mix(hash_a))
