"""Camera tracks: keyframed motion of a camera."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raystream.core.checks import check_finite
from raystream.scene.camera import Camera
from raystream.scene.splines import position_at, quaternion_matrix, rotation_at


class CameraMotion(Protocol):
    """A moving camera: a `CameraTrack`, or a camera on an animated node of a file."""

    @property
    def still(self) -> Camera:
        """The camera at rest."""

    @property
    def times(self) -> tuple[float, float]:
        """Start and end of the motion."""

    def at(self, time: float) -> Camera:
        """The camera at a time."""


@dataclass(frozen=True, eq=False)
class CameraTrack:
    """A camera whose eye and view are keyframed.

    Keys are interpolated by splines with tension, continuity and bias; with all three 0 they
    are Catmull-Rom splines, adjusted for uneven times. The first and the last key only shape
    the ends: the motion runs from the second to the last but one. With fewer than four keys
    the eye moves linearly between keys and the view turns at constant speed. Outside these
    times the camera is static.

    Parameters
    ----------
    still : Camera
        The camera at rest; it also provides the eye or the view if that has no keys.
    positions : array_like of shape (K, 4) or (K, 7), optional
        Keys of the eye: time; x, y, z, world space; and tension, continuity, bias [default:
        0]. Times must not decrease.
    rotations : array_like of shape (L, 5) or (L, 8), optional
        Keys of the view: time; x, y, z of an axis of any length, and degrees, right-handed
        about it; and tension, continuity, bias. Without rotation, a camera looks along -z
        with y up.

    Attributes
    ----------
    positions, rotations : ndarray of shape (K, 7) and (L, 8), float64, or None
        Read-only.

    Raises
    ------
    ValueError
        If there are no keys, or they have the wrong shape, are not finite or are out of order.

    References
    ----------
    Kochanek and Bartels, "Interpolating Splines with Local Tension, Continuity, and Bias
    Control", SIGGRAPH 1984. Lext, Assarsson and Moeller, "BART: A Benchmark for Animated Ray
    Tracing", Chalmers technical report 00-14, 2000 (the keys).

    Examples
    --------
    >>> import raystream as rs
    >>> still = rs.Camera(eye=(0, 0, 5), look_at=(0, 0, 0))
    >>> track = rs.CameraTrack(still, positions=[[0, 0, 0, 5], [2, 4, 0, 5]])
    >>> track.at(0.5).eye
    (1.0, 0.0, 5.0)
    """

    still: Camera
    positions: NDArray[np.float64] | None = None
    rotations: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        if self.positions is None and self.rotations is None:
            raise ValueError("positions, rotations: expected keys for at least one")
        for name, width in (("positions", 7), ("rotations", 8)):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, _keys(name, getattr(self, name), width))

    @property
    def times(self) -> tuple[float, float]:
        """Start and end of the motion."""
        spans = [
            keys_span(keys[:, 0]) for keys in (self.positions, self.rotations) if keys is not None
        ]
        return min(first for first, _ in spans), max(last for _, last in spans)

    def at(self, time: float) -> Camera:
        """The camera at a time.

        Parameters
        ----------
        time : float
            In the units of the keys.

        Returns
        -------
        Camera
            `still`, translated and rotated; `look_at` keeps its distance from the eye.

        Raises
        ------
        ValueError
            If `time` is not finite, or the interpolated camera is not.
        """
        check_finite("time", time)
        eye = np.array(self.still.eye)
        toward, up = np.array(self.still.look_at) - eye, np.array(self.still.up)
        with np.errstate(all="ignore"):
            if self.positions is not None:
                eye = position_at(self.positions, time)
            if self.rotations is not None:
                turn = quaternion_matrix(rotation_at(self.rotations, time))
                toward, up = -turn[:, 2] * np.linalg.norm(toward), turn[:, 1]
            look_at = eye + toward
            return replace(self.still, eye=tuple(eye), look_at=tuple(look_at), up=tuple(up))


def _keys(name: str, values: ArrayLike, width: int) -> NDArray[np.float64]:
    """Check keys and fill in tension, continuity and bias."""
    try:
        keys = np.array(values, np.float64)
    except (TypeError, ValueError):
        keys = np.empty(0)
    if keys.ndim != 2 or len(keys) == 0 or keys.shape[1] not in (width - 3, width):
        raise ValueError(f"{name}: expected keys of {width - 3} or {width} numbers each")
    if not np.isfinite(keys).all():
        raise ValueError(f"{name}: expected finite numbers")
    if (np.diff(keys[:, 0]) < 0.0).any():
        raise ValueError(f"{name}: expected times that do not decrease")
    full = np.zeros((len(keys), width))
    full[:, : keys.shape[1]] = keys
    full.flags.writeable = False
    return full


def keys_span(times: NDArray[np.float64]) -> tuple[float, float]:
    """Start and end of a motion: of four keys or more, the outer ones only shape the ends."""
    inner = times if len(times) < 4 else times[1:-1]
    return float(inner[0]), float(inner[-1])
