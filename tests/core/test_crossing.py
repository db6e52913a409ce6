"""Slopes of crossings, points and padded rows, with NumPy alone."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from conftest import assert_same_bits
from gradients import crossing, differences, hits_of, open_mesh, relative_error
from raystream.core.crossing import HitRows, inverse_rows, points_at
from raystream.core.padded_hits import pad


@pytest.fixture(scope="module")
def traced():
    """A tracer, its rays and their hits, some of them misses."""
    scene, _ = open_mesh()
    tracer = rs.Tracer(scene)
    rays = hits_of(scene, 200)
    return tracer, rays, tracer.first_hit(*rays)


def rows_of(directions, corners, is_hit):
    """The rows as an array of shape (N, 3, 3)."""
    return np.moveaxis(np.array(inverse_rows(np, directions, corners, is_hit)), -1, 0)


def test_rows_are_slopes_by_the_origin(traced):
    tracer, (origins, directions), hits = traced
    corners = tracer.structure.triangles.touching_corners(hits)
    rows, is_hit = rows_of(directions, corners, hits.is_hit), hits.is_hit
    assert 100 < is_hit.sum() < 200
    expected = differences(origins[is_hit], directions[is_hit], corners[is_hit])
    assert relative_error(rows[is_hit], expected[:, :3, :3]) < 1e-6
    assert not rows[~is_hit].any()


def test_points_are_the_triangle_s(traced):
    tracer, rays, hits = traced
    corners = tracer.structure.triangles.touching_corners(hits)
    weights = hits.u.astype(float), hits.v.astype(float)
    points = np.stack(points_at(np, corners, *weights, hits.is_hit), axis=-1)
    np.testing.assert_allclose(points, hits.positions, rtol=1e-12)  # NaN at the same places
    is_hit = hits.is_hit
    expected = crossing(rays[0][is_hit], rays[1][is_hit], corners[is_hit])[:, 3:]
    np.testing.assert_allclose(points[is_hit], expected, atol=1e-5)


TRIANGLE = np.array([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]])


@pytest.mark.parametrize("direction", [[1.0, 0, 0], [1.0, 0, 1e-310], [1.0, 0, 5e-324], [0, 0, 0]])
def test_rays_in_the_plane_have_no_slopes_rather_than_infinite_ones(direction):
    with np.errstate(all="ignore"):
        rows = rows_of(np.array([direction]), TRIANGLE, np.array([True]))
    assert not rows.any()


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_numbers_of_misses_do_not_matter(bad):
    rows = rows_of(np.full((1, 3), bad), np.full((1, 3, 3), bad), np.array([False]))
    assert not rows.any()


def corners_of(triangles, prim_id):
    """The corners of triangles, as of hits."""
    weights = np.zeros(prim_id.shape, np.float32)
    return triangles.touching_corners(HitRows(weights, weights, prim_id, np.minimum(prim_id, 0)))


def test_corners_are_in_world_space():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]]) + 1e6
    scene = rs.Scene.from_arrays(vertices, [[0, 1, 2]])
    found = corners_of(scene.triangles, np.array([[0, -1]], np.int32))
    assert not found[0, 1].any()
    np.testing.assert_allclose(found[0, 0], vertices, rtol=1e-12)
    assert found.shape == (1, 2, 3, 3)
    none = rs.Scene.from_arrays(np.zeros((0, 3)), np.zeros((0, 3), int))
    assert corners_of(none.triangles, np.full(4, -1, np.int32)).shape == (4, 3, 3)


@pytest.mark.parametrize("max_hits", [0, 1, 3, 9])
def test_padded_rows_are_those_of_each_ray(traced, max_hits):
    tracer, (origins, directions), _ = traced
    rays = origins.reshape(50, 4, 3), directions.reshape(50, 4, 3)
    found = tracer.multi_hit(*rays, max_hits=max_hits)
    padded = pad(found, max_hits)
    assert max_hits == 0 or found.counts.max() > 0
    missing = {"t": np.inf, "u": 0, "v": 0, "prim_id": -1}
    for name, value in missing.items():
        column = getattr(found, name)
        rows = np.full((200, max_hits), value, column.dtype)
        for ray, (begin, end) in enumerate(
            zip(found.ray_splits, found.ray_splits[1:], strict=False)
        ):
            rows[ray, : end - begin] = column[begin:end]
        assert_same_bits(getattr(padded, name), rows.reshape(50, 4, max_hits))
