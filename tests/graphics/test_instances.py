"""Instances on the compute machine, beside brute force on the CPU."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings

import instanced
import raystream as rs
from cases import CASES
from conftest import assert_same_bits
from instanced import moved, random_rotation, random_transforms
from meshes import cube, icosphere
from raystream.graphics.errors import GraphicsError
from structures.test_instances import (
    instances_and_rays,
    objects,
    random_rays,
    random_scene,
    scene_of,
    varied_rays,
)
from tolerance import Answers, Tolerance, assert_close

pytestmark = pytest.mark.usefixtures("opened")

STRUCTURES = ("bvh", "brute")

#: Each is another shader, which takes seconds to compile.
CROSSINGS = ("triangles",)


def answers_of(tracer: rs.Tracer, rays, **options) -> Answers:
    """All queries, with the numbers of triangles among those of all instances as ids."""
    answers: Answers = {}

    def note(query: str, hits, *columns: str) -> None:
        answers.update({f"{query}: {column}": getattr(hits, column) for column in columns})
        numbers = tracer.structure.triangles.numbers_of(hits.prim_id, hits.instance_id)
        answers[f"{query}: prim_id"] = numbers.astype(np.int32)

    note("first_hit", tracer.first_hit(**rays, **options), "t", "u", "v", "status")
    answers["any_hit"] = tracer.any_hit(**rays, **options)
    for crossings in CROSSINGS:
        chosen = {**rays, **options, "crossings": crossings}
        answers[f"count_hits, {crossings}"] = tracer.count_hits(**chosen)
        for limit in (None, 3):
            many = tracer.multi_hit(**chosen, max_hits=limit)
            note(f"multi_hit, {crossings}, {limit}", many, "ray_splits", "t", "u", "v")
    return answers


def assert_as_on_the_cpu(scene: rs.Scene, rays, structures=STRUCTURES, **options) -> int:
    """All queries agree; returns the number of rays that hit."""
    expected = answers_of(rs.Tracer(scene, "brute"), rays, **options)
    for structure in structures:
        tracer = rs.Tracer(scene, structure, "graphics")
        assert_close(answers_of(tracer, rays, **options), expected, Tolerance(scene, rays))
    return int(np.count_nonzero(expected["first_hit: prim_id"] >= 0))


def test_random_instances() -> None:
    assert assert_as_on_the_cpu(random_scene(1, 40), random_rays(2, 1000)) > 250


@pytest.mark.exhaustive
@pytest.mark.parametrize("seed", range(4))
def test_many_queries(seed, monkeypatch) -> None:
    monkeypatch.setitem(globals(), "CROSSINGS", ("triangles", "surfaces"))
    scene, rays = random_scene(seed, 200, 20.0), random_rays(seed + 9, 25_000, 20.0)
    assert assert_as_on_the_cpu(scene, rays, ["bvh"]) > 3000


def test_varied_rays() -> None:
    """From near and far, with directions of any length."""
    assert assert_as_on_the_cpu(random_scene(61, 12), varied_rays(62, 2048, 10.0)) > 150


def test_many_varied_rays_have_first_hits() -> None:
    scene, rays = random_scene(71, 12), varied_rays(81, 1 << 16, 10.0)
    expected = rs.Tracer(scene).first_hit(**rays)
    hits = rs.Tracer(scene, "bvh", "graphics").first_hit(**rays)
    np.testing.assert_array_equal(hits.is_hit, expected.is_hit)
    other = (hits.prim_id != expected.prim_id) | (hits.instance_id != expected.instance_id)
    assert np.count_nonzero(other) < 3  # two hits at nearly one t
    assert np.count_nonzero(hits.is_hit) > 5000


@pytest.mark.parametrize("name", CASES)
def test_hard_cases_wherever_they_are_placed(name) -> None:
    """Rays on edges, at limits, far away, of any length: moved along with the instances.

    Beside graphics tracers of the objects: t of a ray within a triangle's plane is not the CPU's.
    """
    case = CASES[name](np.random.default_rng(2013))
    size = float(np.ptp(case.vertices[np.isfinite(case.vertices).all(axis=1)], axis=0).max())
    transforms = random_transforms(np.random.default_rng(2013), 3, 2.0 * size)
    transforms[0] = np.eye(3, 4)
    scene = rs.Scene.instances(case.scene, transforms)
    t_min, t_max = case.limits()
    for transform in transforms[:2]:
        rays = {
            "origins": moved(transform, case.origins),
            "directions": moved(transform, case.directions, is_point=False),
            "t_min": t_min,
            "t_max": t_max,
        }
        splits, columns = instanced.all_hits(scene, [case.scene], rays, device="graphics")
        first = instanced.nearest(splits, columns)
        for structure in STRUCTURES if len(case.faces) < 300 else ["bvh"]:
            tracer = rs.Tracer(scene, structure, "graphics")
            hits, many = tracer.first_hit(**rays), tracer.multi_hit(**rays)
            np.testing.assert_array_equal(many.ray_splits, splits)
            for found, wanted in ((hits, first), (many, columns)):
                for column in ("prim_id", "instance_id"):
                    assert_same_bits(getattr(found, column), wanted[column])
                np.testing.assert_allclose(found.t, wanted["t"], rtol=1e-6)


@given(instances_and_rays())
@settings(
    max_examples=25,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)
def test_any_instances(case) -> None:
    """Mirror images, shears, sizes of 10^±6, thin axes, equal instances, on coarse lattices."""
    one, transforms, origins, directions = case
    rays = {
        "origins": moved(transforms[0], origins),
        "directions": moved(transforms[0], directions, is_point=False),
        "t_min": np.zeros(4, np.float32),
        "t_max": np.full(4, np.inf, np.float32),
    }
    assert_as_on_the_cpu(rs.Scene.instances(one, transforms), rays)


@pytest.mark.parametrize("offset", [1e6, 1e9, 1e12])
def test_objects_far_from_the_origin_lose_no_more_than_on_the_cpu(offset) -> None:
    """Differences of large numbers: with pairs of float32 most rays would be other ones."""
    rng = np.random.default_rng(7)
    scene = random_scene(7, 30)
    shift = offset * rng.uniform(0.5, 1.0, 3)
    scene = scene.with_transforms(
        scene.placements.transforms + np.column_stack([np.zeros((3, 3)), shift])
    )
    rays = random_rays(8, 1000)
    rays["origins"] += shift
    expected = rs.Tracer(scene).first_hit(**rays)
    hits = rs.Tracer(scene, "bvh", "graphics").first_hit(**rays)
    for name in ("prim_id", "instance_id"):
        np.testing.assert_array_equal(getattr(hits, name), getattr(expected, name))
    found = expected.is_hit
    assert np.count_nonzero(found) > 200
    np.testing.assert_allclose(hits.t[found], expected.t[found], rtol=1e-5)


def test_rays_from_very_far_away() -> None:
    """Where float64 has a thousandth, rays are moved to objects with the CPU's rounding."""
    scene = random_scene(7, 30)
    rays = random_rays(9, 2000)
    unit = rays["directions"] / np.linalg.norm(rays["directions"], axis=1, keepdims=True)
    far = {"origins": rays["origins"] - 1e13 * unit, "directions": unit}
    expected = rs.Tracer(scene).first_hit(**far)
    hits = rs.Tracer(scene, "bvh", "graphics").first_hit(**far)
    assert np.count_nonzero(expected.is_hit) > 200
    for name in ("prim_id", "instance_id"):
        np.testing.assert_array_equal(getattr(hits, name), getattr(expected, name))
    for name in ("u", "v"):
        np.testing.assert_allclose(getattr(hits, name), getattr(expected, name), atol=1e-4)


