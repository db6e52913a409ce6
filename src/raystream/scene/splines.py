"""Splines: interpolation of keyframed positions and rotations, as in BART."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def rotation_matrix(axis: Array, degrees: float) -> Array:
    """Return a right-handed rotation about an axis of any length; identity for a zero axis."""
    return quaternion_matrix(_quaternion(axis, degrees))


def position_at(keys: Array, time: float) -> Array:
    """Interpolate rows of time, value (3), tension, continuity, bias.

    A Kochanek-Bartels spline through the inner keys; the first and the last key only shape
    its ends, as in BART. Outside, the value is that of the nearer end; with fewer than four
    keys the interpolation is linear.

    References
    ----------
    Kochanek and Bartels, "Interpolating Splines with Local Tension, Continuity, and Bias
    Control", SIGGRAPH 1984.
    """
    times, values = keys[:, 0], keys[:, 1:4]
    if len(keys) < 4:
        return np.array([np.interp(time, times, values[:, axis]) for axis in range(3)])
    i, s = _segment(times, time)
    before, step, after = (values[j + 1] - values[j] for j in (i - 1, i, i + 1))
    out_before, out_step, in_step, in_after = _tangent_weights(times, keys[:, 4:7], i)
    leaving = out_before * before + out_step * step
    arriving = in_step * step + in_after * after
    # Hermite form on [0, 1].
    cubic = leaving + arriving - 2.0 * step
    square = 3.0 * step - 2.0 * leaving - arriving
    return values[i] + s * (leaving + s * (square + s * cubic))


def key_turns(keys: Array) -> list[Array]:
    """Return the unit quaternion of each row of `rotation_at`, with signs for the shorter arcs."""
    turns = [_quaternion(row[1:4], float(row[4])) for row in keys]
    for i in range(1, len(turns)):
        if turns[i] @ turns[i - 1] < 0.0:  # the same rotation, by the shorter way
            turns[i] = -turns[i]
    return turns


def rotation_at(keys: Array, time: float, turns: list[Array] | None = None) -> Array:
    """Interpolate rows of time, axis (3), degrees, tension, continuity, bias.

    Parameters
    ----------
    keys : ndarray of shape (K, 8)
    time : float
    turns : list of ndarray, optional
        Result of `key_turns`.

    Returns
    -------
    ndarray of shape (4,)
        A unit quaternion w, x, y, z: the spherical analogue of `position_at`, with the same
        tangents taken in the logarithm of the quaternions.

    References
    ----------
    Shoemake, "Quaternion Calculus and Fast Animation", SIGGRAPH 1987 course notes.
    """
    times = keys[:, 0]
    turns = key_turns(keys) if turns is None else turns
    if len(keys) < 4:
        return _few_rotations(times, turns, time)
    i, s = _segment(times, time)
    before, step, after = (
        _log(_product(_inverse(turns[j]), turns[j + 1])) for j in (i - 1, i, i + 1)
    )
    out_before, out_step, in_step, in_after = _tangent_weights(times, keys[:, 5:8], i)
    leaving = out_before * before + out_step * step
    arriving = in_step * step + in_after * after
    near_start = _product(turns[i], _exp(0.5 * (leaving - step)))
    near_end = _product(turns[i + 1], _exp(0.5 * (step - arriving)))
    chord = slerp(turns[i], turns[i + 1], s)
    inner = slerp(near_start, near_end, s)
    return slerp(chord, inner, 2.0 * s * (1.0 - s))


def _few_rotations(times: Array, turns: list[Array], time: float) -> Array:
    last = len(turns) - 1
    if last == 0 or time <= times[0]:
        return turns[0]
    if time >= times[last]:
        return turns[last]
    i = min(int(np.searchsorted(times, time, side="right")) - 1, last - 1)
    return slerp(turns[i], turns[i + 1], _fraction(times, i, time))


def _segment(times: Array, time: float) -> tuple[int, float]:
    """Find the inner keys i, i + 1 around a time, and its fraction of that segment."""
    last = len(times) - 2
    if not time > times[1]:
        return 1, 0.0
    if time >= times[last]:
        return last - 1, 1.0
    i = int(np.searchsorted(times[1 : last + 1], time, side="right"))
    i = min(max(i, 1), last - 1)
    return i, _fraction(times, i, time)


def _fraction(times: Array, i: int, time: float) -> float:
    length = float(times[i + 1] - times[i])
    return min(1.0, max(0.0, (time - float(times[i])) / length)) if length > 0.0 else 0.0


def _tangent_weights(times: Array, shape: Array, i: int) -> tuple[float, float, float, float]:
    """Return the weights of value differences in the tangents of segment i, i + 1.

    Returns
    -------
    out_before, out_step : float
        Weights of the differences before and along the segment, for the tangent at key i.
    in_step, in_after : float
        Weights of the differences along and after it, for the tangent at key i + 1.
    """
    length = float(times[i + 1] - times[i])
    tension, continuity, bias = (float(x) for x in shape[i])
    speed = _speed(length, float(times[i + 1] - times[i - 1]))
    out_before = speed * (1 - tension) * (1 + continuity) * (1 + bias)
    out_step = speed * (1 - tension) * (1 - continuity) * (1 - bias)
    tension, continuity, bias = (float(x) for x in shape[i + 1])
    speed = _speed(length, float(times[i + 2] - times[i]))
    in_step = speed * (1 - tension) * (1 - continuity) * (1 + bias)
    in_after = speed * (1 - tension) * (1 + continuity) * (1 - bias)
    return out_before, out_step, in_step, in_after


def _speed(length: float, span: float) -> float:
    """Return the tangent correction for uneven key times (half of the paper's factor of 2)."""
    return length / span if span > 0.0 else 0.0


def _quaternion(axis: Array, degrees: float) -> Array:
    length = float(np.linalg.norm(axis))
    if not (0.0 < length < math.inf and math.isfinite(degrees)):
        return np.array([1.0, 0.0, 0.0, 0.0])
    half = math.radians(degrees) / 2.0
    return np.concatenate([[math.cos(half)], math.sin(half) / length * axis])


def quaternion_matrix(q: Array) -> Array:
    """Return the rotation matrix, shape (3, 3), of a non-zero quaternion w, x, y, z."""
    return unit_quaternion_matrix(*(q / np.linalg.norm(q)))


def unit_quaternion_matrix(w: float, x: float, y: float, z: float) -> Array:
    """Return the rotation matrix, shape (3, 3), of a quaternion of length 1."""
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def _product(p: Array, q: Array) -> Array:
    w = p[0] * q[0] - p[1:] @ q[1:]
    return np.concatenate([[w], p[0] * q[1:] + q[0] * p[1:] + np.cross(p[1:], q[1:])])


def _inverse(q: Array) -> Array:
    return np.concatenate([q[:1], -q[1:]])


def _log(q: Array) -> Array:
    """Return half the rotation vector of a unit quaternion; shape (3,)."""
    sine = float(np.linalg.norm(q[1:]))
    if sine == 0.0:
        return np.zeros(3)
    return q[1:] * (math.atan2(sine, float(q[0])) / sine)


def _exp(vector: Array) -> Array:
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.array([1.0, 0.0, 0.0, 0.0])
    return np.concatenate([[math.cos(angle)], math.sin(angle) / angle * vector])


def slerp(p: Array, q: Array, s: float) -> Array:
    """Interpolate spherically between unit quaternions p and q; s goes from 0 to 1."""
    cosine = min(1.0, max(-1.0, float(p @ q)))
    angle = math.acos(cosine)
    sine = math.sin(angle)
    if sine < 1e-9:  # equal or opposite: linear interpolation suffices
        return p + s * (q - p) if cosine > 0.0 else p
    return (math.sin((1 - s) * angle) * p + math.sin(s * angle) * q) / sine


def slerp_rows(p: Array, q: Array, s: Array) -> Array:
    """Interpolate as `slerp` between rows of quaternions, (N, 4), at fractions s, (N,)."""
    cosine = np.clip(np.einsum("nk,nk->n", p, q), -1.0, 1.0)[:, None]
    angle, s = np.arccos(cosine), s[:, None]
    sine = np.sin(angle)
    is_line = sine < 1e-9
    with np.errstate(divide="ignore", invalid="ignore"):
        arc = (np.sin((1.0 - s) * angle) * p + np.sin(s * angle) * q) / sine
    return np.where(is_line, np.where(cosine > 0.0, p + s * (q - p), p), arc)
