"""Closest points in scenes of spheres and height fields, of instances, and in float64."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import point_oracles
import raystream as rs
from meshes import cube, icosphere

quiet = settings(max_examples=40)

COLUMNS = "distance", "positions", "u", "v", "prim_id", "instance_id", "status"


def both(scene, **options):
    return [rs.Tracer(scene, structure, **options) for structure in ("bvh", "brute")]


def assert_same(found, expected):
    for name in COLUMNS:
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), name)


def points_near(low, high, rng, count):
    """Points around a box, of which some are far away."""
    size = float(np.max(np.subtract(high, low)))
    points = rng.uniform(np.subtract(low, size), np.add(high, size), (count, 3))
    points[: count // 8] *= 1e3
    points[: count // 16] *= 1e7
    return points


# Spheres and height fields


def mixed_scene(rng, sphere_count=60):
    heights = rng.uniform(-1.0, 1.0, (13, 10))
    heights[3, 4:6] = np.nan
    centers = rng.uniform([-6, -6, -3], [6, 6, 3], (sphere_count, 3))
    soup = rng.uniform(-4.0, 4.0, (90, 3))
    return rs.Scene.combine(
        [
            rs.Scene.from_arrays(soup, np.arange(90).reshape(-1, 3)),
            rs.Scene.height_field(heights, origin=(-5, 5, 0.5), spacing=(0.9, -0.8)),
            rs.Scene.height_field(heights[:2, :2] + 4.0, spacing=2.0),
            rs.Scene.spheres(centers, rng.uniform(0.01, 1.0, sphere_count)),
        ]
    )


def all_distances(scene, points):
    """Distances of (N, 3) points from all primitives, (N, P); inf where there is no triangle."""
    held = scene.triangles
    numbers = np.arange(held.first_fields[-1], dtype=np.int32)
    corners = held.to_world(held.corners_at(numbers, numbers))
    known = np.isfinite(corners).all(axis=(1, 2))
    found = np.full((len(points), len(held)), np.inf)
    found[:, np.flatnonzero(known)] = point_oracles.distances(points, corners[known])
    spheres = held.spheres
    gaps = np.linalg.norm(points[:, None].astype(np.longdouble) - spheres.centers, axis=-1)
    found[:, len(numbers) :] = np.abs(gaps - spheres.radii)
    return found


def test_mixed_scenes_as_the_oracle_has_them() -> None:
    rng = np.random.default_rng(1)
    scene = mixed_scene(rng)
    points = points_near([-6, -6, -3], [6, 6, 3], rng, 400)
    points[-60:] = scene.triangles.spheres.centers
    tree, brute = both(scene)
    found = tree.closest_points(points, 5)
    assert_same(found, brute.closest_points(points, 5))
    expected = all_distances(scene, points)
    np.testing.assert_allclose(found.distance, np.sort(expected, axis=1)[:, :5], 1e-13, 1e-13)
    own = np.take_along_axis(expected, found.prim_id.astype(np.int64), axis=1)
    np.testing.assert_allclose(found.distance, own, 1e-13, 1e-13)
    gaps = np.linalg.norm(points[:, None] - found.positions, axis=-1)
    np.testing.assert_allclose(gaps, found.distance, 1e-12, 1e-12)
    is_sphere = found.is_on_sphere
    assert set(np.unique(found.mesh_id[:, 0])) == {0, 1, 2, 3}
    # u and v are those of hits: they lead to the same point.
    again = scene.triangles.to_world(scene.triangles.local_positions(found))
    np.testing.assert_allclose(again, found.positions, rtol=0.0, atol=1e-5)
    normals = found.normals[is_sphere]
    np.testing.assert_allclose(np.linalg.norm(normals, axis=-1), 1.0, 1e-6)


def test_spheres_by_hand() -> None:
    scene = rs.Scene.spheres([[0, 0, 0], [10, 0, 0], [10, 0, 0]], [2.0, 1.0, 1.0])
    points = [[0, 0, 0], [0, 1, 0], [0, -5, 0], [6, 0, 0], [10, 0, 0.5], [5.5, 0, 0]]
    for tracer in both(scene):
        near = tracer.closest_point(points)
        assert near.distance.tolist() == [2.0, 1.0, 3.0, 3.0, 0.5, 3.5]
        # Of equal spheres the first; of a centre the point above it.
        assert near.prim_id.tolist() == [0, 0, 0, 1, 1, 0]
        wanted = [[0, 0, 2], [0, 2, 0], [0, -2, 0], [9, 0, 0], [10, 0, 1], [2, 0, 0]]
        assert near.positions.tolist() == wanted
        assert (tracer.closest_points([10, 0, 3], 3).prim_id == [1, 2, 0]).all()
        limited = tracer.closest_point(points, max_distance=2.0)
        assert limited.is_found.tolist() == [True, True, False, False, True, False]


def test_flat_and_sloping_terrain_by_hand() -> None:
    slope = np.add.outer(np.zeros(9), np.arange(9.0))
    scene = rs.Scene.height_field(slope)
    for tracer in both(scene):
        near = tracer.closest_point([[4, 4, 6], [-3, 4, -4], [4, 12, 4]])
        np.testing.assert_allclose(near.distance, [np.sqrt(2), 5.0, 4.0], 1e-15)
        wanted = [[5, 4, 5], [0, 4, 0], [4, 8, 4]]
        np.testing.assert_allclose(near.positions, wanted, 1e-15, 1e-15)


def test_a_height_field_has_the_bits_of_its_triangles() -> None:
    rng = np.random.default_rng(5)
    field = rs.Scene.height_field(rng.uniform(0.0, 2.0, (40, 31)).astype(np.float32), spacing=0.5)
    store = field.triangles
    numbers = np.arange(len(store), dtype=np.int32)
    corners = store.corners_at(numbers, numbers)
    assert store.scale == 1.0
    assert not store.center.any()
    mesh = rs.Scene.from_arrays(corners.reshape(-1, 3), np.arange(3 * len(store)).reshape(-1, 3))
    points = points_near([0, 0, 0], [15, 20, 2], rng, 500)
    expected = rs.Tracer(mesh).closest_points(points, 3)
    for tracer in both(field):
        assert_same(tracer.closest_points(points, 3), expected)


@quiet
@given(st.integers(0, 2**32 - 1), st.integers(1, 4), st.sampled_from([0.0, 1e4, -1e8]))
def test_trees_have_the_bits_of_brute_force(seed, k, shift) -> None:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 30))
    centers = rng.integers(-4, 5, (count, 3)) + shift
    scene = rs.Scene.spheres(centers, rng.choice([0.5, 1.0, 2.0], count))
    points = np.concatenate([rng.integers(-6, 7, (40, 3)) + shift, centers])
    tree, brute = both(scene)
    assert_same(tree.closest_points(points, k), brute.closest_points(points, k))


# Instances


def placed_scene(rng, count=14, mirrored=True, thin=1.0):
    """Two objects, placed with shear, mirrors and scales that differ by axis."""
    soup = rng.uniform(-1.0, 1.0, (60, 3))
    objects = [
        rs.Scene.from_arrays(*icosphere(1)),
        rs.Scene.from_arrays(soup + 3.0, np.arange(60).reshape(-1, 3)),
    ]
    transforms = rng.normal(size=(count, 3, 4))
    transforms[:, :, 0] *= thin
    transforms[:, :, 3] = rng.uniform(-8.0, 8.0, (count, 3))
    if not mirrored:
        transforms[np.linalg.det(transforms[:, :, :3]) < 0, :, 0] *= -1
    return rs.Scene.instances(objects, transforms, rng.integers(0, 2, count))


@pytest.mark.parametrize("thin", [1.0, 1e-3, 1e-6])
def test_instances_as_the_oracle_has_them(thin) -> None:
    rng = np.random.default_rng(7)
    scene = placed_scene(rng, thin=thin)
    points = points_near([-9, -9, -9], [9, 9, 9], rng, 300)
    tree, brute = both(scene)
    found = tree.closest_points(points, 4)
    assert_same(found, brute.closest_points(points, 4))
    store = scene.triangles
    numbers = np.arange(store.number_count, dtype=np.int32)
    prim_id, instance_id = store.split_ids(numbers)
    corners = store.points_to_world(store.corners_at(prim_id, instance_id), instance_id)
    expected = point_oracles.distances(points, corners)
    wanted = np.sort(expected, axis=1)[:, :4]
    np.testing.assert_allclose(found.distance, wanted, 1e-12, 1e-12)
    own = store.numbers_of(found.prim_id, found.instance_id)
    chosen = np.take_along_axis(expected, own, axis=1)
    np.testing.assert_allclose(found.distance, chosen, 1e-12, 1e-12)
    gaps = np.linalg.norm(points[:, None] - found.positions, axis=-1)
    np.testing.assert_allclose(gaps, found.distance, 1e-11, 1e-11)


def test_instances_as_their_flattened_scene_has_them() -> None:
    rng = np.random.default_rng(8)
    scene = placed_scene(rng)
    points = points_near([-9, -9, -9], [9, 9, 9], rng, 400)
    found = rs.Tracer(scene).closest_point(points)
    flat = rs.Tracer(scene.flattened()).closest_point(points)
    reach = np.abs(flat.positions).max()
    np.testing.assert_allclose(found.distance, flat.distance, 1e-9, 2.0**-22 * reach)


def test_one_instance_at_rest_has_the_bits_of_its_object() -> None:
    rng = np.random.default_rng(9)
    soup = rng.uniform(-4.0, 4.0, (300, 3)).astype(np.float32)
    scene = rs.Scene.from_arrays(soup, np.arange(300).reshape(-1, 3))
    points = points_near([-4, -4, -4], [4, 4, 4], rng, 300)[40:]
    expected = rs.Tracer(scene).closest_points(points, 3)
    for tracer in both(rs.Scene.instances(scene, [np.eye(3, 4)])):
        assert_same(tracer.closest_points(points, 3), expected)


def test_placed_cubes_by_hand() -> None:
    solid = rs.Scene.from_arrays(*cube())
    transforms = np.zeros((3, 3, 4))
    transforms[0] = np.eye(3, 4)
    transforms[1, :, :3] = np.diag([-1.0, 4.0, 1.0])  # mirrored, and longer
    transforms[1, 0, 3] = 10.0
    transforms[2, :, :3] = np.diag([0.5, 0.5, 0.5])
    transforms[2, 2, 3] = 20.0
    scene = rs.Scene.instances(solid, transforms)
    points = [[0.5, 0.5, 3.0], [7.0, 2.0, 0.5], [9.5, 7.0, 0.5], [0.25, 0.25, 22.0]]
    for tracer in both(scene):
        near = tracer.closest_point(points)
        assert near.distance.tolist() == [2.0, 2.0, 3.0, 1.5]
        assert near.instance_id.tolist() == [0, 1, 1, 2]
        wanted = [[0.5, 0.5, 1.0], [9.0, 2.0, 0.5], [9.5, 4.0, 0.5], [0.25, 0.25, 20.5]]
        assert near.positions.tolist() == wanted
        tracer.update(transforms=transforms + [0.0, 0.0, 0.0, 1.0])
        assert tracer.closest_point([7.0, 2.0, 1.5]).distance.item() == 3.0


@quiet
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 1e5, -1e9]))
def test_trees_of_instances_have_the_bits_of_brute_force(seed, shift) -> None:
    rng = np.random.default_rng(seed)
    scene = placed_scene(rng, int(rng.integers(1, 9)), thin=float(rng.choice([1.0, 1e-4])))
    transforms = np.array(scene.placements.transforms)
    transforms[:, :, 3] = np.round(transforms[:, :, 3] + shift)
    points = rng.uniform(-12.0, 12.0, (60, 3)) + shift
    tree, brute = both(scene)
    for tracer in (tree, brute):
        tracer.update(transforms=transforms)
    assert_same(tree.closest_points(points, 3), brute.closest_points(points, 3))


# Float64


def test_float64_has_the_bits_of_float32_where_nothing_rounds() -> None:
    rng = np.random.default_rng(11)
    soup = rng.integers(-64, 65, (120, 3)) / 16.0
    scene = rs.Scene.from_arrays(soup, np.arange(120).reshape(-1, 3))
    points = np.concatenate([rng.integers(-200, 201, (300, 3)) / 32.0, soup])
    expected = rs.Tracer(scene).closest_points(points, 3)
    for tracer in both(scene, precision="float64"):
        assert_same(tracer.closest_points(points, 3), expected)


def test_float64_tells_what_float32_cannot() -> None:
    """A millimetre at the equator, seen from the Earth's centre."""
    rng = np.random.default_rng(12)
    place = np.array([6.378e6, 1234.5678, -77.7])
    soup = place + rng.uniform(-1.0, 1.0, (60, 3)) * 1e-3
    soup[:3] = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]  # makes the scene large
    faces = np.arange(60).reshape(-1, 3)
    points = np.concatenate([place + rng.uniform(-2e-3, 2e-3, (100, 3)), [[0, 0, 1e-9]]])
    tree, brute = both(rs.Scene.from_arrays(soup, faces), precision="float64")
    found = tree.closest_points(points, 2)
    assert_same(found, brute.closest_points(points, 2))
    exact = [
        [point_oracles.exact_square(point, corners) for corners in soup[faces]] for point in points
    ]
    wanted = np.sort(np.sqrt(np.array(exact, float)), axis=1)[:, :2]
    np.testing.assert_allclose(found.distance, wanted, 1e-13, 0.0)
    assert found.distance[-1, 0] == 1e-9


