"""Spheres: hits against exact rationals, the tree against brute force, and bad input."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

import raystream as rs
import sphere_oracle
from conftest import assert_same_bits
from raystream.core.spheres import directions_at
from sphere_rays import SETTINGS, some_rays, unit_vectors
from strategies import COORDINATES

COLUMNS = ("t", "u", "v", "prim_id")


def check_setting(name: str, seed: int, count: int) -> int:
    sphere_count, size, offset, (least, most), spread = SETTINGS[name]
    rng = np.random.default_rng(seed)
    centers = rng.uniform(-size, size, (sphere_count, 3)) + offset
    radii = np.exp(rng.uniform(np.log(least), np.log(most), sphere_count))
    targets = rng.integers(0, sphere_count, count)
    rays = some_rays(rng, centers, radii, targets, spread)
    scene = rs.Scene.spheres(centers, radii)
    origins, directions, t_min, t_max = rays
    limits = {"t_min": t_min, "t_max": t_max}
    many = rs.Tracer(scene).multi_hit(origins, directions, **limits)
    slow = rs.Tracer(scene, "brute").multi_hit(origins, directions, **limits)
    for column in ("ray_splits", *COLUMNS):
        assert_same_bits(getattr(many, column), getattr(slow, column))
    is_far = name in ("tiny", "origins far outside")
    return sphere_oracle.check((centers, radii), rays, targets, many, is_far)


@pytest.mark.parametrize("name", SETTINGS)
def test_hits_agree_with_rationals(name) -> None:
    assert check_setting(name, 1, 800) > 400


@pytest.mark.exhaustive
@pytest.mark.parametrize("seed", range(2, 12))
@pytest.mark.parametrize("name", SETTINGS)
def test_a_million_hits_agree_with_rationals(name, seed) -> None:
    assert check_setting(name, seed, 17_000) > 8_000


def assert_queries_agree(scene: rs.Scene, rays: dict) -> int:
    """All queries of the tree have the bits of brute force, and of each other."""
    slow, fast = rs.Tracer(scene, "brute"), rs.Tracer(scene)
    whole = slow.multi_hit(**rays)
    for crossings in ("triangles", "surfaces"):
        for limit in (None, 1, 3):
            options = {"crossings": crossings, "max_hits": limit}
            many, other = fast.multi_hit(**rays, **options), slow.multi_hit(**rays, **options)
            for column in ("ray_splits", *COLUMNS):
                assert_same_bits(getattr(many, column), getattr(other, column))
        counts = fast.count_hits(**rays, crossings=crossings)
        assert_same_bits(counts, slow.count_hits(**rays, crossings=crossings))
    assert_same_bits(slow.count_hits(**rays), np.diff(whole.ray_splits))
    hits, other = fast.first_hit(**rays), slow.first_hit(**rays)
    for column in (*COLUMNS, "status"):
        assert_same_bits(getattr(hits, column), getattr(other, column))
    is_hit = whole.counts > 0
    assert_same_bits(hits.is_hit, is_hit)
    firsts = whole.ray_splits[:-1][is_hit]
    for column in COLUMNS:
        assert_same_bits(getattr(hits, column)[is_hit], getattr(whole, column)[firsts])
    for tracer in (fast, slow):
        assert_same_bits(tracer.any_hit(**rays), is_hit)
    return len(whole.t)


def test_the_tree_has_the_bits_of_brute_force() -> None:
    rng = np.random.default_rng(3)
    centers = rng.uniform(-10.0, 10.0, (5000, 3))
    centers[100:200] = centers[:100]  # twice in the same place
    radii = rng.uniform(0.01, 0.5, 5000)
    radii[100:150] = radii[:50]
    origins, directions, t_min, t_max = some_rays(
        rng, centers, radii, rng.integers(0, 5000, 2000), 30.0
    )
    rays = {"origins": origins, "directions": directions, "t_min": t_min, "t_max": t_max}
    assert assert_queries_agree(rs.Scene.spheres(centers, radii), rays) > 10_000


@st.composite
def spheres_and_rays(draw):
    """A few spheres on a lattice, touching and nested, of any scale, and rays at them."""
    count = draw(st.integers(1, 9))
    rows = st.lists(COORDINATES, min_size=3, max_size=3)
    scale = draw(st.sampled_from([1.0, 1e-6, 1e6]))
    offset = draw(st.sampled_from([0.0, 1e5])) * scale
    centers = np.array(draw(st.lists(rows, min_size=count, max_size=count))) * scale + offset
    sizes = st.sampled_from([1e-6, 0.1, 0.5, 1.0, 3.0])
    radii = np.array(draw(st.lists(sizes, min_size=count, max_size=count))) * scale
    origins = np.array(draw(st.lists(rows, min_size=5, max_size=5))) * scale + offset
    directions = np.array(draw(st.lists(rows, min_size=5, max_size=5)))
    if draw(st.booleans()):
        directions = centers[np.arange(5) % count] - origins
    return centers, radii, origins, directions


#: The ray leaves the sphere at a t beyond float32.
FAR_EXIT = np.zeros((1, 3)), np.array([1e-6]), np.zeros((5, 3)), np.full((5, 3), [0.0, 0.0, 1e-45])


@given(spheres_and_rays())
@example(FAR_EXIT)
@settings(max_examples=80)
def test_any_spheres_agree(case) -> None:
    centers, radii, origins, directions = case
    rays = {"origins": origins, "directions": directions}
    assert_queries_agree(rs.Scene.spheres(centers, radii), rays)
    is_valid = np.any(directions != 0.0, axis=1)
    rows = np.flatnonzero(is_valid)
    many = rs.Tracer(rs.Scene.spheres(centers, radii)).multi_hit(origins[rows], directions[rows])
    zeros = np.zeros(len(rows), np.float32)
    numbers = origins[rows], directions[rows], zeros, zeros + np.inf
    for k in range(len(radii)):
        targets = np.full(len(rows), k)
        sphere_oracle.check((centers, radii), numbers, targets, many, is_far=True)


@pytest.mark.parametrize("structure", ["bvh", "brute"])
def test_limits_belong_to_the_interval(structure) -> None:
    tracer = rs.Tracer(rs.Scene.spheres([[0.0, 0.0, 5.0]], 1.0), structure)
    ray = [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]
    above, below = np.nextafter(np.float32([4.0, 6.0]), np.float32([9.0, 0.0]))
    assert tracer.multi_hit(*ray, t_min=4.0, t_max=6.0).t.tolist() == [4.0, 6.0]
    assert tracer.multi_hit(*ray, t_min=above, t_max=6.0).t.tolist() == [6.0]
    assert tracer.multi_hit(*ray, t_min=4.0, t_max=below).t.tolist() == [4.0]
    assert tracer.count_hits(*ray, t_min=above, t_max=below) == 0
    assert not tracer.any_hit(*ray, t_min=above, t_max=below)
    assert tracer.multi_hit(*ray, t_min=4.0, t_max=4.0).t.tolist() == [4.0]


@pytest.mark.parametrize("structure", ["bvh", "brute"])
def test_rays_from_the_surface_and_rays_that_touch(structure) -> None:
    """All numbers are exact here."""
    tracer = rs.Tracer(rs.Scene.spheres([[0.0, 0.0, 0.0]], 2.0), structure)
    assert tracer.multi_hit([0, 0, -2], [0, 0, 1]).t.tolist() == [0.0, 4.0]
    assert tracer.multi_hit([0, 0, -2], [0, 0, -1]).t.tolist() == [0.0]
    assert tracer.multi_hit([0, 0, 0], [0, 0, 4]).t.tolist() == [0.5]
    touching = tracer.multi_hit([2, 0, -3], [0, 0, 1])
    assert touching.t.tolist() == [3.0, 3.0]
    assert touching.normals.tolist() == [[1.0, 0.0, 0.0]] * 2
    assert tracer.count_hits([np.nextafter(2.0, 3.0), 0, -3], [0, 0, 1]) == 0
    assert tracer.multi_hit([2, 0, 0], [0, 0, 1]).t.tolist() == [0.0, 0.0]


@pytest.mark.parametrize("structure", ["bvh", "brute"])
def test_equal_distances_go_to_the_lowest_prim_id(structure) -> None:
    centers = np.zeros((9, 3))
    tracer = rs.Tracer(rs.Scene.spheres(centers, [2.0, 1.0] * 4 + [1.0]), structure)
    many = tracer.multi_hit([0, 0, -4], [0, 0, 1])
    big, small = [0, 2, 4, 6], [1, 3, 5, 7, 8]
    assert many.prim_id.tolist() == big + small + small + big
    assert tracer.first_hit([0, 0, 0], [0, 0, 1]).prim_id == 1
    kept = tracer.multi_hit([0, 0, -4], [0, 0, 1], max_hits=5)
    assert kept.prim_id.tolist() == [*big, 1]


def test_invalid_rays_miss() -> None:
    tracer = rs.Tracer(rs.Scene.spheres([[0, 0, 5]], 1.0))
    origins = [[0, 0, 0], [np.nan, 0, 0], [0, 0, 0]]
    hits = tracer.first_hit(origins, [[0, 0, 0], [0, 0, 1], [0, 0, np.inf]])
    assert (hits.prim_id == -1).all()
    assert (hits.status == rs.RayStatus.INVALID).all()


def test_positions_and_normals() -> None:
    rng = np.random.default_rng(5)
    centers, radii = rng.uniform(-5.0, 5.0, (200, 3)), rng.uniform(0.1, 1.0, 200)
    origins = rng.uniform(-20.0, 20.0, (4000, 3))
    directions = rng.uniform(-5.0, 5.0, (4000, 3)) - origins
    hits = rs.Tracer(rs.Scene.spheres(centers, radii)).multi_hit(origins, directions)
    assert len(hits.t) > 4000
    k = hits.prim_id
    away = hits.positions - centers[k]
    np.testing.assert_allclose(np.linalg.norm(away, axis=1), radii[k], rtol=1e-12)
    np.testing.assert_allclose(hits.normals, away / radii[k, None], atol=1e-6)
    along = origins[hits.ray_id] + hits.t[:, None].astype(float) * directions[hits.ray_id]
    np.testing.assert_allclose(hits.positions, along, atol=2e-5)
    assert ((hits.u >= 0) & (hits.u <= 1) & (hits.v >= 0) & (hits.v <= 1)).all()
    np.testing.assert_array_equal(hits.shading_normals, hits.normals)
    assert_same_bits(hits.mesh_prim_id, k)
    assert not hits.mesh_id.any()
    assert not hits.material_id.any()
    assert np.isnan(hits.texcoords).all()


def test_the_octahedron_covers_the_sphere() -> None:
    rng = np.random.default_rng(6)
    directions = np.vstack([unit_vectors(rng, 500), np.eye(3), -np.eye(3)])
    tracer = rs.Tracer(rs.Scene.spheres([[1.0, 2.0, 3.0]], 0.25))
    hits = tracer.first_hit([1.0, 2.0, 3.0], directions)
    np.testing.assert_allclose(directions_at(hits.u, hits.v), directions, atol=4e-7)


@pytest.mark.parametrize("offset", [0.0, 1e6])
def test_rays_leave_spheres(offset) -> None:
    rng = np.random.default_rng(7)
    centers, radii = rng.uniform(-5.0, 5.0, (300, 3)) + offset, rng.uniform(1e-3, 1.0, 300)
    tracer = rs.Tracer(rs.Scene.spheres(centers, radii))
    targets = rng.integers(0, 300, 5000)
    origins = rng.uniform(-20.0, 20.0, (5000, 3)) + offset
    hits = tracer.first_hit(origins, centers[targets] - origins)
    hits = hits[hits.is_hit]
    assert len(hits.t) > 4000
    directions = unit_vectors(rng, len(hits.t))
    leaving = np.einsum("ij,ij->i", directions, hits.normals.astype(float))
    again = tracer.multi_hit(*hits.spawn(directions))
    same = np.flatnonzero(again.prim_id == hits.prim_id[again.ray_id])
    counts = np.bincount(again.ray_id[same], minlength=len(hits.t))
    sure = np.abs(leaving) > 1e-5
    assert (counts[sure & (leaving > 0)] == 0).all()
    assert (counts[sure & (leaving < 0)] == 1).all()  # the other side


@pytest.mark.parametrize(
    ("centers", "radii", "message"),
    [
        ([[0, 0, np.nan]], 1.0, "centers: expected finite coordinates.*row 0"),
        ([[0, 0, 0], [0, np.inf, 0]], 1.0, "centers: .*row 1"),
        ([[0, 0, 1e70]], 1.0, "centers: "),
        ([[0, 0]], 1.0, r"centers: expected shape \(N, 3\)"),
        ([[0, 0, 0]], 0.0, "radii: expected finite numbers above 0, got 0.0 for sphere 0"),
        ([[0, 0, 0]] * 2, [1.0, -1.0], "radii: .*-1.0 for sphere 1"),
        ([[0, 0, 0]], np.nan, "radii: "),
        ([[0, 0, 0]], np.inf, "radii: "),
        ([[0, 0, 0]], [1.0, 1.0], "radii: expected one number or shape"),
    ],
)
def test_bad_spheres_are_named(centers, radii, message) -> None:
    with pytest.raises(ValueError, match=message):
        rs.Scene.spheres(centers, radii)


def test_bad_kinds_and_materials_are_named() -> None:
    with pytest.raises(TypeError, match="centers: expected real numbers"):
        rs.Scene.spheres([["a", "b", "c"]], 1.0)
    with pytest.raises(TypeError, match="material_ids: expected integers"):
        rs.Scene.spheres([[0, 0, 0]], 1.0, material_ids=0.5)
    with pytest.raises(ValueError, match="material_ids: expected 0 to 0"):
        rs.Scene.spheres([[0, 0, 0]], 1.0, material_ids=[1])
    with pytest.raises(TypeError, match="meshes"):
        rs.Scene.spheres([[0, 0, 0]], 1.0, meshes=[])


@pytest.mark.parametrize("structure", ["bvh", "brute"])
def test_no_spheres_are_no_error(structure) -> None:
    scene = rs.Scene.spheres(np.zeros((0, 3)), 1.0)
    tracer = rs.Tracer(scene, structure)
    assert tracer.first_hit([[0, 0, 0]], [0, 0, 1]).prim_id.tolist() == [-1]
    assert tracer.count_hits([[0, 0, 0]], [0, 0, 1]).tolist() == [0]
    assert (scene.bounds == 0).all()


@pytest.mark.parametrize("structure", ["grid", "kdtree", "graph"])
def test_other_structures_say_so(structure) -> None:
    with pytest.raises(ValueError, match="use structure='bvh' or structure='brute'"):
        rs.Tracer(rs.Scene.spheres([[0, 0, 0]], 1.0), structure)


def test_what_is_not_supported_says_so() -> None:
    scene = rs.Scene.spheres([[0, 0, 5]], 1.0)
    with pytest.raises(ValueError, match="spheres; use device='cpu', machine='branching'"):
        rs.Tracer(scene, machine="multipass")
    tracer = rs.Tracer(scene)
    with pytest.raises(ValueError, match="not supported in a scene with spheres"):
        tracer.update([[0, 0, 0]])
    with pytest.raises(ValueError, match="other numbers of triangles"):
        rs.Tracer(rs.load("cornell")).update(scene)


def test_a_single_ray_and_copies() -> None:
    scene = rs.Scene.spheres([[0, 0, 5], [0, 0, 9]], [1.0, 2.0])
    tracer = rs.Tracer(scene)
    hit = tracer.cast((0.0, 0.0, 6.5), (0.0, 0.0, 1.0))
    assert (hit.t, hit.prim_id) == (0.5, 1)
    assert hit.position.tolist() == [0.0, 0.0, 7.0]
    assert hit.normal.tolist() == [0.0, 0.0, -1.0]
    for other in (copy.copy(tracer), pickle.loads(pickle.dumps(tracer))):
        assert other.first_hit([0, 0, 0], [0, 0, 1]).t == 4.0
    assert repr(tracer) == "Tracer(2 primitives, structure='bvh')"


def test_counters_count_spheres() -> None:
    rng = np.random.default_rng(8)
    centers = rng.uniform(-5, 5, (1000, 3))
    tracer = rs.Tracer(rs.Scene.spheres(centers, 0.2), counters=True)
    tracer.first_hit(np.full((100, 3), 9.0), rng.uniform(-5, 5, (100, 3)) - 9.0)
    assert tracer.counters.tests.sum() > 100
    assert tracer.counters.tests.sum() < 100 * 1000
