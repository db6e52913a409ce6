"""Viewsheds on a curved Earth: the horizon in closed form, and lowered rasters."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import raystream as rs

EARTH = 6_371_000.0


def horizon(radius: float, eye: float, target: float) -> float:
    """Distance along a sphere to the farthest target that is seen."""
    return radius * sum(math.acos(radius / (radius + height)) for height in (eye, target))


@pytest.mark.parametrize("target", [0.0, 8.0])
@pytest.mark.parametrize(
    ("radius", "refraction", "eye", "length", "tolerance"),
    [
        (50_000.0, 0.0, 20.0, 4000.0, 30.0),
        (50_000.0, 0.25, 20.0, 4000.0, 30.0),
        (EARTH, 0.0, 100.0, 80_000.0, 700.0),
        (EARTH, 0.13, 100.0, 80_000.0, 700.0),
    ],
)
def test_the_sea_is_seen_up_to_the_horizon(radius, refraction, eye, length, tolerance, target):
    """Refraction makes the Earth flatter: a sphere of the radius over 1 - k."""
    spacing = length / 800
    ground = rs.terrain(np.zeros((5, 801)), spacing=spacing)
    seen = ground.viewshed(
        (0.0, 2 * spacing),
        eye,
        target_height=target,
        earth_radius=radius,
        refraction=refraction,
    )
    distance = horizon(radius / (1.0 - refraction), eye, target)
    assert tolerance < distance < length - tolerance
    x = ground.x
    assert seen[2, x < distance - tolerance].all()
    assert not seen[2, x > distance + tolerance].any()
    assert ground.viewshed((0.0, 2 * spacing), eye).all()  # of a flat sea


def test_an_island_beyond_the_horizon_shows_its_top():
    """Of a mountain at distance d what is above the sight line over the horizon is seen."""
    radius, eye, spacing = 50_000.0, 20.0, 10.0
    heights = np.zeros((5, 401))
    heights[:, 320] = 60.0
    first = horizon(radius, eye, 0.0)
    hidden = radius / math.cos((3200.0 - first) / radius) - radius  # above it, it is seen
    for height, is_seen in ((hidden - 1.0, False), (hidden + 1.0, True)):
        heights[:, 320] = height
        seen = rs.terrain(heights, spacing=spacing).viewshed((0.0, 20.0), eye, earth_radius=radius)
        assert seen[2, 320] == is_seen


@given(st.integers(0, 2**16), st.floats(0.0, 0.9))
@settings(max_examples=15)
def test_it_is_the_viewshed_of_the_lowered_raster(seed, refraction):
    rng = np.random.default_rng(seed)
    heights = np.cumsum(rng.normal(size=(24, 30)), axis=1) * 4.0
    heights[rng.random(heights.shape) < 0.02] = np.nan
    heights[12:14, 10:12] = 5.0
    radius, place = 5000.0, (105.0, 123.0)
    ground = rs.terrain(heights, spacing=10.0)
    options = {"height": 9.0, "target_height": 2.0}
    x, y = np.meshgrid(ground.x, ground.y)
    squares = (x - place[0]) ** 2 + (y - place[1]) ** 2
    lowered = heights - (1.0 - refraction) / (2.0 * radius) * squares
    found = ground.viewshed(place, earth_radius=radius, refraction=refraction, **options)
    expected = rs.terrain(lowered, spacing=10.0).viewshed(place, **options)
    np.testing.assert_array_equal(found, expected)
    flat = ground.viewshed(place, **options)
    very_flat = ground.viewshed(place, earth_radius=1e300, **options)
    np.testing.assert_array_equal(very_flat, flat)


def test_distances_are_those_of_the_raster(monkeypatch):
    """Up to max_distance from the eye, not on the lowered ground."""
    ground = rs.terrain(np.zeros((3, 100)), spacing=10.0)
    eye = 30.0
    seen = ground.viewshed(
        (0.0, 10.0), eye, target_height=200.0, max_distance=500.0, earth_radius=2000.0
    )
    distances = np.sqrt(ground.x**2 + 170.0**2)
    np.testing.assert_array_equal(seen[1], distances <= 500.0)


def test_options_of_the_tracer_are_kept_and_labels():
    heights = np.zeros((4, 50))
    for options in ({"structure": "grid"}, {"structure": "bvh", "quality": "fast"}):
        ground = rs.terrain(heights, spacing=10.0, **options)
        seen = ground.viewshed((0.0, 10.0), 1.0, earth_radius=1000.0)
        assert 0.0 < seen.mean() < 1.0
    assert ground._lowered(np.zeros(3), 1000.0, 0.0).tracer.structure.options.quality == "fast"


@pytest.mark.parametrize(
    ("options", "error", "match"),
    [
        ({"earth_radius": 0.0}, ValueError, "earth_radius: expected more than the distance"),
        ({"earth_radius": -EARTH}, ValueError, "earth_radius: expected more than the distance"),
        ({"earth_radius": math.nan}, ValueError, "earth_radius: expected more than the distance"),
        ({"earth_radius": 6.371}, ValueError, r"of the farthest cell, 50, got 6.371; it is in the"),
        ({"earth_radius": "big"}, TypeError, "earth_radius"),
        ({"refraction": 0.13}, ValueError, "refraction: expected 0 without earth_radius"),
        ({"refraction": math.nan, "earth_radius": EARTH}, ValueError, "refraction: expected a fin"),
        ({"refraction": [1], "earth_radius": EARTH}, ValueError, "refraction: expected one number"),
    ],
)
def test_bad_arguments_are_named(options, error, match):
    ground = rs.terrain(np.zeros((4, 5)), spacing=10.0)
    with pytest.raises(error, match=match):
        ground.viewshed((0.0, 0.0), 1.0, **options)
