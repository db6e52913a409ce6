"""Queries of points: shapes, limits, insides, bad input, and what is not supported."""

from __future__ import annotations

import re

import numpy as np
import pytest

import raystream as rs
from meshes import cube, dented_sphere, grid_floor, icosphere, soup
from raystream.core.closest_points import ClosestPoints
from raystream.tracer.inside import _DIRECTIONS
from solid_meshes import box_mesh, joined, sphere_mesh, tracer_of


@pytest.fixture(scope="module")
def tracer():
    return rs.Tracer(rs.Scene.from_arrays(*dented_sphere(2)))


@pytest.mark.parametrize("shape", [(), (1,), (0,), (5,), (2, 3), (2, 0, 3), (1, 1, 1, 2)])
def test_results_keep_the_leading_shape(tracer, shape):
    points = np.random.default_rng(0).normal(size=(*shape, 3))
    found = tracer.closest_point(points)
    assert isinstance(found, ClosestPoints)
    for name in ("distance", "u", "v", "prim_id", "mesh_id", "status", "is_found", "material_id"):
        assert getattr(found, name).shape == shape, name
    assert found.positions.shape == found.normals.shape == (*shape, 3)
    rows = tracer.closest_points(points, 4)
    assert rows.distance.shape == rows.mesh_id.shape == (*shape, 4)
    assert rows.positions.shape == rows.normals.shape == (*shape, 4, 3)
    assert rows.status.shape == shape
    assert tracer.contains(points).shape == shape
    assert tracer.signed_distance(points).shape == shape
    assert tracer.winding_number(points).shape == shape


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64, np.int16, ">f8", "<f4"])
def test_points_of_any_real_type(tracer, dtype):
    points = np.random.default_rng(1).integers(-3, 4, (40, 3))
    expected = tracer.closest_point(points.astype(float))
    found = tracer.closest_point(points.astype(dtype))
    np.testing.assert_array_equal(found.distance, expected.distance)
    strided = np.zeros((40, 6), dtype)[:, ::2]
    strided[:] = points
    np.testing.assert_array_equal(tracer.closest_point(strided).positions, expected.positions)


def test_columns_of_the_triangle():
    vertices = np.array([[0, 0, 0], [4, 0, 0], [0, 4, 0]], float)
    meshes = [rs.Mesh(vertices + [0, 0, 9], [[0, 1, 2]]), rs.Mesh(vertices, [[0, 1, 2]])]
    found = rs.Tracer(rs.Scene(meshes)).closest_point([[1, 2, -1], [7, -1, 0], [0, 9, 8]])
    assert found.prim_id.tolist() == [1, 1, 0]
    assert found.mesh_id.tolist() == [1, 1, 0]
    assert found.u.tolist() == [0.25, 1.0, 0.0]
    assert found.v.tolist() == [0.5, 0.0, 1.0]
    assert found.normals.tolist() == [[0, 0, 1]] * 3
    assert repr(found) == "ClosestPoints(shape=(3,), 3 of 3 found)"


def test_more_rows_than_triangles():
    tracer = rs.Tracer(rs.Scene.from_arrays(*soup(3)))
    found = tracer.closest_points([[0, 0, 0], [1, 1, 1]], 5)
    assert (np.sort(found.prim_id, axis=1) == [-1, -1, 0, 1, 2]).all()
    assert (found.prim_id[:, 3:] == -1).all()
    assert (found.distance[:, 3:] == np.inf).all()
    assert np.isnan(found.positions[:, 3:]).all()
    assert (found.mesh_id[:, 3:] == -1).all()


def test_limits_for_each_point(tracer):
    points = np.random.default_rng(2).normal(size=(50, 3)) * 3
    nearest = tracer.closest_point(points)
    limits = np.random.default_rng(3).random(50) * 3
    found = tracer.closest_point(points, max_distance=limits)
    within = nearest.distance <= limits
    assert 5 < within.sum() < 45
    np.testing.assert_array_equal(found.is_found, within)
    np.testing.assert_array_equal(found.distance[within], nearest.distance[within])
    rows = tracer.closest_points(points, 30, max_distance=limits)
    every = tracer.closest_points(points, 320)
    counts = (every.distance <= limits[:, None]).sum(axis=1)
    np.testing.assert_array_equal(rows.is_found.sum(axis=1), np.minimum(counts, 30))


