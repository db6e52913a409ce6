"""Sweeps of moving sensors and scenes against closed forms in float64."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import raystream as rs
from conftest import EVERY_QUERY, assert_same_bits
from raystream import sweep_patterns
from solid_meshes import box_mesh, sphere_mesh, tracer_of

COLUMNS = (
    "ray_splits", "ranges", "positions", "intensity", "incidence_angle", "return_number",
    "return_count", "prim_id", "mesh_id", "material_id", "status",
)  # fmt: skip

LOW, HIGH = np.array([-9.0, -2.0, -12.0]), np.array([7.0, 5.0, 10.0])

PATTERNS = {
    "spinning": sweep_patterns.spinning(np.linspace(20, -20, 8), columns=90, firing_times=1e-4),
    "raster": sweep_patterns.raster(60, 12),
    "mems": sweep_patterns.mems(60, 12),
    "rosette": sweep_patterns.rosette(700),
}


def turns(axis, angles):
    """Rodrigues' formula for many angles: (N, 3, 3), float64."""
    x, y, z = np.asarray(axis, float) / np.linalg.norm(axis)
    across = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    sine, cosine = np.sin(angles)[:, None, None], np.cos(angles)[:, None, None]
    return np.eye(3) + sine * across + (1 - cosine) * across @ across


def exit_distances(origins, directions):
    """Distance from points in the room to its walls, by slabs, float64."""
    with np.errstate(divide="ignore"):
        walls = np.where(directions > 0, HIGH, LOW)
        return ((walls - origins) / directions).min(axis=1)


@pytest.fixture(scope="module")
def room():
    return tracer_of(box_mesh(LOW, HIGH))


class Drive:
    """Constant velocity and rate of turn: the poses in closed form, and as a track."""

    position, velocity = np.array([0.5, 0.25, -1.0]), np.array([20.0, -3.0, 11.0])
    axis, rate = np.array([1.0, 4.0, -2.0]), 3.0  # radians per second

    def poses(self, times):
        return self.position + times[:, None] * self.velocity, turns(self.axis, self.rate * times)

    def track(self, keys):
        return rs.SensorTrack(keys, *self.poses(np.asarray(keys)))


@pytest.mark.parametrize("name", PATTERNS)
def test_a_sensor_drives_and_turns_in_a_room(room, name):
    """Constant velocity and rate of turn: ranges have a closed form."""
    pattern, drive, start = PATTERNS[name], Drive(), -0.05
    cloud = rs.lidar_sweep(room, pattern, drive.track([-0.1, 0.0, 0.13]), start=start)
    times = start + pattern.times
    origins, rotations = drive.poses(times)
    directions = np.einsum("nij,nj->ni", rotations, pattern.directions)
    exact = exit_distances(origins, directions)
    assert cloud.counts.tolist() == [1] * len(pattern)
    errors = np.abs(cloud.ranges - exact) / exact
    assert errors.max() < 1e-6
    np.testing.assert_allclose(cloud.origins, origins, atol=1e-14)
    np.testing.assert_allclose(cloud.directions, directions, atol=1e-14)
    np.testing.assert_allclose(cloud.positions, origins + exact[:, None] * directions, atol=1e-5)
    reported = exact[:, None] * pattern.directions
    np.testing.assert_allclose(cloud.sensor_positions, reported, atol=1e-5)
    assert np.array_equal(cloud.time, times)
    assert np.array_equal(cloud.channel, pattern.channels)
    assert np.array_equal(cloud.column, pattern.columns)
    # Deskewed: the world's points, seen from the pose at one time.
    for time in (None, 0.0):
        end = np.array([start + pattern.times.max() if time is None else time])
        position, (rotation,) = drive.poses(end)
        expected = (origins + exact[:, None] * directions - position) @ rotation
        np.testing.assert_allclose(cloud.deskewed(time), expected, atol=1e-5)
    assert np.abs(cloud.sensor_positions - cloud.deskewed()).max() > 0.5


