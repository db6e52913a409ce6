"""Transforms of rays to the local frame, and limits in the caller's units."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from meshes import icosphere


@pytest.fixture(scope="module")
def ball():
    vertices, faces = icosphere(3)
    return rs.Scene.from_arrays(vertices, faces)


def step(t, direction):
    return np.nextafter(np.float32(t), np.float32(direction))


@pytest.mark.parametrize("distance", [3.0, 1e3, 1e6, 1e9])
@pytest.mark.parametrize("length", [1.0, 1e-9, 3e7, 1e-25])
def test_limits_are_closed_in_the_reported_distance(ball, distance, length, rng):
    """t_max = the reported t keeps the hit; the next smaller number loses it. So for t_min."""
    count = 200
    origins = rng.normal(size=(count, 3))
    origins *= distance / np.linalg.norm(origins, axis=1, keepdims=True)
    directions = (rng.normal(size=(count, 3)) * 0.3 - origins) * (length / distance)
    for structure in ("brute", "bvh"):
        tracer = rs.Tracer(ball, structure)
        many = tracer.multi_hit(origins, directions)
        t = np.full(count, np.inf, np.float32)
        found = many.counts > 0
        t[found] = many.t[many.ray_splits[:-1][found]]
        same = np.bincount(many.ray_id[many.t == t[many.ray_id]], minlength=count)
        upto = tracer.count_hits(origins, directions, t_max=t)
        np.testing.assert_array_equal(upto[found], same[found])
        assert not tracer.any_hit(origins, directions, t_max=step(t, -np.inf))[found].any()
        from_t = tracer.count_hits(origins, directions, t_min=t)
        np.testing.assert_array_equal(from_t[found], many.counts[found])
        after = tracer.count_hits(origins, directions, t_min=step(t, np.inf))
        np.testing.assert_array_equal(after[found], many.counts[found] - same[found])


@pytest.mark.parametrize("distance", [1e2, 1e5, 1e8, 1e12])
def test_origins_far_outside_hit_as_precisely_as_near_ones(ball, distance, rng):
    """The same lines, begun near and far: the same points on the surface."""
    count = 500
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    through = rng.uniform(-0.5, 0.5, (count, 3))
    tracer = rs.Tracer(ball)
    near = tracer.first_hit(through - 3 * direction, direction)
    far = tracer.first_hit(through - distance * direction, direction)
    assert near.is_hit.all()
    assert far.is_hit.all()
    reach = distance * 2.0**-52  # the origin itself is no more precise in float64
    np.testing.assert_allclose(far.positions, near.positions, atol=4e-6 + 4 * reach)
    np.testing.assert_allclose(far.t, near.t + (distance - 3), rtol=1e-6)


def test_far_rays_that_point_away_or_past_miss(ball):
    tracer = rs.Tracer(ball)
    origins = [[1e6, 0, 0], [1e6, 0, 0], [1e6, 5e5, 0], [0, 0, -1e30]]
    directions = [[1, 0, 0], [-1, 1e-3, 0], [-1, 0, 0], [0, 1, 0]]
    assert not tracer.any_hit(origins, directions).any()
    # Behind the origin is a hit when the interval says so.
    hits = tracer.first_hit([1e6, 0, 0], [1, 0, 0], t_min=-np.inf)
    assert hits.is_hit
    np.testing.assert_allclose(hits.t, -1e6, rtol=1e-5)
    assert tracer.any_hit([1e6, 0, 0], [1, 0, 0], t_min=-2e6, t_max=-1.0)
    assert not tracer.any_hit([1e6, 0, 0], [1, 0, 0], t_min=-9e5, t_max=-1.0)


def test_the_length_of_a_direction_scales_t(ball):
    tracer = rs.Tracer(ball)
    for exponent in (-120, -40, 0, 40, 110):
        length = 2.0**exponent
        hits = tracer.first_hit([0.1, 0.2, -3], np.array([0, 0, 1.0]) * length)
        one = tracer.first_hit([0.1, 0.2, -3], [0, 0, 1.0])
        assert hits.t == one.t / np.float32(length)
        assert hits.prim_id == one.prim_id


def test_a_distance_beyond_float32_is_still_a_hit(ball):
    hits = rs.Tracer(ball).first_hit([0.1, 0.2, -3], [0, 0, 1e-300])
    assert hits.is_hit
    assert hits.t == np.finfo(np.float32).max
    assert rs.Tracer(ball).any_hit([0.1, 0.2, -3], [0, 0, 5e-324])
    assert rs.Tracer(ball).any_hit([0.1, 0.2, -3], [0, 0, 1e308])
    np.testing.assert_allclose(hits.positions[:2], [0.1, 0.2], atol=1e-6)


def test_a_component_much_smaller_than_the_others(ball):
    tracer = rs.Tracer(ball)
    direction = np.array([[1.0, small, -small] for small in (0.0, -0.0, 1e-46, 1e-30, 1e-12)])
    hits = tracer.first_hit([-3, 0.1, 0.2], direction)
    assert hits.is_hit.all()
    np.testing.assert_allclose(hits.t, hits.t[0], rtol=1e-6)
    assert len(set(hits.prim_id.tolist())) == 1


def test_origins_so_far_away_that_float64_is_coarse():
    """Four stacked triangles: the nearest one is hit, at 1e12 and at 1e30."""
    base = np.array([[-9, -9, 0], [9, -9, 0], [0, 9, 0]], float)
    vertices = (base[None] + np.arange(4)[:, None, None] * [0, 0, 1]).reshape(-1, 3)
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, np.arange(12).reshape(-1, 3)))
    for distance in (1e12, 1.1e30):
        for length in (1.0, 0.1, 1.7):
            hits = tracer.first_hit([0, 0, distance], [0, 0, -length])
            assert hits.prim_id == 3
            np.testing.assert_allclose(hits.t, distance / length, rtol=1e-6)
