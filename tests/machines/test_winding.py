"""Winding numbers by the tree: within their bounds, and `contains` decides as exact sums do."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import raystream as rs
from meshes import dented_sphere, grid_floor, icosphere, soup, sticks
from raystream.machines import winding
from raystream.machines.batch import run_calls
from test_closest_point import scenes_and_points


def by_tree(triangles, points, opening):
    """Winding numbers, and bounds of their errors."""
    calls, *found = winding._tree_sums(triangles, points, opening)
    run_calls(calls, (0, len(points)), winding._TREE_CALLS)
    return found


def exactly(triangles, points):
    """Winding numbers by the sum over all triangles."""
    (sums, arguments), found = winding._exact_sums(triangles, points)
    sums(0, len(points), *arguments)
    return found


def open_sphere(level):
    """A sphere with a hole."""
    vertices, faces = icosphere(level)
    return vertices, faces[vertices[faces].mean(axis=1)[:, 2] < 0.8]


SCENES = {
    "open": lambda: open_sphere(4),
    "closed": lambda: dented_sphere(4),
    "soup": lambda: soup(3000, 6),
    "flat": lambda: grid_floor(40),
    "needles": lambda: sticks(800, 1e-3),
    "tiny": lambda: (open_sphere(4)[0] * 1e-9, open_sphere(4)[1]),
    "enormous": lambda: (open_sphere(4)[0] * 1e20, open_sphere(4)[1]),
    "far from the origin": lambda: (open_sphere(4)[0] + [1e7, -3e7, 2e7], open_sphere(4)[1]),
}


def triangles_of(name):
    return rs.Tracer(rs.Scene.from_arrays(*SCENES[name]())).structure.triangles


def points_of(triangles, count, seed=0):
    """Around, near and far from local triangles."""
    rng = np.random.default_rng(seed)
    corners = triangles.corners[triangles.prim_ids].astype(np.float64)
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    size = float((high - low).max())
    around = low - size / 4 + rng.random((count, 3)) * (high - low + size / 2)
    at = corners[rng.integers(0, len(corners), count), 0]
    near = at + rng.normal(size=(count, 3)) * size * 10.0 ** rng.uniform(-6, -1, (count, 1))
    far = at + rng.normal(size=(count, 3)) * size * 10.0 ** rng.uniform(0, 6, (count, 1))
    kind = rng.choice(4, count, p=[0.4, 0.05, 0.35, 0.2])[:, None]
    return np.select([kind == k for k in range(4)], [around, at, near, far])


def half_angles(point, corners):
    """Half of each triangle's solid angle from one point, by NumPy."""
    a, b, c = (corners[:, k] - point for k in range(3))
    lengths = [np.linalg.norm(one, axis=1) for one in (a, b, c)]
    real = lengths[0] * lengths[1] * lengths[2]
    for p, q, length in ((a, b, lengths[2]), (b, c, lengths[0]), (c, a, lengths[1])):
        real = real + np.einsum("ij,ij->i", p, q) * length
    return np.arctan2(np.einsum("ij,ij->i", a, np.cross(b, c)), real)


@pytest.mark.parametrize("name", SCENES)
def test_errors_are_within_their_bounds(name):
    """A wrong term of the expansion exceeds the bound where groups are far away."""
    triangles = triangles_of(name)
    points = points_of(triangles, 1000)
    exact = exactly(triangles, points)
    for opening in (0.9, 0.5, 0.3, 0.1, 0.03, 0.01):
        found, errors = by_tree(triangles, points, opening)
        assert (np.abs(found - exact) <= errors).all(), opening
        if opening <= 0.1:
            # Four terms of the third power, twice the area; soups and needles have more of it.
            assert np.median(errors) < 20.0 * opening**3
        if opening >= 0.3:
            assert np.mean(np.abs(found - exact) > 1e-12) > 0.01  # the tree is used


@settings(max_examples=60)
@given(scenes_and_points(), st.floats(0.001, 0.999))
def test_bounds_hold_for_any_triangles(drawn, opening):
    vertices, faces, points = drawn
    triangles = rs.Tracer(rs.Scene.from_arrays(vertices, faces), "brute").structure.triangles
    if not len(triangles.prim_ids):
        return
    local = (np.asarray(points, np.float64) - triangles.center) * triangles.scale
    corners = triangles.corners[triangles.prim_ids].astype(np.float64).reshape(-1, 3)
    # On the surface exact sums count no solid angle at a corner or an edge.
    away = np.abs(local[:, None] - corners).max(axis=2).min(axis=1) > 1e-6 * np.ptp(corners)
    local = np.concatenate([local[away], corners.max(axis=0) + np.eye(3) * np.ptp(corners)])
    found, errors = by_tree(triangles, local, opening)
    off = np.abs(found - exactly(triangles, local))
    # By whole turns where a point is in the plane of a triangle: there the sides are by chance.
    assert (np.abs(off - np.round(off)) <= errors + 1e-9).all()
    assert (off[-3:] <= errors[-3:] + 1e-9).all()  # outside, where no side is in doubt


