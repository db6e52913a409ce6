"""Daylight: a sun and a clear sky (Preetham, Shirley and Smits 1999)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from raystream.core.checks import check_finite
from raystream.scene.camera import unit_vector
from raystream.scene.lights import DirectionalLight, EnvironmentLight

#: Rows and columns of the sky's image, which has no small features: the sun is a light of its own.
_SIZE = 128, 256

#: Luminance and illuminance for which values are 1, in kcd/m^2 and klx: about those of a white
#: surface in the sun.
_UNIT = 30.0

#: Illuminance by the sun above the atmosphere, klx.
_SUN_ILLUMINANCE = 128.0

#: Wavelengths of red, green and blue in micrometres: those of sRGB's primaries.
_WAVELENGTHS = np.array([0.611, 0.549, 0.464])

#: Absorption by ozone at these wavelengths, per cm, and its usual amount in cm.
_OZONE, _OZONE_AMOUNT = np.array([0.12, 0.085, 0.0075]), 0.35

#: Part of the light that the ground reflects.
_GROUND = 0.2

#: Slopes and offsets of Perez' five coefficients in turbidity: luminance Y, chromaticity x and y.
_SLOPES = np.array(
    [
        [0.1787, -0.3554, -0.0227, 0.1206, -0.0670],
        [-0.0193, -0.0665, -0.0004, -0.0641, -0.0033],
        [-0.0167, -0.0950, -0.0079, -0.0441, -0.0109],
    ]
)
_OFFSETS = np.array(
    [
        [-1.4630, 0.4275, 5.3251, -2.5771, 0.3703],
        [-0.2592, 0.0008, 0.2125, -0.8989, 0.0452],
        [-0.2608, 0.0092, 0.2102, -1.6537, 0.0529],
    ]
)

#: Chromaticity x and y at the zenith: rows are powers 2, 1, 0 of turbidity, columns powers 3, 2, 1,
#: 0 of the sun's angle from the zenith.
_ZENITH = np.array(
    [
        [
            [0.00166, -0.00375, 0.00209, 0.0],
            [-0.02903, 0.06377, -0.03202, 0.00394],
            [0.11693, -0.21196, 0.06052, 0.25886],
        ],
        [
            [0.00275, -0.00610, 0.00317, 0.0],
            [-0.04214, 0.08970, -0.04153, 0.00516],
            [0.15346, -0.26756, 0.06670, 0.26688],
        ],
    ]
)

#: Linear sRGB of CIE XYZ.
_RGB = np.array(
    [
        [3.2404542, -1.5371385, -0.4985314],
        [-0.9692660, 1.8760108, 0.0415560],
        [0.0556434, -0.2040259, 1.0572252],
    ]
)


def daylight(
    azimuth: float = 135.0,
    elevation: float = 45.0,
    *,
    up: ArrayLike = (0.0, 1.0, 0.0),
    turbidity: float = 3.0,
) -> tuple[DirectionalLight, EnvironmentLight]:
    """Make the lights of a clear day: the sun and the sky.

    Parameters
    ----------
    azimuth : float
        Azimuth of the sun in degrees, clockwise as seen from above: 0 is north and 90 is east.
        East is the world's +x; north is -z if y is up, and +y if z is up.
    elevation : float
        Elevation of the sun above the horizon in degrees, greater than 0 and at most 90.
    up : array_like of shape (3,)
        World space; need not be unit length. See :attr:`Scene.up`.
    turbidity : float
        Haze, 1.7 (very clear) to 10 (hazy).

    Returns
    -------
    tuple of DirectionalLight and EnvironmentLight
        Linear RGB in units in which a white surface that faces a high sun has a radiance of about
        1. The ground below the horizon reflects a fifth of the light.

    Raises
    ------
    ValueError
        If an argument is out of range.

    Notes
    -----
    Luminance and colour of the sky follow the model of Preetham, Shirley and Smits ("A Practical
    Analytic Model for Daylight", 1999), with Perez' distribution; the sun is dimmed by air, ozone
    and haze as in that paper, at three wavelengths. The model is less accurate close to the
    horizon.

    Examples
    --------
    >>> import raystream as rs
    >>> scene = rs.load("building")
    >>> sunny = scene.replace(lights=rs.daylight(200, 35, up=scene.up))
    """
    axis = unit_vector("up", up)
    check_finite("azimuth", azimuth)
    if not 0.0 < elevation <= 90.0:
        raise ValueError(f"elevation: expected above 0 and at most 90 degrees, got {elevation}")
    if not 1.7 <= turbidity <= 10.0:
        raise ValueError(f"turbidity: expected 1.7 to 10, got {turbidity}")
    zenith_angle, turn = math.radians(90.0 - elevation), math.radians(azimuth)
    sun = _sunlight(zenith_angle, turbidity)
    sky = _sky(zenith_angle, turn, turbidity)
    sky[_SIZE[0] // 2 :] = _GROUND * (sun * math.cos(zenith_angle) + _irradiance(sky)) / math.pi
    east, north = _east_and_north(axis)
    level = math.cos(turn) * north + math.sin(turn) * east
    toward = math.cos(zenith_angle) * axis + math.sin(zenith_angle) * level
    image = sky.astype(np.float32)
    red, green, blue = map(float, sun)
    x, y, z = map(float, -toward)
    top = float(axis[0]), float(axis[1]), float(axis[2])
    return DirectionalLight((x, y, z), (red, green, blue)), EnvironmentLight(image=image, up=top)


def _east_and_north(up: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Level unit vectors; an environment's image has its centre in the north."""
    east = np.array([1.0, 0.0, 0.0]) - up[0] * up
    if np.linalg.norm(east) < 1e-6:  # east is up
        east = np.array([0.0, 0.0, 1.0]) - up[2] * up
    east /= np.linalg.norm(east)
    return east, np.cross(up, east)


def _sunlight(zenith_angle: float, turbidity: float) -> NDArray[np.float64]:
    """Irradiance of a surface that faces the sun, shape (3,)."""
    degrees = math.degrees(zenith_angle)
    mass = 1.0 / (math.cos(zenith_angle) + 0.15 * (93.885 - degrees) ** -1.253)
    haze = max(0.04608 * turbidity - 0.04586, 0.0)
    depth = 0.008735 * _WAVELENGTHS**-4.08 + haze * _WAVELENGTHS**-1.3 + _OZONE * _OZONE_AMOUNT
    return _SUN_ILLUMINANCE / _UNIT * np.exp(-depth * mass)


def _sky(zenith_angle: float, turn: float, turbidity: float) -> NDArray[np.float64]:
    """Radiance of the sky as an image all around; the lower half is not defined."""
    height, width = _SIZE
    angles = (np.arange(height)[:, None] + 0.5) * (math.pi / height)
    turns = ((np.arange(width) + 0.5) / width - 0.5) * (2.0 * math.pi)
    cosines = np.maximum(np.cos(angles), 0.01)
    to_sun = np.cos(angles) * math.cos(zenith_angle) + np.sin(angles) * math.sin(
        zenith_angle
    ) * np.cos(turns - turn)
    to_sun = np.clip(to_sun, -1.0, 1.0)
    at_zenith = _zenith(zenith_angle, turbidity)
    values = []
    for coefficients, level in zip(_SLOPES * turbidity + _OFFSETS, at_zenith, strict=True):
        there = _perez(coefficients, 1.0, math.cos(zenith_angle))
        values.append(level * _perez(coefficients, cosines, to_sun) / there)
    luminance, x, y = values
    xyz = np.stack([x / y, np.ones_like(y), (1.0 - x - y) / y], axis=-1) * luminance[..., None]
    return np.maximum(xyz @ _RGB.T, 0.0) / _UNIT


def _zenith(angle: float, turbidity: float) -> tuple[float, float, float]:
    """Luminance in kcd/m^2 and chromaticity x, y at the zenith."""
    chi = (4.0 / 9.0 - turbidity / 120.0) * (math.pi - 2.0 * angle)
    luminance = (4.0453 * turbidity - 4.9710) * math.tan(chi) - 0.2155 * turbidity + 2.4192
    powers = np.array([angle**3, angle**2, angle, 1.0])
    x, y = np.array([turbidity**2, turbidity, 1.0]) @ _ZENITH @ powers
    return max(luminance, 0.0), float(x), float(y)


def _perez(
    coefficients: NDArray[np.float64], cosine: ArrayLike, to_sun: ArrayLike
) -> NDArray[np.float64]:
    """Perez' distribution, by the cosines of the angles from the zenith and from the sun."""
    a, b, c, d, e = coefficients
    along = np.asarray(to_sun, np.float64)
    value: NDArray[np.float64] = (1.0 + a * np.exp(b / np.asarray(cosine, np.float64))) * (
        1.0 + c * np.exp(d * np.arccos(along)) + e * along * along
    )
    return value


def _irradiance(sky: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of level ground by the upper half of the sky, shape (3,)."""
    height, width = _SIZE
    angles = (np.arange(height // 2) + 0.5) * (math.pi / height)
    areas = np.sin(angles) * np.cos(angles) * (math.pi / height) * (2.0 * math.pi / width)
    return np.einsum("i,ijk->k", areas, sky[: height // 2])
