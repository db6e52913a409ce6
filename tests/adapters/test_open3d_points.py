"""Open3D's queries of points: closed forms, shapes, and rays through edges."""

from __future__ import annotations

import numpy as np
import pytest

from meshes import cube, icosphere
from raystream.adapters.open3d import RaycastingScene

INVALID = RaycastingScene.INVALID_ID


def scene_of(*meshes, **options):
    scene = RaycastingScene(**options)
    for vertices, faces in meshes:
        scene.add_triangles(vertices, faces)
    return scene


def test_distances_of_a_cube():
    points = np.random.default_rng(0).uniform(-1, 2, (20, 100, 3))
    scene = scene_of(cube())
    beyond = np.abs(points - 0.5) - 0.5
    outside = np.linalg.norm(np.maximum(beyond, 0), axis=-1)
    signed = outside + np.minimum(beyond.max(axis=-1), 0)
    assert 0.02 < (signed < 0).mean() < 0.1
    assert np.abs(scene.compute_distance(points) - np.abs(signed)).max() < 1e-6
    for options in ({}, {"nthreads": 2, "nsamples": 3}):
        found = scene.compute_signed_distance(points, **options)
        assert np.abs(found - signed).max() < 1e-6
        assert (scene.compute_occupancy(points, **options) == (signed < 0)).all()


def test_closest_points_of_two_meshes():
    one, two = cube(), (icosphere(2)[0] + [4, 0, 0], icosphere(2)[1])
    scene = scene_of(one, two)
    points = np.random.default_rng(1).uniform([-1, -1, -1], [6, 1, 1], (500, 3))
    found = scene.compute_closest_points(points)
    assert set(found["geometry_ids"].tolist()) == {0, 1}
    for number, (vertices, faces) in enumerate((one, two)):
        rows = found["geometry_ids"] == number
        corners = vertices[faces[found["primitive_ids"][rows]]]
        u, v = found["primitive_uvs"][rows].T[..., None]
        on_triangle = (1 - u - v) * corners[:, 0] + u * corners[:, 1] + v * corners[:, 2]
        assert np.abs(on_triangle - found["points"][rows]).max() < 2e-6
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        assert np.abs(normals - found["primitive_normals"][rows]).max() < 1e-6
    length = np.linalg.norm(found["points"] - points, axis=1)
    assert np.abs(length - scene.compute_distance(points)).max() < 2e-6


def test_rays_exactly_through_vertices_are_counted_once():
    from raystream.adapters.open3d_points import _DIRECTION

    tip = 2 * _DIRECTION.astype(np.float32).astype(float)
    side, front = np.cross(tip, [1.0, 0, 0]), np.cross(tip, [0, 1.0, 0])
    vertices = np.array([tip, -tip, side, -side, front, -front])
    faces = np.array([(a, b, c) for a in (0, 1) for b in (2, 3) for c in (4, 5)])
    scene = scene_of((vertices, faces))
    assert scene.compute_occupancy([[0, 0, 0]]).tolist() == [1.0]
    assert scene.compute_signed_distance([[0, 0, 0]])[0] < 0


def test_the_majority_decides_in_open_meshes():
    vertices, faces = icosphere(2)
    opened = vertices, faces[vertices[faces][:, :, 1].mean(axis=1) < 0.6]  # towards the first ray
    scene = scene_of(opened)
    assert scene.compute_occupancy([[0, 0, 0]]).tolist() == [0.0]
    assert scene.compute_occupancy([[0, 0, 0]], nsamples=15).tolist() == [1.0]


def test_shapes_and_dtypes():
    scene = scene_of(cube())
    for shape in ((), (5,), (2, 3), (0,)):
        points = np.zeros((*shape, 3), np.float32)
        found = scene.compute_closest_points(points)
        assert {name: (one.shape, one.dtype) for name, one in found.items()} == {
            "points": ((*shape, 3), np.float32),
            "geometry_ids": (shape, np.uint32),
            "primitive_ids": (shape, np.uint32),
            "primitive_uvs": ((*shape, 2), np.float32),
            "primitive_normals": ((*shape, 3), np.float32),
        }
        results = [
            getattr(scene, f"compute_{name}")(points)
            for name in ("distance", "signed_distance", "occupancy")
        ]
        assert [(one.shape, one.dtype) for one in results] == [(shape, np.float32)] * 3
        for one in (*found.values(), *results):
            assert type(one.numpy()) is np.ndarray


def test_bad_points_and_empty_scenes():
    bad = [[np.nan, 0, 0], [0, np.inf, 0]]
    for scene, points in ((scene_of(cube()), bad), (scene_of(), [[0, 0, 0], [1, 2, 3]])):
        found = scene.compute_closest_points(points)
        assert found["primitive_ids"].tolist() == [INVALID] * 2
        assert found["geometry_ids"].tolist() == [INVALID] * 2
        assert np.isnan(found["points"]).all()
        assert not found["primitive_normals"].any()
        assert np.isinf(scene.compute_distance(points)).all()
        assert np.isinf(scene.compute_signed_distance(points)).all()
        assert not scene.compute_occupancy(points).any()


def test_bad_arguments_are_named():
    scene = scene_of(cube())
    for name in ("closest_points", "distance", "signed_distance", "occupancy"):
        method = getattr(scene, f"compute_{name}")
        with pytest.raises(ValueError, match=r"query_points: expected shape \(..., 3\)"):
            method(np.zeros((2, 6)))
        with pytest.raises(TypeError, match="query_points: expected real numbers"):
            method([["x"] * 3])
    for nsamples in (0, 2, -1):
        with pytest.raises(ValueError, match="nsamples: expected an odd number"):
            scene.compute_occupancy([[0, 0, 0]], nsamples=nsamples)
    with pytest.raises(TypeError):
        scene.compute_signed_distance([[0, 0, 0]], nsamples=1.5)
    with pytest.raises(ValueError, match="bvh"):
        scene_of(cube(), structure="grid").compute_distance([[0, 0, 0]])
