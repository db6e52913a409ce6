"""Sweeps: LiDAR returns of a sensor that moves while its pulses are fired."""

from __future__ import annotations

import itertools
import operator
from collections.abc import Iterator
from functools import cached_property
from typing import Any, NamedTuple, TypedDict, Unpack

import numpy as np
from numpy.typing import NDArray

from raystream.core.rays import as_real_array, broadcast
from raystream.jit.threads import Progress, part_of
from raystream.physics.lidar import LidarReturns, lidar_returns
from raystream.physics.scan import Returns
from raystream.physics.sweep_patterns import SweepPattern
from raystream.scene.sensor_track import SensorPoses, SensorTrack
from raystream.tracer import Tracer

__all__ = ["LidarSweep", "lidar_sweep"]

#: Poses of an animated scene per sweep, by default; more than the latter are assumed to be a
#: mistake.
TIME_STEPS, MAX_TIME_STEPS = 16, 1_000_000


class _PulseOptions(TypedDict, total=False):
    """Parameters of `lidar_returns` that `lidar_sweep` has as well."""

    t_min: Any
    t_max: Any
    max_returns: int
    reflectance: Any
    transmission: Any
    threshold: float
    divergence: float
    sub_rays: int
    separation: float
    min_range: float
    cutouts: bool


class _Pulses(NamedTuple):
    """The pulses of a sweep in world space, and when they are fired."""

    pattern: SweepPattern
    motion: SensorTrack
    start: float
    poses: SensorPoses


class LidarSweep(LidarReturns):
    """Returns of one sweep of a sensor: `LidarReturns` with times, channels and the sensor's frame.

    Attributes
    ----------
    pattern : SweepPattern
        Pulse i of the returns is row i of its arrays.
    motion : SensorTrack
    start : float
        Time of the start of the sweep.
    """

    def __init__(self, pulses: _Pulses, ray_splits: NDArray[np.int64], *columns: Any) -> None:
        super().__init__(ray_splits, *columns)
        self.pattern, self.motion, self.start, self._poses = pulses

    @cached_property
    def time(self) -> NDArray[np.float64]:
        """Time at which the pulse of each return was fired, shape (K,), float64."""
        return self.start + self.pattern.times[self.ray_id]

    @property
    def channel(self) -> NDArray[np.int32]:
        """Channel of each return, shape (K,), int32."""
        return self.pattern.channels[self.ray_id]

    @property
    def column(self) -> NDArray[np.int32]:
        """Column of each return, shape (K,), int32."""
        return self.pattern.columns[self.ray_id]

    @property
    def origins(self) -> NDArray[np.float64]:
        """Origins of the pulses, shape (N, 3), float64, world space."""
        return self._poses.positions

    @property
    def directions(self) -> NDArray[np.float64]:
        """Directions of the pulses, shape (N, 3), float64, world space, unit length."""
        return self._poses.directions_to_world(self.pattern.directions)

    @cached_property
    def sensor_positions(self) -> NDArray[np.float64]:
        """The points as the sensor reports them, shape (K, 3), float64.

        Range times direction in the sensor's frame, each at its own time of firing: distorted by
        the motion, which nothing has compensated yet.
        """
        directions = self.pattern.directions[self.ray_id]
        return self.ranges[:, None] * directions

    def deskewed(self, time: float | None = None) -> NDArray[np.float64]:
        """Compensate the sensor's motion: the points in the sensor's frame at one time.

        Parameters
        ----------
        time : float, optional
            The time of that frame [default: when the last pulse was fired].

        Returns
        -------
        ndarray of shape (K, 3), float64
            For a static scene, the points where a stationary sensor would see them at that time.
            Moving objects stay distorted: each point is where its surface was when the pulse was
            fired.

        Raises
        ------
        ValueError
            If the motion does not cover the time.
        """
        if time is None:
            time = self.start + float(self.pattern.times.max(initial=0.0))
        return self.motion.at(time).to_sensor(self.positions)

    def __repr__(self) -> str:
        return f"LidarSweep({len(self.ranges):,} returns of {len(self.ray_splits) - 1:,} pulses)"


