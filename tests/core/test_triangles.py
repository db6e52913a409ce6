import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from raystream.core.triangles import RECENTRE_RATIO, Triangles, local_frame

TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], float)
FACE = np.array([[0, 1, 2]], np.int32)


def store(vertices, faces=FACE):
    return Triangles([(np.asarray(vertices), np.asarray(faces, np.int32))])


def test_ordinary_scenes_are_not_moved():
    triangles = store(TRIANGLE + 10)
    assert not triangles.center.any()
    assert triangles.scale == 1.0
    np.testing.assert_array_equal(triangles.corners[0], (TRIANGLE + 10).astype(np.float32))


def test_far_scenes_are_moved_exactly():
    """The centre is a multiple of a power of two, so float64 loses nothing on the way."""
    far = TRIANGLE + [1e7, -3e7, 123456789.0]
    triangles = store(far)
    np.testing.assert_array_equal(triangles.center % 1.0, 0)
    assert np.abs(triangles.corners).max() <= 2.0
    np.testing.assert_array_equal(triangles.to_world(triangles.corners[0]), far)
    np.testing.assert_array_equal(triangles.world_bounds, [far.min(axis=0), far.max(axis=0)])


@pytest.mark.parametrize("exponent", [-300, -40, -11, 25, 60, 190])
def test_extreme_scales_become_ordinary_by_a_power_of_two(exponent):
    triangles = store(TRIANGLE * 2.0**exponent)
    assert np.frexp(triangles.scale)[0] == 0.5
    assert 2.0**-11 <= triangles.max_coordinate <= 2.0**20
    np.testing.assert_array_equal(
        triangles.to_world(triangles.corners[0]), TRIANGLE * 2.0**exponent
    )


def test_the_limit_of_recentring():
    low, high = np.zeros(3), np.ones(3)
    for offset, moved in ((RECENTRE_RATIO - 2, False), (RECENTRE_RATIO + 2, True)):
        center, scale = local_frame(low + offset, high + offset)
        assert center.any() == moved
        assert scale == 1.0


def test_vertices_without_a_triangle_do_not_count():
    triangles = store(np.vstack([TRIANGLE, [1e30, 0, 0], [np.nan] * 3]))
    np.testing.assert_array_equal(triangles.world_bounds, [[0, 0, 0], [1, 1, 0]])
    assert triangles.nonfinite_count == 0


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e80])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_triangles_with_unusable_vertices_are_left_out(bad, dtype):
    with np.errstate(over="ignore"):
        vertices = np.vstack([TRIANGLE, [bad, 0, 0]]).astype(dtype)
    triangles = store(vertices, [[0, 1, 2], [0, 1, 3]])
    assert triangles.nonfinite_count == 1
    assert triangles.degenerate_count == 0
    assert triangles.prim_ids.tolist() == [0]
    np.testing.assert_array_equal(triangles.bounds, [[0, 0, 0], [1, 1, 0]])


def test_triangles_without_area_are_left_out():
    vertices = np.vstack([TRIANGLE, [3, 0, 0], [0.1, 0.1, 0.1], [0.3, 0.3, 0.3], [0.2, 0.2, 0.2]])
    faces = [[0, 0, 0], [0, 1, 1], [0, 1, 3], [0, 1, 2], [4, 5, 6]]
    triangles = store(vertices.astype(np.float32), faces)
    # The last one is a line in decimal, and nearly one in float32.
    assert triangles.prim_ids.tolist()[0] == 3
    assert triangles.degenerate_count >= 3


def test_meshes_are_numbered_one_after_another():
    meshes = [(TRIANGLE, FACE), (TRIANGLE, FACE[:0]), (TRIANGLE + 5, np.repeat(FACE, 3, axis=0))]
    triangles = Triangles(meshes)
    assert triangles.mesh_splits.tolist() == [0, 1, 1, 4]
    np.testing.assert_array_equal(triangles.corners[1], TRIANGLE + 5)


def test_nothing_at_all():
    triangles = Triangles([])
    assert len(triangles) == 0
    assert triangles.max_coordinate == 0
    np.testing.assert_array_equal(triangles.world_bounds, np.zeros((2, 3)))


def restorable(wait=lambda: None):
    """A store whose corners can be freed."""
    corners = TRIANGLE.astype(np.float32)[None]

    def restore():
        wait()
        return corners.copy()

    solid, bounds = np.ones(1, bool), np.array([corners[0].min(0), corners[0].max(0)])
    splits = np.array([0, 1])
    return Triangles.from_solid(corners, splits, np.zeros(3), 1.0, solid, 0, bounds, restore)


def test_threads_that_restore_corners_at_once_share_them():
    """An array that one of them lost would be freed under those that have its address."""
    barrier = threading.Barrier(4)
    triangles = restorable(lambda: barrier.wait(60))
    triangles.release()
    with ThreadPoolExecutor(4) as pool:
        arrays = list(pool.map(lambda _: triangles.corners, range(4)))
    assert all(one is triangles.corners for one in arrays)
