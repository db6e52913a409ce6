"""The sun and the sky of clear days."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import raystream as rs

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])

UPS = {"y": (0, 1, 0), "z": (0, 0, 2), "x": (1, 0, 0), "slanting": (1, 2, -3)}


def toward_sun(sun):
    """Unit vector."""
    away = np.array(sun.direction)
    return -away / np.linalg.norm(away)


def test_directions_are_those_of_maps():
    """East is +x; north is -z where y is up, and +y where z is up."""
    for azimuth, expected in (
        (0, (0, 0, -1)),
        (90, (1, 0, 0)),
        (180, (0, 0, 1)),
        (270, (-1, 0, 0)),
    ):
        sun, _ = rs.daylight(azimuth, 1e-9)
        np.testing.assert_allclose(toward_sun(sun), expected, atol=1e-9)
    np.testing.assert_allclose(
        toward_sun(rs.daylight(0, 1e-9, up=(0, 0, 1))[0]), (0, 1, 0), atol=1e-9
    )
    np.testing.assert_allclose(toward_sun(rs.daylight(33, 90)[0]), (0, 1, 0), atol=1e-9)
    half = math.sqrt(0.5)
    np.testing.assert_allclose(toward_sun(rs.daylight(90, 45)[0]), (half, half, 0), atol=1e-9)


@pytest.mark.parametrize("up", UPS.values(), ids=UPS)
@pytest.mark.parametrize("azimuth", [20.0, 130.0, 250.0, 340.0])
def test_the_sky_is_brightest_around_the_sun(up, azimuth):
    """As rays see it: an image of the sky alone, all around."""
    sun, sky = rs.daylight(azimuth, 40.0, up=up)
    scene = rs.Scene(lights=[sky], up=up)
    level = np.cross(up, (0.3, 0.5, 0.7))
    camera = rs.Camera((0, 0, 0), level, up, projection="equirectangular")
    size = 128, 64
    seen = rs.render(scene, "vis", size, camera=camera).pixels @ LUMINANCE
    _, directions = camera.rays(*size)
    brightest = directions.reshape(-1, 3)[np.argmax(seen)]
    assert math.degrees(math.acos(min(float(brightest @ toward_sun(sun)), 1.0))) < 4.0


@given(
    azimuth=st.floats(-720, 720),
    elevation=st.floats(1e-6, 90),
    turbidity=st.floats(1.7, 10),
)
def test_all_suns_give_light(azimuth, elevation, turbidity):
    sun, sky = rs.daylight(azimuth, elevation, turbidity=turbidity)
    assert np.isfinite(sun.irradiance).all()
    assert min(sun.irradiance) >= 0.0
    assert sky.image.shape == (128, 256, 3)  # `EnvironmentLight` rejects NaN and negative values
    assert sky.image.max() < 100.0


def test_values_are_those_of_the_model():
    """The luminance at the zenith (Preetham 1999, appendix A.2), in 30 kcd/m^2."""
    for elevation, turbidity in ((45.0, 3.0), (70.0, 2.0), (30.0, 6.0)):
        angle = math.pi / 2 - math.radians(elevation)
        chi = (4 / 9 - turbidity / 120) * (math.pi - 2 * angle)
        expected = (4.0453 * turbidity - 4.9710) * math.tan(chi) - 0.2155 * turbidity + 2.4192
        _, sky = rs.daylight(0.0, elevation, turbidity=turbidity)
        found = float((sky.image[0] @ LUMINANCE).mean()) * 30.0
        assert found == pytest.approx(expected, rel=0.02)


def test_colours_are_those_of_a_clear_day():
    sun, sky = rs.daylight(180.0, 60.0)
    red, green, blue = sky.image[:20].mean(axis=(0, 1))
    assert blue > green > red
    assert sun.irradiance[0] > sun.irradiance[1] > sun.irradiance[2] > 0.8 * sun.irradiance[0]
    low, _ = rs.daylight(180.0, 4.0)
    assert low.irradiance[2] < 0.5 * low.irradiance[0]
    assert sum(low.irradiance) < 0.4 * sum(sun.irradiance)
    hazy, _ = rs.daylight(180.0, 60.0, turbidity=8.0)
    assert sum(hazy.irradiance) < sum(sun.irradiance)


def test_white_surfaces_in_the_sun_are_about_1():
    sun, sky = rs.daylight(180.0, 75.0)
    floor = rs.Mesh([[-9, 0, -9], [9, 0, -9], [9, 0, 9], [-9, 0, 9]], [[0, 2, 1], [0, 3, 2]])
    white = rs.Material(diffuse=(1, 1, 1))
    scene = rs.Scene([floor], materials=[white], lights=[sun, sky])
    camera = rs.Camera((0, 5, 1), (0, 0, 0), fov=20)
    seen = rs.render(scene, "path", (16, 12), 64, camera=camera).pixels.mean(axis=(0, 1))
    assert 0.8 < seen.mean() < 1.5
    lit = np.array(sun.irradiance) * math.sin(math.radians(75.0)) / math.pi
    assert (seen > 1.05 * lit).all()  # by the sky, too
    grey = sky.image[-1, 0] / seen
    np.testing.assert_allclose(grey, 0.2, rtol=0.03)  # the ground


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"azimuth": math.nan}, "azimuth: expected a finite number"),
        ({"elevation": 0.0}, "elevation: expected above 0 and at most 90 degrees"),
        ({"elevation": 91.0}, "elevation"),
        ({"elevation": math.nan}, "elevation"),
        ({"turbidity": 1.0}, "turbidity: expected 1.7 to 10"),
        ({"up": (0, 0, 0)}, "up: expected three finite numbers"),
        ({"up": (0, 1)}, "up"),
    ],
)
def test_suns_that_cannot_be_are_refused(arguments, says):
    with pytest.raises(ValueError, match=says):
        rs.daylight(**arguments)
