"""What is built on the queries: LiDAR returns, visibility, arrays of other libraries, images."""

from __future__ import annotations

import numpy as np

import raystream as rs
from conftest import assert_same_bits


def outdoors() -> rs.Scene:
    leaf = rs.Material(name="leaf")
    ground = rs.Scene.height_field(np.zeros((9, 9)), spacing=2.0)
    return rs.Scene.combine([ground, rs.Scene.spheres([[8, 8, 3]], 1.0, materials=[leaf])])


def test_lidar_returns_of_a_sphere_above_the_ground() -> None:
    """Distances and cosines in closed form; half of the light passes each surface of the sphere."""
    tracer = rs.Tracer(outdoors())
    origins = np.array([[8.0, 8.0, 10.0], [8.6, 8.0, 10.0], [12.1, 8.0, 10.0]])
    scan = rs.lidar_returns(tracer, origins, [0.0, 0.0, -2.0], transmission={"leaf": 0.5})
    assert scan.counts.tolist() == [3, 3, 1]
    half = np.sqrt(1.0 - 0.6**2)
    ranges = [6.0, 8.0, 10.0, 7.0 - half, 7.0 + half, 10.0, 10.0]
    np.testing.assert_allclose(scan.ranges, ranges, rtol=1e-6)
    energy = np.array([0.5, 0.25, 0.25])
    intensity = [*energy, *energy * [half, half, 1.0], 1.0]
    np.testing.assert_allclose(scan.intensity, intensity, atol=2e-6)
    angle = np.degrees(np.arccos(half))
    np.testing.assert_allclose(scan.incidence_angle, [0, 0, 0, angle, angle, 0, 0], atol=0.05)
    assert scan.mesh_id.tolist() == [1, 1, 0, 1, 1, 0, 0]
    assert scan.material_id.tolist() == [1, 1, 0, 1, 1, 0, 0]


def test_a_sweep_over_a_height_field() -> None:
    tracer = rs.Tracer(outdoors())
    pattern = rs.sweep_patterns.spinning([-30.0, -10.0], columns=90)
    track = rs.SensorTrack([0.0, 1.0], [[4.0, 4.0, 2.0], [6.0, 4.0, 2.0]])
    sweep = rs.lidar_sweep(tracer, pattern, track)
    assert len(sweep.ranges) > 50
    assert set(np.unique(sweep.mesh_id)) <= {0, 1}


def test_visibility_between_points() -> None:
    tracer = rs.Tracer(outdoors())
    eye = [[8.0, 8.0, 10.0]]
    points = [[8.0, 8.0, 1.0], [12.0, 8.0, 1.0], [12.0, 8.0, -1.0], [8.0, 8.0, 4.1]]
    assert rs.visibility(tracer, eye, points).tolist() == [[False, True, False, True]]


def test_memory_is_asked_for_beforehand() -> None:
    tracer = rs.Tracer(outdoors())
    assert tracer.memory_needed(1000, "first_hit").total >= 17_000


def test_a_scene_without_camera_and_lights_has_an_image() -> None:
    image = rs.render(outdoors(), size=(40, 30))
    assert np.isfinite(image.pixels).all()
    assert image.pixels.max() > 0.0


def test_shapes_of_rays_are_kept() -> None:
    tracer = rs.Tracer(outdoors())
    origins = np.random.default_rng(0).uniform([1, 1, 5], [15, 15, 9], (4, 5, 3))
    hits = tracer.first_hit(origins, [0.0, 0.0, -1.0])
    assert hits.positions.shape == hits.normals.shape == (4, 5, 3)
    some = hits[1]
    assert_same_bits(some.positions, hits.positions[1])
    assert_same_bits(hits.ravel().normals, hits.normals.reshape(-1, 3))
    one = tracer.first_hit([8.0, 8.0, 9.0], [0.0, 0.0, -1.0])
    assert one.normals.tolist() == [0.0, 0.0, 1.0]
    assert one.spawn([0.0, 0.0, 1.0])[0].shape == (3,)
