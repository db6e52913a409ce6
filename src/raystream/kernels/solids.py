"""Whether meshes are closed, and which side of their triangles is the inside."""

from __future__ import annotations

from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from raystream.core.triangles import Triangles
from raystream.jit.cpu import device, kernel
from raystream.jit.simd import float_as_bits
from raystream.jit.threads import parallel_for

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
        the other. Vertices with equal positions count as one.
    is_flipped : ndarray of shape (M,), bool
        Whether it is closed and its normals point inward: its signed volume is negative.
    is_empty : ndarray of shape (M,), bool
        Whether no triangle of it can be hit; then it is not closed.
    is_closed_together : bool
        Whether all meshes as one are closed: those of a file may be parts of one surface. True
        without any triangle.
    """

    is_closed: NDArray[np.bool_]
    is_flipped: NDArray[np.bool_]
    is_empty: NDArray[np.bool_]
    is_closed_together: bool


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


def _analyse(triangles: Triangles) -> Solids:
    prim_ids = triangles.prim_ids
    edges = np.empty(len(prim_ids), np.uint64)
    volumes = np.empty(len(prim_ids))

    def body(begin: int, end: int) -> None:
        _hash_and_measure(begin, end, triangles.corners, prim_ids, edges, volumes)

    parallel_for(body, len(prim_ids), _CHUNK)
    splits = np.searchsorted(prim_ids, triangles.mesh_splits)
    filled = np.diff(splits) > 0
    is_closed, is_flipped = filled.copy(), np.zeros(len(filled), bool)
    if filled.any():
        firsts = splits[:-1][filled]
        is_closed[filled] = np.add.reduceat(edges, firsts) == 0
        is_flipped[filled] = np.add.reduceat(volumes, firsts) < 0.0
    return Solids(is_closed, is_flipped & is_closed, ~filled, bool(edges.sum() == 0))


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
        a, b, c = corners[prim_ids[i], 0], corners[prim_ids[i], 1], corners[prim_ids[i], 2]
        hash_a, hash_b, hash_c = _hash_point(a), _hash_point(b), _hash_point(c)
        edges[i] = (
            _hash_edge(hash_a, hash_b) + _hash_edge(hash_b, hash_c) + _hash_edge(hash_c, hash_a)
        )
        ax, ay, az = np.float64(a[0]), np.float64(a[1]), np.float64(a[2])
        bx, by, bz = np.float64(b[0]), np.float64(b[1]), np.float64(b[2])
        cx, cy, cz = np.float64(c[0]), np.float64(c[1]), np.float64(c[2])
        volumes[i] = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)


@device
def _mix(bits):
    bits = (bits ^ (bits >> np.uint64(30))) * _FIRST
    bits = (bits ^ (bits >> np.uint64(27))) * _SECOND
    return bits ^ (bits >> np.uint64(31))


@device
def _hash_point(point):
    bits = _STEP
    for axis in range(3):
        # Adding zero turns -0 into 0, the same position.
        number = np.float64(point[axis]) + 0.0
        bits = _mix(bits + _STEP + np.uint64(float_as_bits(number)))
    return bits


@device
def _hash_edge(hash_a, hash_b):
    """The hash of an edge; the reverse edge has its negative, modulo 2**64."""
    return _mix(hash_a + _mix(hash_b)) - _mix(hash_b + _mix(hash_a))
