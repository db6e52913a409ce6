"""Sensor tracks: keyframed poses of a sensor, interpolated for many times at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raystream.core.rays import as_real_array
from raystream.scene.camera import Camera
from raystream.scene.camera_track import CameraMotion
from raystream.scene.key_tracks import KeyTrack

__all__ = ["SensorPoses", "SensorTrack"]

Array = NDArray[np.float64]

#: Largest error of a rotation's entries: pose files have six digits or more.
_ROTATION_ERROR = 1e-3

#: Largest coordinate and time: rays from beyond are invalid, and differences may overflow.
_LIMIT = 2.0**200


class SensorPoses(NamedTuple):
    """Poses of a sensor at N times.

    Attributes
    ----------
    positions : ndarray of shape (N, 3), float64
        World space: the origin of the sensor's frame.
    quaternions : ndarray of shape (N, 4), float64
        Unit quaternions w, x, y, z that rotate the sensor's frame to the world's axes.
    """

    positions: Array
    quaternions: Array

    @property
    def rotations(self) -> Array:
        """Rotation matrices, shape (N, 3, 3); columns: the sensor's axes in world space."""
        rows: Array = _rotated(self.quaternions[:, None, :], np.eye(3))
        return rows.transpose(0, 2, 1)

    def directions_to_world(self, directions: Array) -> Array:
        """Rotate directions in the sensor's frame, (N, 3), into world space."""
        return _rotated(self.quaternions, directions)

    def to_world(self, points: Array) -> Array:
        """Transform points in the sensor's frame, (N, 3), into world space."""
        return self.positions + _rotated(self.quaternions, points)

    def to_sensor(self, points: Array) -> Array:
        """Transform points in world space, (N, 3), into the sensor's frame."""
        return _rotated(self.quaternions * [1.0, -1.0, -1.0, -1.0], points - self.positions)


class SensorTrack:
    """Motion of a sensor: positions and rotations at key times.

    Between keys the position moves linearly, and the rotation turns at constant speed by the
    shorter arc. A track of one key stands still at all times.

    Parameters
    ----------
    times : array_like of shape (K,), real
        Increasing; seconds, or the unit of the scene's animation.
    positions : array_like of shape (K, 3), real
        World space.
    rotations : array_like of shape (K, 3, 3), real, optional
        Rotation matrices from the sensor's frame to the world: their columns are the sensor's
        axes, x to the right, y up and -z ahead, as for a camera [default: the world's axes].

    Attributes
    ----------
    times : ndarray of shape (K,), float64
        Read-only.

    Raises
    ------
    ValueError
        If there is no key, times do not increase, a shape or a number is wrong, or a matrix is
        not a rotation: its columns must be unit vectors at right angles, and right-handed.
    TypeError
        If an array does not hold real numbers.

    References
    ----------
    Shoemake, "Animating Rotation with Quaternion Curves", SIGGRAPH 1985.

    Examples
    --------
    >>> import raystream as rs
    >>> track = rs.SensorTrack([0.0, 2.0], [[0, 2, 0], [20, 2, 0]])  # 10 m/s along x
    >>> track.at([0.5, 1.5]).positions.tolist()
    [[5.0, 2.0, 0.0], [15.0, 2.0, 0.0]]
    """

    def __init__(self, times: ArrayLike, positions: ArrayLike, rotations: Any = None) -> None:
        keys = np.array(as_real_array("times", times), np.float64)
        if keys.ndim != 1 or len(keys) == 0:
            raise ValueError(f"times: expected shape (K,) with at least one key, got {keys.shape}")
        if not (np.abs(keys) <= _LIMIT).all() or not (np.diff(keys) > 0.0).all():
            raise ValueError("times: expected finite numbers that increase, within 2**200")
        keys.flags.writeable = False
        turns = np.tile([1.0, 0.0, 0.0, 0.0], (len(keys), 1))
        if rotations is not None:
            turns = _quaternions(_finite("rotations", rotations, (len(keys), 3, 3)))
        self.times = keys
        self._position = KeyTrack(keys, _finite("positions", positions, (len(keys), 3)))
        self._rotation = KeyTrack(keys, turns, is_rotation=True)

    @classmethod
    def of_camera(
        cls, camera: Camera | CameraMotion, times: Sequence[float] | Array = (0.0,)
    ) -> SensorTrack:
        """Make the track of a sensor that moves with a camera.

        Parameters
        ----------
        camera : Camera, CameraTrack or a moving camera of a scene
            The sensor's frame: the origin at the eye, -z along the view, y up in the image.
        times : sequence of float
            Times of the keys; between them the camera's splines are replaced by lines and arcs.
        """
        cameras = [camera if isinstance(camera, Camera) else camera.at(time) for time in times]
        axes = [np.transpose(one.basis()) * [1.0, 1.0, -1.0] for one in cameras]
        return cls(times, [one.eye for one in cameras], axes)

    @property
    def span(self) -> tuple[float, float]:
        """First and last time of the motion; minus and plus infinity for a single key."""
        if len(self.times) == 1:
            return -np.inf, np.inf
        return float(self.times[0]), float(self.times[-1])

    def at(self, times: ArrayLike) -> SensorPoses:
        """Interpolate the poses at times.

        Parameters
        ----------
        times : array_like of shape (N,) or (), real
            Within the track.

        Returns
        -------
        SensorPoses

        Raises
        ------
        ValueError
            If a time is not finite, or outside the track.
        """
        moments = np.atleast_1d(as_real_array("times", times)).astype(np.float64)
        if moments.ndim != 1:
            raise ValueError(f"times: expected shape (N,), got {moments.shape}")
        first, last = self.span
        is_covered = (moments >= first) & (moments <= last) & np.isfinite(moments)
        if not is_covered.all():
            raise ValueError(
                f"times: expected finite numbers from {first:g} to {last:g}, the span of the "
                f"track, got {moments[~is_covered][0]:.9g}"
            )
        return SensorPoses(self._position.at_times(moments), self._rotation.at_times(moments))

    def __repr__(self) -> str:
        first, last = float(self.times[0]), float(self.times[-1])
        return f"SensorTrack({len(self.times):,} keys from {first:g} to {last:g})"