@quiet
@given(st.integers(0, 2**32 - 1), st.integers(1, 3), st.sampled_from([0.0, 1e6, -1e12]))
def test_float64_trees_have_the_bits_of_brute_force(seed, k, shift) -> None:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 40))
    soup = shift + rng.choice([1.0, 0.1]) * rng.integers(-5, 6, (3 * count, 3))
    scene = rs.Scene.from_arrays(soup, np.arange(3 * count).reshape(-1, 3))
    far = shift + rng.normal(size=(40, 3)) * rng.choice([1.0, 1e9, 1e13])
    points = np.concatenate([far, soup])
    tree, brute = both(scene, precision="float64")
    assert_same(tree.closest_points(points, k), brute.closest_points(points, k))


# Insides


@pytest.mark.parametrize("method", ["rays", "winding"])
def test_insides_of_spheres_and_meshes(method) -> None:
    rng = np.random.default_rng(21)
    centers, radii = rng.uniform(-3.0, 3.0, (40, 3)), rng.uniform(0.2, 1.5, 40)
    vertices, faces = cube()
    scene = rs.Scene.combine(
        [rs.Scene.spheres(centers, radii), rs.Scene.from_arrays(4.0 * vertices - 2.0, faces)]
    )
    points = rng.uniform(-4.0, 4.0, (500, 3))
    gaps = np.linalg.norm(points[:, None] - centers, axis=-1)
    around = (gaps < radii).sum(axis=1) + (np.abs(points) < 2.0).all(axis=1)
    for tracer in both(scene):
        assert (tracer.contains(points, method=method) == (around > 0)).all()
        np.testing.assert_allclose(tracer.winding_number(points), around, 0.0, 1e-12)
        signed = tracer.signed_distance(points, method=method)
        assert ((signed < 0) == (around > 0)).all()
    assert np.isnan(tracer.winding_number([np.nan, 0.0, 0.0]))
    assert abs(tracer.winding_number(centers[0] + [0, 0, 9.0])) < 1e-12