@pytest.mark.exhaustive
def test_a_million_pulses_of_a_drive(room):
    """Half a second of a sensor with 128 channels, by keys of a hundredth of a second."""
    pattern, drive, worst, count = sweep_patterns.vls128(), Drive(), 0.0, 0
    motion = drive.track(np.linspace(-0.2, 0.31, 52))
    for sweep in range(5):
        start = -0.2 + 0.1 * sweep
        cloud = rs.lidar_sweep(room, pattern, motion, start=start)
        origins, rotations = drive.poses(start + pattern.times)
        directions = np.einsum("nij,nj->ni", rotations, pattern.directions)
        exact = exit_distances(origins, directions)
        assert (cloud.counts == 1).all()
        worst = max(worst, (np.abs(cloud.ranges - exact) / exact).max())
        count += len(exact)
    assert count > 10**6
    assert worst < 1e-6


def test_a_drive_beside_a_wall():
    """In exact rational arithmetic: the wall is 4 m to the right, the speed 16 m/s."""
    wall = rs.Mesh(
        [[4, -99, -999], [4, -99, 999], [4, 99, 999], [4, 99, -999]], [[0, 1, 2], [0, 2, 3]]
    )
    pattern = sweep_patterns.spinning([0.0], rate=8.0, columns=32)
    car = rs.SensorTrack([0, 1], [[0, 0, 0], [0, 0, -16]])
    cloud = rs.lidar_sweep(rs.Tracer(rs.Scene([wall])), pattern, car, start=0.5)
    assert cloud.column.tolist() == list(range(1, 16))
    for column, point in zip(cloud.column.tolist(), cloud.positions, strict=True):
        azimuth = 2 * math.pi * column / 32
        travelled = 16 * (Fraction(1, 2) + Fraction(column, 256))
        ahead = 4 / math.tan(azimuth)
        np.testing.assert_allclose(point, [4, 0, -float(travelled) - ahead], rtol=1e-6, atol=1e-6)
    # The wall is bent in the sensor's own points, and straight again without its motion.
    np.testing.assert_allclose(cloud.sensor_positions[:, 0], 4.0, rtol=1e-6)
    order = np.argsort(cloud.column)
    spacing = np.diff(cloud.deskewed()[order, 2] - cloud.sensor_positions[order, 2])
    np.testing.assert_allclose(spacing, -16 / 256, atol=1e-4)


OPTIONS = {
    "t_max": 9.0, "transmission": 0.4, "reflectance": 0.7, "divergence": 2.0, "sub_rays": 5,
    "separation": 0.2,
}  # fmt: skip


@pytest.mark.parametrize("structure", ["bvh", "brute", "grid"])
def test_a_sensor_that_stands_still_gives_the_bits_of_lidar_returns(structure):
    scene = (box_mesh(LOW, HIGH), sphere_mesh((2, 0, -4), 1.5), sphere_mesh((-4, 1, 2), 1.0))
    tracer = tracer_of(*scene, structure=structure)
    pattern = PATTERNS["spinning"]
    position = np.array([0.5, 0.25, -1.0])
    for motion in (
        rs.SensorTrack([0], [position]),
        rs.SensorTrack([0, 0.05, 1], [position] * 3),
    ):
        for options in ({}, OPTIONS):
            cloud = rs.lidar_sweep(tracer, pattern, motion, **options)
            expected = rs.lidar_returns(tracer, position, pattern.directions, **options)
            for column in COLUMNS:
                assert_same_bits(getattr(cloud, column), getattr(expected, column))
            found = cloud.deskewed() + position
            np.testing.assert_allclose(found, cloud.positions, atol=1e-12)
            np.testing.assert_allclose(cloud.sensor_positions, cloud.deskewed(), atol=1e-12)
    assert cloud.return_count.max() > 1


def test_a_moving_sensor_gives_the_bits_of_lidar_returns_for_its_rays(room):
    cloud = rs.lidar_sweep(room, PATTERNS["mems"], Drive().track([0, 0.1]), **OPTIONS)
    expected = rs.lidar_returns(room, cloud.origins, cloud.directions, **OPTIONS)
    for column in COLUMNS:
        assert_same_bits(getattr(cloud, column), getattr(expected, column))


