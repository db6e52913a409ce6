"""Sweep patterns of LiDARs: where each pulse of a sweep goes, and when it is fired.

All patterns are in the sensor's frame, which is a camera's: x to the right, y up, -z ahead.
"""

from __future__ import annotations

import operator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raystream.core.memory import check_memory
from raystream.core.rays import as_real_array
from raystream.physics.spinning_sensors import VLP16, VLP32C, VLS128, Channels
from raystream.physics.sweep_pattern import SweepPattern, finite_number

__all__ = ["SweepPattern", "mems", "raster", "rosette", "spinning", "vlp16", "vlp32c", "vls128"]

Array = NDArray[np.float64]

#: Bytes per ray while a pattern is made.
_RAY_BYTES = 160

#: Least and greatest rates, per second; beyond, a rate is assumed to be a mistake.
_RATES = 1e-4, 1e9


def spinning(
    elevations: ArrayLike,
    *,
    rate: float = 10.0,
    columns: int = 1024,
    azimuth_offsets: ArrayLike = 0.0,
    firing_times: ArrayLike = 0.0,
) -> SweepPattern:
    """Make the pattern of a head that spins about the y axis, clockwise seen from above.

    One revolution. It starts ahead, and fires all channels once in each column, while the head
    keeps turning.

    Parameters
    ----------
    elevations : array_like of shape (C,), real
        Elevation of each channel above the horizon, in degrees.
    rate : float
        Revolutions per second.
    columns : int
        Columns per revolution, evenly spaced.
    azimuth_offsets : array_like of shape (C,) or (), real
        Angle by which each channel points to the right of the head, in degrees.
    firing_times : array_like of shape (C,) or (), real
        Seconds after the start of its column at which each channel is fired.

    Returns
    -------
    SweepPattern
        Pulses by column, then channel. Channels are numbered in the order of `elevations`.

    Raises
    ------
    ValueError
        If there is no channel or column, an angle or rate is out of range, or a channel is
        fired after the end of its column.
    TypeError
        If the values are not real numbers.
    MemoryError
        If the pattern does not fit into memory.

    Examples
    --------
    >>> import numpy as np
    >>> from raystream import sweep_patterns
    >>> pattern = sweep_patterns.spinning(np.linspace(-22.5, 22.5, 64), rate=20, columns=512)
    >>> pattern
    SweepPattern(32,768 pulses in 0.05 s)
    """
    angles = as_real_array("elevations", elevations).astype(np.float64)
    if angles.ndim != 1 or len(angles) == 0:
        raise ValueError(
            f"elevations: expected an angle for each of at least one channel, got shape "
            f"{angles.shape}"
        )
    if not (np.abs(angles) <= 90.0).all():
        raise ValueError("elevations: expected degrees from -90 to 90")
    column_time = 1.0 / (_rate(rate) * _count("columns", columns))
    offsets = _per_channel("azimuth_offsets", azimuth_offsets, len(angles))
    firings = _per_channel("firing_times", firing_times, len(angles))
    if not ((firings >= 0.0) & (firings <= column_time)).all():
        raise ValueError(
            f"firing_times: expected seconds from 0 to {column_time:g}, the time of a column"
        )
    return _revolution(Channels(angles, offsets, firings, column_time), _rate(rate), columns)


def vlp16(rate: float = 10.0) -> SweepPattern:
    """Make the pattern of a Velodyne VLP-16 (Puck): 16 channels from -15 to 15 degrees.

    One revolution. Lasers fire one by one, 2.304 microseconds apart, and start again every
    55.296. Channels are the manual's laser numbers, in the order of firing.

    Parameters
    ----------
    rate : float
        Revolutions per second.

    Returns
    -------
    SweepPattern
        By column, then channel; the last column of a revolution is the last that fits.

    Notes
    -----
    All beams begin at the sensor's origin. The real ones lie up to 11 mm above or below.

    References
    ----------
    Velodyne LiDAR, "VLP-16 User Manual", 63-9243 Rev. D, table 9-1 and section 9.4.

    Examples
    --------
    >>> from raystream import sweep_patterns
    >>> sweep_patterns.vlp16()
    SweepPattern(28,928 pulses in 0.1 s)
    """
    return _sensor(VLP16, rate)


def vlp32c(rate: float = 10.0) -> SweepPattern:
    """Make the pattern of a Velodyne VLP-32C: 32 channels from -25 to 15 degrees, denser ahead.

    One revolution. Lasers fire in pairs, 2.304 microseconds apart, and start again every 55.296.
    Channels are the manual's laser numbers.

    Parameters
    ----------
    rate : float
        Revolutions per second.

    Returns
    -------
    SweepPattern
        By column, then channel; the last column of a revolution is the last that fits.

    References
    ----------
    Velodyne LiDAR, "VLP-32C User Manual", 63-9325 Rev. C, table 9-6 (angles); firing times as in
    and azimuth offsets as in the driver ``ros-drivers/velodyne``.
    """
    return _sensor(VLP32C, rate)


