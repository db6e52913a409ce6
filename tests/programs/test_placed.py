"""Filters, programs and skipped triangles in scenes with instances, against moved rays."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import instanced
import raystream as rs
from conftest import assert_same_bits
from instanced import COLUMNS, random_transforms
from meshes import cube, icosphere, soup

STRUCTURES = ("bvh", "brute")

#: Kernels for many rays.
MANY = ("packet", "groups", "wavefront")


@cache
def objects() -> list[rs.Scene]:
    """Two meshes in the first: mesh_id is not the object's number."""
    both = rs.Scene([rs.Mesh(*icosphere(1)), rs.Mesh(*cube())])
    return [both, rs.Scene.from_arrays(*soup(60, seed=3)), rs.Scene.from_arrays(*cube())]


def random_scene(rng, count: int, spread: float = 5.0, **options) -> rs.Scene:
    ids = rng.integers(0, len(objects()), count)
    return rs.Scene.instances(objects(), random_transforms(rng, count, spread), ids, **options)


def random_rays(rng, count: int, spread: float = 5.0) -> dict:
    origins = rng.uniform(-2.0 * spread, 2.0 * spread, (count, 3))
    directions = rng.uniform(-spread, spread, (count, 3)) - origins
    t_max = np.where(rng.random(count) < 0.5, np.inf, rng.uniform(0.5, 3.0, count))
    limits = {"t_min": np.zeros(count, np.float32), "t_max": t_max.astype(np.float32)}
    return {"origins": origins, "directions": directions, **limits}


def rows_of(splits, columns, keep):
    """The rows that are kept: splits and columns."""
    ray_id = np.repeat(np.arange(len(splits) - 1), np.diff(splits))
    counts = np.bincount(ray_id[keep], minlength=len(splits) - 1)
    return np.concatenate([[0], np.cumsum(counts)]), {n: c[keep] for n, c in columns.items()}


def assert_queries(tracer, rays, expected, **options) -> None:
    """All queries have these rows, with options that filter."""
    splits, columns = expected
    first = instanced.nearest(splits, columns)
    hits = tracer.first_hit(**rays, **options)
    for name in COLUMNS:
        assert_same_bits(getattr(hits, name), first[name])
    assert_same_bits(tracer.any_hit(**rays, **options), splits[1:] > splits[:-1])
    assert_same_bits(tracer.count_hits(**rays, **options), np.diff(splits))
    for limit in (None, 2):
        many = tracer.multi_hit(**rays, max_hits=limit, **options)
        wanted_splits, wanted = instanced.kept(splits, columns, limit or len(columns["t"]))
        assert_same_bits(many.ray_splits, wanted_splits)
        for name in COLUMNS:
            assert_same_bits(getattr(many, name), wanted[name])


def normals_of(scene, prim_id, instance_id) -> np.ndarray:
    """Of triangles in world space, outside, float64: by the inverse matrix, in NumPy."""
    corners = np.concatenate(
        [
            np.asarray(mesh.vertices, np.float64)[mesh.faces]
            for one in objects()
            for mesh in one.meshes
        ]
    )[prim_id]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inverses = scene.placements.inverses[instance_id][:, :, :3]
    return np.einsum("kij,ki->kj", inverses, normals)


def choose(hit):
    kept = (hit.prim_id + 2 * hit.instance_id + hit.mesh_id + hit.ray) % 3 != 0
    return kept and hit.t > 0.1 and hit.u < 0.9


def entering(hit):
    return hit.is_entering


def chosen(columns, splits):
    ray_id = np.repeat(np.arange(len(splits) - 1), np.diff(splits))
    ends = np.cumsum([mesh.triangle_count for one in objects() for mesh in one.meshes])
    mesh_id = np.searchsorted(ends, columns["prim_id"], side="right")
    number = columns["prim_id"] + 2 * columns["instance_id"] + mesh_id + ray_id
    t, u = (columns[name].astype(np.float64) for name in ("t", "u"))  # as `choose` compares them
    return (number % 3 != 0) & (t > 0.1) & (u < 0.9)


@pytest.mark.parametrize("structure", STRUCTURES)
def test_filters_keep_what_they_keep_of_all_hits(structure, rng) -> None:
    scene, rays = random_scene(rng, 40), random_rays(rng, 1500)
    splits, columns = instanced.all_hits(scene, objects(), rays)
    tracer = rs.Tracer(scene, structure)
    keep = chosen(columns, splits)
    assert 0.4 < keep.mean() < 0.8
    assert_queries(tracer, rays, rows_of(splits, columns, keep), on_hit=choose)


