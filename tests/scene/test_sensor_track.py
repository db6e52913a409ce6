"""Tracks of sensors against closed forms, and many times at once against one at a time."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import raystream as rs
from raystream.scene.key_tracks import KeyTrack
from raystream.scene.splines import slerp, slerp_rows

ANGLES = st.floats(-math.pi, math.pi)


def turn(axis, angle):
    """Rodrigues' formula, in float64."""
    x, y, z = np.asarray(axis, float) / np.linalg.norm(axis)
    across = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * across + (1 - math.cos(angle)) * across @ across


@st.composite
def axes(draw):
    axis = draw(st.lists(st.integers(-5, 5), min_size=3, max_size=3))
    return np.array(axis if any(axis) else [0, 0, 1], float)


def test_it_moves_along_lines_and_turns_evenly():
    axis = (1, -2, 3)
    rate = 0.9  # radians per unit of time
    keys = np.array([0.0, 1.0, 2.5])
    positions = [[0, 0, 0], [4, 0, 2], [4, 3, 2]]
    track = rs.SensorTrack(keys, positions, [turn(axis, rate * key) for key in keys])
    times = np.linspace(0.0, 2.5, 101)
    poses = track.at(times)
    for column, values in enumerate(np.transpose(positions)):
        np.testing.assert_allclose(poses.positions[:, column], np.interp(times, keys, values))
    expected = np.array([turn(axis, rate * time) for time in times])
    np.testing.assert_allclose(poses.rotations, expected, atol=1e-14)
    assert track.span == (0.0, 2.5)
    assert repr(track) == "SensorTrack(3 keys from 0 to 2.5)"


def test_it_turns_by_the_shorter_arc():
    track = rs.SensorTrack([0, 1], np.zeros((2, 3)), [turn((0, 1, 0), a) for a in (-3.0, 3.0)])
    half = track.at(0.5).rotations[0]
    np.testing.assert_allclose(half, turn((0, 1, 0), math.pi), atol=1e-14)


@given(axes(), st.one_of(ANGLES, st.sampled_from([0.0, math.pi, -math.pi, 1e-9, math.pi - 1e-9])))
def test_matrices_come_back(axis, angle):
    matrix = turn(axis, angle)
    pose = rs.SensorTrack([0], [[1, 2, 3]], [matrix]).at(7.0)
    np.testing.assert_allclose(pose.rotations[0], matrix, atol=1e-14)
    points = np.array([[0.5, -2.0, 8.0]])
    np.testing.assert_allclose(pose.to_world(points)[0], matrix @ points[0] + [1, 2, 3], atol=1e-13)
    np.testing.assert_allclose(pose.to_sensor(pose.to_world(points)), points, atol=1e-13)
    found = pose.directions_to_world(points)
    np.testing.assert_allclose(found[0], matrix @ points[0], atol=1e-13)


def test_without_rotations_directions_keep_their_bits(rng):
    directions = rng.normal(size=(100, 3))
    for times, positions in (([0], [[1, 2, 3]]), ([0, 1], [[1, 2, 3], [4, 5, 6]])):
        poses = rs.SensorTrack(times, positions).at(np.full(100, 0.25))
        assert np.array_equal(poses.directions_to_world(directions), directions)


def test_one_key_stands_still_at_all_times():
    track = rs.SensorTrack([5.0], [[1, 2, 3]])
    assert track.at([-1e300, 5.0, 1e300]).positions.tolist() == [[1, 2, 3]] * 3
    assert track.span == (-math.inf, math.inf)


def test_a_sensor_where_a_camera_is():
    camera = rs.Camera((1, 2, 3), (4, 0, 5), (0.1, 1, 0))
    pose = rs.SensorTrack.of_camera(camera).at(0.0)
    right, up, forward = camera.basis()
    np.testing.assert_allclose(pose.positions, [camera.eye])
    ahead = pose.directions_to_world(np.array([[0, 0, -1.0]]))
    np.testing.assert_allclose(ahead[0], forward, atol=1e-15)
    np.testing.assert_allclose(pose.rotations[0].T, [right, up, -np.array(forward)], atol=1e-15)
    keys = [[0, 0, 0, 5], [1, 0, 0, 5], [2, 3, 0, 5], [4, 4, 4, 4], [5, 4, 4, 4]]
    moving = rs.CameraTrack(rs.Camera((0, 0, 5), (0, 0, 3)), keys)
    times = np.linspace(1, 4, 13)
    track = rs.SensorTrack.of_camera(moving, times)
    np.testing.assert_allclose(track.at(times).positions, [moving.at(t).eye for t in times])