def vls128(rate: float = 10.0) -> SweepPattern:
    """Make the pattern of a Velodyne VLS-128: 128 channels from -25 to 15 degrees.

    One revolution. Lasers fire in groups of eight, 2.665 microseconds apart, with a pause after
    the eighth group, and start again every 53.3. Channels are the manual's laser numbers.

    Parameters
    ----------
    rate : float
        Revolutions per second.

    Returns
    -------
    SweepPattern
        By column, then channel; the last column of a revolution is the last that fits.

    References
    ----------
    Velodyne LiDAR, "VLS-128 User Manual", 63-9483 Rev. A, section 9.4 (times); angles as in the
    calibration of the driver ``ros-drivers/velodyne``.
    """
    return _sensor(VLS128, rate)


def raster(
    columns: int, rows: int, *, fov: tuple[float, float] = (120.0, 25.0), rate: float = 10.0
) -> SweepPattern:
    """Make the pattern of a scanner that sweeps lines from the left, one by one from the top.

    Pulses are evenly spaced in azimuth, elevation and time: a polygon mirror, or a solid-state
    scanner. For a flash LiDAR, which fires all pulses at once, replace the times with zeros:
    ``dataclasses.replace(pattern, times=0 * pattern.times)``.

    Parameters
    ----------
    columns, rows : int
        Pulses per line, and number of lines.
    fov : (float, float)
        Degrees across, at most 360, and from top to bottom, at most 180.
    rate : float
        Sweeps per second.

    Returns
    -------
    SweepPattern
        In the order of firing; channels are lines from the top, columns count from the left.

    Raises
    ------
    ValueError
        If there is no pulse, or an angle or rate is out of range.
    MemoryError
        If the pattern does not fit into memory.
    """
    wide, high, period = *_fov(fov), 1.0 / _rate(rate)
    row, column = _grid(rows, columns)
    return SweepPattern(
        _directions(wide * ((column + 0.5) / columns - 0.5), high * (0.5 - (row + 0.5) / rows)),
        (row * columns + column) * (period / (rows * columns)),
        period,
        row,
        column,
    )


def mems(
    columns: int, rows: int, *, fov: tuple[float, float] = (60.0, 20.0), rate: float = 10.0
) -> SweepPattern:
    """Make the pattern of a mirror that oscillates from side to side and tilts down evenly.

    The azimuth is a sine of time and the elevation linear: lines alternate in direction, are
    slightly inclined, and are denser at their ends. Pulses are evenly spaced in time.

    Parameters
    ----------
    columns, rows : int
        Pulses per line, which is half an oscillation, and number of lines.
    fov : (float, float)
        Degrees across, at most 360, and from top to bottom, at most 180.
    rate : float
        Sweeps per second.

    Returns
    -------
    SweepPattern
        In the order of firing; channels are lines from the top, columns count along each.

    Raises
    ------
    ValueError
        If there is no pulse, or an angle or rate is out of range.
    MemoryError
        If the pattern does not fit into memory.
    """
    wide, high, period = *_fov(fov), 1.0 / _rate(rate)
    row, column = _grid(rows, columns)
    lines = row + (column + 0.5) / columns
    return SweepPattern(
        _directions(-0.5 * wide * np.cos(np.pi * lines), high * (0.5 - lines / rows)),
        (row * columns + column) * (period / (rows * columns)),
        period,
        row,
        column,
    )


