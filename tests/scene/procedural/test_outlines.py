"""Outlines: bevels, circles, holes, gears and bands, counter-clockwise and of the stated size."""

from __future__ import annotations

import numpy as np
import pytest

from raystream.scene.procedural import outlines

SQUARE = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]


def area(outline):
    x, y = outline.points.T
    return float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)) / 2


def test_sharp_corners_become_short_edges_with_the_normals_of_their_neighbours():
    outline = outlines.bevelled(SQUARE, 0.1)
    assert area(outline) == pytest.approx(4.0 - 4 * 0.1**2 / 2)
    np.testing.assert_allclose(outline.points[:2], [(-1.0, -0.9), (-0.9, -1.0)])
    np.testing.assert_allclose(outline.normals[:2], [(-1.0, 0.0), (0.0, -1.0)], atol=1e-12)
    # At most 0.3 of an edge is cut at its ends.
    assert area(outlines.bevelled(SQUARE, 5.0)) == pytest.approx(4.0 - 4 * 0.6**2 / 2)


def test_blunt_corners_stay_and_have_normals_in_between():
    corners = outlines.circle(1.0, 24).points
    outline = outlines.bevelled(corners, 0.01)
    np.testing.assert_allclose(outline.points, corners)
    np.testing.assert_allclose(outline.normals, corners, atol=1e-12)


def test_without_bevel_there_are_no_normals():
    outline = outlines.bevelled(SQUARE, 0.0)
    np.testing.assert_array_equal(outline.points, SQUARE)
    assert outline.normals is None
    assert outline.enlarged(1.0) is outline


def test_open_outlines_keep_their_ends():
    profile = outlines.bevelled([(0.0, 0.0), (1.0, 0.0), (1.0, 2.0), (0.0, 2.0)], 0.1, closed=False)
    np.testing.assert_allclose(profile.points[[0, -1]], [(0.0, 0.0), (0.0, 2.0)])
    np.testing.assert_allclose(profile.normals[[0, -1]], [(0.0, -1.0), (0.0, 1.0)])
    assert len(profile.points) == 6


@pytest.mark.parametrize("closed", [True, False])
def test_edges_are_divided_evenly(closed):
    outline = outlines.bevelled(SQUARE, 0.0, closed=closed, steps=4)
    lengths = np.hypot(*np.diff(outline.points, axis=0).T)
    np.testing.assert_allclose(lengths, 0.5)
    assert len(outline.points) == (16 if closed else 13)


def test_holes_contain_their_circle_and_match_the_outline():
    outline = outlines.bevelled(SQUARE, 0.1, steps=3)
    hole = outlines.hole(outline, 0.5)
    directions = [np.arctan2(*points.T) for points in (outline.points, hole.points)]
    np.testing.assert_allclose(*directions)
    middles = (hole.points + np.roll(hole.points, -1, axis=0)) / 2
    assert np.hypot(*middles.T).min() >= 0.5 - 1e-12
    assert np.hypot(*hole.points.T).max() < 0.6


def test_gears_have_teeth_between_root_and_tip():
    gear = outlines.gear(1.0, 1.2, 17)
    assert len(gear.points) == 4 * 17
    np.testing.assert_allclose(np.unique(np.hypot(*gear.points.T).round(9)), [1.0, 1.2])
    assert np.pi < area(gear) < 1.44 * np.pi


def test_bands_enclose_both_circles():
    center = (3.0, -4.0)
    band = outlines.hull((1.0, 2.0), center, 400)
    for middle, radius in (((0.0, 0.0), 1.0), (center, 2.0)):
        away = np.hypot(*(band.points - middle).T)
        assert away.min() == pytest.approx(radius)
    # The convex hull of two discs: two sectors, and a trapezoid at either side.
    distance, turn = 5.0, np.arcsin(1.0 / 5.0)
    tangent = distance * np.cos(turn)
    exact = 3.0 * tangent + (np.pi / 2 - turn) + 4.0 * (np.pi / 2 + turn)
    assert area(band) == pytest.approx(exact, rel=1e-4)