def test_equal_distances_go_to_the_first_instance() -> None:
    one = scene_of(*cube())
    scene = rs.Scene.instances([one, one], np.tile(np.eye(3, 4), (3, 1, 1)), [1, 0, 1])
    for structure in STRUCTURES:
        tracer = rs.Tracer(scene, structure, "graphics")
        hits = tracer.first_hit([0.2, 0.3, 5.0], [0.0, 0.0, -1.0])
        assert hits.instance_id == 0
        assert hits.prim_id >= one.triangle_count  # of the second object
        many = tracer.multi_hit([[0.2, 0.3, 5.0]], [0.0, 0.0, -1.0])
        assert many.instance_id.tolist() == [0, 1, 2, 0, 1, 2]


@pytest.mark.parametrize("distance", [5.0, 1e5])
def test_limits_are_closed(distance) -> None:
    """At the hits themselves, also where rays begin far away and t is rounded."""
    scene = random_scene(31, 10)
    rays = random_rays(32, 1000)
    far = -rays["directions"] / np.linalg.norm(rays["directions"], axis=1, keepdims=True)
    whole = {"origins": rays["origins"] + distance * far, "directions": -far}
    t = rs.Tracer(scene).first_hit(**whole).t
    whole = {name: values[np.isfinite(t)] for name, values in whole.items()}
    t = t[np.isfinite(t)]
    assert len(t) > 100
    below, above = np.nextafter(t, np.float32(-np.inf)), np.nextafter(t, np.float32(np.inf))
    for limits in ({"t_max": t}, {"t_max": below}, {"t_min": t}, {"t_min": above}):
        expected = rs.Tracer(scene, "brute").first_hit(**whole, **limits)
        for structure in STRUCTURES:
            hits = rs.Tracer(scene, structure, "graphics").first_hit(**whole, **limits)
            # A driver may round t another way.
            assert np.count_nonzero(hits.instance_id != expected.instance_id) <= 2


