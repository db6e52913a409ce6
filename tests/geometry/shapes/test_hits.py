"""Rays at shapes of users: closed forms, fine meshes, brute force, and the engine's own spheres."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import raystream as rs
import users_shapes as users
from conftest import assert_same_bits
from users_shapes import CASES, rays_near, some

COLUMNS = ("t", "u", "v", "prim_id")


def assert_like_brute_force(scene: rs.Scene, rays: dict[str, Any], kernel: str) -> int:
    """All queries have the bits of brute force; returns the number of hits."""
    fast, slow = rs.Tracer(scene, rs.Bvh(kernel=kernel)), rs.Tracer(scene, "brute")
    a, b = fast.first_hit(**rays), slow.first_hit(**rays)
    for column in (*COLUMNS, "status"):
        assert_same_bits(getattr(a, column), getattr(b, column))
    assert_same_bits(fast.any_hit(**rays), b.is_hit)
    a, b = (one.multi_hit(**rays) for one in (fast, slow))
    for column in ("ray_splits", *COLUMNS, "status"):
        assert_same_bits(getattr(a, column), getattr(b, column))
    assert_same_bits(fast.count_hits(**rays), b.counts)
    return len(b.t)


@pytest.mark.parametrize("kernel", ["packet", "single"])
@pytest.mark.parametrize("name", CASES)
def test_trees_have_the_bits_of_brute_force(name, kernel) -> None:
    rays = rays_near(np.random.default_rng(1), 1500)
    assert assert_like_brute_force(some([name]), rays, kernel) > 300


@pytest.mark.parametrize("offset", [0.0, 1e5])
@pytest.mark.parametrize("kernel", ["packet", "wavefront"])
def test_scenes_of_all_kinds(kernel, offset) -> None:
    rng = np.random.default_rng(2)
    mesh = rs.Scene.from_arrays(rng.uniform(-4, 4, (60, 3)) + offset, np.arange(60).reshape(20, 3))
    spheres = rs.Scene.spheres(rng.uniform(-4, 4, (20, 3)) + offset, 0.5)
    ground = rs.Scene.height_field(rng.random((9, 9)), origin=[offset - 4] * 3)
    scene = rs.Scene.combine([mesh, some(CASES, 3, 5, offset), spheres, ground])
    assert assert_like_brute_force(scene, rays_near(rng, 1500, offset), kernel) > 500


@pytest.mark.parametrize("other", ["spheres", "field"])
def test_shapes_beside_one_tree_in_flight(other) -> None:
    rng = np.random.default_rng(4)
    spheres = rs.Scene.spheres(rng.uniform(-4, 4, (20, 3)), 0.5)
    ground = rs.Scene.height_field(rng.random((9, 9)), origin=[-4] * 3)
    scene = rs.Scene.combine([spheres if other == "spheres" else ground, some(["ball"], 3, 5)])
    assert assert_like_brute_force(scene, rays_near(rng, 1500), "wavefront") > 300


@settings(max_examples=15, deadline=None)
@given(
    names=st.lists(st.sampled_from(list(CASES)), min_size=1, max_size=3),
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(1, 12),
    offset=st.sampled_from([0.0, -1e3, 1e7]),
)
def test_any_shapes_agree(names, seed, count, offset) -> None:
    rays = rays_near(np.random.default_rng(seed), 300, offset)
    assert_like_brute_force(some(names, seed, count, offset), rays, "packet")


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", CASES)
def test_a_million_rays(name) -> None:
    for seed in range(10, 110):
        scene = some([name], seed, 30, [0.0, 1e3, 1e7][seed % 3])
        rays = rays_near(np.random.default_rng(seed), 10_000, [0.0, 1e3, 1e7][seed % 3])
        assert_like_brute_force(scene, rays, ["packet", "single"][seed % 2])


# Spheres


def test_balls_of_users_are_spheres() -> None:
    """The same ids and numbers of hits; distances to the last bit, as the formula is the same."""
    records = users.balls(np.random.default_rng(5), 50)
    rays = rays_near(np.random.default_rng(6), 4000)
    mine = rs.Tracer(rs.Scene.shapes(users.ball, records))
    own = rs.Tracer(rs.Scene.spheres(records["center"], records["radius"]))
    a, b = mine.multi_hit(**rays), own.multi_hit(**rays)
    assert_same_bits(a.ray_splits, b.ray_splits)
    same = a.prim_id == b.prim_id
    assert same.mean() > 0.999
    np.testing.assert_allclose(a.t, b.t, rtol=1e-6)
    np.testing.assert_allclose(a.positions[same], b.positions[same], atol=3e-6)
    np.testing.assert_allclose(a.normals[same], b.normals[same], atol=6e-6)


# Closed forms: how far hits are from the surface


def _lengths(vectors: np.ndarray) -> np.ndarray:
    return np.linalg.norm(vectors, axis=-1)


def _beside(records: Any, points: np.ndarray, name: str) -> np.ndarray:
    """About how far points are from surfaces."""
    center = records["center"] if "center" in records.dtype.names else 0.0
    place = points - center
    if name == "ball":
        return _lengths(place) - records["radius"]
    if name == "bitten":
        other = _lengths(points - records["bite"]) - records["bite_radius"]
        own = _lengths(place) - records["radius"]
        assert (own < 1e-5).all()
        assert (other > -1e-5).all()
        return np.minimum(np.abs(own), np.abs(other))
    if name == "torus":
        around = np.hypot(place[:, 0], place[:, 1]) - records["major"]
        return np.hypot(around, place[:, 2]) - records["minor"]
    if name == "capsule":
        line = records["b"] - records["a"]
        share = ((points - records["a"]) * line).sum(-1) / (line * line).sum(-1)
        nearest = records["a"] + np.clip(share, 0.0, 1.0)[:, None] * line
        return _lengths(points - nearest) - records["radius"]
    if name == "tube":
        s = np.linspace(0.0, 1.0, 2001)[:, None]
        weights = np.stack([(1 - s) ** 2, 2 * s * (1 - s), s * s])
        curve = np.einsum("ksx,nkd->nsd", weights, records["points"])
        return _lengths(points[:, None] - curve).min(axis=1) - records["radius"]
    if name == "rounded":
        outer = np.abs(place) - (records["half"] - records["round"][:, None])
        return _lengths(np.maximum(outer, 0.0)) - records["round"]
    if name == "disc":
        axis = records["normal"] / _lengths(records["normal"])[:, None]
        assert (_lengths(place) <= records["radius"] + 1e-5).all()
        return (place * axis).sum(-1)
    value = (records["factors"] * place * place).sum(-1) - records["constant"]
    return value / (2.0 * _lengths(records["factors"] * place))


@pytest.mark.parametrize("name", CASES)
def test_hits_are_on_the_surface(name) -> None:
    shape, make, _ = CASES[name]
    records, rays = make(np.random.default_rng(7), 40), rays_near(np.random.default_rng(8), 2000)
    hits = rs.Tracer(rs.Scene.shapes(shape, records)).multi_hit(**rays)
    assert len(hits.t) > 300
    beside = _beside(records[hits.prim_id], hits.positions, name)
    np.testing.assert_allclose(beside, 0.0, atol=4e-6 if name == "tube" else 1e-9)
    origins, directions = (rays[key][hits.ray_id] for key in ("origins", "directions"))
    along = origins + hits.t.astype(float)[:, None] * directions
    np.testing.assert_allclose(along, hits.positions, atol=1e-5)
    ends = [hits.positions + size * hits.normals for size in (1e-3, -1e-3)]
    outside, inside = (
        (_beside(records[hits.prim_id], end, name) for end in ends)
        if name
        not in (
            "bitten",
            "disc",
        )
        else (np.ones(1), np.zeros(1))
    )
    assert (outside > inside).all()


# Meshes


@pytest.mark.parametrize("name", CASES)
def test_meshes_of_the_shapes_are_hit_alike(name) -> None:
    """All crossings but those that graze, to the size of the mesh's error."""
    shape, make, mesh = CASES[name]
    records = make(np.random.default_rng(9), 6)
    rays = rays_near(np.random.default_rng(10), 4000)
    rays["directions"] /= _lengths(rays["directions"])[:, None]
    own = rs.Tracer(rs.Scene.shapes(shape, records)).multi_hit(**rays)
    tracer = rs.Tracer(rs.Scene.combine([mesh(one, 128) for one in records]))
    others = tracer.multi_hit(**rays, crossings="surfaces")
    same = own.counts == others.counts
    assert same.mean() > 0.995
    rows, rows_there = same[own.ray_id], same[others.ray_id]
    cosine = (own.normals * rays["directions"][own.ray_id]).sum(axis=1)[rows]
    apart = np.abs(own.t[rows] - others.t[rows_there]) * np.abs(cosine)
    assert np.quantile(apart, 0.99) < 1e-3
    assert len(apart) > 100
