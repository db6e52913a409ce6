"""Thickness and LiDAR in scenes with instances, against plain tracers of the objects."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import raystream as rs
from conftest import assert_same_bits
from instanced import moved, random_rotation, random_transforms
from meshes import cube, icosphere, soup


@cache
def objects() -> list[rs.Scene]:
    """A shell of two meshes, a cube that faces inward, and an open mesh."""
    vertices, faces = icosphere(1)
    shell = rs.Scene([rs.Mesh(vertices, faces), rs.Mesh(0.5 * vertices, faces)])
    corners, sides = cube()
    inward = rs.Scene.from_arrays(corners, sides[:, ::-1])
    return [shell, inward, rs.Scene.from_arrays(*soup(40, seed=3))]


def random_scene(rng, count: int, spread: float = 5.0) -> rs.Scene:
    ids = rng.integers(0, len(objects()), count)
    return rs.Scene.instances(objects(), random_transforms(rng, count, spread), ids)


def rays_of(rng, count: int, spread: float = 5.0):
    origins = rng.uniform(-spread, spread, (count, 3))
    return origins, rng.uniform(-spread, spread, (count, 3)) - origins


COLUMNS = ("ray", "t_entry", "t_exit", "instance_id", "mesh_id", "entry_prim_id", "exit_prim_id")
UNPAIRED = ("ray", "t", "instance_id", "mesh_id", "prim_id", "kind")


def by_objects(scene, origins, directions, **options):
    """Segments and unpaired crossings of every instance alone, by moved rays."""
    segments, unpaired = ([[] for _ in names] for names in (COLUMNS, UNPAIRED))
    tracers = [rs.Tracer(one, "brute") for one in objects()]
    first_prims = np.cumsum([0, *(one.triangle_count for one in objects())])
    first_meshes = np.cumsum([0, *(len(one.meshes) for one in objects())])
    placed = scene.placements
    for k, (object_id, inverse) in enumerate(zip(placed.object_ids, placed.inverses, strict=True)):
        found = rs.thickness(
            tracers[object_id],
            moved(inverse, origins),
            moved(inverse, directions, is_point=False),
            **options,
        )
        prims, meshes = first_prims[object_id], first_meshes[object_id]
        entry, exit_ = (
            np.where(ids < 0, -1, ids + prims) for ids in (found.entry_prim_id, found.exit_prim_id)
        )
        of_instance = np.full(len(found.t_entry), k)
        rows = (found.ray_id, found.t_entry, found.t_exit, of_instance)
        for column, values in zip(
            segments, (*rows, found.mesh_id + meshes, entry, exit_), strict=True
        ):
            column.append(values)
        rows = (found.unpaired_ray, found.unpaired_t, np.full(len(found.unpaired_t), k))
        more = found.unpaired_mesh_id + meshes, found.unpaired_prim_id + prims, found.unpaired_kind
        for column, values in zip(unpaired, (*rows, *more), strict=True):
            column.append(values)
    return sorted_rows(map(np.concatenate, segments)), sorted_rows(map(np.concatenate, unpaired))


def sorted_rows(columns):
    columns = list(columns)
    order = np.lexsort(columns[::-1])
    return [column[order] for column in columns]


def assert_thickness(scene, origins, directions, structure="bvh", **options) -> rs.Thickness:
    found = rs.thickness(rs.Tracer(scene, structure), origins, directions, **options)
    segments, unpaired = by_objects(scene, origins, directions, **options)
    own = sorted_rows([found.ray_id, *(getattr(found, name) for name in COLUMNS[1:])])
    for values, expected in zip(own, segments, strict=True):
        np.testing.assert_array_equal(values, expected)
    own = sorted_rows(getattr(found, f"unpaired_{name}") for name in UNPAIRED)
    for values, expected in zip(own, unpaired, strict=True):
        np.testing.assert_array_equal(values, expected)
    rows = found.ray_id[1:] == found.ray_id[:-1]
    assert (np.diff(found.t_entry)[rows] >= 0.0).all()  # in order of entry
    lengths = np.linalg.norm(np.asarray(directions, float), axis=-1)[found.ray_id]
    np.testing.assert_allclose(
        found.path_length, (found.t_exit.astype(float) - found.t_entry) * lengths, rtol=1e-12
    )
    return found


@pytest.mark.filterwarnings("ignore:thickness. meshes overlap")
@pytest.mark.parametrize("structure", ["bvh", "brute"])
@pytest.mark.parametrize("ends", ["report", "clip"])
def test_every_instance_is_a_solid_of_its_own(structure, ends, rng) -> None:
    scene = random_scene(rng, 40)
    origins, directions = rays_of(rng, 2000)
    limits = {"t_min": rng.uniform(-0.5, 0.5, 2000), "t_max": rng.uniform(0.5, 3.0, 2000)}
    found = assert_thickness(scene, origins, directions, structure, ends=ends, **limits)
    assert len(found.t_entry) > 1000
    assert len(found.unpaired_t) > 100
    assert found.mesh_is_flipped.tolist() == [False, False, True, False]
    assert len(np.unique(found.instance_id)) > 20


@pytest.mark.filterwarnings("ignore:thickness. meshes overlap")
def test_equal_instances_count_twice() -> None:
    scene = rs.Scene.instances(objects()[1], np.tile(np.eye(3, 4), (3, 1, 1)))
    found = rs.thickness(rs.Tracer(scene), [0.2, 0.3, 5.0], [0.0, 0.0, -2.0])
    assert found.instance_id.tolist() == [0, 1, 2]
    assert found.mesh_id.tolist() == [0, 0, 0]
    height = np.ptp(objects()[1].meshes[0].vertices[:, 2])
    assert found.total_length() == pytest.approx(3.0 * height, rel=1e-6)
    assert found.is_complete
    passed = rs.attenuation(found, 0.5)
    assert passed == pytest.approx(np.exp(-1.5 * height), rel=1e-6)


@pytest.mark.filterwarnings("ignore:thickness. meshes overlap")
@given(st.integers(0, 2**20), st.sampled_from([1e-6, 1.0, 1e6]), st.sampled_from([1.0, 1e-4]))
@settings(max_examples=25)
def test_closed_meshes_are_left_as_often_as_entered(seed, size, thinness) -> None:
    """Mirrored, sheared, thin, through their edges and vertices: no crossing is left over."""
    rng = np.random.default_rng(seed)
    transforms = random_transforms(rng, 6, 2.0) * size
    transforms[:, :, :3] = transforms[:, :, :3] @ np.diag([1.0, thinness, 1.0])
    vertices, faces = cube()
    one = rs.Scene.from_arrays(vertices, faces)
    scene = rs.Scene.instances(one, transforms)
    chosen = rng.integers(0, 6, 300)
    corners = vertices[rng.integers(0, len(vertices), 300)].astype(float)
    aims = np.einsum("nij,nj->ni", transforms[chosen, :, :3], corners) + transforms[chosen, :, 3]
    origins = rng.normal(size=(300, 3))
    origins *= (40.0 * size / np.linalg.norm(origins, axis=1))[:, None]
    found = rs.thickness(rs.Tracer(scene), origins, aims - origins)
    assert found.is_complete.all()
    assert found.mesh_is_closed.all()


@pytest.mark.filterwarnings("ignore:thickness. meshes overlap")
def test_thickness_is_that_of_the_flattened_scene(rng) -> None:
    scene = random_scene(rng, 30)
    closed = scene.with_transforms(scene.placements.transforms)
    origins, directions = rays_of(rng, 1500)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    origins -= 40.0 * directions
    placed = rs.thickness(rs.Tracer(closed), origins, directions)
    flat = rs.thickness(rs.Tracer(scene.flattened()), origins, directions)
    differs = np.abs(placed.total_length() - flat.total_length()) > 1e-3
    assert np.count_nonzero(differs) <= 6  # at silhouettes, and edges of open meshes
    assert placed.total_length().max() > 1.0


def test_lidar_returns_are_those_of_the_flattened_scene(rng) -> None:
    named = [
        rs.Scene(one.meshes, materials=[rs.Material(name)])
        for one, name in zip(objects(), "abc", strict=True)
    ]
    transforms = random_transforms(rng, 30, 5.0)
    scene = rs.Scene.instances(named, transforms, np.arange(30) % 3)
    origins, directions = rays_of(rng, 1200)
    options = {
        "reflectance": {"a": 0.9, "b": 0.5, "c": 0.7},
        "transmission": {"a": 0.5, "c": 0.8},
        "threshold": 1e-3,
        "max_returns": 50,
        "separation": 0.01,
    }
    placed = rs.lidar_returns(rs.Tracer(scene), origins, directions, **options)
    # Of the flattened scene the materials are repeated; by number they are the same.
    flat_scene = scene.flattened()
    assert [material.name for material in flat_scene.materials] == ["a", "b", "c"]
    flat = rs.lidar_returns(rs.Tracer(flat_scene), origins, directions, **options)
    same = placed.counts == flat.counts
    assert np.count_nonzero(~same) <= 12  # rays at edges
    a, b = (one.ray_id for one in (placed, flat))
    a, b = same[a], same[b]
    assert np.count_nonzero(a) > 1500
    close = np.abs(placed.ranges[a] - flat.ranges[b]) < 1e-3
    close &= np.abs(placed.intensity[a] - flat.intensity[b]) < 1e-4
    close &= np.abs(placed.incidence_angle[a] - flat.incidence_angle[b]) < 0.05
    assert np.count_nonzero(~close) <= 12
    numbers = scene.triangles.numbers_of(placed.prim_id, placed.instance_id)[a]
    assert np.count_nonzero(numbers != flat.prim_id[b]) <= 12
    np.testing.assert_array_equal(
        placed.material_id, scene.placements.object_ids[placed.instance_id]
    )


def test_a_pulse_meets_a_plate_at_the_angle_of_its_transform(rng) -> None:
    """In closed form: a square turned by 60 degrees, thinned, and moved away by 10."""
    square = rs.Mesh([[-9, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0]], [[0, 1, 2], [0, 2, 3]])
    turned = random_rotation(rng)
    normal = turned[:, 2]
    transform = np.concatenate([turned @ np.diag([2.0, 0.5, -1e-3]), [[0.0]] * 3], axis=1)
    tracer = rs.Tracer(rs.Scene.instances(square, [transform, np.eye(3, 4) + [[0, 0, 0, 90]] * 3]))
    direction = np.cos(np.pi / 3) * normal + np.sin(np.pi / 3) * turned[:, 0]
    found = rs.lidar_returns(tracer, -10.0 * direction, 2.0 * direction, max_returns=1)
    assert found.ranges == pytest.approx([10.0], rel=1e-6)
    assert found.incidence_angle == pytest.approx([60.0], abs=1e-5)
    assert found.intensity == pytest.approx([0.5], rel=1e-6)
    assert found.instance_id.tolist() == [0]


def test_a_sweep_of_instances_that_move(rng) -> None:
    """Each pose is an update of the instances alone; returns know their instance."""
    wall = rs.Mesh([[5, -9, -9], [5, -9, 9], [5, 9, 9], [5, 9, -9]], [[0, 1, 2], [0, 2, 3]])
    start = np.tile(np.eye(3, 4), (2, 1, 1))
    start[1, 0, 3] = 3.0  # hidden by the first
    scene = rs.Scene.instances(wall, start)
    shift = np.array([[0, 0, 0, 10.0], [0] * 4, [0] * 4])
    moving = rs.Animation(lambda t: scene.with_transforms(start + t * shift), (0.0, 1.0), 10.0)
    tracer = rs.Tracer(scene.replace(animation=moving))
    structures = tracer.structure.objects
    still = rs.SensorTrack([0.0, 1.0], [[0, 0, 0], [0, 0, 0]])
    pattern = rs.sweep_patterns.spinning([0.0], rate=10, columns=360)
    cloud = rs.lidar_sweep(tracer, pattern, still, time_steps=360)
    assert len(cloud.ranges) > 50
    assert (cloud.instance_id == 0).all()
    np.testing.assert_allclose(cloud.positions[:, 0], 5.0 + 10.0 * cloud.time, atol=2e-3)
    assert tracer.structure.objects is structures
    static = rs.Tracer(scene)
    once = rs.lidar_sweep(static, pattern, still)
    expected = rs.lidar_returns(static, once.origins, once.directions)
    for name in ("ranges", "prim_id", "instance_id", "intensity"):
        assert_same_bits(getattr(once, name), getattr(expected, name))


def test_worlds_are_asked_for_and_searched() -> None:
    places = np.tile(np.eye(3, 4), (2, 1, 1))
    places[1, 2, 3] = -2.0
    tracer = rs.Tracer(rs.Scene.instances(objects()[1], places, worlds=[0, 1]))
    ray = [0.2, 0.3, 5.0], [0.0, 0.0, -1.0]
    for ask in (rs.thickness, rs.lidar_returns):
        with pytest.raises(ValueError, match="worlds: expected the world of each ray, 0 to 1"):
            ask(tracer, *ray)
    entries = [rs.thickness(tracer, *ray, worlds=k).t_entry for k in range(2)]
    ranges = [rs.lidar_returns(tracer, *ray, worlds=k).ranges for k in range(2)]
    assert len(entries[0]) == len(ranges[0]) == 1
    for near, far in (entries, ranges):
        np.testing.assert_allclose(far, near + 2.0, rtol=1e-6)


def test_empty_scenes() -> None:
    tracer = rs.Tracer(rs.Scene.instances(objects(), [], []))
    found = rs.thickness(tracer, [[0.0, 0, 5]], [0.0, 0, -1])
    assert found.total_length().tolist() == [0.0]
    assert found.mesh_is_closed.tolist() == [True, True, True, False]
    assert len(rs.lidar_returns(tracer, [[0.0, 0, 5]], [0.0, 0, -1]).ranges) == 0