def lidar_sweep(
    tracer: Tracer,
    pattern: SweepPattern,
    motion: SensorTrack,
    *,
    start: float = 0.0,
    time_steps: int = TIME_STEPS,
    progress: Progress | None = None,
    **pulses: Unpack[_PulseOptions],
) -> LidarSweep:
    """Sweep a scene with a moving LiDAR, and compute the returns.

    Each pulse leaves the sensor where the motion has it at the pulse's own time.

    Parameters
    ----------
    tracer : Tracer
        If its scene is animated, the scene also moves during the sweep; afterwards, the tracer has
        its original scene again.
    pattern : SweepPattern
        From `raystream.sweep_patterns`, or your own.
    motion : SensorTrack
        Must cover the times of all pulses.
    start : float
        Time at which the sweep starts, in the units of the motion and of the scene's animation:
        seconds. Pulse i is fired at ``start + pattern.times[i]``.
    time_steps : int
        For an animated scene: the sweep is divided into this many intervals of equal length, and
        the scene is posed once for each, at its middle. A surface is then up to speed * duration /
        (2 * time_steps) from its place at the time of the pulse. Each interval costs a
        `Tracer.update`. Poses of the sensor are exact for each pulse in any case.
    progress : callable, optional
        Called with (pulses done, pulses).
    **pulses
        As in `lidar_returns`: ``t_min``, ``t_max``, ``max_returns``, ``reflectance``,
        ``transmission``, ``threshold``, ``divergence``, ``sub_rays``, ``separation``,
        ``min_range``, ``cutouts``. Directions are of unit length: ``min_range`` and ``t_max`` are
        the sensor's ranges in scene units.

    Returns
    -------
    LidarSweep
        ``positions`` in world space, ``sensor_positions`` as the sensor reports them, and
        `LidarSweep.deskewed` with its motion compensated. Its returns have the bits of
        `lidar_returns` for the same rays.

    Raises
    ------
    ValueError, TypeError, RaystreamError
        As `lidar_returns`, or if the motion does not cover the sweep, or an argument is out of
        range.

    Notes
    -----
    Light is instantaneous: a pulse meets the scene as it is when it is fired. There is no
    Doppler effect, and a pulse with several sub-rays sends all of them at once.

    An interrupted sweep restores the tracer's scene before it raises.

    Examples
    --------
    A car passes a wall 5 m to its right, at 20 m/s along -z:

    >>> import raystream as rs
    >>> wall = rs.Mesh([[5, -9, -99], [5, -9, 99], [5, 9, 99], [5, 9, -99]], [[0, 1, 2], [0, 2, 3]])
    >>> tracer = rs.Tracer(rs.Scene([wall]))
    >>> car = rs.SensorTrack([0.0, 1.0], [[0, 0, 0], [0, 0, -20]])
    >>> pattern = rs.sweep_patterns.spinning([0.0], rate=10, columns=4)
    >>> cloud = rs.lidar_sweep(tracer, pattern, car, start=0.5)
    >>> cloud.time.tolist(), cloud.positions.round(6).tolist()
    ([0.525], [[5.0, 0.0, -10.5]])
    """
    if not isinstance(pattern, SweepPattern):
        raise TypeError(
            f"pattern: expected a SweepPattern, got {type(pattern).__name__}; see "
            "raystream.sweep_patterns"
        )
    if not isinstance(motion, SensorTrack):
        raise TypeError(f"motion: expected a SensorTrack, got {type(motion).__name__}")
    steps = operator.index(time_steps)
    if not 1 <= steps <= MAX_TIME_STEPS:
        raise ValueError(f"time_steps: expected 1 to {MAX_TIME_STEPS:,}, got {steps}")
    fired = _Pulses(pattern, motion, _time(start), _poses(pattern, motion, _time(start)))
    directions = fired.poses.directions_to_world(pattern.directions)
    if tracer.scene.animation is None:
        found = lidar_returns(
            tracer, fired.poses.positions, directions, progress=progress, **pulses
        )
        return LidarSweep(fired, *_columns(found))

    limits = _limits(pulses, len(pattern))
    before, done = tracer.scene, 0
    parts: list[LidarReturns] = []
    rows: list[NDArray[np.int64]] = []
    try:
        for time, members in _time_steps(pattern.times, steps):
            tracer.update(before.at(fired.start + time))
            chosen: _PulseOptions = {**pulses}
            if "t_min" in limits:
                chosen["t_min"] = limits["t_min"][members]
            if "t_max" in limits:
                chosen["t_max"] = limits["t_max"][members]
            parts.append(
                lidar_returns(
                    tracer,
                    fired.poses.positions[members],
                    directions[members],
                    progress=part_of(progress, done, len(members), len(pattern)),
                    **chosen,
                )
            )
            rows.append(members)
            done += len(members)
    finally:
        tracer.update(before)
    return LidarSweep(fired, *_joined(parts, rows))


