import math

import numpy as np
import pytest

import raystream as rs


def test_rays_by_hand():
    camera = rs.Camera((1, 2, 3), (1, 2, -7), (0, 1, 0), 90)
    origins, directions = camera.rays(4, 2)
    assert origins.shape == directions.shape == (2, 4, 3)
    assert (origins == [1, 2, 3]).all()
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1, rtol=1e-6)
    # The upper left pixel's centre: half a pixel of height 1 from the top, tan(45) = 1.
    expected = np.array([-1.5, 0.5, -1])
    np.testing.assert_allclose(directions[0, 0], expected / np.linalg.norm(expected), rtol=1e-6)
    middle = camera.rays(4, 2, [2.0], [1.0])[1]
    np.testing.assert_allclose(middle, [[0, 0, -1]], atol=1e-7)


def test_up_need_not_be_perpendicular():
    tilted = rs.Camera((0, 0, 5), (0, 3, 0), (0, 1, 0)).basis()
    np.testing.assert_allclose(tilted @ tilted.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(tilted), -1)  # right, up, into the image
    assert tilted[1, 1] > 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (((0, 0, 0), (0, 0, 0)), "look_at"),
        (((0, 0, math.nan), (0, 0, 0)), "eye"),
        (((0, 0, 1), (0, 0)), "look_at"),
        (((0, 0, 1), (0, 0, 0), (0, 0, 2)), "up"),
        (((0, 0, 1), (0, 0, 0), (0, 0, 0)), "up"),
        (((0, 0, 1), (0, 0, 0), (0, 1, 0), 0), "fov"),
        (((0, 0, 1), (0, 0, 0), (0, 1, 0), 180), "fov"),
        (((0, 0, 1), (0, 0, 0), (0, 1, 0), math.nan), "fov"),
    ],
)
def test_bad_cameras_are_named(arguments, words):
    with pytest.raises(ValueError, match=words):
        rs.Camera(*arguments)


@pytest.mark.parametrize("up", [(0, 1, 0), (0, 0, 1), (0, 0, -1), (1, 0, 0)])
@pytest.mark.parametrize("offset", [0.0, 1e7])
@pytest.mark.parametrize("size", [(1, 1, 1), (10, 1, 3), (0, 5, 0), (1e-6, 1e-6, 1e-6), (1, 0, 1)])
def test_a_framing_camera_sees_the_whole_box_and_fills_the_picture(up, offset, size):
    low = np.array([-1.0, -2, -3]) * max(size) + offset
    high = low + size
    camera = rs.Camera.framing(low, high, up=up)
    right, upward, forward = camera.basis()
    corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
    offsets = corners - np.array(camera.eye)
    depth = offsets @ forward
    assert (depth > 0).all()
    half = math.tan(math.radians(camera.fov) / 2)
    across, along = (
        np.abs(offsets @ right / depth) / (half * 4 / 3),
        np.abs(offsets @ upward / depth) / half,
    )
    assert max(across.max(), along.max()) <= 1
    assert max(across.max(), along.max()) > 0.6


def test_a_scene_without_extent_has_a_camera_too():
    assert rs.Scene().camera.fov == 40
    point = rs.Scene.from_arrays([[5, 5, 5]] * 3, [[0, 1, 2]])
    assert all(map(math.isfinite, point.camera.eye))


def test_the_given_camera_wins():
    camera = rs.Camera((0, 0, 9), (0, 0, 0))
    scene = rs.Scene(camera=camera)
    assert scene.camera is camera
    assert scene.has_own_camera
    plain = rs.Scene()
    assert not plain.has_own_camera
    assert plain.replace(camera=camera).has_own_camera
    assert not scene.replace(camera=None).has_own_camera