def test_expansions_are_the_sums_of_numpy():
    triangles = triangles_of("soup")
    points = points_of(triangles, 20)
    corners = triangles.corners[triangles.prim_ids].astype(np.float64)
    expected = [half_angles(point, corners).sum() / (2.0 * np.pi) for point in points]
    found, errors = by_tree(triangles, points, 0.1)
    assert (np.abs(found - expected) <= errors + 1e-12).all()


@pytest.mark.parametrize("name", ["open", "soup", "flat", "far from the origin"])
def test_insides_are_those_of_exact_sums(name, monkeypatch):
    triangles = triangles_of(name)
    local = points_of(triangles, 20_000, 1)
    if name != "flat":  # and where the number is almost 1/2
        line = np.linspace(0.0, 3.0, 4000)[:, None] * [0.0, 0.0, 1.0]
        local = np.concatenate([local, local.mean(axis=0) + line])
    points = local / triangles.scale + triangles.center
    expected = np.abs(winding.winding_of(triangles, points)) > 0.5
    summed, sums = [], winding._exact_sums
    monkeypatch.setattr(winding, "_exact_sums", lambda *of: summed.append(of[1]) or sums(*of))
    found = winding.inside_by_winding(triangles, points)
    np.testing.assert_array_equal(found, expected)
    # Near a flat sheet all numbers are almost 1/2.
    assert sum(map(len, summed)) < (0.4 if name == "flat" else 0.02) * len(points)


@pytest.mark.exhaustive
def test_a_million_points():
    """Of an open sphere, around it and near the level of 1/2: none that differs."""
    triangles = triangles_of("open")
    rng = np.random.default_rng(2026)
    points = points_of(triangles, 500_000, 2)
    disc = rng.uniform(-0.8, 0.8, (500_000, 3)) * [1.0, 1.0, 0.4] + [0.0, 0.0, 0.8]
    points = np.concatenate([points, disc])
    exact = winding.winding_of(triangles, points)
    assert np.mean(np.abs(np.abs(exact) - 0.5) < 0.05) > 0.02
    np.testing.assert_array_equal(winding.inside_by_winding(triangles, points), np.abs(exact) > 0.5)
    for accuracy in (1e-2, 1e-4):
        found = winding.winding_of(triangles, points, None, accuracy)
        assert np.abs(found - exact).max() <= accuracy


@pytest.mark.parametrize("accuracy", [10.0, 0.1, 1e-3, 1e-5, 1e-9, 1e-300])
def test_errors_are_below_the_accuracy(accuracy):
    tracer = rs.Tracer(rs.Scene.from_arrays(*open_sphere(4)))
    points = points_of(tracer.structure.triangles, 1000, 3).reshape(10, 100, 3)
    points[3, 4, 1] = np.nan
    exact = tracer.winding_number(points)
    found = tracer.winding_number(points, accuracy=accuracy)
    assert found.shape == (10, 100)
    assert np.isnan(found).sum() == 1
    assert np.nanmax(np.abs(found - exact)) <= accuracy
    assert (accuracy < 1e-3) or np.nanmax(np.abs(found - exact)) > 0.0


def test_small_scenes_and_few_points_are_summed():
    tracer = rs.Tracer(rs.Scene.from_arrays(*open_sphere(2)))
    points = points_of(tracer.structure.triangles, 1000)
    for some in (points, points[:9]):
        np.testing.assert_array_equal(
            tracer.winding_number(some, accuracy=0.1), tracer.winding_number(some)
        )


@pytest.mark.parametrize("accuracy", [-1e-3, np.nan])
def test_accuracies_are_numbers_from_zero(accuracy):
    tracer = rs.Tracer(rs.load("cornell"))
    with pytest.raises(ValueError, match="accuracy: expected a number >= 0, got"):
        tracer.winding_number([0.0, 0.0, 0.0], accuracy=accuracy)


def test_progress_reaches_its_end():
    tracer = rs.Tracer(rs.Scene.from_arrays(*open_sphere(4)))
    points = points_of(tracer.structure.triangles, 20_000)
    for query in (
        lambda report: tracer.contains(points, method="winding", progress=report),
        lambda report: tracer.winding_number(points, accuracy=1e-4, progress=report),
    ):
        steps = []
        query(lambda done, count, steps=steps: steps.append(done / count))
        assert steps[-1] == 1.0
        assert max(steps) <= 1.0
