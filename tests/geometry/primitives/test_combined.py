"""Scenes of triangles, height fields and spheres: one search through all of them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import raystream as rs
from conftest import assert_same_bits
from meshes import icosphere, soup

COLUMNS = ("t", "u", "v", "prim_id")


def parts(seed: int = 0, offset: float = 0.0) -> list[rs.Scene]:
    rng = np.random.default_rng(seed)
    place = np.array([offset, offset, 0.0])
    vertices, faces = soup(150, seed)
    first = rs.Scene.height_field(rng.random((13, 10)), origin=place, spacing=0.2)
    second = rs.Scene.height_field(rng.random((5, 22)), origin=place + [0, 0, 1], spacing=-0.2)
    balls = rs.Scene.spheres(rng.random((70, 3)) * 2 + place, rng.uniform(0.01, 0.3, 70))
    more = rs.Scene.spheres(rng.random((9, 3)) * 2 + place, 0.05)
    mesh = rs.Scene.from_arrays(vertices + place, faces)
    return [first, balls, mesh, second, more]


def some_rays(seed: int, count: int, offset: float = 0.0) -> dict:
    rng = np.random.default_rng(seed)
    origins = rng.uniform(-3.0, 4.0, (count, 3))
    directions = rng.uniform(0.0, 2.0, (count, 3)) - origins
    return {"origins": origins + [offset, offset, 0.0], "directions": directions}


def assert_same_queries(scene: rs.Scene, rays: dict) -> int:
    fast, slow = rs.Tracer(scene), rs.Tracer(scene, "brute")
    for limit in (None, 1, 4):
        a, b = fast.multi_hit(**rays, max_hits=limit), slow.multi_hit(**rays, max_hits=limit)
        for column in ("ray_splits", *COLUMNS):
            assert_same_bits(getattr(a, column), getattr(b, column))
    a, b = fast.first_hit(**rays), slow.first_hit(**rays)
    for column in COLUMNS:
        assert_same_bits(getattr(a, column), getattr(b, column))
    assert_same_bits(fast.any_hit(**rays), b.is_hit)
    assert_same_bits(fast.count_hits(**rays), slow.count_hits(**rays))
    return int(slow.count_hits(**rays).sum())


@pytest.mark.parametrize("offset", [0.0, 1e5])
def test_trees_have_the_bits_of_brute_force(offset) -> None:
    scene = rs.Scene.combine(parts(1, offset))
    assert assert_same_queries(scene, some_rays(2, 2000, offset)) > 5000


@given(st.integers(0, 2**16), st.sampled_from([0.0, 1e3]))
@settings(max_examples=20)
def test_any_parts_agree(seed, offset) -> None:
    rng = np.random.default_rng(seed)
    some = [one for one in parts(seed, offset) if rng.random() < 0.6]
    assert_same_queries(rs.Scene.combine(some), some_rays(seed, 40, offset))


def test_all_hits_are_those_of_the_parts() -> None:
    """Each part alone, merged by t: the frames are the same, so the bits are."""
    some, rays = parts(3), some_rays(4, 1500)
    whole = rs.Tracer(rs.Scene.combine(some)).multi_hit(**rays)
    order = [2, 0, 3, 1, 4]  # triangles, height fields, spheres
    counts = [len(some[k].triangles) for k in order]
    firsts = np.cumsum([0, *counts])
    columns = []
    for k, first in zip(order, firsts, strict=False):
        hits = rs.Tracer(some[k]).multi_hit(**rays)
        columns.append((hits.ray_id, hits.t, hits.prim_id + first))
    ray_id, t, prim_id = (np.concatenate(one) for one in zip(*columns, strict=True))
    by = np.lexsort((np.arange(len(t)), prim_id, t, ray_id))
    assert len(t) == len(whole.t) > 5000
    # A triangle's t is clamped to a box that is padded by the size of the scene: a unit of float32.
    np.testing.assert_allclose(whole.t, t[by], rtol=2e-6, atol=2e-6)
    assert np.count_nonzero(whole.prim_id != prim_id[by]) <= 4
    assert_same_bits(whole.ray_id, ray_id[by])
    mesh_id = np.searchsorted(np.cumsum([150, 2 * 12 * 9, 2 * 4 * 21]), whole.prim_id, "right")
    assert_same_bits(whole.mesh_id, mesh_id.astype(np.int32))


def test_positions_normals_and_spawned_rays() -> None:
    scene, rays = rs.Scene.combine(parts(5, 1e4)), some_rays(6, 3000, 1e4)
    tracer = rs.Tracer(scene)
    hits = tracer.first_hit(**rays)
    hits, rows = hits[hits.is_hit], np.flatnonzero(hits.is_hit)
    along = rays["origins"][rows] + hits.t[:, None].astype(float) * rays["directions"][rows]
    np.testing.assert_allclose(hits.positions, along, atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(hits.normals, axis=1), 1.0, atol=1e-6)
    assert len(np.unique(hits.mesh_id)) == 4
    back = -rays["directions"][rows]
    away = np.where(np.einsum("ij,ij->i", back, hits.normals.astype(float)) > 0, 1.0, -1.0)
    again = tracer.multi_hit(*hits.spawn(away[:, None] * hits.normals))
    outside = hits.mesh_id[again.ray_id] < 3
    same = again.prim_id == hits.prim_id[again.ray_id]
    assert not (same & outside).any()


def test_equal_distances_go_to_triangles_first() -> None:
    """A triangle, a cell and a sphere that meet at (0.25, 0.25, 0): numbers that are exact."""
    flat = rs.Scene.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    ground = rs.Scene.height_field(np.zeros((2, 2)))
    ball = rs.Scene.spheres([[0.25, 0.25, -1.0]], 1.0)
    for some, expected in (
        ([flat, ground, ball], [0, 1, 2, 3, 3]),
        ([ball, ground, flat], [0, 1, 2, 3, 3]),
        ([ground, ball], [0, 1, 2, 2]),
    ):
        for structure in ("bvh", "brute"):
            tracer = rs.Tracer(rs.Scene.combine(some), structure)
            many = tracer.multi_hit([0.25, 0.25, 2.0], [0, 0, -1])
            assert many.prim_id.tolist() == expected  # the cell is hit on its diagonal: twice
            assert many.t.tolist() == [2.0] * (len(expected) - 1) + [4.0]
            assert tracer.first_hit([0.25, 0.25, 2.0], [0, 0, -1]).prim_id == 0


def test_materials_follow_each_other() -> None:
    red, blue = rs.Material(name="red"), rs.Material(name="blue")
    balls = rs.Scene.spheres(
        [[0, 0, 5], [0, 9, 5]], 1.0, material_ids=[1, 0], materials=[red, blue]
    )
    vertices, faces = icosphere(1)
    mesh = rs.Scene.from_arrays(vertices + [0, 18, 5], faces)
    ground = rs.Scene.height_field(np.zeros((2, 2)), origin=(0, 27, 5), materials=[blue])
    scene = rs.Scene.combine([mesh, balls, ground])
    assert [one.name for one in scene.materials] == ["", "red", "blue", "blue"]
    hits = rs.Tracer(scene).first_hit([[0, 0, 0], [0, 9, 0], [0, 18, 0], [0.5, 27.2, 0]], [0, 0, 1])
    assert hits.material_id.tolist() == [2, 1, 0, 3]
    assert hits.mesh_id.tolist() == [2, 2, 0, 1]
    assert hits.mesh_prim_id.tolist()[:2] == [0, 1]


def test_bad_parts_are_named() -> None:
    ball = rs.Scene.spheres([[0, 0, 0]], 1.0)
    with pytest.raises(TypeError, match=r"scenes\[1\]: expected a Scene, got int"):
        rs.Scene.combine([ball, 3])
    with pytest.raises(ValueError, match="meshes: all other geometry would be lost"):
        rs.Scene.combine(parts()).replace(meshes=[])


def test_a_scene_keeps_its_primitives_with_other_lights() -> None:
    scene = rs.Scene.combine(parts(7)).replace(lights=[rs.PointLight((0, 0, 9), (1, 1, 1))])
    assert scene.has_primitives
    assert len(scene.lights) == 1
    assert rs.Tracer(scene).count_hits(**some_rays(8, 200)).sum() > 100
    assert np.isfinite(scene.camera.rays(4, 3)[1]).all()
