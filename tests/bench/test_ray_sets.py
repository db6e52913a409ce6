"""Ray sets: shapes and properties of the rays."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from raystream.bench.point_sets import NEAR
from raystream.bench.ray_sets import AO_LENGTH, DEFAULT_SETS, RAY_SETS, make_ray_sets
from raystream.bench.worker import load_rays, save_rays

SIZE = (16, 12)

POINT_SETS = ("closest", "closest_near", "closest_grid")


@pytest.fixture(scope="module")
def scene():
    return rs.load("spheres:2000")


@pytest.fixture(scope="module")
def tracer(scene):
    return rs.Tracer(scene)


@pytest.fixture(scope="module")
def sets(scene, tracer):
    return {rays.name: rays for rays in make_ray_sets(tracer, scene.camera, SIZE, list(RAY_SETS))}


def test_all_are_plain_arrays(sets, scene, tracer):
    assert list(sets) == list(RAY_SETS)
    assert set(DEFAULT_SETS) < set(RAY_SETS)
    hits = tracer.first_hit(*scene.camera.rays(*SIZE))
    seen = int(np.count_nonzero(hits.is_hit))
    shapes = dict.fromkeys(RAY_SETS, (seen, 3)) | {
        "primary": (192, 3),
        "image": (12, 16, 3),
        "multi": (192, 3),
        "random": (192, 3),
        "random_multi": (192, 3),
    }
    shapes |= dict.fromkeys(POINT_SETS, (192, 3)) | {"closest_grid": (125, 3)}
    for name, (_, _, rays) in sets.items():
        for array in rays[: 1 if name in POINT_SETS else 2]:
            assert array.shape == shapes[name], name
            assert array.dtype == np.float32
            assert array.flags.c_contiguous
            assert np.isfinite(array).all()


def test_an_image_is_the_same_rays(sets):
    for flat, shaped in zip(sets["primary"].rays[:2], sets["image"].rays[:2], strict=True):
        assert np.array_equal(flat, shaped.reshape(-1, 3))


def test_shadow_rays_end_at_one_light(sets):
    rays = sets["shadow"].rays
    ends = rays.origins + rays.directions
    assert rays.t_max == 1.0
    assert np.ptp(ends, axis=0).max() < 1e-3 * np.abs(ends).max()


def test_bounces_leave_the_side_that_is_seen(sets, scene, tracer):
    hits = tracer.first_hit(*scene.camera.rays(*SIZE))
    hits = hits[hits.is_hit]
    toward_eye = np.asarray(scene.camera.eye) - hits.positions
    side = np.sign(np.einsum("ij,ij->i", hits.normals, toward_eye))
    for name in ("ao", "bounce"):
        directions = sets[name].rays.directions
        assert (side * np.einsum("ij,ij->i", hits.normals, directions) >= -1e-6).all()
        assert np.allclose(np.linalg.norm(directions, axis=1), 1.0, atol=1e-6)
    diagonal = np.linalg.norm(scene.bounds[1] - scene.bounds[0])
    assert sets["ao"].rays.t_max == pytest.approx(AO_LENGTH * diagonal)
    assert sets["bounce"].rays.t_max == np.inf


def test_random_rays_start_in_the_box(sets, scene):
    origins = sets["random"].rays.origins
    low, high = scene.bounds
    assert (origins >= low - 1e-4).all()
    assert (origins <= high + 1e-4).all()


def test_a_set_does_not_depend_on_the_others(sets, scene, tracer):
    (alone,) = make_ray_sets(tracer, scene.camera, SIZE, ["bounce"])
    assert np.array_equal(alone.rays.directions, sets["bounce"].rays.directions)
    (other,) = make_ray_sets(tracer, scene.camera, SIZE, ["bounce"], seed=1)
    assert not np.array_equal(other.rays.directions, sets["bounce"].rays.directions)


def test_rays_reach_other_processes_as_they_are(sets, tmp_path):
    for name in ("ao", "image"):
        rays = sets[name].rays
        save_rays(tmp_path, rays)
        there = load_rays(tmp_path)
        assert there.t_max == rays.t_max
        assert np.array_equal(there.origins, rays.origins)
        assert np.array_equal(there.directions, rays.directions)
        assert there.origins.flags.c_contiguous


def test_points_lie_where_their_sets_say(sets, scene, tracer):
    low, high = scene.bounds
    diagonal = np.linalg.norm(high - low)
    around, near, grid = (sets[name].rays for name in POINT_SETS)
    assert [one.unit for one in (around, near, grid)] == [pytest.approx(diagonal)] * 3
    places = (around.points - low) / (high - low)  # from -1/4 to 5/4
    assert -0.25 <= places.min() < -0.1
    assert 1.1 < places.max() <= 1.25 + 1e-6
    away = tracer.closest_point(near.points).distance
    assert 0.2 * NEAR * diagonal < np.mean(away) < 2.0 * NEAR * diagonal
    for k in range(3):
        lines = np.unique(grid.points[:, k])
        assert np.allclose(lines, np.linspace(low[k], high[k], 5), atol=1e-5 * diagonal)


def test_points_reach_other_processes_as_they_are(sets, tmp_path):
    points = sets["closest_near"].rays
    save_rays(tmp_path, points)
    there = load_rays(tmp_path)
    assert there.unit == points.unit
    assert np.array_equal(there.points, points.points)


def test_nothing_to_see(scene, tracer):
    away = rs.Camera(eye=(0, 1e4, 0), look_at=(0, 2e4, 0), up=(0, 0, 1))
    sets = {r.name: r.rays for r in make_ray_sets(tracer, away, SIZE, list(RAY_SETS))}
    assert len(sets["primary"]) == len(sets["image"]) == len(sets["random"]) == 192
    assert len(sets["shadow"]) == len(sets["ao"]) == len(sets["bounce"]) == 0