BAD = [[np.nan, 0, 0], [0, np.inf, 0], [0, 0, -np.inf], [1e300, 0, 0], [np.nan] * 3]


@pytest.mark.parametrize("structure", ["bvh", "brute"])
def test_bad_points_are_reported(structure):
    tracer = rs.Tracer(rs.Scene.from_arrays(*icosphere(1)), structure)
    points = np.array([*BAD, [0, 0, 0]])
    for repeat in (1, 30):  # alone, and in a batch that is sorted
        found = tracer.closest_point(np.tile(points, (repeat, 1)))
        assert (found.status.reshape(repeat, -1) == [rs.RayStatus.INVALID] * 5 + [0]).all()
        assert (found.prim_id.reshape(repeat, -1)[:, :5] == -1).all()
        assert (found.distance.reshape(repeat, -1)[:, :5] == np.inf).all()
        assert found.is_found.reshape(repeat, -1)[:, 5].all()
    assert tracer.contains(points).tolist() == [False] * 5 + [True]
    assert np.isnan(tracer.signed_distance(points)).tolist() == [True] * 5 + [False]
    assert np.isnan(tracer.winding_number(points)).tolist() == [True] * 5 + [False]


@pytest.mark.parametrize(
    ("arguments", "error", "text"),
    [
        ({"points": [0, 0]}, ValueError, r"points: expected shape \(..., 3\), got \(2,\)"),
        ({"points": 1.0}, ValueError, "points: expected shape"),
        ({"points": "abc"}, TypeError, "points: expected real numbers"),
        ({"points": [[1j, 0, 0]]}, TypeError, "points: expected real numbers"),
        ({"points": [[0, 0, 0]], "max_distance": -1}, ValueError, "max_distance: expected"),
        ({"points": [[0, 0, 0]], "max_distance": np.nan}, ValueError, "max_distance: expected"),
        ({"points": [[0, 0, 0]], "max_distance": [1, 2]}, ValueError, "does not broadcast"),
        ({"points": [[0, 0, 0]], "max_distance": "far"}, TypeError, "max_distance: expected"),
        ({"points": [[0, 0, 0]], "k": 0}, ValueError, "k: expected at least 1"),
        ({"points": [[0, 0, 0]], "k": 1.5}, TypeError, "integer"),
        ({"points": [[0, 0, 0]], "k": 2**40}, MemoryError, "smaller k"),
    ],
)
def test_bad_arguments_are_named(tracer, arguments, error, text):
    query = tracer.closest_points if "k" in arguments else tracer.closest_point
    with pytest.raises(error, match=text):
        query(**arguments)


@pytest.mark.parametrize(
    "options",
    [
        {"structure": "grid"},
        {"structure": "kdtree"},
        {"structure": "graph"},
        {"structure": "bvh", "machine": "multipass"},
    ],
)
def test_what_is_not_supported_says_what_is(options):
    tracer = rs.Tracer(rs.Scene.from_arrays(*cube()), **options)
    for query in (tracer.closest_point, tracer.signed_distance):
        with pytest.raises(ValueError, match="structure='bvh' or structure='brute'"):
            query([0.5, 0.5, 0.5])
    assert tracer.contains([[0.5, 0.5, 0.5], [2, 0, 0]]).tolist() == [True, False]


@pytest.mark.parametrize("structure", ["bvh", "brute"])
def test_scenes_without_triangles(structure):
    nothing = rs.Scene.from_arrays(np.zeros((3, 3)), [[0, 1, 2]])  # degenerate
    empty = rs.Scene.from_arrays(np.zeros((0, 3)), np.zeros((0, 3), int))
    for scene in (nothing, empty):
        tracer = rs.Tracer(scene, structure)
        found = tracer.closest_points([[0, 0, 0], [1, 2, 3]], 2)
        assert (found.prim_id == -1).all()
        assert np.isnan(found.normals).all()
        assert not tracer.contains([[0, 0, 0]]).any()
        assert tracer.signed_distance([0, 0, 0]).item() == np.inf
        assert tracer.winding_number([1, 2, 3]).item() == 0


def test_degenerate_and_infinite_triangles_do_not_count():
    vertices = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 5, 5], [6, 6, 6], [np.inf, 0, 0]]
    faces = [[0, 1, 2], [3, 4, 3], [3, 3, 3], [3, 4, 5], [0, 0, 1]]
    for structure in ("bvh", "brute"):
        tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces), structure)
        assert tracer.closest_points([5.0, 5.0, 5.0], 3).prim_id.tolist() == [0, -1, -1]