def test_signed_distance_of_one_sphere() -> None:
    tracer = rs.Tracer(rs.Scene.spheres([[1e6, 0, 0]], [2.0]))
    points = [[1e6, 0, 0], [1e6, 1, 0], [1e6, 0, 5], [1e6 - 3, 0, 0]]
    assert tracer.signed_distance(points).tolist() == [-2.0, -1.0, 3.0, 1.0]


def test_spheres_around_points_by_hand() -> None:
    """One inside counts 1, one that the point is on 1/2."""
    scene = rs.Scene.spheres([[0, 0, 0], [1, 0, 0]], [2.0, 1.0])
    points = [[0, 0, 0], [0.5, 0, 0], [2, 0, 0], [9, 9, 9], [1e9, 0, 0]]
    for tracer in both(scene):
        assert tracer.winding_number(points).tolist() == [1.5, 2.0, 1.0, 0.0, 0.0]


def test_height_fields_are_open() -> None:
    tracer = rs.Tracer(rs.Scene.height_field(np.zeros((30, 40))))
    with pytest.raises(ValueError, match="a height field is an open surface"):
        tracer.contains([0.0, 0.0, 1.0])
    assert tracer.winding_number([20.0, 15.0, -1e-9]).round(3).item() == 0.5
    assert not tracer.contains([20.0, 15.0, 5.0], method="winding").item()


