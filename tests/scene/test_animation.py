"""Scenes that move: frames, poses, cameras to choose from."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from raystream.scene.animation import Timeline
from raystream.scene.key_tracks import KeyTrack

TRIANGLE = rs.Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])


def test_frames_are_counted_as_python_does() -> None:
    line = Timeline(1.0, 3.0, 5.0)
    assert line.frame_count == 10
    assert line.time_of(5) == 2.0
    assert line.chosen() == tuple(range(10))
    assert line.chosen(slice(1, 8, 3)) == (1, 4, 7)
    assert line.chosen(slice(None, None, -4)) == (9, 5, 1)
    assert line.chosen(slice(-2, None)) == (8, 9)
    assert line.chosen(-1) == (9,)
    assert line.chosen([3, 1]) == (3, 1)
    # 7 frames in 0.3: their product rounds to more than 7.
    assert Timeline(0.0, 0.3, 7 / 0.3).frame_count == 7
    assert Timeline(0.0, 1e-9, 1.0).frame_count == 1


@pytest.mark.parametrize(
    ("frames", "reason"),
    [
        (10, "frames: expected 0 to 9 .* got 10"),
        (-11, "got -11"),
        (slice(0, 11), "got 11"),
        (slice(5, 5), "selects none of 10 frames"),
        (slice(0, 5, 0), "step"),
        ([0, 99], "got 99"),
    ],
)
def test_frames_outside_are_refused(frames, reason) -> None:
    with pytest.raises(ValueError, match=reason):
        Timeline(0.0, 2.0, 5.0).chosen(frames)


@pytest.mark.parametrize(
    "numbers", [(0, 0, 1), (1, 0, 1), (0, np.inf, 1), (0, 1, 0), (0, 1, np.nan), (0, 1e9, 1e9)]
)
def test_timelines_that_make_no_sense_are_refused(numbers) -> None:
    with pytest.raises(ValueError, match=r"times|fps"):
        Timeline(*numbers)


def test_tracks_interpolate() -> None:
    """Steps, lines, and a parabola, which a Hermite spline with its slopes is exactly."""
    times = np.array([0.0, 1.0, 3.0])
    values = (times**2)[:, None]
    assert KeyTrack(times, values, "step").at(2.99) == 1.0
    assert KeyTrack(times, values).at(2.0) == 5.0
    slopes = 2.0 * times[:, None]
    cubic = KeyTrack(times, values, "cubic", False, slopes, slopes)
    for time in (0.0, 0.3, 1.0, 2.2, 3.0):
        assert cubic.at(time) == pytest.approx(time**2, abs=1e-12)
    assert (cubic.at(-1.0), cubic.at(9.0)) == (0.0, 9.0)


def test_rotations_go_the_shorter_way() -> None:
    half = np.deg2rad(100) / 2
    turn = np.array([0.0, 0.0, np.sin(half), np.cos(half)])
    track = KeyTrack(np.array([0.0, 1.0]), np.array([[0, 0, 0, 1], -turn]), is_rotation=True)
    for s in (0.25, 0.5, 0.9):
        expected = [0, 0, np.sin(s * half), np.cos(s * half)]
        np.testing.assert_allclose(track.at(s), expected, atol=1e-15)


def moving_scene(**options) -> rs.Scene:
    def at(time):
        light = rs.PointLight((time, 0, 5), (1, 1, 1))
        moved = TRIANGLE.moved(TRIANGLE.vertices + [0, time, 1])
        return rs.Scene([TRIANGLE, moved], lights=[light])

    animation = rs.Animation(at, (0, 2), fps=4)
    return rs.Scene([TRIANGLE, TRIANGLE], animation=animation, **options)


def test_scene_at_a_time() -> None:
    camera = rs.Camera((0, 0, 9), (0, 0, 0))
    track = rs.CameraTrack(camera, [[0, 0, 0, 9], [2, 4, 0, 9]])
    scene = moving_scene(camera_track=track)
    later = scene.at(0.5)
    assert later.meshes[0] is TRIANGLE
    assert later.meshes[1].vertices[0].tolist() == [0, 0.5, 1]
    assert later.lights[0].position == (0.5, 0, 5)
    assert later.camera.eye == (1, 0, 9)
    assert later.bounds[1].tolist() == [1, 1.5, 1]
    assert later.at(1.0).camera.eye == (2, 0, 9)
    assert scene.timeline().frame_count == 8
    assert scene.timeline(fps=1).frame_count == 2
    assert scene.replace(camera=camera).at(1.0).camera.eye == (0, 0, 9)  # it stays
    with pytest.raises(ValueError, match="finite"):
        scene.at(np.nan)
    with pytest.raises(ValueError, match="is static"):
        rs.Scene([TRIANGLE]).timeline()
    still = rs.Scene([TRIANGLE], camera_track=track)
    assert still.timeline().frame_count == 48
    store = still.triangles
    assert still.at(1.0).triangles is store


def test_replaced_parts_do_not_follow_the_animation() -> None:
    scene = moving_scene()
    lamp = rs.PointLight((9, 9, 9), (1, 1, 1))
    lit = scene.replace(lights=[lamp]).replace(background=(0, 0, 1))
    assert lit.at(0.5).lights == (lamp,)
    assert lit.at(0.5).background == (0, 0, 1)
    assert lit.at(0.5).meshes[1].vertices[0].tolist() == [0, 0.5, 1]
    still = scene.replace(meshes=[TRIANGLE])
    assert still.at(0.5).triangles is still.triangles
    assert still.at(0.5).lights[0].position == (0.5, 0, 5)
    again = lit.replace(animation=scene.animation)
    assert again.at(0.5).lights[0].position == (0.5, 0, 5)


def test_cameras_to_choose_from() -> None:
    front, side = rs.Camera((0, 0, 9), (0, 0, 0)), rs.Camera((9, 0, 0), (0, 0, 0))
    track = rs.CameraTrack(side, [[0, 9, 0, 0], [1, 9, 1, 0]])
    scene = rs.Scene([TRIANGLE], cameras={"front": front, "side": track})
    assert scene.camera is front
    assert scene.cameras == {"front": front, "side": side}
    for which in ("side", 1):
        moving = scene.replace(camera=which)
        assert (moving.camera, moving.camera_track) == (side, track)
        still = moving.replace(camera=0)
        assert (still.camera, still.camera_track) == (front, None)
    for which in ("top", 2, -1):
        with pytest.raises(ValueError, match=r"no camera .*'front' \(0\), 'side' \(1\)"):
            scene.replace(camera=which)
    with pytest.raises(ValueError, match="no named cameras"):
        rs.Scene(camera="front")


def test_tracer_takes_the_scene_of_another_time(rng) -> None:
    """With its lights, and the same bits as a separate tracer."""
    scene = moving_scene()
    tracer = rs.Tracer(scene.at(0.0))
    rays = {"origins": rng.random((200, 3)) * [1, 2, 0] + [0, 0, 3], "directions": [0, 0, -1]}
    for time in (0.7, 0.1):
        posed = scene.at(time)
        assert not tracer.update(posed, max_cost_growth=np.inf).rebuilt
        assert tracer.scene.lights == posed.lights
        hits, expected = tracer.first_hit(**rays), rs.Tracer(posed).first_hit(**rays)
        assert (hits.prim_id == 1).sum() > 20
        for name in ("t", "u", "v", "prim_id"):
            np.testing.assert_array_equal(getattr(hits, name), getattr(expected, name))
    structure = tracer.structure
    report = tracer.update(tracer.scene)
    assert (tracer.structure is structure, report.rebuilt) == (True, False)
    with pytest.raises(ValueError, match="expected 2 meshes"):
        tracer.update(rs.Scene([TRIANGLE]))
    other = rs.Mesh(TRIANGLE.vertices, [[0, 2, 1]])
    with pytest.raises(ValueError, match="mesh 1 has different faces"):
        tracer.update(rs.Scene([TRIANGLE, other]))