def _time(start: Any) -> float:
    time = as_real_array("start", start)
    if time.ndim or not np.isfinite(time):
        raise ValueError(f"start: expected a finite number, got {start!r}")
    return float(time)


def _poses(pattern: SweepPattern, motion: SensorTrack, start: float) -> SensorPoses:
    times = start + pattern.times
    low, high = motion.span
    if len(times) and not (times.min() >= low and times.max() <= high):
        raise ValueError(
            f"start: the sweep's pulses are fired from {times.min():.9g} to {times.max():.9g}, but "
            f"the motion lasts from {low:.9g} to {high:.9g}; choose another start, or add keys"
        )
    return motion.at(times)


def _limits(pulses: _PulseOptions, count: int) -> dict[str, NDArray[Any]]:
    """`t_min` and `t_max` that differ between pulses, one for each."""
    found: dict[str, NDArray[Any]] = {}
    for name in ("t_min", "t_max"):
        values = as_real_array(name, pulses.get(name, 0.0))
        if values.ndim:
            found[name] = broadcast(name, values, (count,))
    return found


def _time_steps(
    times: NDArray[np.float64], steps: int
) -> Iterator[tuple[float, NDArray[np.int64]]]:
    """Cut the times of pulses into equal parts: the middle of each, and its pulses."""
    if len(times) == 0:
        yield 0.0, np.zeros(0, np.int64)
        return
    first, length = float(times.min()), float(np.ptp(times)) / steps
    # A part may be too short to be told from none: every pulse then has a time of its own.
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        part = np.floor((times - first) / length) if length > 0.0 else np.zeros(len(times))
    part = np.minimum(part, float(steps - 1))
    order = np.argsort(part, kind="stable")
    numbers, begins = np.unique(part[order], return_index=True)
    ends = itertools.chain(begins[1:], [len(times)])
    for number, begin, end in zip(numbers, begins, ends, strict=True):
        yield first + (float(number) + 0.5) * length, order[begin:end]


def _columns(found: LidarReturns) -> tuple[Any, ...]:
    """The arguments of `LidarReturns`, of its result."""
    returns = Returns(*(getattr(found, name) for name in Returns._fields))
    return found.ray_splits, returns, found.mesh_id, found.material_id, found.status


def _joined(parts: list[LidarReturns], rows: list[NDArray[np.int64]]) -> tuple[Any, ...]:
    """Columns of several groups of pulses, in the order of the pulses."""
    pulses = np.concatenate(rows)
    counts = np.zeros(len(pulses), np.int64)
    counts[pulses] = np.concatenate([part.counts for part in parts])
    status = np.zeros(len(pulses), np.uint8)
    status[pulses] = np.concatenate([part.status for part in parts])
    owner = np.concatenate([own[part.ray_id] for own, part in zip(rows, parts, strict=True)])
    order = np.argsort(owner, kind="stable")

    def column(name: str) -> NDArray[Any]:
        return np.concatenate([getattr(part, name) for part in parts])[order]

    returns = Returns(*(column(name) for name in Returns._fields))
    splits = np.concatenate([[0], np.cumsum(counts)])
    return splits, returns, column("mesh_id"), column("material_id"), status