@pytest.mark.parametrize("method", ["rays", "winding"])
def test_insides_of_instances_as_flattened(method) -> None:
    rng = np.random.default_rng(22)
    objects = [rs.Scene.from_arrays(*icosphere(1)), rs.Scene.from_arrays(*cube())]
    transforms = rng.normal(size=(20, 3, 4))
    transforms[:, :, 3] *= 2.0
    scene = rs.Scene.instances(objects, transforms, rng.integers(0, 2, 20))
    assert (np.linalg.det(transforms[:, :, :3]) < 0).any()
    points = rng.uniform(-4.0, 4.0, (400, 3))
    tracer, flat = rs.Tracer(scene), rs.Tracer(scene.flattened())
    numbers = flat.winding_number(points)
    np.testing.assert_allclose(tracer.winding_number(points), numbers, 0.0, 1e-4)
    assert set(np.unique(numbers.round(3) + 0.0)) >= {0.0, 1.0, 2.0}
    inside = tracer.contains(points, method=method)
    assert (inside == flat.contains(points, method=method)).all()
    assert (inside == (numbers > 0.5)).all()
    signed, expected = tracer.signed_distance(points), flat.signed_distance(points)
    np.testing.assert_allclose(signed, expected, 0.0, 1e-5)


def test_open_objects_of_instances_are_named() -> None:
    half = rs.Mesh(cube()[0], cube()[1][:-1], name="half")
    scene = rs.Scene.instances([rs.Scene.from_arrays(*cube()), half], [np.eye(3, 4)] * 2, [0, 1])
    tracer = rs.Tracer(scene)
    with pytest.raises(ValueError, match=r"mesh 1 \('half'\) is open"):
        tracer.contains([0.5, 0.5, 0.5])
    assert tracer.contains([[0.5, 0.5, 0.5], [3, 3, 3]], method="winding").tolist() == [True, False]


