"""Key tracks: keyframed values, interpolated as in glTF."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from raystream.scene.splines import slerp, slerp_rows

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class KeyTrack:
    """A keyframed vector or rotation; constant before the first and after the last key.

    Parameters
    ----------
    times : ndarray of shape (K,), float64
        At least one; must not decrease.
    values : ndarray of shape (K, W), float64
        Rotations are unit quaternions, W = 4.
    method : {"step", "linear", "cubic"}
        The value of the previous key; linear, for rotations spherical along the shorter arc;
        or Hermite splines, normalised for rotations.
    is_rotation : bool
    arriving, leaving : ndarray of shape (K, W), float64, optional
        Tangents at the keys per unit of time, for ``"cubic"``.

    References
    ----------
    Khronos Group, "glTF 2.0 Specification", appendix C (animation sampler interpolation).
    """

    times: Array
    values: Array
    method: str = "linear"
    is_rotation: bool = False
    arriving: Array | None = None
    leaving: Array | None = None

    def at(self, time: float) -> Array:
        """The value at a time, shape (W,)."""
        last = len(self.times) - 1
        if last == 0 or time <= self.times[0]:
            return self._normalized(self.values[0])
        if time >= self.times[last]:
            return self._normalized(self.values[last])
        i = int(np.searchsorted(self.times, time, side="right")) - 1
        if self.method == "step":
            return self.values[i]
        length = float(self.times[i + 1] - self.times[i])
        s = (time - float(self.times[i])) / length
        before, after = self.values[i], self.values[i + 1]
        if self.arriving is not None and self.leaving is not None:
            out, into = length * self.leaving[i], length * self.arriving[i + 1]
            return self._normalized(_hermite(before, out, into, after, s))
        if self.is_rotation:
            return slerp(before, -after if before @ after < 0.0 else after, s)
        return before + s * (after - before)

    def at_times(self, times: Array) -> Array:
        """The values at N times, shape (N, W): those of `at`, but for rounding."""
        last = len(self.times) - 1
        if last == 0:
            return np.repeat(self._normalized(self.values[0])[None], len(times), axis=0)
        i = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, last - 1)
        length = self.times[i + 1] - self.times[i]
        with np.errstate(divide="ignore", invalid="ignore"):
            s = np.where(length > 0.0, np.clip((times - self.times[i]) / length, 0.0, 1.0), 1.0)
        before, after = self.values[i], self.values[i + 1]
        if self.method == "step":
            return np.where(s[:, None] < 1.0, before, after)
        if self.arriving is not None and self.leaving is not None:
            out, into = length[:, None] * self.leaving[i], length[:, None] * self.arriving[i + 1]
            found = _hermite(before, out, into, after, s[:, None])
            if not self.is_rotation:
                return found
            return found / np.linalg.norm(found, axis=1, keepdims=True)
        if self.is_rotation:
            is_far = np.einsum("nk,nk->n", before, after) < 0.0
            return slerp_rows(before, np.where(is_far[:, None], -after, after), s)
        return before + s[:, None] * (after - before)

    def _normalized(self, value: Array) -> Array:
        """Normalise a rotation; return other values unchanged."""
        length = float(np.linalg.norm(value))
        return value / length if self.is_rotation and length > 0.0 else value


def _hermite(before: Array, out: Array, into: Array, after: Array, s: float | Array) -> Array:
    square, cube = s * s, s * s * s
    value: Array = (
        (2 * cube - 3 * square + 1) * before
        + (cube - 2 * square + s) * out
        + (3 * square - 2 * cube) * after
        + (cube - square) * into
    )
    return value