@pytest.mark.parametrize("structure", STRUCTURES)
def test_the_front_is_outside_of_mirrored_instances(structure, rng) -> None:
    scene, rays = random_scene(rng, 40), random_rays(rng, 1500)
    splits, columns = instanced.all_hits(scene, objects(), rays)
    ray_id = np.repeat(np.arange(len(splits) - 1), np.diff(splits))
    normals = normals_of(scene, columns["prim_id"], columns["instance_id"])
    keep = np.einsum("nk,nk->n", normals, rays["directions"][ray_id]) < 0.0
    assert 0.3 < keep.mean() < 0.7
    tracer = rs.Tracer(scene, structure)
    assert_queries(tracer, rays, rows_of(splits, columns, keep), on_hit=entering)


@pytest.mark.parametrize("kernel", ["auto", "single", *MANY])
def test_large_batches_are_filtered(kernel, rng) -> None:
    """As many rays of an image as kernels for many rays take."""
    scene = random_scene(rng, 40)
    x, y = np.meshgrid(np.linspace(-6.0, 6.0, 96), np.linspace(-6.0, 6.0, 64))
    origins = np.stack([x, y, np.full(x.shape, 12.0)], axis=-1)
    rays = origins, [0.05, 0.1, -1.0]
    tracer, brute = rs.Tracer(scene, kernel=kernel), rs.Tracer(scene, "brute")
    hits = brute.first_hit(*rays)
    for options in ({"on_hit": choose}, {"skip_prim_ids": hits}, {"skip_prim_ids": hits.prim_id}):
        found, expected = (one.first_hit(*rays, **options) for one in (tracer, brute))
        assert 0.1 < (expected.t != hits.t).mean() < 0.9
        for name in COLUMNS:
            assert_same_bits(getattr(found, name), getattr(expected, name))
        assert_same_bits(tracer.any_hit(*rays, **options), brute.any_hit(*rays, **options))


