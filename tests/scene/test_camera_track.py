"""Cameras that move."""

from __future__ import annotations

import math

import numpy as np
import pytest

import raystream as rs

STILL = rs.Camera((0, 0, 5), (0, 0, 3), fov=50, aperture=0.1)


def test_two_keys_are_a_straight_line_and_an_even_turn():
    track = rs.CameraTrack(STILL, [[1, 0, 0, 5], [3, 8, 4, 5]], [[1, 0, 1, 0, 0], [3, 0, 2, 0, 90]])
    half = track.at(2.0)
    assert half.eye == pytest.approx((4, 2, 5))
    diagonal = 2 * math.sqrt(0.5)  # -z turned by 45 degrees about y; look_at is 2 away
    assert half.look_at == pytest.approx((4 - diagonal, 2, 5 - diagonal))
    assert half.up == pytest.approx((0, 1, 0))
    quarter = math.radians(22.5)
    assert track.at(1.5).basis()[2] == pytest.approx((-math.sin(quarter), 0, -math.cos(quarter)))
    assert (half.fov, half.aperture) == (50, 0.1)
    assert track.times == (1, 3)


@pytest.mark.parametrize("time", [-1e300, 0.0, 1.0])
def test_before_the_first_key_it_stands_still(time):
    track = rs.CameraTrack(STILL, [[1, 0, 0, 5], [3, 8, 4, 5]])
    assert track.at(time).eye == (0, 0, 5)
    assert track.at(3.0 + abs(time)).eye == (8, 4, 5)


def test_without_rotations_the_view_stays_and_without_positions_the_eye():
    moved = rs.CameraTrack(STILL, [[0, 1, 2, 3]]).at(7.0)
    assert (moved.eye, moved.look_at, moved.up) == ((1, 2, 3), (1, 2, 1), (0, 1, 0))
    turned = rs.CameraTrack(STILL, rotations=[[0, 1, 0, 0, 90]]).at(7.0)
    assert turned.eye == STILL.eye
    assert turned.look_at == pytest.approx((0, 2, 5))  # -z turned about x is y
    assert turned.up == pytest.approx((0, 0, 1))


def test_four_keys_are_a_catmull_rom_spline():
    """At half of even keys: -1, 9, 9, -1, over 16."""
    keys = np.array([[0, 1, 7, 0], [1, 2, 0, 0], [2, 5, -3, 1], [3, -4, 2, 0]], float)
    track = rs.CameraTrack(STILL, keys)
    assert track.at(1.5).eye == pytest.approx(np.array([-1, 9, 9, -1]) / 16 @ keys[:, 1:])
    assert track.at(1.0).eye == pytest.approx((2, 0, 0))
    assert track.at(2.0).eye == track.at(9.0).eye == pytest.approx((5, -3, 1))
    assert track.times == (1, 2)


def test_tension_makes_corners():
    keys = np.zeros((4, 7))
    keys[:, 0] = keys[:, 1] = range(4)
    keys[:, 4] = 1.0
    assert rs.CameraTrack(STILL, keys).at(1.25).eye[0] == pytest.approx(1 + 10 / 64)


def test_a_path_without_jumps():
    keys = np.array(
        [[0, 0, 0, 9], [1, 0, 0, 9], [2.5, 4, 1, 0], [3, 4, 1, 0], [6, -2, 0, 1]], float
    )
    turns = [
        [0, 0, 1, 0, 0],
        [1, 0, 1, 0, 10],
        [3, 1, 1, 0, 100],
        [5, 0, 0, 1, -50],
        [6, 1, 0, 0, 5],
    ]
    track = rs.CameraTrack(STILL, keys, turns)
    assert track.times == (1, 5)
    views = [track.at(time) for time in np.linspace(0, 7, 1401)]
    for path in ([view.eye for view in views], [view.basis()[2] for view in views]):
        assert np.linalg.norm(np.diff(path, axis=0), axis=1).max() < 0.1
    for view in views[::100]:
        assert math.dist(view.eye, view.look_at) == pytest.approx(2)


def test_keys_are_copied_and_cannot_be_written():
    keys = np.array([[0.0, 1, 2, 3]])
    track = rs.CameraTrack(STILL, keys)
    keys[:] = 9
    assert track.at(0).eye == (1, 2, 3)
    with pytest.raises(ValueError, match="read-only"):
        track.positions[0, 0] = 1


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({}, "positions, rotations"),
        ({"positions": []}, "positions: .* 4 or 7"),
        ({"positions": np.zeros((2, 5))}, "positions: .* 4 or 7"),
        ({"positions": [[0, 1, 2, "x"]]}, "positions"),
        ({"positions": [[0, 1, 2, math.inf]]}, "positions: expected finite"),
        ({"positions": [[0, 1, 2, 3], [-1, 1, 2, 3]]}, "positions: .* decrease"),
        ({"rotations": np.zeros((2, 4))}, "rotations: .* 5 or 8"),
        ({"rotations": [[math.nan, 0, 1, 0, 0]]}, "rotations: expected finite"),
    ],
)
def test_bad_keys_are_named(keys, words):
    with pytest.raises(ValueError, match=words):
        rs.CameraTrack(STILL, **keys)


@pytest.mark.parametrize("time", [math.nan, math.inf])
def test_times_must_be_finite(time):
    track = rs.CameraTrack(STILL, [[0, 1, 2, 3]])
    for camera_at in (track.at, rs.Scene().camera_at, rs.Scene(camera_track=track).camera_at):
        with pytest.raises(ValueError, match=r"^time: "):
            camera_at(time)


def test_keys_that_are_too_far_apart_end_in_one_error():
    track = rs.CameraTrack(STILL, [[k, (-1) ** k * 1e308, 0, 0] for k in range(4)])
    with pytest.raises(ValueError, match="eye"):
        track.at(1.5)


def test_a_scene_falls_back_to_its_still_camera():
    scene = rs.Scene(camera=STILL)
    assert scene.camera_track is None
    assert scene.camera_at(3.0) is STILL
    assert rs.Scene().camera_at(3.0) == rs.Scene().camera


def test_a_scene_shows_its_track_until_it_is_given_another_camera():
    track = rs.CameraTrack(STILL, [[0, 0, 0, 5], [2, 4, 0, 5]])
    scene = rs.Scene(camera_track=track)
    assert scene.camera is STILL
    assert scene.has_own_camera
    assert scene.camera_at(1.0).eye == (2, 0, 5)
    other = rs.Camera((1, 1, 1), (0, 0, 0))
    assert rs.Scene(camera=other, camera_track=track).camera is other
    seen = scene.replace(camera=other)
    assert seen.camera_track is None
    assert seen.camera_at(1.0) is other
    assert scene.replace(lights=[]).camera_at(1.0).eye == (2, 0, 5)
    assert seen.replace(camera_track=track).camera is STILL
    assert scene.replace(camera_track=None).camera_at(1.0) is STILL
