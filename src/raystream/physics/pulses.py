"""Kernels that trace the energy of light pulses and merge echoes into returns."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.cpu import device, kernel


class Surfaces(NamedTuple):
    """The surfaces that pulses hit, and their optical properties.

    Attributes
    ----------
    corners : ndarray of shape (F, 3, 3), float32, or None
        None if `Echoes.cosine` is known.
    material_ids : ndarray of shape (F,), int32
    reflectance, transmission : ndarray of shape (M,), float64
        Per material.
    threshold : float64
        A pulse is followed while it has at least this much energy.
    """

    corners: NDArray[np.float32] | None
    material_ids: NDArray[np.int32]
    reflectance: NDArray[np.float64]
    transmission: NDArray[np.float64]
    threshold: float


class Echoes(NamedTuple):
    """Echoes of pulses, one per row of `MultiHits`.

    Attributes
    ----------
    energy : ndarray of shape (K,), float64
        Energy returned, as a fraction of the pulse's; 0 after the end of the pulse.
    cosine : ndarray of shape (K,), float64
        Cosine of the angle of incidence.
    detected_count : ndarray of shape (N,), int64
        Echoes of at least the threshold's energy.
    is_spent : ndarray of shape (N,), bool
        Whether the pulse has ended.
    """

    energy: NDArray[np.float64]
    cosine: NDArray[np.float64]
    detected_count: NDArray[np.int64]
    is_spent: NDArray[np.bool_]

    @classmethod
    def empty(cls, ray_count: int, row_count: int) -> Echoes:
        """Allocate, not initialised."""
        energy, cosine = np.empty(row_count), np.empty(row_count)
        count, is_spent = np.empty(ray_count, np.int64), np.empty(ray_count, np.bool_)
        return cls(energy, cosine, count, is_spent)


@kernel
def follow_pulses(begin, end, directions, splits, prim_id, surfaces, echoes):
    """Compute the echoes of rays begin to end.

    Parameters
    ----------
    begin, end : int
    directions : ndarray of shape (N, 3), float64
        Unit length.
    splits : ndarray of shape (N + 1,), int64
    prim_id : ndarray of shape (K,), int32
        Triangles in order of distance.
    surfaces : Surfaces
    echoes : Echoes
        Written.
    """
    for i in range(np.uint64(begin), np.uint64(end)):
        left, count = 1.0, 0
        dx, dy, dz = directions[i, 0], directions[i, 1], directions[i, 2]
        for row in range(splits[i], splits[i + np.uint64(1)]):
            prim = prim_id[row]
            material = surfaces.material_ids[prim]
            cosine = _cosine_at(surfaces.corners, prim, dx, dy, dz, echoes.cosine[row])
            passing = left * surfaces.transmission[material]
            energy = (left - passing) * surfaces.reflectance[material] * cosine
            echoes.energy[row] = energy
            echoes.cosine[row] = cosine
            count += energy > 0.0 and energy >= surfaces.threshold
            left = passing if passing >= surfaces.threshold else 0.0
        echoes.detected_count[i] = count
        echoes.is_spent[i] = left == 0.0


@device
def _cosine_at(corners, i, dx, dy, dz, known):
    """The cosine at a triangle; the known one without corners."""
    if corners is None:
        return known
    return _cosine(corners, i, dx, dy, dz)


@device
def _cosine(corners, i, dx, dy, dz):
    """Cosine of the angle between a direction and a triangle's normal, either side; 0 to 1."""
    a, b, c = corners[i, 0], corners[i, 1], corners[i, 2]
    ax, ay, az = np.float64(a[0]), np.float64(a[1]), np.float64(a[2])
    px, py, pz = b[0] - ax, b[1] - ay, b[2] - az
    qx, qy, qz = c[0] - ax, c[1] - ay, c[2] - az
    nx = py * qz - pz * qy
    ny = pz * qx - px * qz
    nz = px * qy - py * qx
    # Scaled before squaring: normals of small triangles would underflow.
    largest = max(abs(nx), abs(ny), abs(nz))
    nx, ny, nz = nx / largest, ny / largest, nz / largest
    along = abs(nx * dx + ny * dy + nz * dz)
    return min(along / np.sqrt(nx * nx + ny * ny + nz * nz), 1.0)


@kernel
def merge_echoes(begin, end, splits, ranges, separation, first):
    """Merge echoes of pulses begin to end that a receiver cannot resolve.

    Parameters
    ----------
    begin, end : int
    splits : ndarray of shape (N + 1,), int64
        Pulse i has rows splits[i] to splits[i + 1], by increasing range.
    ranges : ndarray of shape (K,), float64
    separation : float
        An echo belongs to a return if it is less than this beyond the first echo.
    first : ndarray of shape (K,), bool
        Written: whether a row begins a return.
    """
    for i in range(np.uint64(begin), np.uint64(end)):
        start = -np.inf
        for row in range(splits[i], splits[i + np.uint64(1)]):
            first[row] = not ranges[row] - start < separation
            if first[row]:
                start = ranges[row]