def varied_rays(rng, count: int) -> dict:
    """With limits on both sides, from far away, along axes and to corners, and of any length."""
    rays = random_rays(rng, count)
    origins, aims = rays["origins"], rays["origins"] + rays["directions"]
    quarter = count // 4
    rays["t_min"][: count // 2] = rng.uniform(-1.0, 1.0, count // 2)
    origins[quarter : 2 * quarter] *= 10.0 ** rng.uniform(0.0, 6.0, (quarter, 1))
    origins[2 * quarter :], aims[2 * quarter :] = np.round(origins[2 * quarter :]), 0.0
    aims[2 * quarter :] = origins[2 * quarter :] + rng.integers(-1, 2, (count - 2 * quarter, 3))
    directions = aims - origins
    directions[(directions == 0.0).all(axis=1)] = [0.0, 0.0, -1.0]
    directions[::5] *= 10.0 ** rng.uniform(-18.0, 18.0, (len(directions[::5]), 1))
    rays["t_max"][::5] = np.inf
    return {**rays, "directions": directions}


@pytest.mark.parametrize("kernel", MANY)
def test_kernels_for_many_rays_filter_as_brute_force(kernel, rng) -> None:
    """Also instances at one place: of equal hits, the filter may keep any."""
    scene, rays = random_scene(rng, 24), varied_rays(rng, 4000)
    transforms = np.tile(np.eye(3, 4), (24, 1, 1))
    transforms[:, :, 3] = rng.integers(-1, 2, (24, 3))
    for one in (scene, scene.with_transforms(transforms)):
        tracer, brute = rs.Tracer(one, kernel=kernel), rs.Tracer(one, "brute")
        for skipped in (None, brute.first_hit(**rays)):
            options = {"on_hit": choose, "skip_prim_ids": skipped}
            found, expected = (each.first_hit(**rays, **options) for each in (tracer, brute))
            assert 0.05 < expected.is_hit.mean() < 0.9
            for name in (*COLUMNS, "status"):
                assert_same_bits(getattr(found, name), getattr(expected, name))
            assert_same_bits(tracer.any_hit(**rays, **options), brute.any_hit(**rays, **options))


@given(st.integers(0, 2**20), st.integers(1, 12), st.booleans())
@example(1226, 8, True)  # a hit at float32's 0.1, which is more than 0.1
@settings(max_examples=25)
def test_any_instances_are_filtered(seed, count, is_grid) -> None:
    rng = np.random.default_rng(seed)
    scene, rays = random_scene(rng, count, 2.0), random_rays(rng, 60, 2.0)
    if is_grid:  # rays that meet edges, and hits at equal distances
        transforms = np.tile(np.eye(3, 4), (count, 1, 1))
        transforms[:, :, 3] = rng.integers(-1, 2, (count, 3))
        scene = scene.with_transforms(transforms)
        rays["origins"] = np.round(rays["origins"])
        rays["directions"] = np.round(rays["directions"]) + [0.0, 0.0, 0.5]
    splits, columns = instanced.all_hits(scene, objects(), rays)
    expected = rows_of(splits, columns, chosen(columns, splits))
    for structure in STRUCTURES:
        assert_queries(rs.Tracer(scene, structure), rays, expected, on_hit=choose)


FIELDS = np.dtype([("depth", "f8"), ("count", "i8"), ("instances", "i8"), ("meshes", "i8")])


def add_up(hit, payload):
    payload.depth = 0.5 * payload.depth + hit.t
    payload.count += 1
    payload.instances += (hit.instance_id + 1) * payload.count
    payload.meshes += hit.mesh_id * hit.prim_id
    if payload.count == 6:
        return rs.Decision.STOP
    return rs.Decision.CONTINUE


def test_programs_see_hits_in_order(rng) -> None:
    scene, rays = random_scene(rng, 60), random_rays(rng, 800)
    splits, columns = instanced.all_hits(scene, objects(), rays)
    ends = np.cumsum([mesh.triangle_count for one in objects() for mesh in one.meshes])
    expected = np.zeros(800, FIELDS)
    assert np.diff(splits).max() > 6
    for ray in range(800):
        for row in range(splits[ray], min(splits[ray + 1], splits[ray] + 6)):
            one, prim_id = expected[ray], columns["prim_id"][row]
            one["depth"] = 0.5 * one["depth"] + columns["t"][row]
            one["count"] += 1
            one["instances"] += (columns["instance_id"][row] + 1) * one["count"]
            one["meshes"] += np.searchsorted(ends, prim_id, side="right") * prim_id
    for structure in STRUCTURES:
        found = rs.Tracer(scene, structure).trace(**rays, on_hit=add_up, payload=FIELDS)
        for name in FIELDS.names:
            np.testing.assert_array_equal(found[name], expected[name])


@pytest.mark.parametrize("structure", STRUCTURES)
def test_numbers_skip_triangles_in_all_instances(structure, rng) -> None:
    scene, rays = random_scene(rng, 40), random_rays(rng, 1000)
    splits, columns = instanced.all_hits(scene, objects(), rays)
    ray_id = np.repeat(np.arange(1000), np.diff(splits))
    first = instanced.nearest(splits, columns)["prim_id"]
    skips = np.stack([first, rng.integers(-1, scene.triangle_count, 1000)], axis=1)
    keep = (columns["prim_id"][:, None] != skips[ray_id]).all(axis=1)
    tracer = rs.Tracer(scene, structure)
    assert np.count_nonzero(~keep) > 400
    assert_queries(tracer, rays, rows_of(splits, columns, keep), skip_prim_ids=skips)
    keep &= chosen(columns, splits)
    expected = rows_of(splits, columns, keep)
    assert_queries(tracer, rays, expected, skip_prim_ids=skips, on_hit=choose)


@pytest.mark.parametrize("structure", STRUCTURES)
def test_hits_skip_triangles_in_their_instances(structure, rng) -> None:
    transforms = np.tile(np.eye(3, 4), (5, 1, 1))
    transforms[:, :, 3] = np.arange(5.0)[:, None] * [0.2, 0.1, 0.3]
    scene = rs.Scene.instances(objects()[2], transforms)
    rays = random_rays(rng, 1000, 1.0)
    splits, columns = instanced.all_hits(scene, [objects()[2]], rays)
    ray_id = np.repeat(np.arange(1000), np.diff(splits))
    first = instanced.nearest(splits, columns)
    keep = columns["prim_id"] != first["prim_id"][ray_id]
    others = ~keep & (columns["instance_id"] != first["instance_id"][ray_id])
    assert np.count_nonzero(others) > 100  # the same triangle, elsewhere
    tracer = rs.Tracer(scene, structure)
    hits = tracer.first_hit(**rays)
    expected = rows_of(splits, columns, keep | others)
    assert_queries(tracer, rays, expected, skip_prim_ids=hits)


def test_hits_skip_their_triangles_in_plain_scenes(rng) -> None:
    tracer = rs.Tracer(objects()[0])
    rays = random_rays(rng, 300, 1.0)
    hits = tracer.first_hit(**rays)
    found = tracer.first_hit(**rays, skip_prim_ids=hits)
    expected = tracer.first_hit(**rays, skip_prim_ids=hits.prim_id)
    assert_same_bits(found.t, expected.t)
    assert (found.prim_id[hits.is_hit] != hits.prim_id[hits.is_hit]).all()


def test_rays_of_worlds_are_filtered(rng) -> None:
    worlds = rng.integers(-1, 6, 80)
    scene = random_scene(rng, 80, worlds=worlds)
    rays, of_rays = random_rays(rng, 700), rng.integers(-1, 6, 700)
    splits, columns = instanced.all_hits(scene, objects(), rays)
    ray_id = np.repeat(np.arange(700), np.diff(splits))
    of_hits = worlds[columns["instance_id"]]
    keep = (of_hits == -1) | (of_hits == of_rays[ray_id])
    assert 0.1 < keep.mean() < 0.6
    kept = rows_of(splits, columns, keep & chosen(columns, splits))
    for structure in STRUCTURES:
        tracer = rs.Tracer(scene, structure)
        assert_queries(tracer, rays, kept, on_hit=choose, worlds=of_rays)
        counts = tracer.trace(**rays, on_hit=count, payload=int, worlds=of_rays)
        assert_same_bits(counts, np.bincount(ray_id[keep], minlength=700))


def count(hit, payload):
    payload[0] += 1


def test_the_nearest_hit_that_raises_is_reported(rng) -> None:
    scene, rays = random_scene(rng, 20), random_rays(rng, 200)
    tracer = rs.Tracer(scene)

    def fails(hit):
        if hit.instance_id == 3:
            raise ValueError("the third")
        return True

    for query in (tracer.first_hit, tracer.any_hit, tracer.count_hits, tracer.multi_hit):
        with pytest.raises(RuntimeError, match="fails: raised ValueError: the third"):
            query(**rays, on_hit=fails)


def test_instance_id_is_0_without_instances() -> None:
    tracer = rs.Tracer(objects()[2])
    ray = [0.2, 0.3, 5.0], [0.0, 0.0, -1.0]
    assert tracer.any_hit(*ray, on_hit=lambda hit: hit.instance_id == 0)
    assert not tracer.any_hit(*ray, on_hit=lambda hit: hit.instance_id != 0)


def test_a_scene_without_instances_has_nothing_to_filter() -> None:
    tracer = rs.Tracer(rs.Scene.instances(objects(), [], []))
    ray = [[0.2, 0.3, 5.0]], [0.0, 0.0, -1.0]
    assert not tracer.first_hit(*ray, on_hit=choose).is_hit.any()
    assert tracer.trace(*ray, on_hit=count, payload=int).tolist() == [0]
    assert len(tracer.multi_hit(*ray, skip_prim_ids=[0]).t) == 0


def test_bad_skips_are_named(rng) -> None:
    scene = random_scene(rng, 4)
    tracer = rs.Tracer(scene)
    ray = [[0.0, 0, 5]], [0.0, 0, -1]
    with pytest.raises(ValueError, match="skip_prim_ids: expected -1 or a prim_id below"):
        tracer.first_hit(*ray, skip_prim_ids=[scene.triangle_count])
    with pytest.raises(ValueError, match="skip_prim_ids: expected the rays' shape"):
        tracer.first_hit(*ray, skip_prim_ids=tracer.first_hit(ray[0] * 2, ray[1]))
    with pytest.raises(TypeError, match="skip_prim_ids: expected integers"):
        tracer.any_hit(*ray, skip_prim_ids=[0.5])
    other = rs.Tracer(rs.Scene.instances(objects()[2], np.tile(np.eye(3, 4), (9, 1, 1))))
    hits = other.first_hit([[0.2, 0.3, 5.0]], [0.0, 0, -1], on_hit=lambda hit: hit.instance_id == 8)
    with pytest.raises(ValueError, match="skip_prim_ids: the hits are of another scene"):
        tracer.first_hit(*ray, skip_prim_ids=hits)
