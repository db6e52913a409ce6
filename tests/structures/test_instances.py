"""Scenes with instances: every query has the bits of plain tracers, asked with moved rays."""

from __future__ import annotations

import copy
import pickle
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import instanced
import raystream as rs
from cases import CASES
from conftest import assert_same_bits
from instanced import COLUMNS, moved, random_transforms
from meshes import cube, icosphere, soup
from raystream.core.instances import Instances
from raystream.geometry.instances.hit_ids import split_numbers
from strategies import COORDINATES, meshes

STRUCTURES = ("bvh", "brute")

#: Kernels for many rays, of first and any hits only; and of all queries.
NEAREST_ONLY = ({"kernel": "groups"},)
MANY = (*NEAREST_ONLY, {"kernel": "packet"}, {"kernel": "wavefront"})

#: Options of tracers that must agree: rays one by one, many at once, and without trees.
TRACERS = ({"kernel": "single"}, *MANY, {"structure": "brute"})


def scene_of(vertices, faces) -> rs.Scene:
    return rs.Scene.from_arrays(vertices, faces)


@cache
def objects() -> list[rs.Scene]:
    return [scene_of(*icosphere(2)), scene_of(*soup(200, seed=3)), scene_of(*cube())]


def random_scene(seed: int, count: int, spread: float = 10.0) -> rs.Scene:
    rng = np.random.default_rng(seed)
    ids = rng.integers(0, len(objects()), count)
    return rs.Scene.instances(objects(), random_transforms(rng, count, spread), ids)


def random_rays(seed: int, count: int, spread: float = 10.0) -> dict:
    rng = np.random.default_rng(seed)
    origins = rng.uniform(-2.0 * spread, 2.0 * spread, (count, 3))
    directions = rng.uniform(-spread, spread, (count, 3)) - origins
    t_min = np.where(rng.random(count) < 0.5, 0.0, rng.uniform(-0.5, 1.0, count))
    t_max = np.where(rng.random(count) < 0.5, np.inf, rng.uniform(0.5, 3.0, count))
    limits = {"t_min": t_min.astype(np.float32), "t_max": t_max.astype(np.float32)}
    return {"origins": origins, "directions": directions, **limits}


def assert_agrees(scene: rs.Scene, parts: list[rs.Scene], rays) -> int:
    """All queries of all kernels agree with the oracle; returns the number of hits."""
    expected = {
        crossings: instanced.all_hits(scene, parts, rays, crossings)
        for crossings in ("triangles", "surfaces")
    }
    splits, columns = expected["triangles"]
    first = instanced.nearest(splits, columns)
    for options in TRACERS:
        tracer = rs.Tracer(scene, **options)
        hits = tracer.first_hit(**rays)
        for name in COLUMNS:
            assert_same_bits(getattr(hits, name), first[name])
        assert_same_bits(tracer.any_hit(**rays), splits[1:] > splits[:-1])
        if options in NEAREST_ONLY:
            continue
        for crossings, (all_splits, all_columns) in expected.items():
            counts = tracer.count_hits(**rays, crossings=crossings)
            assert_same_bits(counts, np.diff(all_splits))
            for limit in (None, 1, 3):
                many = tracer.multi_hit(**rays, crossings=crossings, max_hits=limit)
                most = limit or len(all_columns["t"])
                wanted_splits, wanted = instanced.kept(all_splits, all_columns, most)
                assert_same_bits(many.ray_splits, wanted_splits)
                for name in COLUMNS:
                    assert_same_bits(getattr(many, name), wanted[name])
    return len(columns["t"])


def test_random_instances_agree_with_tracers_of_the_objects() -> None:
    assert assert_agrees(random_scene(1, 40), objects(), random_rays(2, 3000)) > 3000


@pytest.mark.exhaustive
@pytest.mark.parametrize("seed", range(4))
def test_a_million_queries_agree(seed) -> None:
    scene, rays = random_scene(seed, 200, 20.0), random_rays(seed + 9, 25_000, 20.0)
    assert assert_agrees(scene, objects(), rays) > 25_000