@pytest.mark.parametrize("method", ["rays", "winding"])
def test_insides_in_float64(method) -> None:
    """A cube of a micrometre, far away."""
    vertices, faces = cube()
    place, size = np.array([5e6, -1e3, 7.0]), 1e-6
    corners = place + size * vertices
    lengths = np.ptp(corners, axis=0)
    rng = np.random.default_rng(23)
    points = corners.min(axis=0) + rng.uniform(-0.5, 1.5, (300, 3)) * lengths
    wanted = ((points > corners.min(axis=0)) & (points < corners.max(axis=0))).all(axis=1)
    open_cube = rs.Tracer(rs.Scene.from_arrays(corners, faces[1:]), precision="float64")
    with pytest.raises(ValueError, match="is open"):
        open_cube.contains(points)
    for tracer in both(rs.Scene.from_arrays(corners, faces), precision="float64"):
        assert (tracer.contains(points, method=method) == wanted).all()
        numbers = tracer.winding_number(points)
        np.testing.assert_allclose(numbers[wanted].min(), 1.0)


def test_instances_from_afar() -> None:
    """Boxes of absent children are infinitely far away, and so is the limit at first."""
    rng = np.random.default_rng(24)
    objects = [rs.Scene.from_arrays(rng.normal(size=(9, 3)), np.arange(9).reshape(-1, 3))]
    transforms = rng.normal(size=(3, 3, 4)) * 0.01
    transforms[:, :, 3] *= 100.0
    scene = rs.Scene.instances(objects, transforms, [0, 0, 0])
    points = rng.normal(size=(200, 3)) * 10.0 ** rng.uniform(2.0, 12.0, (200, 1))
    tree, brute = both(scene)
    assert_same(tree.closest_points(points, 4), brute.closest_points(points, 4))


@pytest.mark.parametrize("structure", ["bvh", "brute"])
def test_invalid_points_are_around_nothing(structure: str) -> None:
    rng = np.random.default_rng(6)
    balls = rs.Scene.spheres(rng.uniform(-2, 2, (20, 3)), 0.5)
    placed = rs.Scene.instances(balls, np.eye(3, 4))
    points = rng.uniform(-2, 2, (60, 3))
    wrong = np.concatenate([points[:3], np.full((4, 3), [[np.nan], [np.inf], [-np.inf], [1e308]])])
    wrong[:3, 1] = np.nan, np.inf, 1e300
    both = np.concatenate([points, wrong])
    for scene in (balls, placed):
        tracer = rs.Tracer(scene, structure)
        numbers = tracer.winding_number(both)
        np.testing.assert_array_equal(numbers[:60], tracer.winding_number(points))
        assert np.isnan(numbers[60:]).all()
        assert numbers[:60].any()
        assert not tracer.contains(both)[60:].any()