def _finite(name: str, values: Any, shape: tuple[int, ...]) -> Array:
    array = as_real_array(name, values).astype(np.float64)
    if array.shape != shape:
        raise ValueError(f"{name}: expected shape {shape}, got {array.shape}")
    if not (np.abs(array) <= _LIMIT).all():
        raise ValueError(f"{name}: expected finite numbers within 2**200")
    return array


def _quaternions(rotations: Array) -> Array:
    """Return the unit quaternions w, x, y, z of rotation matrices: (K, 3, 3) gives (K, 4)."""
    with np.errstate(over="ignore", invalid="ignore"):
        error = np.abs(rotations.transpose(0, 2, 1) @ rotations - np.eye(3)).max(axis=(1, 2))
        is_rotation = (error <= _ROTATION_ERROR) & (np.linalg.det(rotations) > 0.0)
    if not is_rotation.all():
        raise ValueError(
            f"rotations: matrix {int(np.argmin(is_rotation))} is not a rotation; its columns must "
            "be unit vectors at right angles to each other, and right-handed"
        )
    m = rotations.transpose(1, 2, 0)
    w = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
    xy, xz, yz = m[0, 1] + m[1, 0], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1]
    x, y, z = m[0, 0], m[1, 1], m[2, 2]
    # Four times the outer product of a quaternion with itself: each row is a multiple of it, and
    # that with the largest diagonal the most accurate.
    products = np.array(
        [
            [1.0 + x + y + z, w[0], w[1], w[2]],
            [w[0], 1.0 + x - y - z, xy, xz],
            [w[1], xy, 1.0 - x + y - z, yz],
            [w[2], xz, yz, 1.0 - x - y + z],
        ]
    )
    best = products.diagonal().argmax(axis=1)
    found: Array = products[best, :, np.arange(len(rotations))]
    found /= np.linalg.norm(found, axis=1, keepdims=True)
    return found


def _rotated(quaternions: Array, vectors: Array) -> Array:
    """Rotate vectors by unit quaternions; the identity keeps their bits."""
    along = quaternions[..., 1:]
    twice = 2.0 * np.cross(along, vectors)
    return vectors + quaternions[..., :1] * twice + np.cross(along, twice)