@pytest.mark.parametrize("structure", ["bvh", "brute"])
def test_moved_and_stored_triangles(structure, tmp_path):
    vertices, faces = dented_sphere(2)
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces), structure)
    points = np.random.default_rng(4).normal(size=(200, 3)) * 2
    tracer.save(tmp_path / "tracer.npz")
    loaded = rs.Tracer.load(tmp_path / "tracer.npz").closest_point(points)
    np.testing.assert_array_equal(loaded.distance, tracer.closest_point(points).distance)
    moved = vertices * [1, 2, 0.5] + [0.1, 0, 0]
    tracer.update(moved)
    expected = rs.Tracer(rs.Scene.from_arrays(moved, faces), structure).closest_point(points)
    np.testing.assert_array_equal(tracer.closest_point(points).positions, expected.positions)


def test_progress_and_interrupts(tracer):
    points = np.random.default_rng(5).normal(size=(60_000, 3))
    for query in (tracer.closest_point, tracer.contains, tracer.signed_distance):
        seen = []
        query(points, progress=lambda done, total, seen=seen: seen.append(done / total))
        assert seen == sorted(seen)
        assert seen[-1] == 1.0

    def stop(done, total):
        raise KeyboardInterrupt

    for query in (tracer.closest_point, tracer.contains, tracer.winding_number):
        with pytest.raises(KeyboardInterrupt):
            query(points, progress=stop)


# Inside and outside.


def box_distance(points, low, high):
    """The signed distance from a box in closed form."""
    middle, half = (np.add(low, high)) / 2, (np.subtract(high, low)) / 2
    off = np.abs(points - middle) - half
    outside = np.linalg.norm(np.maximum(off, 0), axis=-1)
    return outside + np.minimum(off.max(axis=-1), 0)


def test_signed_distance_from_a_box():
    low, high = np.array([-1, -2, 0.5]), np.array([2, 1, 1.5])
    tracer = tracer_of(box_mesh(low, high))
    points = np.random.default_rng(6).uniform(-4, 4, (20_000, 3))
    expected = box_distance(points, low, high)
    found = tracer.signed_distance(points)
    assert 100 < (expected < 0).sum() < 1_000
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14)
    near = tracer.signed_distance(points, max_distance=0.25)
    np.testing.assert_array_equal(near[np.isfinite(near)], found[np.abs(found) <= 0.25])
    np.testing.assert_array_equal(np.signbit(near), np.signbit(found))
    winding = tracer.signed_distance(points[:500], method="winding")
    np.testing.assert_array_equal(winding, found[:500])


@pytest.mark.parametrize("flipped", [False, True])
def test_rays_and_winding_numbers_agree(flipped):
    vertices, faces = dented_sphere(3)
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces[:, ::-1] if flipped else faces))
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    points = np.random.default_rng(7).uniform(low - 0.3, high + 0.3, (3_000, 3))
    by_rays, by_winding = tracer.contains(points), tracer.contains(points, method="winding")
    assert 300 < by_rays.sum() < 2_700
    near = tracer.closest_point(points).distance < 1e-5
    np.testing.assert_array_equal(by_rays[~near], by_winding[~near])


@pytest.mark.parametrize("direction", _DIRECTIONS)
def test_rays_through_vertices_and_edges(direction):
    """Points whose rays meet edges and vertices exactly, as far as float32 goes."""
    vertices, faces = icosphere(2)
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces))
    corners = vertices[faces]
    aims = np.concatenate([vertices, (corners[:, 0] + corners[:, 1]) / 2])
    for t in (0.2, 0.7, 1.5, 3.0):
        points = aims - t * np.array(direction)
        radius = np.linalg.norm(points, axis=1)
        clear = np.abs(radius - 0.98) > 0.03
        assert clear.sum() > 50
        np.testing.assert_array_equal(tracer.contains(points)[clear], radius[clear] < 0.98)


