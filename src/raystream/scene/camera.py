"""Camera: a pinhole that turns pixels into eye rays."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["Camera"]

Vector = tuple[float, float, float]


def unit_vector(name: str, values: ArrayLike) -> NDArray[np.float64]:
    """Scale a vector to length 1; raises ValueError if it is zero or not finite."""
    vector = np.asarray(values, np.float64)
    if vector.shape != (3,) or not np.isfinite(vector).all() or not vector.any():
        raise ValueError(f"{name}: expected three finite numbers, not all zero, got {values!r}")
    vector = vector / np.abs(vector).max()
    result: NDArray[np.float64] = vector / np.linalg.norm(vector)
    return result


@dataclass(frozen=True)
class Camera:
    """A pinhole camera in a right-handed world.

    Parameters
    ----------
    eye : Vector
        Position of the pinhole, world space.
    look_at : Vector
        The point in the middle of the picture.
    up : Vector
        The direction that is up in the picture; need not be perpendicular to the view.
    fov : float
        Vertical field of view in degrees, in (0, 180).

    Raises
    ------
    ValueError
        If a number is not finite, eye and look_at coincide, or up is parallel to the view.

    References
    ----------
    Purcell 2002, section 3.1.1 (the eye ray generator).
    """

    eye: Vector
    look_at: Vector
    up: Vector = (0.0, 1.0, 0.0)
    fov: float = 40.0

    def __post_init__(self) -> None:
        for name in ("eye", "look_at", "up"):
            vector = tuple(float(c) for c in np.asarray(getattr(self, name)).ravel())
            if len(vector) != 3 or not all(map(math.isfinite, vector)):
                raise ValueError(f"{name}: expected three finite numbers, got {vector}")
            object.__setattr__(self, name, vector)
        if not 0.0 < self.fov < 180.0:
            raise ValueError(f"fov: expected degrees between 0 and 180, got {self.fov}")
        if self.eye == self.look_at:
            raise ValueError("look_at: must differ from eye")
        self.basis()

    @classmethod
    def framing(
        cls,
        low: ArrayLike,
        high: ArrayLike,
        *,
        up: ArrayLike = (0.0, 1.0, 0.0),
        fov: float = 40.0,
        aspect: float = 4.0 / 3.0,
    ) -> Camera:
        """Place a camera so that a box fills the picture, seen from the front, right and above.

        Parameters
        ----------
        low, high : array_like of shape (3,)
            Corners of the box, world space.
        up : array_like of shape (3,)
            The world's up; its length does not matter.
        fov : float
            Vertical field of view in degrees.
        aspect : float
            Width of the picture over its height.
        """
        low, high = np.asarray(low, np.float64), np.asarray(high, np.float64)
        center = low + (high - low) / 2
        up = unit_vector("up", up)
        # A three-quarter view: the direction from the centre to the eye, for y up.
        front = (
            np.array([0.0, 0.0, 1.0]) if abs(up[1]) >= abs(up[2]) else np.array([0.0, -1.0, 0.0])
        )
        right = np.cross(up, front)
        toward_eye = front + 0.55 * right + 0.45 * up
        toward_eye /= np.linalg.norm(toward_eye)
        axis_right = np.cross(up, toward_eye)
        axis_right /= np.linalg.norm(axis_right)
        axis_up = np.cross(toward_eye, axis_right)
        tan_up = math.tan(math.radians(fov) / 2)
        tan_right = tan_up * aspect
        # Back off until every corner lies inside the frustum.
        distance = 0.0
        for corner in np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T - center:
            depth = corner @ toward_eye
            distance = max(
                distance,
                depth + abs(corner @ axis_right) / tan_right,
                depth + abs(corner @ axis_up) / tan_up,
            )
        distance = distance * 1.05 if distance > 0.0 else max(1.0, float(np.abs(center).max()))
        return cls(tuple(center + distance * toward_eye), tuple(center), tuple(up), fov)

    def basis(self) -> NDArray[np.float64]:
        """Unit vectors of the picture.

        Returns
        -------
        ndarray of shape (3, 3), float64
            Rows: right, up, and forward (into the picture), world space.
        """
        forward = np.subtract(self.look_at, self.eye)
        forward = forward / np.linalg.norm(forward)
        up = np.asarray(self.up, np.float64)
        norm = float(np.linalg.norm(up))
        right = np.cross(forward, up / norm) if norm > 0.0 else np.zeros(3)
        length = float(np.linalg.norm(right))
        if not length > 1e-9:
            raise ValueError("up: must not be zero or parallel to the view direction")
        right /= length
        return np.stack([right, np.cross(right, forward), forward])

    def rays(
        self, width: int, height: int, x: ArrayLike | None = None, y: ArrayLike | None = None
    ) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
        """Make the rays from the eye through points of the picture.

        Parameters
        ----------
        width, height : int
            Size of the picture in pixels. Pixels are square.
        x, y : array_like that broadcast to a shape S, float, optional
            Points in pixels: (0, 0) is the upper left corner of the picture, and pixel
            (column, row) covers [column, column + 1) x [row, row + 1). Without them:
            every pixel's centre, S = (height, width).

        Returns
        -------
        origins : ndarray of shape S + (3,), float64
            The eye, repeated without copying (read-only).
        directions : ndarray of shape S + (3,), float32
            Unit length, world space.
        """
        if x is None or y is None:
            x = np.arange(width, dtype=np.float64)[None, :] + 0.5
            y = np.arange(height, dtype=np.float64)[:, None] + 0.5
        scale = 2.0 * math.tan(math.radians(self.fov) / 2) / height
        across = (np.asarray(x, np.float64) - width / 2) * scale
        down = (np.asarray(y, np.float64) - height / 2) * scale
        right, up, forward = self.basis()
        directions = (across[..., None] * right + forward) - down[..., None] * up
        directions /= np.sqrt(np.einsum("...k,...k->...", directions, directions))[..., None]
        origins = np.broadcast_to(np.asarray(self.eye, np.float64), directions.shape)
        return origins, directions.astype(np.float32)
