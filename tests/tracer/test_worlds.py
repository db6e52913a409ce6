"""Queries of scenes whose instances are in worlds: each world is as a scene of its own."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from meshes import cube, icosphere

WORLDS = np.array([0, 2, -1, 2, 0, 3])


def scene_of(rng: np.random.Generator, worlds: object = WORLDS) -> rs.Scene:
    """Closed objects that are turned and scaled, apart from each other."""
    transforms = np.zeros((6, 3, 4))
    for k, transform in enumerate(transforms):
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        transform[:, :3] = turn * rng.uniform(0.5, 1.5)
        transform[:, 3] = 5.0 * k, *rng.uniform(-1.0, 1.0, 2)
    objects = [rs.Scene.from_arrays(*cube()), rs.Scene.from_arrays(*icosphere(1))]
    ids = [0, 1, 1, 0, 1, 0]
    names = list("abcdef")
    return rs.Scene.instances(objects, transforms, ids, worlds=worlds, names=names)


def rows_in(world: int) -> np.ndarray:
    return np.flatnonzero((world == WORLDS) | (WORLDS == -1))


@pytest.fixture
def points(rng: np.random.Generator) -> np.ndarray:
    return rng.uniform([-2, -2, -2], [28, 2, 2], (40, 10, 3))


@pytest.fixture
def worlds(rng: np.random.Generator) -> np.ndarray:
    return rng.integers(-1, 4, (40, 10))


@pytest.mark.parametrize("structure", ["bvh", "brute"])
@pytest.mark.parametrize("k", [None, 3])
def test_closest_points_are_those_of_each_world(rng, points, worlds, structure, k):
    scene = scene_of(rng)
    tracer = rs.Tracer(scene, structure)
    limits = rng.uniform(0.5, 6.0, (40, 10))

    def ask(one, places, **options):
        if k is None:
            return one.closest_point(places, **options)
        return one.closest_points(places, k, **options)

    found = ask(tracer, points, max_distance=limits, worlds=worlds)
    assert 0.1 < found.is_found.mean() < 0.95
    for world in range(-1, 4):
        rows = rows_in(world)
        parts = [scene.placements.object_ids[rows], scene.placements.transforms[rows]]
        plain = rs.Scene.instances(
            [rs.Scene.from_arrays(*cube()), rs.Scene.from_arrays(*icosphere(1))], parts[1], parts[0]
        )
        is_here = worlds == world
        own = ask(rs.Tracer(plain, structure), points[is_here], max_distance=limits[is_here])
        for name in ("distance", "u", "v", "prim_id", "status"):
            np.testing.assert_array_equal(getattr(found, name)[is_here], getattr(own, name))
        np.testing.assert_allclose(found.positions[is_here], own.positions, atol=1e-12)
        ids = np.append(rows, -1)[own.instance_id]
        np.testing.assert_array_equal(found.instance_id[is_here], ids)


def test_inside_is_told_in_each_world(rng):
    scene = scene_of(rng)
    tracer = rs.Tracer(scene)
    places = scene.placements.transforms
    points = np.repeat(places[:, :, :3] @ [0.2, 0.2, 0.2] + places[:, :, 3], 5, axis=0)
    worlds = np.tile(np.arange(-1, 4), 6)
    wanted = np.repeat(WORLDS, 5)
    wanted = (wanted == worlds) | (wanted == -1)
    for method in ("rays", "winding"):
        seen: list[tuple[int, int]] = []
        inside = tracer.contains(
            points, method=method, worlds=worlds, progress=lambda *step, to=seen: to.append(step)
        )
        np.testing.assert_array_equal(inside, wanted)
        assert seen[-1][1] == 30
        assert seen == sorted(seen)
        far = tracer.signed_distance(points, method=method, worlds=worlds)
        np.testing.assert_array_equal(far < 0.0, wanted)
    np.testing.assert_allclose(tracer.winding_number(points, worlds=worlds), wanted, atol=1e-9)


def test_rays_of_analyses_have_worlds(rng, worlds):
    scene = scene_of(rng)
    tracer = rs.Tracer(scene)
    origins = np.column_stack([np.full(400, -9.0), rng.uniform(-1.0, 1.0, (400, 2))])
    ids = worlds.ravel()
    deep = rs.thickness(tracer, origins, [1.0, 0.0, 0.0], worlds=ids)
    echoes = rs.lidar_returns(tracer, origins, [1, 0, 0], transmission=0.5, worlds=ids)
    for world in range(-1, 4):
        some, rows = np.flatnonzero(ids == world), rows_in(world)
        one = tracer.in_world(world)
        own = rs.thickness(one, origins[some], [1.0, 0.0, 0.0])
        np.testing.assert_array_equal(deep.total_length()[some], own.total_length())
        np.testing.assert_array_equal(
            deep.instance_id[np.isin(deep.ray_id, some)], rows[own.instance_id]
        )
        returns = rs.lidar_returns(one, origins[some], [1, 0, 0], transmission=0.5)
        is_here = np.isin(np.repeat(np.arange(400), np.diff(echoes.ray_splits)), some)
        np.testing.assert_array_equal(echoes.ranges[is_here], returns.ranges)
        for ray in some[:5]:
            hit = tracer.cast(origins[ray], (1.0, 0.0, 0.0), world=world)
            assert hit.t == one.cast(origins[ray], (1.0, 0.0, 0.0)).t
            assert (
                hit.instance_id
                == tracer.first_hit(origins[ray], [1, 0, 0], worlds=world).instance_id.item()
            )


def test_a_world_is_a_scene(rng):
    scene = scene_of(rng)
    tracer = rs.Tracer(scene, counters=True)
    one = tracer.in_world(2)
    assert one.is_counting
    assert one.scene.placements.names == ("b", "c", "d")
    assert one.scene.placements.worlds is None
    assert one.structure.objects[0] is tracer.structure.objects[0]
    camera = rs.Camera((10.0, 3.0, 30.0), (10.0, 0.0, 0.0))
    plain = rs.Tracer(scene.in_world(2))
    wanted = rs.visible_faces(plain, camera, (40, 30))
    found = rs.visible_faces(rs.Tracer(scene).in_world(2), camera, (40, 30))
    np.testing.assert_array_equal(found.prim_ids, wanted.prim_ids)
    np.testing.assert_array_equal(found.instance_ids, wanted.instance_ids)
    images = [
        rs.render(it, "raycast", size=(32, 24), camera=camera).pixels
        for it in (plain, rs.Tracer(scene).in_world(2))
    ]
    np.testing.assert_array_equal(*images)
    # An update of the world's tracer leaves the first one alone.
    raised = one.scene.placements.transforms.copy()
    raised[:, 2, 3] += 100.0
    one.update(transforms=raised)
    assert tracer.any_hit([10.0, 0.0, 9.0], [0.0, 0.0, -1.0], worlds=2)
    assert not one.any_hit([10.0, 0.0, 9.0], [0.0, 0.0, -1.0])


def test_wrong_worlds_are_named(rng):
    tracer = rs.Tracer(scene_of(rng))
    for world in (-2, 4):
        with pytest.raises(ValueError, match=f"world: expected -1 to 3, got {world}"):
            tracer.in_world(world)
    for ask in (tracer.closest_point, tracer.contains, tracer.winding_number):
        with pytest.raises(ValueError, match="worlds: expected the world of each ray"):
            ask([[0.0, 0.0, 0.0]])
        with pytest.raises(ValueError, match="worlds"):
            ask([[0.0, 0.0, 0.0]], worlds=[0, 1])
    with pytest.raises(rs.RaystreamError, match=r"in worlds; use in_world of the tracer"):
        rs.render(tracer, size=(8, 8))
    plain = rs.Tracer(scene_of(rng, None))
    with pytest.raises(ValueError, match="world: expected a scene with worlds"):
        plain.in_world(0)
    with pytest.raises(ValueError, match="the scene has no instances"):
        rs.load("cornell").in_world(0)
    with pytest.raises(ValueError, match="worlds: expected None"):
        plain.closest_point([0.0, 0.0, 0.0], worlds=0)


def test_no_points_and_empty_worlds(rng):
    tracer = rs.Tracer(scene_of(rng))
    assert tracer.closest_point(np.zeros((0, 3)), worlds=0).prim_id.shape == (0,)
    assert tracer.contains(np.zeros((2, 0, 3)), worlds=0).shape == (2, 0)
    lone = rs.Tracer(scene_of(rng, [0, 0, 0, 0, 0, 2]))
    found = lone.closest_point([[0.0, 0.0, 0.0]] * 2, worlds=[1, 2])
    assert found.is_found.tolist() == [False, True]
    assert found.instance_id.tolist() == [-1, 5]


@pytest.mark.parametrize("structure", ["bvh", "brute"])
def test_one_world_in_float64(rng, structure):
    scene = scene_of(rng)
    whole = rs.Tracer(scene, structure, precision="float64")
    origins = rng.uniform([-2, -2, -5], [28, 2, -4], (200, 3))
    for world in range(-1, 4):
        tracer = whole.in_world(world)
        plain = rs.Tracer(scene.in_world(world), structure, precision="float64")
        found, expected = (one.first_hit(origins, [0, 0, 1.0]) for one in (tracer, plain))
        for name in ("t", "u", "v", "prim_id", "instance_id", "positions", "normals"):
            np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
        assert found.is_hit.any()
        np.testing.assert_array_equal(
            whole.first_hit(origins, [0, 0, 1.0], worlds=world).t, found.t
        )


@pytest.mark.parametrize("kernel", ["single", "packet", "wavefront"])
def test_instances_in_all_worlds_are_hit_once(rng, kernel):
    scenes = [scene_of(np.random.default_rng(5), worlds) for worlds in (np.full(6, -1), None)]
    origins = rng.uniform([-2, -2, -5], [28, 2, -4], (3000, 3))
    tracer, brute = rs.Tracer(scenes[0], rs.Bvh(kernel=kernel)), rs.Tracer(scenes[1], "brute")
    found = tracer.count_hits(origins, [0, 0, 1.0])
    np.testing.assert_array_equal(found, brute.count_hits(origins, [0, 0, 1.0]))
    assert found.max() == 2
    assert len(tracer.multi_hit(origins, [0, 0, 1.0]).t) == found.sum()
