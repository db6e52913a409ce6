"""SweepPattern: directions and firing times of the pulses of a LiDAR's sweep."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.rays import as_real_array

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SweepPattern:
    """Directions and firing times of the pulses of one sweep.

    Parameters
    ----------
    directions : array_like of shape (N, 3), real
        Sensor's frame: x to the right, y up, -z ahead. Of any length.
    times : array_like of shape (N,), real
        Seconds from the start of the sweep, 0 to `period`; in any order.
    period : float
        Seconds from the start of a sweep to the start of the next.
    channels, columns : array_like of shape (N,), int, optional
        Where each pulse belongs in an image of the sweep: the number of its laser or line, and its
        number within that [default: one channel, pulses in the order given].

    Attributes
    ----------
    directions : ndarray of shape (N, 3), float64
        Unit length.
    times : ndarray of shape (N,), float64
    channels, columns : ndarray of shape (N,), int32
        All arrays are read-only.

    Raises
    ------
    ValueError
        If shapes disagree, a number is not finite, a direction is zero, a time is outside the
        period, or a channel or column is negative.
    TypeError
        If an array does not hold real numbers, or channels or columns are not integers.

    Examples
    --------
    >>> from raystream import sweep_patterns
    >>> pattern = sweep_patterns.SweepPattern([[0, 0, -1], [2, 0, 0]], [0.0, 0.01], period=0.1)
    >>> pattern.directions.tolist(), pattern.columns.tolist()
    ([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0]], [0, 1])
    """

    directions: Any
    times: Any
    period: float
    channels: Any = None
    columns: Any = None

    def __post_init__(self) -> None:
        directions = as_real_array("directions", self.directions).astype(np.float64)
        if directions.ndim != 2 or directions.shape[1] != 3:
            raise ValueError(f"directions: expected shape (N, 3), got {directions.shape}")
        count = len(directions)
        with np.errstate(invalid="ignore"):
            largest = np.abs(directions).max(axis=1, initial=0.0)
        if not (np.isfinite(largest) & (largest > 0.0)).all():
            raise ValueError("directions: expected finite numbers, and no zero vectors")
        # Scaled before squaring: lengths of tiny and huge vectors would underflow or overflow.
        scaled = directions / largest[:, None]
        lengths = np.sqrt(np.einsum("nk,nk->n", scaled, scaled))
        period = finite_number("period", self.period)
        if not period > 0.0:
            raise ValueError(f"period: expected a number above 0, got {period:g}")
        times = as_real_array("times", self.times).astype(np.float64)
        if times.shape != (count,):
            raise ValueError(f"times: expected shape ({count},), got {times.shape}")
        if not ((times >= 0.0) & (times <= period)).all():
            raise ValueError(f"times: expected numbers from 0 to the period, {period:g}")
        unit = directions if _are_unit(directions) else scaled / lengths[:, None]
        channels = np.zeros(count, int) if self.channels is None else self.channels
        columns = np.arange(count) if self.columns is None else self.columns
        values = {
            "directions": unit,
            "times": times,
            "channels": _numbers("channels", channels, count),
            "columns": _numbers("columns", columns, count),
        }
        for name, array in values.items():
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        object.__setattr__(self, "period", period)

    def __len__(self) -> int:
        return len(self.times)

    def __repr__(self) -> str:
        return f"SweepPattern({len(self):,} pulses in {self.period:g} s)"


def finite_number(name: str, value: Any) -> float:
    """Check one real number."""
    array = as_real_array(name, value)
    if array.ndim or not np.isfinite(array):
        raise ValueError(f"{name}: expected a finite number, got {value!r}")
    return float(array)


def _numbers(name: str, values: Any, count: int) -> NDArray[np.int32]:
    array = np.asarray(values)
    if array.dtype.kind not in "iu":
        raise TypeError(f"{name}: expected integers, got dtype {array.dtype}")
    if array.shape != (count,):
        raise ValueError(f"{name}: expected shape ({count},), got {array.shape}")
    if array.size and not (array.min() >= 0 and array.max() < 1 << 31):
        raise ValueError(f"{name}: expected numbers from 0 to 2**31 - 1")
    return array.astype(np.int32)


def _are_unit(directions: Array) -> bool:
    """Whether directions are of unit length but for rounding: their bits are kept then."""
    with np.errstate(over="ignore"):
        squares = np.einsum("nk,nk->n", directions, directions)
    return bool((np.abs(squares - 1.0) <= 1e-15).all())
