"""Points on surfaces of instances: solids where the answer is known, and flattened scenes."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from instanced import random_rotation, random_transforms
from meshes import cube, icosphere
from raystream.core.errors import RaystreamError

CONVEX = {"sphere": icosphere(2), "cube": cube(), "coarse": icosphere(0)}


def scene_of(mesh, transforms) -> rs.Scene:
    return rs.Scene.instances(rs.Scene.from_arrays(*mesh), transforms)


def random_points(tracer, rng, count):
    """Points anywhere in triangles of any instance."""
    scene = tracer.scene
    prim_ids = rng.integers(0, scene.triangle_count, count)
    instances = rng.integers(0, len(scene.placements), count)
    u, v = rng.random((2, count))
    u, v = np.where(u + v > 1, [1 - u, 1 - v], [u, v])
    return rs.surface_points(tracer, prim_ids, u, v, instances)


@pytest.mark.parametrize("solid", CONVEX)
@pytest.mark.parametrize(
    ("scale", "offset"), [(1.0, 0.0), (1e-3, 0.0), (1e4, 3.0), (1.0, 1e6), (7.0, 90.0)]
)
@pytest.mark.parametrize("thinness", [1.0, 1e-3, 1e-6])
def test_points_on_a_convex_instance_see_each_other_through_it(solid, scale, offset, thinness, rng):
    turns = [random_rotation(rng) for _ in range(2)]
    transform = np.zeros((1, 3, 4))
    transform[0, :, :3] = turns[0] @ np.diag([1.0, thinness, -1.0]) @ turns[1] * scale
    transform[0, :, 3] = offset
    tracer = rs.Tracer(scene_of(CONVEX[solid], transform))
    points = random_points(tracer, rng, 300)
    if thinness == 1e-6 and offset == 1e6:
        # World positions, of float64, are rounded by a thousandth of the plate's thickness: points
        # near its edges leave it.
        assert rs.visibility(tracer, points).mean() > 0.98
        return
    assert rs.visibility(tracer, points).all()
    assert rs.visibility(tracer, points, points).all()
    assert not rs.visibility(tracer, points, front_only=True).any()
    middle = points.positions.mean(axis=0)
    assert rs.visibility(tracer, [middle], points).all()
    assert rs.visibility(tracer, points, [middle]).all()


def test_points_see_what_they_see_in_the_flattened_scene(rng):
    transforms = random_transforms(rng, 8, 2.5)
    scene = scene_of(icosphere(1), transforms)
    tracer, flat = rs.Tracer(scene), rs.Tracer(scene.flattened())
    points = random_points(tracer, rng, 250)
    numbers = scene.triangles.numbers_of(points.prim_id, points.instance_id)
    # A mirror image's faces are turned: its vertices 1 and 2 are exchanged.
    is_mirrored = np.linalg.det(transforms[points.instance_id, :, :3]) < 0.0
    u, v = np.where(is_mirrored, [points.v, points.u], [points.u, points.v])
    same = rs.surface_points(flat, numbers, u, v)
    np.testing.assert_allclose(same.positions, points.positions, atol=1e-5)
    eyes = rng.uniform(-4.0, 4.0, (60, 3))
    for front_only in (False, True):
        for a, b, c, d in (
            (points, None, same, None),
            (points, eyes, same, eyes),
            (eyes, points, eyes, same),
        ):
            seen = rs.visibility(tracer, a, b, front_only=front_only)
            expected = rs.visibility(flat, c, d, front_only=front_only)
            assert (seen != expected).mean() < 2e-3  # rounding at silhouettes
            assert 0.02 < seen.mean() < 0.9


def test_a_shell_just_above_hides_a_sphere_from_afar(rng):
    """The shell is the same sphere in another instance, larger by a thousandth."""
    turn = random_rotation(rng) @ np.diag([1.0, 0.1, -1.0])
    inner = np.concatenate([turn, np.full((3, 1), 7.0)], axis=1)
    outer = np.concatenate([turn * 1.001, np.full((3, 1), 7.0)], axis=1)
    tracer = rs.Tracer(scene_of(icosphere(3), [inner, outer]))
    points = random_points(tracer, rng, 2000)
    below, above = (
        rs.surface_points(tracer, points.prim_id, points.u, points.v, k) for k in range(2)
    )
    for distance in (20.0, 1e3, 1e6, 1e12):
        eye = [[0.6 * distance, 0.0, 0.8 * distance]]
        for pair in ((below, eye), (eye, below)):
            assert not rs.visibility(tracer, *pair).any()
        toward = np.einsum("nk,nk->n", above.normals.astype(float), eye - above.positions)
        toward /= np.linalg.norm(eye - above.positions, axis=1)
        seen = rs.visibility(tracer, eye, above).ravel()
        assert seen[toward > 1e-2].all()
        assert not seen[toward < -1e-2].any()


def test_triangles_are_skipped_in_all_instances(rng):
    places = np.tile(np.eye(3, 4), (3, 1, 1))
    places[:, 2, 3] = [0.0, 2.0, 4.0]
    square = [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], [[0, 1, 2], [0, 2, 3]]
    tracer = rs.Tracer(scene_of(square, places))
    ends = [[0.5, -0.5, -1.0]], [[0.5, -0.5, 9.0]]
    assert not rs.visibility(tracer, *ends).any()
    assert rs.visibility(tracer, *ends, skip_a=[0]).all()
    assert not rs.visibility(tracer, *ends, skip_b=[1]).any()


def test_files_know_where_instances_are(rng, tmp_path):
    transforms = random_transforms(rng, 5, 2.0)
    scene = scene_of(icosphere(1), transforms)
    points = rng.uniform(-3.0, 3.0, (40, 3))
    path = tmp_path / "seen.npy"
    found = rs.visibility(rs.Tracer(scene), points, out=path)
    np.testing.assert_array_equal(found, rs.visibility(rs.Tracer(scene), points))
    moved = scene.with_transforms(transforms + [0.0, 0.0, 0.0, 1e-3])
    with pytest.raises(RaystreamError, match="different: the scene"):
        rs.visibility(rs.Tracer(moved), points, out=path)


def test_faces_of_instances_are_seen(rng):
    transforms = random_transforms(rng, 6, 3.0)
    scene = scene_of(cube(), transforms)
    camera = rs.Camera((0.0, 2.0, 14.0), (0.0, 0.0, 0.0), fov=50)
    tracer, flat = rs.Tracer(scene), rs.Tracer(scene.flattened())
    for points in (0, 3):
        found = rs.visible_faces(tracer, camera, (60, 40), points_per_face=points)
        expected = rs.visible_faces(flat, camera, (60, 40), points_per_face=points)
        numbers = scene.triangles.numbers_of(found.prim_ids, found.instance_ids)
        assert (np.diff(numbers) > 0).all()
        assert abs(int(found.pixel_counts.sum()) - int(expected.pixel_counts.sum())) <= 8
        assert len(np.setxor1d(numbers, expected.prim_ids)) <= 1
    assert len(found.prim_ids) > len(np.unique(found.prim_ids)) > 6
    assert (expected.instance_ids == 0).all()


def test_small_faces_are_looked_for_in_every_instance():
    """From inside a cube all of its faces are seen, of pixels that show few of them."""
    places = np.tile(np.eye(3, 4) * 3.0, (2, 1, 1))
    places[1, :, 3] = 40.0
    tracer = rs.Tracer(scene_of(icosphere(3), places))
    count = tracer.scene.triangle_count
    found = rs.visible_faces(tracer, places[1, :, 3], (8, 4))
    assert found.instance_ids.tolist() == [1] * count
    assert found.prim_ids.tolist() == list(range(count))
    assert found.pixel_counts.sum() == 32


def test_what_is_not_supported_says_so(rng):
    tracer = rs.Tracer(scene_of(cube(), random_transforms(rng, 2)))
    worlds = rs.Scene.instances(rs.Scene.from_arrays(*cube()), [np.eye(3, 4)] * 2, worlds=[0, 1])
    for ask in (
        lambda one: rs.visibility(one, [[0.0, 0, 0]]),
        lambda one: rs.visible_faces(one),
    ):
        with pytest.raises(RaystreamError, match="whose instances are in worlds"):
            ask(rs.Tracer(worlds))
    plain = rs.Tracer(rs.Scene.from_arrays(*cube()))
    points = rs.surface_points(tracer, [0, 1], instance_ids=[0, 1])
    with pytest.raises(ValueError, match="a: the hits are of another scene"):
        rs.visibility(plain, points)
    for tracer_, ids, error, message in (
        (plain, [0], ValueError, "instance_ids: expected None"),
        (tracer, None, ValueError, "instance_ids: expected the instance of each"),
        (tracer, [0.5], TypeError, "instance_ids: expected integers"),
        (tracer, [2], ValueError, "instance_ids: expected 0 to 1"),
        (tracer, [[0], [1]], ValueError, r"instance_ids: shape \(2, 1\) does not broadcast"),
    ):
        with pytest.raises(error, match=message):
            rs.surface_points(tracer_, [0], instance_ids=ids)
    both = rs.Scene.instances(
        [rs.Scene.from_arrays(*cube()), rs.Scene.from_arrays(*icosphere(0))],
        [np.eye(3, 4)] * 2,
        [0, 1],
    )
    with pytest.raises(ValueError, match="prim_ids: triangle 3 is not one of instance 1"):
        rs.surface_points(rs.Tracer(both), [0, 3], instance_ids=[0, 1])
    misses = rs.surface_points(tracer, [-1, 0], instance_ids=[9, 1])
    assert misses.instance_id.tolist() == [-1, 1]
    assert rs.visibility(tracer, misses)[0].tolist() == [False, False]