def varied_rays(seed: int, count: int, spread: float) -> dict:
    """Rays near and far, with directions of any length, in tiles that share an origin, and lone."""
    rng = np.random.default_rng(seed)
    rays = random_rays(seed, count, spread)
    origins, aims = rays["origins"], rays["origins"] + rays["directions"]
    origins[: count // 4] = origins[0]
    origins[count // 4 : count // 2] *= 10.0 ** rng.uniform(0.0, 6.0, (count // 4, 1))
    aims[: count // 8] = aims[0] + 0.05 * spread * rng.normal(size=(count // 8, 3))
    rays["directions"] = aims - origins
    lengths = 10.0 ** rng.uniform(-18.0, 18.0, (count // 8, 1))
    rays["directions"][-(count // 8) :] *= lengths
    rays["t_max"][-(count // 8) :] = np.inf
    return rays


def assert_varied_rays_agree(scene: rs.Scene, rays) -> int:
    """All kernels have the oracle's hits; returns the number of rays that hit."""
    splits, columns = instanced.all_hits(scene, objects(), rays)
    first = instanced.nearest(splits, columns)
    for options in TRACERS:
        tracer = rs.Tracer(scene, **options)
        hits = tracer.first_hit(**rays)
        for name in COLUMNS:
            assert_same_bits(getattr(hits, name), first[name])
        assert_same_bits(tracer.any_hit(**rays), splits[1:] > splits[:-1])
        if options in ({"kernel": "packet"}, {"kernel": "wavefront"}):
            assert_same_bits(tracer.count_hits(**rays), np.diff(splits))
            many = tracer.multi_hit(**rays)
            assert_same_bits(many.ray_splits, splits)
            for name in COLUMNS:
                assert_same_bits(getattr(many, name), columns[name])
    return int(np.count_nonzero(first["prim_id"] >= 0))


def test_varied_rays_agree() -> None:
    scene = random_scene(61, 12)
    assert assert_varied_rays_agree(scene, varied_rays(62, 8192, 10.0)) > 500


@pytest.mark.exhaustive
@pytest.mark.parametrize("seed", range(8))
def test_a_million_varied_rays_agree(seed) -> None:
    scene = random_scene(seed + 71, 12)
    assert assert_varied_rays_agree(scene, varied_rays(seed + 81, 1 << 17, 10.0)) > 1 << 12


def test_batches_are_traced_by_any_kernel() -> None:
    """Large ones race; images, lists of their rows and single rays have the same hits."""
    scene = random_scene(63, 60)
    rays = varied_rays(64, 1 << 17, 10.0)
    camera = rs.Camera((0.0, 0.0, 30.0), (0.0, 0.0, 0.0))
    origins, directions = camera.rays(320, 256)
    expected = rs.Tracer(scene, kernel="single")
    reported: list[tuple[int, int]] = []
    for one in (
        rays,
        {"origins": origins, "directions": directions},
        {"origins": origins.reshape(-1, 3), "directions": directions.reshape(-1, 3)},
        {"origins": origins[0, 0], "directions": directions[90:160, 100:201], "t_max": 31.0},
    ):
        wanted, seen = expected.first_hit(**one), expected.any_hit(**one)
        for kernel in ("auto", "auto", "groups", "packet", "wavefront"):
            tracer = rs.Tracer(scene, kernel=kernel)
            for _ in range(2):
                hits = tracer.first_hit(**one, progress=lambda *done: reported.append(done))
                for name in (*COLUMNS, "status"):
                    assert_same_bits(getattr(hits, name), getattr(wanted, name))
                assert_same_bits(tracer.any_hit(**one), seen)
            assert reported[-1] == (seen.size, seen.size)
        assert seen.any()
        assert not seen.all()


@pytest.mark.parametrize("options", MANY)
def test_invalid_rays_are_named_by_kernels_for_many(options) -> None:
    scene = random_scene(65, 20)
    rays = random_rays(66, 4000)
    directions, origins = rays["directions"], rays["origins"]
    directions[::7] = np.nan
    directions[1::7] *= 1e160
    directions[2::7] = 0.0
    origins[3::7] = np.inf
    directions[4::7] *= 1e-160
    tracers = rs.Tracer(scene, kernel="single"), rs.Tracer(scene, **options)
    for t_max in (np.inf, 2.0):  # with a limit, long ones cannot reach the scene
        wanted, hits = (one.first_hit(origins, directions, t_max=t_max) for one in tracers)
        for name in (*COLUMNS, "status"):
            assert_same_bits(getattr(hits, name), getattr(wanted, name))
        assert (hits.status.reshape(-1)[1::7] == 1).all()
        assert (hits.status.reshape(-1)[5::7] == 0).all()
        wanted, hits = (one.multi_hit(origins, directions, t_max=t_max) for one in tracers)
        for name in (*COLUMNS, "ray_splits", "status"):
            assert_same_bits(getattr(hits, name), getattr(wanted, name))


@pytest.mark.parametrize("name", CASES)
def test_hard_cases_agree_wherever_they_are_placed(name) -> None:
    """Rays on edges, at limits, far away, of any length: moved along with the instances."""
    rng = np.random.default_rng(2013)
    case = CASES[name](rng)
    size = float(np.ptp(case.vertices[np.isfinite(case.vertices).all(axis=1)], axis=0).max())
    transforms = random_transforms(rng, 3, 2.0 * size)
    transforms[0] = np.eye(3, 4)
    scene = rs.Scene.instances(case.scene, transforms)
    t_min, t_max = case.limits()
    for transform in transforms[: 2 if len(case.faces) > 300 else 3]:
        rays = {
            "origins": moved(transform, case.origins),
            "directions": moved(transform, case.directions, is_point=False),
            "t_min": t_min,
            "t_max": t_max,
        }
        assert_agrees(scene, [case.scene], rays)


@st.composite
def instances_and_rays(draw):
    """A mesh, up to five transforms of any size, two of them equal, and rays at its vertices.

    Some are thin: one axis is scaled by a thousandth or a millionth.
    """
    (vertices, faces), scale, offset = draw(meshes())
    count = draw(st.integers(1, 5))
    rng = np.random.default_rng(draw(st.integers(0, 2**16)))
    sizes = draw(st.lists(st.sampled_from([1.0, 1e-6, 1e6, -1.0]), min_size=count, max_size=count))
    transforms = random_transforms(rng, count, abs(scale))
    linear = np.eye(3) if draw(st.booleans()) else transforms[:, :, :3].copy()
    thin = draw(st.sampled_from([1.0, 1e-3, 1e-6]))
    transforms[:, :, :3] = linear * np.array(sizes)[:, None, None] * [1.0, thin, 1.0]
    transforms[-1] = transforms[0]
    rows = st.lists(COORDINATES, min_size=3, max_size=3)
    origins = np.array(draw(st.lists(rows, min_size=4, max_size=4))) * scale + offset
    directions = np.array(draw(st.lists(rows, min_size=4, max_size=4)))
    if draw(st.booleans()):
        directions = vertices[np.arange(4) % len(vertices)] - origins
    return scene_of(vertices, faces), transforms, origins, directions


@given(instances_and_rays())
@settings(max_examples=60)
def test_any_instances_agree(case) -> None:
    one, transforms, origins, directions = case
    rays = {
        "origins": moved(transforms[0], origins),
        "directions": moved(transforms[0], directions, is_point=False),
        "t_min": np.zeros(4, np.float32),
        "t_max": np.full(4, np.inf, np.float32),
    }
    assert_agrees(rs.Scene.instances(one, transforms), [one], rays)


def test_ids_of_many_hits_are_split_as_those_of_few() -> None:
    """By a kernel; with objects that have no triangles, before, between and behind others."""
    empty = rs.Scene.from_arrays(np.zeros((0, 3)), np.zeros((0, 3), int))
    ids = [0, 1, 0, 0, 2, 1, 2, 0]
    places = random_transforms(np.random.default_rng(5), len(ids))
    scene = rs.Scene.instances([empty, *objects()[:2]], places, ids)
    triangles = rs.Tracer(scene).structure.triangles
    total = int(triangles.first_ids[-1])
    rng = np.random.default_rng(6)
    numbers = rng.integers(-1, total, 1 << 15).astype(np.int32)
    numbers[1 << 14 :].sort()
    numbers[:4] = -1, 0, total - 1, -1
    expected = triangles.split_ids(numbers)
    for one, wanted in zip(split_numbers(triangles, numbers), expected, strict=True):
        assert_same_bits(one, wanted)
    instance_id = np.searchsorted(triangles.first_ids, numbers, side="right") - 1
    assert_same_bits(expected[1], instance_id.astype(np.int32))


def test_equal_distances_go_to_the_first_instance() -> None:
    one = scene_of(*cube())
    scene = rs.Scene.instances([one, one], np.tile(np.eye(3, 4), (3, 1, 1)), [1, 0, 1])
    for structure in STRUCTURES:
        tracer = rs.Tracer(scene, structure)
        hits = tracer.first_hit([0.2, 0.3, 5.0], [0.0, 0.0, -1.0])
        assert hits.instance_id == 0
        assert hits.prim_id >= one.triangle_count  # of the second object
        many = tracer.multi_hit([[0.2, 0.3, 5.0]], [0.0, 0.0, -1.0])
        assert many.instance_id.tolist() == [0, 1, 2, 0, 1, 2]


def test_hits_are_where_the_flattened_scene_has_them() -> None:
    """An oracle in world space, within what float32 leaves of it."""
    scene, rays = random_scene(5, 30), random_rays(6, 4000)
    hits = rs.Tracer(scene).first_hit(**rays)
    flat = rs.Tracer(scene.flattened()).first_hit(**rays)
    is_close = np.isclose(hits.t, flat.t, rtol=1e-4, atol=1e-5) | (hits.t == flat.t)
    assert np.count_nonzero(~is_close) <= 4  # rays at an edge
    is_same = is_close & hits.is_hit & flat.is_hit
    assert np.count_nonzero(is_same) > 900
    a, b = hits[is_same], flat[is_same]
    np.testing.assert_allclose(a.positions, b.positions, atol=2e-4)
    dots = np.einsum("ij,ij->i", a.normals, b.normals)
    assert np.count_nonzero(dots < 0.999) <= 4  # at an edge: the other triangle
    numbers = scene.triangles.first_ids[a.instance_id] + a.mesh_prim_id
    assert np.count_nonzero(numbers != b.prim_id) <= 4


def test_normals_of_mirror_images_point_outwards() -> None:
    one = scene_of(*icosphere(2))
    mirror = np.diag([1.0, 1.0, -1.0]) @ np.eye(3, 4)
    scene = rs.Scene.instances(one, [np.eye(3, 4), mirror + [[0, 0, 0, 5], [0] * 4, [0] * 4]])
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(200, 3))
    for center in ([0.0, 0.0, 0.0], [5.0, 0.0, 0.0]):
        for some in (scene, scene.flattened()):
            hits = rs.Tracer(some).first_hit(center, directions)
            assert hits.is_hit.all()
            assert (np.einsum("ij,ij->i", hits.normals, directions) > 0.0).all()
            assert (np.einsum("ij,ij->i", hits.shading_normals, directions) > 0.0).all()


@pytest.mark.parametrize("offset", [0.0, 1e5])
def test_rays_leave_surfaces(offset) -> None:
    scene = random_scene(7, 30)
    scene = scene.with_transforms(scene.placements.transforms + [0.0, 0.0, 0.0, offset])
    tracer, rays = rs.Tracer(scene), random_rays(8, 4000)
    rays["origins"] += offset
    hits = tracer.first_hit(rays["origins"], rays["directions"])
    hits = hits[hits.is_hit]
    assert len(hits.t) > 1000
    directions = np.random.default_rng(1).normal(size=(len(hits.t), 3))
    again = tracer.multi_hit(*hits.spawn(directions))
    same = (again.prim_id == hits.prim_id[again.ray_id]) & (
        again.instance_id == hits.instance_id[again.ray_id]
    )
    assert not same.any()


def test_instances_of_instances() -> None:
    rng = np.random.default_rng(11)
    inner = rs.Scene.instances(objects()[0], random_transforms(rng, 4))
    outer = random_transforms(rng, 3)
    scene = rs.Scene.instances([objects()[2], inner], outer, [1, 0, 1])
    assert len(scene.placements) == 9
    assert scene.placements.object_ids.tolist() == [1] * 4 + [0] + [1] * 4
    for k, matrix in enumerate(inner.placements.transforms):
        product = np.vstack([outer[2], [0, 0, 0, 1]]) @ np.vstack([matrix, [0, 0, 0, 1]])
        np.testing.assert_allclose(scene.placements.transforms[5 + k], product[:3], rtol=1e-12)
    assert_agrees(scene, [objects()[2], objects()[0]], random_rays(12, 1000))


def test_update_moves_instances() -> None:
    scene, rays = random_scene(13, 50), random_rays(14, 1000)
    tracer = rs.Tracer(scene)
    structures = tracer.structure.objects
    elsewhere = random_transforms(np.random.default_rng(15), 50)
    tracer.first_hit(**rays)
    report = tracer.update(transforms=elsewhere)
    assert report.rebuilt
    assert tracer.structure.objects is structures
    assert_same_bits(tracer.scene.placements.transforms, elsewhere)
    fresh = rs.Tracer(scene.with_transforms(elsewhere)).first_hit(**rays)
    for name in COLUMNS:
        assert_same_bits(getattr(tracer.first_hit(**rays), name), getattr(fresh, name))
    tracer.update(scene)
    before = rs.Tracer(scene).first_hit(**rays)
    assert_same_bits(tracer.first_hit(**rays).t, before.t)


@pytest.mark.parametrize("offset", [(1e5, 5e4, 0.0), (5e6, 0.0, 0.0), (0.0, -3e4, 2e9)])
def test_instances_that_move_far_are_hit_as_in_a_new_tracer(offset) -> None:
    scene, rays = random_scene(13, 50), random_rays(14, 1000)
    places = scene.placements.transforms
    tracer = rs.Tracer(scene)
    before = tracer.first_hit(**rays)
    away = places.copy()
    away[:, :, 3] += offset
    tracer.update(transforms=away)
    rays["origins"] = rays["origins"] + offset
    fresh = rs.Tracer(scene.with_transforms(away), "brute").first_hit(**rays)
    after = tracer.first_hit(**rays)
    for name in COLUMNS:
        assert_same_bits(getattr(after, name), getattr(fresh, name))
    assert (after.prim_id == before.prim_id).mean() > 0.99
    tracer.update(transforms=places)
    rays["origins"] = random_rays(14, 1000)["origins"]
    assert_same_bits(tracer.first_hit(**rays).t, before.t)


def test_rays_meet_the_instances_of_their_world() -> None:
    rng = np.random.default_rng(21)
    count, world_count = 300, 20
    transforms = random_transforms(rng, count, 6.0)
    ids = rng.integers(0, len(objects()), count)
    # Worlds of one instance, of hundreds, and without any; some instances are in all worlds.
    worlds = np.minimum(rng.geometric(0.3, count) - 1, world_count - 1)
    worlds[rng.random(count) < 0.02] = -1
    worlds[worlds == 5] = 6
    worlds[0] = world_count - 1
    scene = rs.Scene.instances(objects(), transforms, ids, worlds=worlds)
    rays = random_rays(22, 3000, 6.0)
    of_rays = rng.integers(-1, world_count, 3000)
    for structure in STRUCTURES:
        tracer = rs.Tracer(scene, structure)
        hits = tracer.first_hit(**rays, worlds=of_rays)
        seen = tracer.any_hit(**rays, worlds=of_rays)
        many = tracer.multi_hit(**rays, worlds=of_rays)
        counts = tracer.count_hits(**rays, worlds=of_rays)
        for world in range(-1, world_count):
            chosen = np.flatnonzero((worlds == world) | (worlds == -1))
            asked = np.flatnonzero(of_rays == world)
            alone = rs.Scene.instances(objects(), transforms[chosen], ids[chosen])
            one = rs.Tracer(alone, "brute")
            own = {name: values[asked] for name, values in rays.items()}
            expected = one.first_hit(**own)
            found = hits[asked]
            for name in ("t", "u", "v", "prim_id"):
                assert_same_bits(getattr(found, name), getattr(expected, name))
            numbers = np.append(chosen, -1)[expected.instance_id]
            np.testing.assert_array_equal(found.instance_id, numbers)
            assert_same_bits(seen[asked], expected.is_hit)
            assert_same_bits(counts[asked], one.count_hits(**own))
            all_of = one.multi_hit(**own)
            rows = np.isin(many.ray_id, asked)
            assert_same_bits(many.t[rows], all_of.t)
            np.testing.assert_array_equal(many.instance_id[rows], chosen[all_of.instance_id])


@pytest.mark.ci
def test_many_small_worlds_are_built_at_once() -> None:
    rng = np.random.default_rng(23)
    worlds = np.repeat(np.arange(4000), 9)
    transforms = random_transforms(rng, len(worlds), 3.0)
    scene = rs.Scene.instances(objects()[2], transforms, worlds=worlds)
    tracer = rs.Tracer(scene)
    rays = random_rays(24, 4000, 3.0)
    hits = tracer.first_hit(**rays, worlds=np.arange(4000))
    assert hits.is_hit.mean() > 0.3
    assert_same_bits(worlds[hits.instance_id[hits.is_hit]], np.flatnonzero(hits.is_hit))
    brute = rs.Tracer(scene, "brute")
    some = {name: values[:40] for name, values in rays.items()}
    expected = brute.first_hit(**some, worlds=np.arange(40))
    assert_same_bits(hits[:40].t, expected.t)
    assert_same_bits(hits[:40].instance_id, expected.instance_id)


def test_bad_worlds_are_named() -> None:
    one, eye = objects()[2], np.eye(3, 4)
    ray = ([0.0, 0, 5], [0.0, 0, -1])
    for worlds, message in (([-2], "worlds: expected -1 or more, got -2"), ([2**30], "less than")):
        with pytest.raises(ValueError, match=message):
            rs.Scene.instances(one, [eye], worlds=worlds)
    with pytest.raises(TypeError, match="worlds: expected integers"):
        rs.Scene.instances(one, [eye], worlds=[0.5])
    scene = rs.Scene.instances(one, [eye, eye], worlds=[0, 1])
    tracer = rs.Tracer(scene)
    with pytest.raises(ValueError, match="worlds: expected the world of each ray, 0 to 1"):
        tracer.first_hit(*ray)
    with pytest.raises(ValueError, match="worlds: expected the world of each ray"):
        tracer.cast(*ray)
    with pytest.raises(ValueError, match="worlds: expected -1 to 1"):
        tracer.any_hit(*ray, worlds=2)
    with pytest.raises(ValueError, match="worlds: shape"):
        tracer.any_hit(*ray, worlds=[0, 1])
    with pytest.raises(TypeError, match="worlds: expected integers"):
        tracer.any_hit(*ray, worlds=0.5)
    with pytest.raises(ValueError, match="worlds: expected None"):
        rs.Tracer(one).first_hit(*ray, worlds=0)
    with pytest.raises(ValueError, match="instances are in worlds"):
        scene.flattened()
    with pytest.raises(ValueError, match="whose instances are in worlds"):
        rs.Scene.instances(scene, [eye])
    moved = scene.with_transforms(np.tile(eye, (2, 1, 1)) + [0, 0, 0, 1.0])
    assert moved.placements.world_count == 2


def test_one_ray_copies_and_counters() -> None:
    scene, rays = random_scene(16, 30), random_rays(17, 100)
    tracer = rs.Tracer(scene)
    hits = tracer.first_hit(rays["origins"], rays["directions"])
    for i in range(100):
        hit = tracer.cast(rays["origins"][i], rays["directions"][i])
        assert (hit.t, hit.prim_id, hit.instance_id) == (
            hits.t[i],
            hits.prim_id[i],
            hits.instance_id[i],
        )
        np.testing.assert_array_equal(hit.position, hits.positions[i])
    for other in (copy.copy(tracer), pickle.loads(pickle.dumps(tracer))):
        assert_same_bits(other.first_hit(rays["origins"], rays["directions"]).t, hits.t)
    counting = rs.Tracer(scene, counters=True)
    counted = counting.first_hit(rays["origins"], rays["directions"])
    assert_same_bits(counted.instance_id, hits.instance_id)
    assert counting.counters.tests[hits.is_hit].min() > 0
    cast = counting.cast(rays["origins"][0], rays["directions"][0])
    assert cast.instance_id == hits.instance_id[0]


def test_shapes_and_misses() -> None:
    tracer = rs.Tracer(random_scene(18, 10))
    hits = tracer.first_hit(np.full((2, 3, 3), 1e6), [1.0, 0.0, 0.0])
    assert hits.instance_id.shape == (2, 3)
    assert (hits.instance_id == -1).all()
    assert np.isnan(hits.positions).all()
    assert np.isnan(hits.normals).all()
    assert hits.ravel()[:2].instance_id.tolist() == [-1, -1]
    bad = tracer.first_hit([np.nan, 0, 0], [1.0, 0, 0])
    assert bad.status == rs.RayStatus.INVALID
    for length in (1e-200, 1e200):
        assert tracer.first_hit([0.0, 0, 0], [length, 0, 0]).status == rs.RayStatus.INVALID
    one = rs.Tracer(objects()[0]).first_hit([0.0, 0, 0], [1.0, 0, 0])
    assert one.instance_id == 0


def test_a_scene_without_instances_is_empty() -> None:
    for transforms in ([], np.zeros((0, 3, 4))):
        scene = rs.Scene.instances(objects(), transforms, [])
        for structure in STRUCTURES:
            assert not rs.Tracer(scene, structure).any_hit([0.0, 0, 0], [1.0, 0, 0])
    nothing = scene_of([[0, 0, 0]], [[0, 0, 0]])  # no triangle that can be hit
    scene = rs.Scene.instances([nothing, objects()[2]], [np.eye(3, 4)] * 2, [0, 1])
    hits = rs.Tracer(scene).first_hit([0.2, 0.3, 5.0], [0.0, 0.0, -1.0])
    assert (hits.instance_id, hits.mesh_id) == (1, 1)


def test_materials_and_meshes_of_objects() -> None:
    red, grey = rs.Material(diffuse=(1, 0, 0)), rs.Material(name="grey")
    mesh = rs.Mesh(*cube(), material_ids=0)
    scene = rs.Scene.instances(
        [mesh, rs.load("cornell")], [np.eye(3, 4)] * 2, [1, 0], materials=[red, grey]
    )
    assert scene.materials[:2] == (red, grey)
    assert scene.materials[2:] == rs.load("cornell").materials
    cornell = rs.load("cornell")
    plain = rs.Tracer(cornell).first_hit([278.0, 273.0, -800.0], [0.0, 0.0, 1.0])
    hits = rs.Tracer(scene).first_hit([278.0, 273.0, -800.0], [0.0, 0.0, 1.0])
    assert hits.material_id == plain.material_id + 2
    assert hits.mesh_id == plain.mesh_id + 1
    assert hits.mesh_prim_id == plain.mesh_prim_id


def test_memory_grows_with_the_objects() -> None:
    one = scene_of(*icosphere(5))
    places = np.tile(np.eye(3, 4), (1000, 1, 1))
    places[:, 0, 3] = np.arange(1000.0)
    tracer = rs.Tracer(rs.Scene.instances(one, places))
    alone = rs.Tracer(one).structure.report.byte_count
    assert tracer.structure.report.byte_count < alone + 300 * 1000


@pytest.mark.ci
def test_bad_instances_are_named() -> None:
    one = objects()[0]
    eye = np.eye(3, 4)
    for transforms, ids, message in (
        (np.eye(4), None, r"transforms: expected shape \(K, 3, 4\), got \(4, 4\)"),
        (np.eye(4)[None], None, r"transforms: expected shape \(K, 3, 4\); for 4 x 4"),
        ([eye, np.zeros((3, 4))], None, "transforms: transform 1 is singular"),
        ([eye * np.nan], None, "transforms: transform 0 is not finite"),
        ([eye * 1e70], None, "transforms: transform 0 is not finite, or beyond"),
        ([eye], [1], "object_ids: expected 0 to 0, got 1 to 1"),
        ([eye], [0, 0], "object_ids: expected one for each of 1 transforms"),
    ):
        with pytest.raises(ValueError, match=message):
            rs.Scene.instances(one, transforms, ids)
    with pytest.raises(ValueError, match="object_ids: expected the object of each"):
        rs.Scene.instances([one, one], [eye])
    with pytest.raises(TypeError, match=r"objects\[0\]: expected a Mesh, a Scene or .* got int"):
        rs.Scene.instances([3], [eye])
    with pytest.raises(TypeError, match="object_ids: expected integers"):
        rs.Scene.instances(one, [eye], [0.5])
    large = scene_of(*icosphere(6))
    many = rs.Scene.instances(large, np.tile(eye, (2**31 // large.triangle_count + 1, 1, 1)))
    with pytest.raises(ValueError, match="triangles in all instances are more than"):
        rs.Tracer(many)
    with pytest.raises(ValueError, match="has no instances"):
        one.with_transforms([eye])
    scene = rs.Scene.instances(one, [eye])
    with pytest.raises(
        ValueError, match=r"expected shape \(1, 3, 4\), one for each instance as before"
    ):
        scene.with_transforms([eye, eye])
    with pytest.raises(ValueError, match="meshes: fixed in a scene with instances"):
        scene.replace(meshes=one.meshes * 2)
    tracer = rs.Tracer(scene)
    with pytest.raises(ValueError, match="either vertices or transforms"):
        tracer.update()
    with pytest.raises(ValueError, match="by transforms="):
        tracer.update(one.meshes[0].vertices)
    with pytest.raises(ValueError, match="objects differ"):
        tracer.update(rs.Scene.instances(objects()[2], [eye]))


def test_what_is_not_supported_says_so() -> None:
    scene = rs.Scene.instances(objects()[2], [np.eye(3, 4)])
    for options in ({"structure": "grid"}, {"machine": "multipass"}):
        with pytest.raises(ValueError, match=r"scene.flattened\(\)"):
            rs.Tracer(scene, **options)


@pytest.mark.parametrize("thinness", [1e-3, 1e-6, 1e-8])
def test_needles_and_plates_agree(thinness) -> None:
    """Transforms that nearly flatten their objects, turned before and after."""
    rng = np.random.default_rng(31)
    transforms = np.zeros((12, 3, 4))
    for transform in transforms:
        scales = np.where(rng.random(3) < 0.5, 1.0, thinness)
        turns = instanced.random_rotation(rng), instanced.random_rotation(rng)
        transform[:, :3] = turns[0] @ np.diag(scales) @ turns[1]
        transform[:, 3] = rng.uniform(-2.0, 2.0, 3)
        product = transform[:, :3] @ Instances([0], [transform]).inverses[0, :, :3]
        assert np.abs(product - np.eye(3)).max() < 1e-15 / thinness + 1e-12
    scene = rs.Scene.instances(objects()[2], transforms)
    rays = random_rays(32, 4000, 2.0)
    # To points of the instances, which rays at random hardly meet.
    points = moved(np.eye(3, 4), rng.uniform(-0.5, 0.5, (4000, 3)))
    chosen = rng.integers(0, 12, 4000)
    aims = np.einsum("kij,kj->ki", transforms[chosen, :, :3], points) + transforms[chosen, :, 3]
    rays["directions"] = aims - rays["origins"]
    assert assert_agrees(scene, [objects()[2]], rays) > 1000
    tracer = rs.Tracer(scene)
    hits = tracer.first_hit(rays["origins"], rays["directions"])
    hits = hits[hits.is_hit]
    again = tracer.multi_hit(*hits.spawn(rng.normal(size=(len(hits.t), 3))))
    rows = again.ray_id
    is_same = again.prim_id == hits.prim_id[rows]
    assert not (is_same & (again.instance_id == hits.instance_id[rows])).any()


def test_far_and_tiny_scenes_do_not_overflow() -> None:
    triangle = scene_of([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    plain = rs.Tracer(triangle)
    for scale, distance in ((1.0, 1e39), (1e-30, 1e9), (1e-30, 1e11), (1e30, 1e39)):
        scene = rs.Scene.instances(triangle, [np.eye(3, 4) * scale])
        ray = ([0.2 * scale, 0.2 * scale, distance], [0.0, 0.0, -1.0])
        for structure in STRUCTURES:
            hit = rs.Tracer(scene, structure).first_hit(*ray)
            expected = plain.first_hit([0.2, 0.2, distance / scale], [0.0, 0.0, -1.0 / scale])
            assert_same_bits(hit.t, expected.t)


def test_distances_that_are_reported_as_one() -> None:
    """So short, long or denormal that they round to the same number: the ids decide."""
    one = objects()[2]
    places = np.tile(np.eye(3, 4), (6, 1, 1))
    places[:, 2, 3] = [0.0, 1.0, 2.0, -1.0, 3.0, -2.0]
    scene = rs.Scene.instances(one, places)
    ray = {"origins": np.array([[0.2, 0.3, 9.0]])}
    limits = {"t_min": np.zeros(1, np.float32), "t_max": np.full(1, np.inf, np.float32)}
    for length in (1e50, 1e38, 1e-39, 1e-44, 1e-60):
        direction = np.array([[0.0, 0.0, -length]])
        assert_agrees(scene, [one], {**ray, "directions": direction, **limits})


def test_no_hits_have_attributes() -> None:
    tracer = rs.Tracer(random_scene(33, 4))
    none = tracer.first_hit(np.zeros((0, 3)), np.zeros((0, 3)))
    away = tracer.multi_hit([[1e5, 0.0, 0.0]], [1.0, 0.0, 0.0])
    for hits in (none, away):
        for name in ("positions", "normals", "shading_normals", "texcoords", "material_id"):
            assert len(getattr(hits, name)) == 0
    assert len(none.spawn(np.zeros((0, 3)))[0]) == 0


def test_scenes_with_the_same_objects_are_updates() -> None:
    one, other = objects()[2], objects()[0]
    poses = [random_transforms(np.random.default_rng(k), 3) for k in range(3)]
    first = rs.Scene.instances(one, poses[0])
    frames = [first.with_transforms(pose) for pose in poses]  # before triangles are made
    tracer = rs.Tracer(first)
    for frame in (*frames, rs.Scene.instances(one, poses[1])):
        tracer.update(frame)
        assert tracer.scene.placements is frame.placements
    with pytest.raises(ValueError, match="objects differ"):
        tracer.update(rs.Scene.instances([one, other], poses[0], [0, 0, 0]))
    with pytest.raises(ValueError, match="the scene has instances"):
        rs.Tracer(one).update(first)
    twin = copy.copy(tracer)
    assert twin.structure.objects[0] is tracer.structure.objects[0]


def test_materials_of_meshes_are_given() -> None:
    red = rs.Scene(objects()[2].meshes, materials=[rs.Material("red")])
    scene = rs.Scene.instances([rs.Mesh(*cube()), red], [np.eye(3, 4)] * 2, [0, 1])
    assert [material.name for material in scene.materials] == [rs.Material().name, "red"]
    with pytest.raises(ValueError, match="materials: mesh '' uses material 1, but 1 are given"):
        rs.Scene.instances([rs.Mesh(*cube(), material_ids=1), red], [np.eye(3, 4)], [0])


def test_inverses_are_accurate() -> None:
    transforms = random_transforms(np.random.default_rng(3), 500, 100.0)
    transforms[:100, :, :3] *= 2.0**150
    transforms[100:200, :, :3] *= 2.0**-150
    instances = Instances(np.zeros(500, int), transforms)
    expected = np.linalg.inv(
        np.concatenate([transforms, np.tile([[[0.0, 0, 0, 1]]], (500, 1, 1))], axis=1)
    )[:, :3]
    np.testing.assert_allclose(instances.inverses[:, :, :3], expected[:, :, :3], rtol=1e-9)