@pytest.mark.parametrize("method", ["step", "linear", "cubic"])
@pytest.mark.parametrize("is_rotation", [False, True])
def test_many_times_at_once_are_as_one_by_one(method, is_rotation, rng):
    times = np.array([-1.0, 0.0, 0.0, 0.5, 3.0])
    values = rng.normal(size=(5, 4))
    values /= np.linalg.norm(values, axis=1, keepdims=True)
    tangents = rng.normal(size=(2, 5, 4)) if method == "cubic" else (None, None)
    for count in (1, 5):
        used = [None if one is None else one[:count] for one in tangents]
        track = KeyTrack(times[:count], values[:count], method, is_rotation, *used)
        asked = np.concatenate([rng.uniform(-2, 4, 50), times])
        one_by_one = np.array([track.at(time) for time in asked])
        found = track.at_times(asked)
        if is_rotation:  # a quaternion and its negative are the same rotation
            found *= np.sign(np.einsum("nk,nk->n", found, one_by_one))[:, None]
        np.testing.assert_allclose(found, one_by_one, atol=1e-12)


@given(axes(), axes(), ANGLES, ANGLES, st.floats(0, 1))
def test_rows_of_rotations_are_as_single_ones(first, second, a, b, s):
    p = np.array([math.cos(a), *(math.sin(a) * first / np.linalg.norm(first))])
    q = np.array([math.cos(b), *(math.sin(b) * second / np.linalg.norm(second))])
    if p @ q < -1 + 1e-6:  # nearly opposite: the arc is not defined
        q = -q
    found = slerp_rows(np.array([p, p]), np.array([q, p]), np.array([s, s]))
    np.testing.assert_allclose(found, [slerp(p, q, s), p], atol=1e-9)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([], []), r"times: expected shape \(K,\) with at least one key, got \(0,\)"),
        ((0.0, [1, 2, 3]), r"times: expected shape \(K,\)"),
        (([0, 0], np.zeros((2, 3))), "times: expected finite numbers that increase"),
        (([0, math.nan], np.zeros((2, 3))), "times: expected finite numbers that increase"),
        (([0, 1], np.zeros((3, 3))), r"positions: expected shape \(2, 3\), got \(3, 3\)"),
        (([0, 1e300], np.zeros((2, 3))), r"times: .* within 2\*\*200"),
        (([0], [[0, math.nan, 0]]), "positions: expected finite numbers"),
        (([0], [[0, 1e300, 0]]), r"positions: expected finite numbers within 2\*\*200"),
        (([0], [[0, 0, 0]], [np.eye(4)]), r"rotations: expected shape \(1, 3, 3\)"),
        (([0], [[0, 0, 0]], [np.full((3, 3), math.nan)]), "rotations: expected finite numbers"),
        (([0], [[0, 0, 0]], [2 * np.eye(3)]), "rotations: matrix 0 is not a rotation"),
        (([0], [[0, 0, 0]], [1e60 * np.eye(3)]), "rotations: matrix 0 is not a rotation"),
        (
            ([0, 1], np.zeros((2, 3)), [np.eye(3), np.diag([1, 1, -1])]),
            "rotations: matrix 1 is not a rotation",
        ),
    ],
)
def test_bad_keys(arguments, message):
    with pytest.raises(ValueError, match=message):
        rs.SensorTrack(*arguments)


def test_times_outside_the_track():
    track = rs.SensorTrack([0, 2], np.zeros((2, 3)))
    for time in (-0.1, 2.1, math.nan, math.inf):
        with pytest.raises(ValueError, match="times: expected finite numbers from 0 to 2"):
            track.at([1.0, time])
    with pytest.raises(ValueError, match="finite"):
        rs.SensorTrack([0], [[0, 0, 0]]).at(math.nan)
    with pytest.raises(ValueError, match=r"times: expected shape \(N,\)"):
        track.at([[1.0]])
    with pytest.raises(TypeError, match="times: expected real numbers"):
        track.at(["now"])