@pytest.mark.parametrize("wrong", range(3))
def test_winding_numbers_decide_where_rays_disagree(wrong):
    class Leaky(rs.Tracer):
        """One of the three rays misses a surface."""

        def count_hits(self, origins, directions, **options):
            missed = np.array_equal(directions, np.float32(_DIRECTIONS[wrong]))
            return super().count_hits(origins, directions, **options) + missed

    vertices, faces = dented_sphere(2)
    scene = rs.Scene.from_arrays(vertices, faces)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    points = np.random.default_rng(13).uniform(low, high, (500, 3))
    expected = rs.Tracer(scene).contains(points)
    assert 50 < expected.sum() < 450
    seen = []
    found = Leaky(scene).contains(points, progress=lambda *steps: seen.append(steps))
    np.testing.assert_array_equal(found, expected)
    assert seen == sorted(seen)


def test_parts_of_one_surface():
    """A cube of six open meshes is closed."""
    vertices, faces = cube()
    meshes = [rs.Mesh(vertices, faces[k : k + 2]) for k in range(0, 12, 2)]
    tracer = rs.Tracer(rs.Scene(meshes))
    assert tracer.contains([[0.5, 0.4, 0.3], [1.5, 0.4, 0.3]]).tolist() == [True, False]


def test_solids_within_solids():
    shell = tracer_of(sphere_mesh(radius=3), sphere_mesh(radius=1, flipped=True))
    points = [[0, 0, 0], [2, 0, 0], [4, 0, 0]]
    for method in ("rays", "winding"):
        assert shell.contains(points, method=method).tolist() == [False, True, False]
    np.testing.assert_allclose(shell.winding_number(points), [0, 1, 0], atol=1e-12)
    doubled = tracer_of(sphere_mesh(radius=3), sphere_mesh(radius=1))
    for method in ("rays", "winding"):
        assert doubled.contains(points, method=method).tolist() == [True, True, False]
    assert (doubled.signed_distance(points) < 0).tolist() == [True, True, False]


def overlapping_solids():
    """Nested, crossing, equal, with a cavity, and in one mesh; the boxes that are solid."""
    boxes = [([0, 0, 0], [4, 3, 2]), ([1, 1, 0.5], [2, 2, 1.5]), ([3, 1, 1], [6, 2, 4]),
             ([3, 1, 1], [6, 2, 4]), ([-2, -1, -1], [0.5, 1, 1])]  # fmt: skip
    meshes = [box_mesh(*box) for box in boxes]
    yield "meshes", boxes, meshes
    yield "one mesh", boxes, [joined(*meshes)]
    yield "inward", boxes, [rs.Mesh(mesh.vertices, mesh.faces[:, ::-1]) for mesh in meshes]
    yield (
        "open parts",
        boxes,
        [rs.Mesh(mesh.vertices, mesh.faces[part::2]) for mesh in meshes for part in (0, 1)],
    )


@pytest.mark.parametrize("k", range(4))
@pytest.mark.parametrize("structure", ["bvh", "brute"])
def test_points_in_several_solids_are_inside(k, structure):
    _, boxes, meshes = list(overlapping_solids())[k]
    tracer = tracer_of(*meshes, structure=structure)
    points = np.random.default_rng(21).uniform([-3, -2, -2], [7, 4, 5], (4000, 3))
    inside = np.array([((points > low) & (points < high)).all(axis=1) for low, high in boxes])
    assert (inside.sum(axis=0) > 1).sum() > 100
    np.testing.assert_array_equal(tracer.contains(points), inside.any(axis=0))
    np.testing.assert_array_equal(tracer.contains(np.float32(points)), inside.any(axis=0))
    np.testing.assert_array_equal(tracer.signed_distance(points) < 0, inside.any(axis=0))


def test_overlapping_solids_far_away_and_their_progress():
    boxes = np.array([[[0, 0, 0], [4, 3, 2]], [[1, 1, 0.5], [2, 2, 1.5]]]) + [1e6, 2e6, -1e6]
    tracer = tracer_of(*(box_mesh(*box) for box in boxes))
    steps = []
    points = boxes.mean(axis=1) + np.random.default_rng(2).normal(size=(2000, 2, 3))
    found = tracer.contains(points, progress=lambda *step: steps.append(step))
    expected = ((points > boxes[0, 0]) & (points < boxes[0, 1])).all(axis=-1)
    np.testing.assert_array_equal(found, expected)
    assert steps == sorted(steps)
    assert steps[-1][0] == steps[-1][1]


