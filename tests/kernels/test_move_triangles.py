"""The store made on all threads is the one that NumPy makes, bit for bit."""

import numpy as np
import pytest

import raystream as rs
from raystream.core.triangles import Triangles
from raystream.kernels.move_triangles import make_triangles

FIELDS = ("corners", "prim_ids", "mesh_splits", "center", "bounds")


def assert_same(meshes):
    made, expected = make_triangles(meshes), Triangles(meshes)
    for name in FIELDS:
        a, b = getattr(made, name), getattr(expected, name)
        assert a.dtype == b.dtype
        np.testing.assert_array_equal(a, b, err_msg=name)
    assert np.array_equal(np.signbit(made.corners), np.signbit(expected.corners))
    for name in ("scale", "max_coordinate", "degenerate_count", "nonfinite_count"):
        assert getattr(made, name) == getattr(expected, name), name
    return made


def soup(rng, count, dtype):
    vertices = rng.normal(size=(count, 3)).astype(dtype)
    faces = rng.integers(0, count, (2 * count, 3)).astype(np.int32)
    return vertices, faces  # some faces name a vertex twice: no area


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("offset", [0.0, 3e4])
@pytest.mark.parametrize("size", [1.0, 1e-9, 1e30])
def test_frames(rng, dtype, offset, size):
    vertices, faces = soup(rng, 500, dtype)
    made = assert_same([((vertices + dtype(offset)) * dtype(size), faces)])
    assert made.degenerate_count > 0
    assert (made.scale == 1.0) == (size == 1.0)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_vertices_that_are_not_finite(rng, dtype):
    vertices, faces = soup(rng, 500, dtype)
    vertices[::50] = np.nan
    vertices[1::50, 1] = np.inf
    with np.errstate(over="ignore"):
        vertices[2::50] *= dtype(1e250)
    assert assert_same([(vertices, faces)]).nonfinite_count > 0


@pytest.mark.parametrize("far", [1e20, 1e100])
def test_far_vertices_beside_a_nan_do_not_count(far):
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [far, 0, 0], [np.nan] * 3])
    faces = np.array([[0, 1, 2], [0, 3, 4]], np.int32)
    assert assert_same([(vertices, faces)]).scale == 1.0


def test_several_meshes_and_chunks(rng):
    meshes = [soup(rng, count, np.float32) for count in (3, 40_000, 1)]
    meshes.insert(1, (np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32)))
    assert_same(meshes)


def test_nothing():
    assert_same([])
    assert_same([(np.full((3, 3), np.nan), np.array([[0, 1, 2]], np.int32))])


def test_corners_are_restored_after_a_release(rng):
    meshes = [soup(rng, 100, np.float64), soup(rng, 50, np.float32)]
    made = make_triangles(meshes)
    before = made.corners
    made.release()
    assert made.byte_count < before.nbytes  # the numbers of the solid ones
    assert made.corners is not before
    np.testing.assert_array_equal(made.corners, before)
    assert made.corners is made.corners
    kept = Triangles(meshes)
    before = kept.corners
    kept.release()
    assert kept.corners is before


def test_a_built_tree_does_not_keep_the_corners():
    scene = rs.load("spheres:40000")
    triangles = scene.triangles
    expected = Triangles([(mesh.vertices, mesh.faces) for mesh in scene.meshes]).corners
    tracer = rs.Tracer(scene)
    assert triangles.byte_count == 0
    hits = tracer.first_hit(*scene.camera.rays(30, 20))
    assert hits.is_hit.any()
    assert triangles.byte_count == 0
    np.testing.assert_array_equal(triangles.corners, expected)