# Scenes that move.


def moving(mesh, velocity, times=(0.0, 10.0)):
    """A scene of a mesh at constant velocity."""
    velocity = np.asarray(velocity, float)

    def at(time):
        return rs.Scene([mesh.moved(mesh.vertices + time * velocity)])

    return rs.Scene([mesh], animation=rs.Animation(at, times))


def middles(pattern, steps):
    """Times at which the scene is posed, for each pulse: its part's middle."""
    times = pattern.times
    length = (times.max() - times.min()) / steps
    part = np.minimum(np.floor((times - times.min()) / length), steps - 1)
    return times.min() + (part + 0.5) * length


def test_a_wall_comes_nearer_in_steps():
    """The range is that of the wall's place in the middle of each part, and tends to the exact."""
    wall = rs.Mesh(
        [[-999, -999, -20], [999, -999, -20], [999, 999, -20], [-999, 999, -20]],
        [[0, 1, 2], [0, 2, 3]],
    )
    speed, start = 32.0, 0.25
    tracer = rs.Tracer(moving(wall, (0, 0, speed)))
    pattern = sweep_patterns.raster(40, 10, fov=(60, 20))
    still = rs.SensorTrack([0], [[0, 0, 0]])
    errors = []
    for steps in (1, 4, 16, 64):
        cloud = rs.lidar_sweep(tracer, pattern, still, start=start, time_steps=steps)
        depth = -pattern.directions[:, 2]
        stepped = (20 - speed * (start + middles(pattern, steps))) / depth
        np.testing.assert_allclose(cloud.ranges, stepped, rtol=1e-6)
        exact = (20 - speed * (start + pattern.times)) / depth
        errors.append(np.abs((cloud.ranges - exact) * depth).max())
        assert errors[-1] <= speed * np.ptp(pattern.times) / (2 * steps) + 1e-5
    assert errors[0] > 3.9 * errors[1] > 15 * errors[2]


def test_a_sphere_flies_past_a_moving_sensor():
    """Ray against sphere in float64, both where they are at each pulse's time."""
    radius, start = 1.5, 0.4
    center, velocity = np.array([-6.0, 0.5, -9.0]), np.array([12.0, 1.0, -3.0])
    tracer = rs.Tracer(moving(sphere_mesh(center, radius, level=5), velocity))
    car = rs.SensorTrack([0, 1], [[0, 0, 0], [0, 0, -8]])
    pattern = sweep_patterns.raster(160, 60, fov=(70, 40))
    steps = 100
    cloud = rs.lidar_sweep(tracer, pattern, car, start=start, time_steps=steps)
    times = start + pattern.times
    posed = start + middles(pattern, steps)
    origins = np.multiply.outer(times, [0.0, 0.0, -8.0])
    offset = origins - (center + posed[:, None] * velocity)
    along = np.einsum("nk,nk->n", offset, pattern.directions)
    root = along**2 - np.einsum("nk,nk->n", offset, offset) + radius**2
    hit = cloud.counts.astype(bool)
    # The mesh lies within the sphere, by at most 1 - cos(1.6 degrees) of the radius.
    inside = 4e-4 * radius
    assert not (hit & (root < -1e-5)).any()
    assert hit[root > 2 * radius * inside].all()
    assert 300 < hit.sum() < len(pattern) / 2
    exact = -along[hit] - np.sqrt(root[hit])
    depth = cloud.ranges - exact
    sure = root[hit] > 0.1
    assert depth[sure].min() > -1e-5
    assert depth[sure].max() < 1.5 * inside * radius / math.sqrt(0.1)
    # It is sheared: its points are within the sphere's, where the sphere is at their own times.
    place = cloud.positions - (center + cloud.time[:, None] * velocity)
    distance = np.linalg.norm(place, axis=1)
    bound = np.linalg.norm(velocity) * 0.1 / (2 * steps) + inside
    assert np.abs(distance - radius).max() < bound


