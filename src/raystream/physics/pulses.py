"""What becomes of a pulse of light on its way, and how echoes merge into returns."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.jit.cpu import device, kernel

__all__ = ["Echoes", "Surfaces", "follow_pulses", "merge_echoes"]


class Surfaces(NamedTuple):
    """What pulses meet, and what it does to them.

    Attributes
    ----------
    corners : ndarray of shape (F, 3, 3), float32
    material_ids : ndarray of shape (F,), int32
    reflectance, transmission : ndarray of shape (M,), float64
        Of each material.
    threshold : float64
        A pulse is followed while it has at least so much energy.
    """

    corners: NDArray[np.float32]
    material_ids: NDArray[np.int32]
    reflectance: NDArray[np.float64]
    transmission: NDArray[np.float64]
    threshold: float


class Echoes(NamedTuple):
    """Echoes of pulses: one for each row of `MultiHits`.

    Attributes
    ----------
    energy : ndarray of shape (K,), float64
        That comes back, as part of the pulse's; 0 where the pulse has ended before.
    cosine : ndarray of shape (K,), float64
        Of the angle of incidence.
    noticed_count : ndarray of shape (N,), int64
        Echoes of at least the threshold's energy.
    is_spent : ndarray of shape (N,), bool
        Whether the pulse has ended.
    """

    energy: NDArray[np.float64]
    cosine: NDArray[np.float64]
    noticed_count: NDArray[np.int64]
    is_spent: NDArray[np.bool_]

    @classmethod
    def empty(cls, ray_count: int, row_count: int) -> Echoes:
        """Make room, not initialised."""
        energy, cosine = np.empty(row_count), np.empty(row_count)
        count, is_spent = np.empty(ray_count, np.int64), np.empty(ray_count, np.bool_)
        return cls(energy, cosine, count, is_spent)


@kernel
def follow_pulses(begin, end, directions, splits, prim_id, surfaces, echoes):
    """Find the echoes of rays begin to end.

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
            cosine = _cosine(surfaces.corners, prim, dx, dy, dz)
            passing = left * surfaces.transmission[material]
            energy = (left - passing) * surfaces.reflectance[material] * cosine
            echoes.energy[row] = energy
            echoes.cosine[row] = cosine
            count += energy > 0.0 and energy >= surfaces.threshold
            left = passing if passing >= surfaces.threshold else 0.0
        echoes.noticed_count[i] = count
        echoes.is_spent[i] = left == 0.0


@device
def _cosine(corners, i, dx, dy, dz):
    """Of the angle between a direction and a triangle's normal, either side; 0 to 1."""
    a, b, c = corners[i, 0], corners[i, 1], corners[i, 2]
    ax, ay, az = np.float64(a[0]), np.float64(a[1]), np.float64(a[2])
    px, py, pz = b[0] - ax, b[1] - ay, b[2] - az
    qx, qy, qz = c[0] - ax, c[1] - ay, c[2] - az
    nx = py * qz - pz * qy
    ny = pz * qx - px * qz
    nz = px * qy - py * qx
    # Scaled before it is squared: small triangles' normals would vanish.
    largest = max(abs(nx), abs(ny), abs(nz))
    nx, ny, nz = nx / largest, ny / largest, nz / largest
    along = abs(nx * dx + ny * dy + nz * dz)
    return min(along / np.sqrt(nx * nx + ny * ny + nz * nz), 1.0)


@kernel
def merge_echoes(begin, end, splits, ranges, separation, first):
    """Put echoes of pulses begin to end together that a receiver would not tell apart.

    Parameters
    ----------
    begin, end : int
    splits : ndarray of shape (N + 1,), int64
        Pulse i has rows splits[i] to splits[i + 1], by increasing range.
    ranges : ndarray of shape (K,), float64
    separation : float
        An echo belongs to a return if it is less than this beyond its first echo.
    first : ndarray of shape (K,), bool
        Written: whether a row is the first of a return.
    """
    for i in range(np.uint64(begin), np.uint64(end)):
        start = -np.inf
        for row in range(splits[i], splits[i + np.uint64(1)]):
            first[row] = not ranges[row] - start < separation
            if first[row]:
                start = ranges[row]