def rosette(
    points: int,
    *,
    deflections: tuple[float, float] = (10.0, 10.0),
    speeds: tuple[float, float] = (121.0, -77.0),
    rate: float = 10.0,
    start: float = 0.0,
) -> SweepPattern:
    """Make the pattern of two rotating wedge prisms (Risley prisms): a rosette about -z.

    Each prism bends the beam by a fixed angle, in a direction that rotates; the two angles add up
    as vectors, as for thin prisms. If the speeds times the period are not integers, sweeps differ:
    give each its `start`, and their union fills the field of view.

    Parameters
    ----------
    points : int
        Pulses per sweep, evenly spaced in time.
    deflections : (float, float)
        Degrees by which each prism bends the beam; the field of view is a circle, twice their
        sum across, at most 180.
    speeds : (float, float)
        Revolutions per second of each prism; negative numbers turn it the other way.
    rate : float
        Sweeps per second.
    start : float
        Seconds since both prisms bent the beam to the right.

    Returns
    -------
    SweepPattern
        In the order of firing: one channel.

    Raises
    ------
    ValueError
        If there is no pulse, or an angle, speed or rate is out of range.
    MemoryError
        If the pattern does not fit into memory.

    References
    ----------
    Marshall, "Risley Prism Scan Patterns", Proceedings of SPIE 3787, 1999.

    Examples
    --------
    >>> from raystream import sweep_patterns
    >>> first, second = (sweep_patterns.rosette(10_000, start=s) for s in (0.0, 0.1))
    >>> first
    SweepPattern(10,000 pulses in 0.1 s)
    """
    count, period = _count("points", points), 1.0 / _rate(rate)
    check_memory(count * _RAY_BYTES, f"{count:,} pulses would", "give fewer points")
    bends = [finite_number("deflections", angle) for angle in _pair("deflections", deflections)]
    turns = [finite_number("speeds", speed) for speed in _pair("speeds", speeds)]
    if min(bends) < 0.0 or sum(bends) > 90.0:
        raise ValueError(
            f"deflections: expected two angles from 0 with a sum of at most 90, got {deflections}"
        )
    times = np.arange(count) * (period / count)
    phases = 2.0 * np.pi * np.multiply.outer(finite_number("start", start) + times, turns)
    across, up = np.radians(bends) @ np.cos(phases.T), np.radians(bends) @ np.sin(phases.T)
    angle = np.hypot(across, up)
    lateral = np.sinc(angle / np.pi)  # sin(angle) / angle
    directions = np.stack([lateral * across, lateral * up, -np.cos(angle)], axis=1)
    return SweepPattern(directions, times, period)


def _sensor(channels: Channels, rate: float) -> SweepPattern:
    """Pattern of a sensor whose firing sequence takes a fixed time."""
    columns = int(1.0 / (_rate(rate) * channels.column_time) + 1e-9)
    if columns == 0:
        raise ValueError(f"rate: a revolution is shorter than a firing sequence, got {rate:g}")
    return _revolution(channels, _rate(rate), columns)


def _revolution(channels: Channels, rate: float, columns: int) -> SweepPattern:
    """The columns of a revolution, channel by channel."""
    column, channel = _grid(columns, len(channels.elevations))
    times = column * channels.column_time + channels.firing_times[channel]
    azimuths = 360.0 * rate * times + channels.azimuth_offsets[channel]
    directions = _directions(azimuths, channels.elevations[channel])
    # The last firing may pass the end by rounding.
    period = max(1.0 / rate, float(times.max()))
    return SweepPattern(directions, times, period, channel, column)


def _directions(azimuths: Array, elevations: Array) -> Array:
    """Unit vectors, (N, 3): degrees to the right of -z, and above the horizon."""
    around, above = np.radians(azimuths), np.radians(elevations)
    level = np.cos(above)
    return np.stack([level * np.sin(around), np.sin(above), -level * np.cos(around)], axis=1)


def _grid(outer: int, inner: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Numbers of row and place of a grid's cells, in C order."""
    rows, places = _count("rows", outer), _count("columns", inner)
    check_memory(
        rows * places * _RAY_BYTES, f"{rows * places:,} pulses would", "give fewer of them"
    )
    row, place = np.divmod(np.arange(rows * places), places)
    return row, place


def _per_channel(name: str, values: ArrayLike, count: int) -> Array:
    array = as_real_array(name, values).astype(np.float64)
    if array.shape not in ((), (count,)):
        raise ValueError(f"{name}: expected shape () or ({count},), got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name}: expected finite numbers")
    return np.broadcast_to(array, (count,))


def _fov(fov: tuple[float, float]) -> tuple[float, float]:
    wide, high = (finite_number("fov", angle) for angle in _pair("fov", fov))
    if not (0.0 < wide <= 360.0 and 0.0 < high <= 180.0):
        raise ValueError(
            f"fov: expected degrees across, above 0 and at most 360, and from top to bottom, at "
            f"most 180, got {fov}"
        )
    return wide, high


def _pair(name: str, values: Any) -> tuple[Any, Any]:
    try:
        first, second = values
    except (TypeError, ValueError):
        raise ValueError(f"{name}: expected two numbers, got {values!r}") from None
    return first, second


def _rate(value: Any) -> float:
    rate = finite_number("rate", value)
    if not _RATES[0] <= rate <= _RATES[1]:
        low, high = _RATES
        raise ValueError(f"rate: expected a number from {low:g} to {high:g}, got {rate:g}")
    return rate


def _count(name: str, value: Any) -> int:
    count = operator.index(value)
    if not 1 <= count < 1 << 31:
        raise ValueError(f"{name}: expected a number from 1 to 2**31 - 1, got {count}")
    return count
