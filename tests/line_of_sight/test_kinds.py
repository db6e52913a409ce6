"""Points on spheres, height fields and triangles in float64, and which faces are visible."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from field_rays import mesh_of
from meshes import icosphere
from raystream.core.spheres import directions_at, numbers_toward


def test_numbers_of_points_on_spheres() -> None:
    directions = np.random.default_rng(1).normal(size=(1000, 3))
    unit = directions / np.linalg.norm(directions, axis=1)[:, None]
    np.testing.assert_allclose(directions_at(*numbers_toward(directions)), unit, atol=1e-15)


def test_points_on_a_sphere_see_what_is_above_their_tangent_plane() -> None:
    tracer = rs.Tracer(rs.Scene.spheres([[3, 0, 0], [0, 5, 0]], [1.0, 0.5]))
    rng = np.random.default_rng(2)
    points = rs.surface_points(tracer, np.zeros(200, int), *rng.uniform(0.0, 1.0, (2, 200)))
    others = rng.uniform(-9.0, 9.0, (300, 3)) + [0.0, -20.0, 0.0]  # the second hides none of them
    height = np.einsum("ik,ijk->ij", points.normals, others[None] - points.positions[:, None])
    clear = rs.visibility(tracer, points, others)
    is_certain = np.abs(height) > 1e-4
    assert np.array_equal(clear[is_certain], (height > 0.0)[is_certain])


def test_points_on_a_height_field_see_what_those_of_its_mesh_see() -> None:
    rng = np.random.default_rng(3)
    heights = rng.uniform(0.0, 1.0, (8, 9))
    tracers = [rs.Tracer(one) for one in (rs.Scene.height_field(heights), mesh_of(heights))]
    ids, places = rng.integers(0, 2 * 7 * 8, 60), rng.uniform([0, 0, 0], [8, 7, 3], (50, 3))
    found, wanted = (rs.visibility(one, rs.surface_points(one, ids), places) for one in tracers)
    assert np.array_equal(found, wanted)
    eye = rs.Camera((4, -6, 4), (4, 4, 0))
    found, wanted = (rs.visible_faces(one, eye, (40, 30)) for one in tracers)
    assert np.array_equal(found.prim_ids, wanted.prim_ids)
    assert np.array_equal(found.pixel_counts, wanted.pixel_counts)


def test_points_in_float64_see_what_those_in_float32_see() -> None:
    scene = rs.load("cornell")
    rng = np.random.default_rng(4)
    ids, places = np.arange(scene.triangle_count), rng.uniform(20.0, 530.0, (80, 3))
    tracers = [rs.Tracer(scene, precision=one) for one in ("float64", "float32")]
    found, wanted = (rs.visibility(one, rs.surface_points(one, ids), places) for one in tracers)
    assert np.array_equal(found, wanted)
    found, wanted = (rs.visible_faces(one, size=(50, 50)) for one in tracers)
    assert np.array_equal(found.prim_ids, wanted.prim_ids)


def test_points_in_float64_far_from_the_origin_do_not_hide_themselves() -> None:
    vertices, faces = icosphere(2)
    away = np.array([6.4e6, 1e6, -3e6]) + 1.0 / 3.0
    tracer = rs.Tracer(
        rs.Scene.from_arrays(vertices.astype(np.float64) + away, faces), precision="float64"
    )
    points = rs.surface_points(tracer, np.arange(len(faces)))
    place = away + [0.0, 0.0, 5.0]
    height = np.einsum("ik,ik->i", points.normals, place - points.positions)
    assert np.array_equal(rs.visibility(tracer, points, place[None])[:, 0], height > 0.0)


@pytest.mark.parametrize("pixels", [64, 3])
def test_the_sphere_in_front_hides_the_one_behind(pixels: int) -> None:
    scene = rs.Scene.spheres([[0, 0, 0], [0, 0, 5], [3, 0, 0]], [1.0, 0.5, 0.01])
    seen = rs.visible_faces(rs.Tracer(scene), rs.Camera((0, 0, -9), (0, 0, 0)), (pixels, pixels))
    assert seen.prim_ids.tolist() == [0, 2]
    assert seen.instance_ids.tolist() == [0, 0]


def test_view_factors_of_a_height_field_are_those_of_its_mesh() -> None:
    heights = np.random.default_rng(5).uniform(0.0, 3.0, (4, 5))
    scenes = rs.Scene.height_field(heights), mesh_of(heights)
    patches = np.arange(24) // 2
    found, wanted = (rs.view_factors(rs.Tracer(one), patches, rays=256) for one in scenes)
    np.testing.assert_allclose(found.factors, wanted.factors, atol=1e-12)


def test_view_factors_in_float64_are_right_far_from_the_origin() -> None:
    vertices = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    faces = [[0, 3, 1], [0, 2, 3], [4, 7, 6], [4, 5, 7], [0, 5, 4], [0, 1, 5]]
    faces += [[2, 7, 3], [2, 6, 7], [0, 6, 2], [0, 4, 6], [1, 7, 5], [1, 3, 7]]
    away = np.array([6.4e6, 1e6, -3e6]) + 1.0 / 3.0
    room = rs.Scene.from_arrays(vertices + away, faces)
    found = rs.view_factors(rs.Tracer(room, precision="float64"), np.arange(12) // 2, rays=4096)
    wanted = np.full((6, 6), 0.2000438)  # of sides that share an edge
    wanted[np.arange(6), [1, 0, 3, 2, 5, 4]] = 0.1998249
    np.fill_diagonal(wanted, 0.0)
    np.testing.assert_allclose(found.factors, wanted, atol=0.02)