def test_a_cavity_of_a_cavity():
    radii = (5, 4, 3, 2)  # a shell within a shell; and a solid through both walls
    shells = [sphere_mesh(radius=r, flipped=k % 2 == 1) for k, r in enumerate(radii)]
    tracer = tracer_of(*shells, box_mesh([-9, -0.5, -0.5], [9, 0.5, 0.5]))
    points = [[0.1, r, 0.2] for r in (0, 1, 2.5, 3.5, 4.5, 6)]
    assert tracer.contains(points).tolist() == [True, False, True, False, True, False]
    line = [[x, 0.1, 0.2] for x in (2.5, 3.5, 4.5, 6, 9.5)]
    assert tracer.contains(line).tolist() == [True, True, True, True, False]


def test_open_surfaces_need_winding_numbers():
    vertices, faces = icosphere(3)
    bowl = rs.Tracer(rs.Scene.from_arrays(vertices, faces[10:]))
    for query in (bowl.contains, bowl.signed_distance):
        with pytest.raises(ValueError, match="method='winding'"):
            query([0, 0, 0])
        with pytest.raises(ValueError, match="expected 'rays' or 'winding', got 'parity'"):
            query([0, 0, 0], method="parity")
    points = [[0, 0, 0], [0.9, 0, 0], [1.2, 0, 0]]
    assert bowl.contains(points, method="winding").tolist() == [True, True, False]
    with pytest.raises(ValueError, match="outside: mesh 0 is open"):
        rs.Tracer(rs.Scene.from_arrays(*grid_floor(2))).contains([0, 0, 0])


def test_meshes_that_are_open_are_named():
    vertices, faces = icosphere(1)
    solid = rs.Mesh(vertices, faces, name="ball")
    for count, named in (
        (2, "meshes 1 ('bowl 0') and 2 ('bowl 1') are"),
        (5, "meshes 1 ('bowl 0'), 2 ('bowl 1'), 3 ('bowl 2') and 2 more are"),
    ):
        empty = rs.Mesh(vertices, faces[:0], name="nothing")
        bowls = [rs.Mesh(vertices, faces[k + 1 :], name=f"bowl {k}") for k in range(count)]
        with pytest.raises(ValueError, match=re.escape(f"{named} open")):
            rs.Tracer(rs.Scene([solid, *bowls, empty])).contains([0, 0, 0])


# Winding numbers.


def solid_angle(a, b, c):
    """By the spherical excess: the angles between the planes of the triangle's sides."""
    total = 0.0
    for p, q, r in ((a, b, c), (b, c, a), (c, a, b)):
        first, second = np.cross(p, q), np.cross(p, r)
        cosine = first @ second / np.linalg.norm(first) / np.linalg.norm(second)
        total += np.arccos(np.clip(cosine, -1, 1))
    return (total - np.pi) * np.sign(a @ np.cross(b, c))


def test_winding_numbers_are_sums_of_solid_angles():
    vertices, faces = soup(40, 5, 0.5)
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces))
    corners = tracer.structure.triangles.corners.astype(float)
    points = np.random.default_rng(11).uniform(-1, 2, (45, 3))
    expected = [sum(solid_angle(*(t - p for t in tri)) for tri in corners) for p in points]
    found = tracer.winding_number(points)
    np.testing.assert_allclose(found, np.array(expected) / (4 * np.pi), rtol=0, atol=1e-7)
    assert np.ptp(found) > 0.3


def test_turns_are_counted():
    """A surface that is there 25 times surrounds its inside 25 times; a flipped one, -25 times."""
    vertices, faces = dented_sphere(2)
    points = np.random.default_rng(12).normal(size=(30, 3)) * 0.2 + vertices.mean(axis=0)
    once = rs.Tracer(rs.Scene.from_arrays(vertices, faces)).winding_number(points)
    assert (np.abs(once - np.round(once)) < 1e-12).all()
    assert (np.round(once) == 1).sum() > 10
    for copies in (faces, faces[:, ::-1]):
        scene = rs.Scene.from_arrays(vertices, np.tile(copies, (25, 1)))
        sign = 1 if copies is faces else -1
        found = rs.Tracer(scene).winding_number(points)
        np.testing.assert_allclose(found, sign * 25 * np.round(once), atol=1e-10)


def test_points_on_corners_have_winding_numbers():
    vertices, faces = cube()
    numbers = rs.Tracer(rs.Scene.from_arrays(vertices, faces)).winding_number(vertices)
    assert np.isfinite(numbers).all()
    assert (np.abs(numbers) <= 1).all()