def test_rays_meet_the_instances_of_their_world() -> None:
    rng = np.random.default_rng(21)
    count, world_count = 200, 20
    ids = rng.integers(0, len(objects()), count)
    # Worlds of one instance, of many, and without any; some instances are in all worlds.
    worlds = np.minimum(rng.geometric(0.3, count) - 1, world_count - 1)
    worlds[rng.random(count) < 0.02] = -1
    worlds[worlds == 5] = 6
    worlds[0] = world_count - 1
    transforms = random_transforms(rng, count, 6.0)
    scene = rs.Scene.instances(objects(), transforms, ids, worlds=worlds)
    of_rays = rng.integers(-1, world_count, 1000)
    assert assert_as_on_the_cpu(scene, random_rays(22, 1000, 6.0), worlds=of_rays) > 100
    with pytest.raises(ValueError, match="worlds: expected the world of each ray"):
        rs.Tracer(scene, "bvh", "graphics").any_hit([0.0, 0, 0], [1.0, 0, 0])


def is_odd(hit) -> bool:
    return hit.instance_id % 2 == 1


def test_filters_on_the_host() -> None:
    scene, rays = random_scene(41, 30), random_rays(42, 400)
    tracer, other = rs.Tracer(scene, "bvh", "graphics"), rs.Tracer(scene)
    hits = tracer.first_hit(**rays, on_hit=is_odd)
    assert_same_bits(hits.instance_id, other.first_hit(**rays, on_hit=is_odd).instance_id)
    assert (hits.instance_id[hits.is_hit] % 2 == 1).all()
    first = tracer.first_hit(**rays)
    behind = tracer.first_hit(**rays, skip_prim_ids=first)
    assert_same_bits(behind.instance_id, other.first_hit(**rays, skip_prim_ids=first).instance_id)


def test_instances_move_and_tracers_are_copied() -> None:
    scene, rays = random_scene(13, 50), random_rays(14, 500)
    tracer = rs.Tracer(scene, "bvh", "graphics", counters=True)
    elsewhere = random_transforms(np.random.default_rng(15), 50)
    tracer.update(transforms=elsewhere)
    expected = rs.Tracer(scene.with_transforms(elsewhere)).first_hit(**rays)
    hits = tracer.first_hit(**rays)
    assert tracer.counters.tests[hits.is_hit].min() > 0
    for one in (hits, *(two.first_hit(**rays) for two in (copy.copy(tracer), pickled(tracer)))):
        assert_same_bits(one.instance_id, expected.instance_id)
    i = int(np.argmax(hits.is_hit))
    cast = tracer.cast(*(rays[name][i] for name in ("origins", "directions", "t_min", "t_max")))
    assert (cast.prim_id, cast.instance_id) == (hits.prim_id[i], hits.instance_id[i])


def pickled(tracer: rs.Tracer) -> rs.Tracer:
    copied: rs.Tracer = pickle.loads(pickle.dumps(tracer))
    return copied


def test_instances_of_instances_and_parts_of_batches() -> None:
    rng = np.random.default_rng(11)
    inner = rs.Scene.instances(objects()[0], random_transforms(rng, 4))
    scene = rs.Scene.instances([objects()[2], inner], random_transforms(rng, 3), [1, 0, 1])
    rays = random_rays(12, 500)
    assert assert_as_on_the_cpu(scene, rays) > 20
    whole = rs.Tracer(scene, "bvh", "graphics").multi_hit(**rays)
    parts = rs.Tracer(scene, "bvh", "graphics", rays_at_once=64).multi_hit(**rays)
    for name in ("t", "prim_id", "instance_id", "ray_splits"):
        assert_same_bits(getattr(whole, name), getattr(parts, name))


