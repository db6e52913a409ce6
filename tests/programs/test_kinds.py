"""Filters, programs and skipped primitives: spheres, height fields and float64, against NumPy."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import raystream as rs
from conftest import assert_same_bits
from meshes import icosphere, soup

COLUMNS = ("t", "u", "v", "prim_id", "mesh_id")
STRUCTURES = ("bvh", "brute")

#: Kernels for many rays.
KERNELS = {
    "primitives": ("auto", "single", "packet", "wavefront"),
    "float64": ("auto", "single", "packet", "groups"),
}


def primitives(rng) -> rs.Scene:
    """Two meshes, two height fields with other sides up, and spheres, some inside each other."""
    meshes = rs.Scene([rs.Mesh(*icosphere(1)), rs.Mesh(*soup(60, seed=3))])
    turned, level = rng.uniform(-1, 1, (9, 11)), rng.uniform(-1, 1, (7, 6))
    fields = [
        rs.Scene.height_field(turned, origin=(4, -4, -2), spacing=(-0.8, 0.9)),
        rs.Scene.height_field(level, origin=(-4, -4, 2), spacing=1.2),
    ]
    centers = rng.uniform(-4, 4, (40, 3))
    return rs.Scene.combine([meshes, *fields, rs.Scene.spheres(centers, rng.uniform(0.1, 2, 40))])


@cache
def scene_of(kind: str) -> rs.Scene:
    if kind == "primitives":
        return primitives(np.random.default_rng(8))
    return rs.Scene([rs.Mesh(*icosphere(2)), rs.Mesh(*soup(200, seed=4))])


@cache
def tracer_of(kind: str, structure: str, kernel: str = "auto") -> rs.Tracer:
    options = {"kernel": kernel} if structure == "bvh" else {}
    precision = "float64" if kind == "float64" else "float32"
    return rs.Tracer(scene_of(kind), structure, precision=precision, **options)


def random_rays(rng, count: int) -> dict:
    origins = rng.uniform(-8.0, 8.0, (count, 3))
    t_max = np.where(rng.random(count) < 0.5, np.inf, rng.uniform(0.5, 3.0, count))
    directions = rng.uniform(-3.0, 3.0, (count, 3)) - origins
    return {"origins": origins, "directions": directions, "t_max": t_max}


def image_rays() -> dict:
    x, y = np.meshgrid(np.linspace(-5.0, 5.0, 96), np.linspace(-5.0, 5.0, 64))
    origins = np.stack([x, y, np.full(x.shape, 9.0)], axis=-1)
    return {"origins": origins, "directions": [0.05, 0.1, -1.0]}


def scattered_rays(rng) -> dict:
    rays = random_rays(rng, 6000)
    return {"origins": rays["origins"], "directions": rays["directions"]}


def ray_directions(many, rays) -> np.ndarray:
    shape = (*many.status.shape, 3)
    return np.broadcast_to(rays["directions"], shape).reshape(-1, 3)[many.ray_id]


def choose(hit):
    kept = (hit.prim_id + 2 * hit.mesh_id + hit.ray) % 3 != 0
    return kept and hit.t > 0.1 and hit.u < 0.9 and hit.v > 0.05


def chosen(many) -> np.ndarray:
    kept = (many.prim_id + 2 * many.mesh_id + many.ray_id) % 3 != 0
    t, u, v = (getattr(many, name).astype(np.float64) for name in "tuv")
    return kept & (t > 0.1) & (u < 0.9) & (v > 0.05)


def entering(hit):
    return hit.is_entering


def never(hit):
    return hit.t < 0.0


def kept_rows(many, keep, most=None):
    """Splits and columns of the rows that are kept, at most `most` of a ray."""
    rays = many.ray_id[keep]
    rank = np.arange(len(rays)) - np.searchsorted(rays, rays)
    rows = np.flatnonzero(keep)[rank < (len(keep) if most is None else most)]
    counts = np.bincount(many.ray_id[rows], minlength=many.status.size)
    columns = {name: getattr(many, name)[rows] for name in COLUMNS}
    return np.concatenate([[0], np.cumsum(counts)]), columns


def assert_first(hits, splits, columns) -> None:
    is_hit = splits[1:] > splits[:-1]
    assert_same_bits(hits.is_hit.ravel(), is_hit)
    for name in COLUMNS:
        assert_same_bits(getattr(hits, name).ravel()[is_hit], columns[name][splits[:-1][is_hit]])


def assert_queries(tracer, rays, many, keep, **options) -> None:
    """All queries have the rows that are kept of all hits, with options that filter."""
    splits, columns = kept_rows(many, keep)
    assert_first(tracer.first_hit(**rays, **options), splits, columns)
    shape, counts = many.status.shape, np.diff(splits)
    assert_same_bits(tracer.any_hit(**rays, **options), (counts > 0).reshape(shape))
    assert_same_bits(tracer.count_hits(**rays, **options), counts.reshape(shape))
    for most in (None, 2):
        found = tracer.multi_hit(**rays, max_hits=most, **options)
        wanted, columns = kept_rows(many, keep, most)
        assert_same_bits(found.ray_splits, wanted)
        for name in COLUMNS:
            assert_same_bits(getattr(found, name), columns[name])


@pytest.mark.parametrize("structure", STRUCTURES)
@pytest.mark.parametrize("kind", KERNELS)
def test_filters_keep_what_they_keep_of_all_hits(kind, structure, rng) -> None:
    tracer, rays = tracer_of(kind, structure), random_rays(rng, 800)
    many = tracer.multi_hit(**rays)
    keep = chosen(many)
    assert 0.3 < keep.mean() < 0.8
    assert_queries(tracer, rays, many, keep, on_hit=choose)


@pytest.mark.parametrize("structure", STRUCTURES)
@pytest.mark.parametrize("kind", KERNELS)
def test_rays_enter_against_the_normals(kind, structure, rng) -> None:
    tracer, rays = tracer_of(kind, structure), random_rays(rng, 800)
    many = tracer.multi_hit(**rays)
    along = np.einsum("nk,nk->n", many.normals.astype(float), ray_directions(many, rays))
    for mesh_id in np.unique(many.mesh_id):  # both sides of each mesh, field and the spheres
        assert 0.2 < (along[many.mesh_id == mesh_id] < 0.0).mean() < 0.8
    assert_queries(tracer, rays, many, along < 0.0, on_hit=entering)


@pytest.mark.parametrize(("kind", "kernel"), [(kind, k) for kind in KERNELS for k in KERNELS[kind]])
def test_kernels_for_many_rays_filter(kind, kernel, rng) -> None:
    tracer = tracer_of(kind, "bvh", kernel)
    for rays in (image_rays(), scattered_rays(rng)):
        many = tracer_of(kind, "brute").multi_hit(**rays)
        for options, keep in (
            ({"on_hit": choose}, chosen(many)),
            ({"on_hit": never}, np.zeros(len(many.t), np.bool_)),
        ):
            splits, columns = kept_rows(many, keep)
            assert_first(tracer.first_hit(**rays, **options), splits, columns)
            seen = tracer.any_hit(**rays, **options)
            assert_same_bits(seen.ravel(), splits[1:] > splits[:-1])


@pytest.mark.parametrize("structure", STRUCTURES)
@pytest.mark.parametrize("kind", KERNELS)
def test_what_is_skipped_is_not_there(kind, structure, rng) -> None:
    """Of a sphere, neither side is."""
    tracer, rays = tracer_of(kind, structure), random_rays(rng, 800)
    many, hits = tracer.multi_hit(**rays), tracer.first_hit(**rays)
    keep = many.prim_id != hits.prim_id[many.ray_id]
    assert 0.2 < keep.mean() < 0.8
    for skipped in (hits, hits.prim_id):
        assert_queries(tracer, rays, many, keep, skip_prim_ids=skipped)
    both = {"skip_prim_ids": hits, "on_hit": choose}
    assert_queries(tracer, rays, many, keep & chosen(many), **both)
    pairs = np.stack([hits.prim_id, np.full(800, -1)], axis=1)
    assert_queries(tracer, rays, many, keep, skip_prim_ids=pairs)


@pytest.mark.parametrize("kernel", KERNELS["primitives"])
def test_kernels_for_many_rays_skip_both_sides_of_spheres(kernel) -> None:
    rays, brute = image_rays(), tracer_of("primitives", "brute")
    tracer, many, hits = (
        tracer_of("primitives", "bvh", kernel),
        brute.multi_hit(**rays),
        brute.first_hit(**rays),
    )
    assert hits.is_on_sphere.mean() > 0.3
    keep = many.prim_id != hits.prim_id.ravel()[many.ray_id]
    splits, columns = kept_rows(many, keep)
    assert_first(tracer.first_hit(**rays, skip_prim_ids=hits), splits, columns)
    seen = tracer.any_hit(**rays, skip_prim_ids=hits)
    assert_same_bits(seen.ravel(), splits[1:] > splits[:-1])


@pytest.mark.parametrize("kind", KERNELS)
def test_skipped_primitives_are_those_of_the_scene(kind) -> None:
    tracer = tracer_of(kind, "bvh")
    count = len(tracer.structure.triangles)
    tracer.first_hit([0, 0, 9], [0, 0, -1], skip_prim_ids=count - 1)
    with pytest.raises(ValueError, match=f"a prim_id below {count}"):
        tracer.first_hit([0, 0, 9], [0, 0, -1], skip_prim_ids=count)


def until_third(hit, payload):
    payload.count += 1
    payload.t = hit.t
    payload.prim_id = hit.prim_id
    payload.inside += 1 if hit.is_entering else -1
    if payload.count == 3:
        return rs.Decision.STOP
    return rs.Decision.CONTINUE


RECORD = np.dtype([("t", "f8"), ("count", "i8"), ("prim_id", "i4"), ("inside", "i4")])


@pytest.mark.parametrize("structure", STRUCTURES)
@pytest.mark.parametrize("kind", KERNELS)
def test_programs_run_over_the_hits_in_order(kind, structure, rng) -> None:
    """The t of a hit in float64 is not rounded."""
    tracer, rays = tracer_of(kind, structure), random_rays(rng, 800)
    many = tracer.multi_hit(**rays, max_hits=3)
    records = tracer.trace(**rays, on_hit=until_third, payload=RECORD)
    assert_same_bits(records["count"], many.counts)
    has_any = many.counts > 0
    last = many.ray_splits[1:][has_any] - 1
    assert_same_bits(records["t"][has_any], many.t[last].astype(np.float64))
    assert_same_bits(records["prim_id"][has_any], many.prim_id[last])
    along = np.einsum("nk,nk->n", many.normals.astype(float), ray_directions(many, rays))
    inside = np.bincount(many.ray_id, -np.sign(along), minlength=len(has_any))
    assert records["inside"].tolist() == inside.tolist()


def test_limits_in_float64_hold_for_rays_that_are_traced_again() -> None:
    """The first hit is ignored, and the second lies a step beyond the interval."""
    scene = rs.Scene.from_arrays(
        np.array([[0, 0, z] for z in (1, 3) for _ in range(3)])
        + np.tile([[0, 0, 0], [1, 0, 0], [0, 1, 0]], (2, 1)) / 3.0,
        [[0, 1, 2], [3, 4, 5]],
    )
    tracer = rs.Tracer(scene, precision="float64")
    ray = [0.1, 0.1, 0.0], [0.0, 0.0, 0.7]
    second = tracer.multi_hit(*ray).t[1]
    for t_max, prim_id in ((second, 1), (np.nextafter(second, 0.0), -1)):
        hits = tracer.first_hit(*ray, t_max=t_max, on_hit=lambda hit: hit.prim_id == 1)
        assert hits.prim_id == prim_id
        assert hits.t.dtype == np.float64


def fails(hit):
    if hit.prim_id == 1:
        raise ValueError("of the second")
    return False


@pytest.mark.parametrize(("kind", "kernel"), [(kind, k) for kind in KERNELS for k in KERNELS[kind]])
def test_errors_in_functions_are_named(kind, kernel) -> None:
    tracer, rays = tracer_of(kind, "bvh", kernel), image_rays()
    assert 1 in tracer.multi_hit(**rays).prim_id
    for query in (tracer.first_hit, tracer.any_hit, tracer.count_hits, tracer.multi_hit):
        with pytest.raises(RuntimeError, match="fails: raised ValueError: of the second"):
            query(**rays, on_hit=fails)
    with pytest.raises(TypeError, match="expected"):
        tracer.first_hit(**rays, on_hit=lambda hit, payload: True)
    with pytest.raises(TypeError, match="Numba cannot compile it"):
        tracer.first_hit(**rays, on_hit=lambda hit: hit.color)


@pytest.mark.parametrize("kind", KERNELS)
@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), remainder=st.integers(0, 2))
def test_any_rays_are_filtered(kind, seed, remainder) -> None:
    """From far away, along axes, of any length, and with limits."""
    rng = np.random.default_rng(seed)
    rays = random_rays(rng, 200)
    origins, directions = rays["origins"], rays["directions"]
    origins[:50] *= 10.0 ** rng.uniform(0.0, 6.0, (50, 1))
    directions[:50] = rng.uniform(-3.0, 3.0, (50, 3)) - origins[:50]
    directions[50:100] = np.eye(3)[rng.integers(0, 3, 50)] * rng.choice([-1.0, 1.0], (50, 1))
    directions[::5] *= 10.0 ** rng.uniform(-18.0, 18.0, (40, 1))
    many = tracer_of(kind, "brute").multi_hit(**rays)
    skipped = rng.integers(-1, len(tracer_of(kind, "bvh").structure.triangles), (200, 3))
    skipped[many.ray_id, 0] = np.where(many.prim_id % 3 == remainder, many.prim_id, -1)
    keep = (skipped[many.ray_id] != many.prim_id[:, None]).all(axis=1)
    assert_queries(tracer_of(kind, "bvh"), rays, many, keep, skip_prim_ids=skipped)
