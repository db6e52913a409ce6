"""Channels of spinning LiDARs: their angles and firing times."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Channels(NamedTuple):
    """Channels of a spinning head.

    Attributes
    ----------
    elevations : ndarray of shape (C,), float64
        Degrees above the horizon.
    azimuth_offsets : ndarray of shape (C,), float64
        Degrees to the right of the head.
    firing_times : ndarray of shape (C,), float64
        Seconds after the start of a column.
    column_time : float
        Seconds from the start of a column to that of the next.
    """

    elevations: Array
    azimuth_offsets: Array
    firing_times: Array
    column_time: float


# fmt: off
_VLP32C_ELEVATIONS = np.array([
    -25.0, -1.0, -1.667, -15.639, -11.31, 0.0, -0.667, -8.843,
    -7.254, 0.333, -0.333, -6.148, -5.333, 1.333, 0.667, -4.0,
    -4.667, 1.667, 1.0, -3.667, -3.333, 3.333, 2.333, -2.667,
    -3.0, 7.0, 4.667, -2.333, -2.0, 15.0, 10.333, -1.333,
])
_VLP32C_OFFSETS = np.array([
    1.4, -4.2, 1.4, -1.4, 1.4, -1.4, 4.2, -1.4, 1.4, -4.2, 1.4, -1.4, 4.2, -1.4, 4.2, -1.4,
    1.4, -4.2, 1.4, -4.2, 4.2, -1.4, 1.4, -1.4, 1.4, -1.4, 1.4, -4.2, 4.2, -1.4, 1.4, -1.4,
])
_VLS128_ELEVATIONS = np.array([
    -11.742, -1.99, 3.4, -5.29, -0.78, 4.61, -4.08, 1.31,
    -6.5, -1.11, 4.28, -4.41, 0.1, 6.48, -3.2, 2.19,
    -3.86, 1.53, -9.244, -1.77, 2.74, -5.95, -0.56, 4.83,
    -2.98, 2.41, -6.28, -0.89, 3.62, -5.07, 0.32, 7.58,
    -0.34, 5.18, -3.64, 1.75, -25.0, -2.43, 2.96, -5.73,
    0.54, 9.7, -2.76, 2.63, -7.65, -1.55, 3.84, -4.85,
    3.18, -5.51, -0.12, 5.73, -4.3, 1.09, -16.042, -2.21,
    4.06, -4.63, 0.76, 15.0, -3.42, 1.97, -6.85, -1.33,
    -5.62, -0.23, 5.43, -3.53, 0.98, -19.582, -2.32, 3.07,
    -4.74, 0.65, 11.75, -2.65, 1.86, -7.15, -1.44, 3.95,
    -2.1, 3.29, -5.4, -0.01, 4.5, -4.19, 1.2, -13.565,
    -1.22, 4.17, -4.52, 0.87, 6.08, -3.31, 2.08, -6.65,
    1.42, -10.346, -1.88, 3.51, -6.06, -0.67, 4.72, -3.97,
    2.3, -6.39, -1.0, 4.39, -5.18, 0.21, 6.98, -3.09,
    4.98, -3.75, 1.64, -8.352, -2.54, 2.85, -5.84, -0.45,
    8.43, -2.87, 2.52, -6.17, -1.66, 3.73, -4.96, 0.43,
])
# fmt: on
_VLS128_OFFSETS = np.tile([6.354, 4.548, 2.732, 0.911, -0.911, -2.732, -4.548, -6.354], 16)

#: "VLP-16 User Manual", 63-9243 Rev. D: table 9-1 and section 9.4.
VLP16 = Channels(
    np.array([-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15], np.float64),
    np.zeros(16),
    2.304e-6 * np.arange(16.0),
    55.296e-6,
)

#: "VLP-32C User Manual", 63-9325 Rev. C: table 9-6. Lasers fire in pairs. Offsets and times as in
#: ros-drivers/velodyne.
VLP32C = Channels(_VLP32C_ELEVATIONS, _VLP32C_OFFSETS, 2.304e-6 * (np.arange(32.0) // 2), 55.296e-6)

#: "VLS-128 User Manual", 63-9483 Rev. A, section 9.4: groups of eight, and a pause after half of
#: them. Angles as in the calibration of ros-drivers/velodyne.
VLS128 = Channels(
    _VLS128_ELEVATIONS,
    _VLS128_OFFSETS,
    2.665e-6 * (np.arange(128.0) // 8 + np.arange(128.0) // 64),
    53.3e-6,
)