def test_scenes_without_anything_to_hit() -> None:
    for transforms in ([], np.zeros((0, 3, 4))):
        scene = rs.Scene.instances(objects(), transforms, [])
        for structure in STRUCTURES:
            tracer = rs.Tracer(scene, structure, "graphics")
            assert not tracer.any_hit([0.0, 0, 0], [1.0, 0, 0])
    nothing = scene_of([[0, 0, 0]], [[0, 0, 0]])  # no triangle that can be hit
    scene = rs.Scene.instances([nothing, objects()[2]], [np.eye(3, 4)] * 2, [0, 1])
    for structure in STRUCTURES:
        tracer = rs.Tracer(scene, structure, "graphics")
        hits = tracer.first_hit([0.2, 0.3, 5.0], [0.0, 0.0, -1.0])
        assert (hits.instance_id, hits.mesh_id) == (1, 1)


@pytest.mark.parametrize("structure", STRUCTURES)
def test_invalid_rays_miss(structure: str) -> None:
    scene = random_scene(65, 20)
    rays = random_rays(66, 400)
    directions, origins = rays["directions"], rays["origins"]
    directions[::7] = np.nan
    directions[1::7] *= 1e160
    directions[2::7] = 0.0
    origins[3::7] = np.inf
    directions[4::7] *= 1e-160
    expected = rs.Tracer(scene).first_hit(origins, directions)
    hits = rs.Tracer(scene, structure, "graphics").first_hit(origins, directions)
    for name in ("status", "prim_id", "instance_id"):
        assert_same_bits(getattr(hits, name), getattr(expected, name))
    assert (hits.status[1::7] == rs.RayStatus.INVALID).all()


def test_directions_along_axes_stay_there() -> None:
    """Zeros of either sign decide which boxes a ray on their faces enters."""
    turned = np.zeros((3, 3, 4))
    turned[0, :, :3], turned[1, :, :3] = np.eye(3), -np.eye(3)
    turned[2, :, :3] = np.eye(3)[[2, 0, 1]]
    turned[:, 0, 3] = [0.0, 4.0, 8.0]
    scene = rs.Scene.instances(scene_of(*cube()), turned)
    origins, directions = [], []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            for x in np.arange(-1.0, 10.0):
                origin, direction = np.array([x, 0.0, 1.0]), np.full(3, sign * 0.0)
                origin[axis] -= sign * 20.0
                direction[axis] = sign
                origins.append(origin)
                directions.append(direction)
    rays = {"origins": np.array(origins), "directions": np.array(directions)}
    assert assert_as_on_the_cpu(scene, rays) > 10


def test_images_are_those_of_the_cpu() -> None:
    one = rs.Scene([rs.Mesh(*icosphere(2), material_ids=0)], materials=[rs.Material()])
    places = np.tile(np.eye(3, 4), (9, 1, 1))
    for k, place in enumerate(places):
        place[:, :3] = random_rotation(np.random.default_rng(k)) * (0.5 + 0.1 * k)
        place[:2, 3] = 2.5 * (k % 3), 2.5 * (k // 3)
    camera = rs.Camera((2.5, 2.5, 12.0), (2.5, 2.5, 0.0))
    scene = rs.Scene.instances(one, places, camera=camera)
    images = [
        rs.render(scene, "raycast", size=(32, 32), device=device).pixels
        for device in ("cpu", "graphics")
    ]
    assert np.ptp(images[0]) > 0.1
    off = np.abs(images[0] - images[1]).max(axis=-1) > 1e-3
    assert np.count_nonzero(off) <= 1


def test_what_is_not_supported_is_named() -> None:
    scene = random_scene(1, 3)
    for machine in ("branching", "multipass"):
        with pytest.raises(ValueError, match=f"machine='{machine}': not supported in a scene with"):
            rs.Tracer(scene, "bvh", "graphics", machine=machine)
    for structure in ("grid", "kdtree", "graph"):
        with pytest.raises(ValueError, match=f"structure='{structure}': not supported in a scene"):
            rs.Tracer(scene, structure, "graphics")


def test_scenes_that_are_too_large_are_an_error(monkeypatch) -> None:
    scene = random_scene(1, 3)
    monkeypatch.setattr("raystream.graphics.buffers._MIN_BYTES", 1 << 40)
    with pytest.raises(GraphicsError, match=r"bvh, array 0 would take .* bytes"):
        rs.Tracer(scene, "bvh", "graphics")