def copied(scene):
    """A scene that poses copies of its meshes at the same place: all is traced in steps."""

    def at(time):
        return scene.replace(meshes=[mesh.moved(mesh.vertices) for mesh in scene.meshes])

    return scene.replace(animation=rs.Animation(at, (0.0, 1.0)))


@pytest.mark.parametrize(
    ("structure", "steps"), [("bvh", 1), ("bvh", 7), ("bvh", 1000), ("brute", 7), ("kdtree", 3)]
)
def test_steps_of_a_scene_that_stands_still_give_the_same_bits(structure, steps, rng):
    meshes = (box_mesh(LOW, HIGH), sphere_mesh((2, 0, -4), 1.5), sphere_mesh((-4, 1, 2), 1.0))
    scene = rs.Scene(meshes)
    whole = PATTERNS["spinning"]
    order = rng.permutation(len(whole))
    shuffled = sweep_patterns.SweepPattern(
        whole.directions[order], whole.times[order], whole.period
    )
    motion = Drive().track([0, 0.1])
    limits = {**OPTIONS, "t_max": rng.uniform(3, 12, len(whole)), "t_min": 0.5}
    for pattern in (whole, shuffled):
        expected = rs.lidar_sweep(rs.Tracer(scene, structure), pattern, motion, **limits)
        tracer = rs.Tracer(copied(scene), structure)
        found = rs.lidar_sweep(tracer, pattern, motion, time_steps=steps, **limits)
        for column in COLUMNS:
            assert_same_bits(getattr(found, column), getattr(expected, column))
        assert_same_bits(found.time, expected.time)
    assert len(found.ranges) > 100


@pytest.mark.parametrize("make_tracer", EVERY_QUERY, indirect=True)
def test_every_structure_and_machine_moves_the_scene_alike(make_tracer):
    scene = moving(sphere_mesh((-1, 0, -5), 1.5), (30, -5, 10))
    pattern, motion = sweep_patterns.raster(30, 20, fov=(50, 30)), Drive().track([0, 0.1])
    found = rs.lidar_sweep(make_tracer(scene), pattern, motion, time_steps=5)
    expected = rs.lidar_sweep(rs.Tracer(scene, "brute"), pattern, motion, time_steps=5)
    for column in COLUMNS:
        assert_same_bits(getattr(found, column), getattr(expected, column))
    assert 50 < len(found.ranges) < len(pattern)


def test_the_tracer_keeps_its_scene():
    mesh = sphere_mesh((0, 0, -5), 1.0)
    scene = moving(mesh, (0, 0, 30))
    tracer = rs.Tracer(scene)
    before = tracer.first_hit([0, 0, 0], [0, 0, -1])
    still = rs.SensorTrack([0], [[0, 0, 0]])
    rs.lidar_sweep(tracer, PATTERNS["raster"], still, time_steps=3)
    assert tracer.scene.meshes[0] is mesh
    assert tracer.first_hit([0, 0, 0], [0, 0, -1]).t == before.t

    posed = []

    def at(time):
        posed.append(time)
        if len(posed) == 3:
            raise KeyboardInterrupt
        return scene.animation.at(time)

    tracer.update(scene.replace(animation=rs.Animation(at, (0.0, 1.0))))
    with pytest.raises(KeyboardInterrupt):
        rs.lidar_sweep(tracer, PATTERNS["raster"], still, time_steps=5)
    assert posed == sorted(posed)
    assert tracer.first_hit([0, 0, 0], [0, 0, -1]).t == before.t
    assert tracer.scene.meshes[0] is mesh


@pytest.mark.parametrize("velocity", [(1e5, 5e4, 0), (5e6, 0, 0), (0, -3e4, 2e9), (0, 40, 0)])
def test_a_sensor_that_rides_with_a_fast_target_sees_it_as_at_rest(velocity):
    """Far from where the tracer was built, ranges were off by 9 mm at 1e5 and by 0.4 at 5e6."""
    mesh = sphere_mesh((0, 0, -8), 2.0, level=4)
    scene = moving(mesh, velocity)
    tracer = rs.Tracer(scene)
    y, x = np.mgrid[-0.3:0.3:20j, -0.3:0.3:20j]
    ways = np.stack([x, y, np.full_like(x, -1.0)], axis=-1).reshape(-1, 3)
    pattern = sweep_patterns.SweepPattern(ways, np.zeros(len(ways)), 0.1)
    found, expected, near = (
        rs.lidar_sweep(one, pattern, rs.SensorTrack([0], [place]), start=1.0)
        for one, place in (
            (tracer, velocity),
            (rs.Tracer(rs.Scene(scene.at(1.0).meshes)), velocity),
            (rs.Tracer(rs.Scene([mesh])), (0, 0, 0)),
        )
    )
    for column in COLUMNS:
        assert_same_bits(getattr(found, column), getattr(expected, column))
    assert len(near.ranges) > 200
    assert found.ray_splits.tolist() == near.ray_splits.tolist()
    np.testing.assert_allclose(found.ranges, near.ranges, atol=2e-6)
    before = rs.Tracer(scene).first_hit([0, 0, 0], [0, 0, -1])
    assert tracer.first_hit([0, 0, 0], [0, 0, -1]).t == before.t


def test_pulses_of_a_flash_are_fired_at_once():
    tracer = rs.Tracer(moving(sphere_mesh((0, 0, -8), 2.0), (0, 0, 20)))
    pattern = sweep_patterns.SweepPattern([[0, 0, -1]] * 3, [0.0] * 3, 0.1)
    still = rs.SensorTrack([0], [[0, 0, 0]])
    cloud = rs.lidar_sweep(tracer, pattern, still, start=0.125)
    np.testing.assert_allclose(cloud.ranges, 8 - 2 - 20 * 0.125, rtol=1e-3)


# Invariances.

COORDINATES = st.integers(-8, 8).map(lambda number: number / 4)


@settings(max_examples=25)
@given(
    shift=st.integers(-1000, 1000).map(float),
    velocity=st.tuples(COORDINATES, COORDINATES, COORDINATES),
    rate=st.floats(-20, 20),
)
def test_shifts_of_time_change_nothing(room, shift, velocity, rate):
    """Motion and start shifted together: the same rays, but for rounding of the times."""
    keys = np.array([0.0, 0.05, 0.1])
    positions = keys[:, None] * np.array(velocity)
    rotations = turns((1, 2, 3), rate * keys)
    pattern = PATTERNS["rosette"]
    plain = rs.lidar_sweep(room, pattern, rs.SensorTrack(keys, positions, rotations))
    moved = rs.lidar_sweep(
        room, pattern, rs.SensorTrack(keys + shift, positions, rotations), start=shift
    )
    # Rounding: 1000 s has a last place of 1e-13 s; grazing rays multiply it, and float32 rounds.
    np.testing.assert_allclose(moved.ranges, plain.ranges, rtol=1e-6)
    np.testing.assert_allclose(moved.time - shift, plain.time, atol=1e-12)
    np.testing.assert_allclose(moved.deskewed(), plain.deskewed(), rtol=1e-5, atol=1e-5)


@settings(max_examples=25)
@given(
    axis=st.tuples(st.integers(-4, 4), st.integers(-4, 4), st.integers(1, 4)),
    angle=st.floats(-3.1, 3.1),
    offset=st.tuples(COORDINATES, COORDINATES, COORDINATES),
)
def test_a_turned_world_looks_the_same(axis, angle, offset):
    """The scene and the track are moved alike: what the sensor reports stays."""
    (turn,) = turns(axis, np.array([angle]))
    mesh = box_mesh(LOW, HIGH)
    keys = np.array([0.0, 0.1])
    positions, rotations = Drive().poses(keys)
    pattern = PATTERNS["raster"]
    plain = rs.lidar_sweep(tracer_of(mesh), pattern, rs.SensorTrack(keys, positions, rotations))
    turned = rs.lidar_sweep(
        tracer_of(mesh.moved(mesh.vertices @ turn.T + offset)),
        pattern,
        rs.SensorTrack(keys, positions @ turn.T + offset, turn @ rotations),
    )
    # Vertices of the turned room are rounded to float32: 1e-6, over the cosine of the angle.
    grazing = np.cos(np.radians(plain.incidence_angle))
    error = np.abs(turned.ranges - plain.ranges) * grazing
    assert error.max() < 5e-6
    np.testing.assert_allclose(
        turned.positions, plain.positions @ turn.T + offset, atol=5e-6 / grazing.min()
    )
    np.testing.assert_allclose(turned.deskewed(), plain.deskewed(), atol=5e-6 / grazing.min())


# Arguments.


def test_progress_counts_pulses(room):
    seen = []
    pattern, still = PATTERNS["raster"], rs.SensorTrack([0], [[0, 0, 0]])

    def note(*done):
        seen.append(done)

    rs.lidar_sweep(room, pattern, still, progress=note)
    assert seen[-1] == (720, 720)
    seen.clear()
    tracer = rs.Tracer(copied(rs.Scene([box_mesh(LOW, HIGH)])))
    rs.lidar_sweep(tracer, pattern, still, time_steps=4, progress=note)
    assert seen == [(180, 720), (360, 720), (540, 720), (720, 720)]


def test_no_pulses():
    pattern = sweep_patterns.SweepPattern(np.zeros((0, 3)), [], 0.1)
    still = rs.SensorTrack([0], [[0, 0, 0]])
    scene = rs.Scene([box_mesh(LOW, HIGH)])
    for tracer in (rs.Tracer(scene), rs.Tracer(copied(scene)), rs.Tracer(rs.Scene())):
        cloud = rs.lidar_sweep(tracer, pattern, still)
        assert cloud.ranges.shape == cloud.time.shape == (0,)
        assert cloud.positions.shape == cloud.sensor_positions.shape == (0, 3)
        assert cloud.deskewed().shape == (0, 3)
    assert repr(cloud) == "LidarSweep(0 returns of 0 pulses)"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"start": 0.95}, r"start: the sweep's pulses are fired from 0\.95 to 1\.0\d+, but the"),
        ({"start": -0.01}, "but the motion lasts from 0 to 1; choose another start"),
        ({"start": math.nan}, "start: expected a finite number, got nan"),
        ({"start": [0.0]}, "start: expected a finite number"),
        ({"time_steps": 0}, "time_steps: expected 1 to 1,000,000, got 0"),
        ({"time_steps": 10**400}, "time_steps: expected 1 to 1,000,000"),
        ({"threshold": 2.0}, "threshold: expected a number from 0 to 1, got 2"),
        ({"t_max": [1.0, 2.0]}, r"t_max: shape \(2,\) does not broadcast"),
        ({"reflectance": {"wood": 1.0}}, "reflectance: no material 'wood'"),
    ],
)
def test_bad_arguments(room, arguments, message):
    motion = rs.SensorTrack([0, 1], np.zeros((2, 3)))
    animated = rs.Tracer(copied(rs.Scene([box_mesh(LOW, HIGH)])))
    for tracer in (room, animated):
        with pytest.raises(ValueError, match=message):
            rs.lidar_sweep(tracer, PATTERNS["raster"], motion, **arguments)


def test_bad_types(room):
    motion = rs.SensorTrack([0, 1], np.zeros((2, 3)))
    with pytest.raises(TypeError, match="pattern: expected a SweepPattern, got list"):
        rs.lidar_sweep(room, [], motion)
    camera = rs.CameraTrack(rs.Camera((0, 0, 5), (0, 0, 0)), [[0, 0, 0, 5]])
    with pytest.raises(TypeError, match="motion: expected a SensorTrack, got CameraTrack"):
        rs.lidar_sweep(room, PATTERNS["raster"], camera)
    with pytest.raises(TypeError, match="max_return"):
        rs.lidar_sweep(room, PATTERNS["raster"], motion, max_return=1)
    with pytest.raises(ValueError, match="times: expected finite numbers from 0 to 1"):
        rs.lidar_sweep(room, PATTERNS["raster"], motion).deskewed(2.0)
