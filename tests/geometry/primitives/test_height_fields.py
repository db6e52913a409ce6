"""Height fields: the bits of the mesh of the same triangles, traced by brute force."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import raystream as rs
from conftest import assert_same_bits
from field_rays import PLACES, mesh_of, random_heights, rays_at

COLUMNS = ("t", "u", "v", "prim_id")


def assert_like_the_mesh(heights, rays=None, seed=0, count=1000, **place) -> int:
    """All queries have the bits of the mesh; returns the number of hits."""
    mesh, field = mesh_of(heights, **place), rs.Scene.height_field(heights, **place)
    assert_same_bits(field.bounds, mesh.bounds)
    rays = rays or rays_at(np.random.default_rng(seed), mesh, count)
    slow = rs.Tracer(mesh, "brute")
    total = 0
    for structure in ("bvh", "brute"):
        tracer = rs.Tracer(field, structure)
        a, b = tracer.first_hit(**rays), slow.first_hit(**rays)
        for column in (*COLUMNS, "status", "positions", "normals"):
            assert_same_bits(getattr(a, column), getattr(b, column))
        assert_same_bits(tracer.any_hit(**rays), b.is_hit)
        for crossings in ("triangles", "surfaces"):
            for limit in (None, 2):
                options = {"crossings": crossings, "max_hits": limit}
                a, b = tracer.multi_hit(**rays, **options), slow.multi_hit(**rays, **options)
                for column in ("ray_splits", *COLUMNS):
                    assert_same_bits(getattr(a, column), getattr(b, column))
            counts = tracer.count_hits(**rays, crossings=crossings)
            assert_same_bits(counts, slow.count_hits(**rays, crossings=crossings))
            total += int(counts.sum())
    return total


@pytest.mark.parametrize("name", PLACES)
def test_hits_have_the_bits_of_the_mesh(name) -> None:
    shape, missing, place = PLACES[name]
    heights = random_heights(np.random.default_rng(1), *shape, missing)
    assert assert_like_the_mesh(heights, **place) > 100


@pytest.mark.exhaustive
@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("name", PLACES)
def test_a_million_rays_have_the_bits_of_the_mesh(name, seed) -> None:
    shape, missing, place = PLACES[name]
    heights = random_heights(np.random.default_rng(seed + 50), *shape, missing)
    assert assert_like_the_mesh(heights, seed=seed, count=8_000, **place) > 1000


@st.composite
def fields(draw):
    """Small fields with ties, holes and any spacing."""
    rows, columns = draw(st.integers(2, 11)), draw(st.integers(2, 11))
    values = st.sampled_from([0.0, 0.0, 1.0, -1.0, 0.5, 1e-6, 100.0, np.nan])
    heights = draw(st.lists(values, min_size=rows * columns, max_size=rows * columns))
    heights = np.array(heights).reshape(rows, columns)
    heights[:2, :2] = 0.25  # something to hit
    spacing = draw(st.tuples(*2 * [st.sampled_from([1.0, -1.0, 0.1, 1e3])]))
    origin = draw(st.tuples(*3 * [st.sampled_from([0.0, 1e4])]))
    return heights, spacing, origin, draw(st.integers(0, 2**16))


@given(fields())
@settings(max_examples=40)
def test_any_field_agrees(case) -> None:
    heights, spacing, origin, seed = case
    assert_like_the_mesh(heights, seed=seed, count=60, spacing=spacing, origin=origin)


def test_integers_and_float32_are_taken_as_they_are() -> None:
    rng = np.random.default_rng(2)
    heights = rng.integers(-50, 50, (20, 20), dtype=np.int16)
    assert assert_like_the_mesh(heights, count=300) > 0
    assert assert_like_the_mesh(heights.astype(np.float32) / 3, count=300) > 0


def test_a_mesh_of_a_terrain_has_the_same_triangles() -> None:
    heights = random_heights(np.random.default_rng(3), 12, 9)
    ground = rs.terrain(heights, spacing=(2.0, -2.0), structure="brute")
    rays = rays_at(np.random.default_rng(4), ground.scene, 500)
    field = rs.Tracer(rs.Scene.height_field(heights, spacing=(2.0, -2.0)))
    a, b = field.first_hit(**rays), ground.tracer.first_hit(**rays)
    for column in COLUMNS:
        assert_same_bits(getattr(a, column), getattr(b, column))


def test_rays_leave_height_fields() -> None:
    rng = np.random.default_rng(5)
    tracer = rs.Tracer(rs.Scene.height_field(random_heights(rng, 30, 30)))
    origins = np.array([0.0, 0.0, 20.0]) + rng.uniform(0, 29, (3000, 3)) * [1, 1, 0]
    hits = tracer.first_hit(origins, [0.0, 0.0, -1.0])
    assert hits.is_hit.all()
    again = tracer.multi_hit(*hits.spawn(rng.normal(size=(3000, 3))))
    assert (again.prim_id != hits.prim_id[again.ray_id]).all()


def test_memory_is_near_that_of_the_array() -> None:
    heights = np.zeros((1500, 2000), np.float32)
    tracer = rs.Tracer(rs.Scene.height_field(heights))
    assert tracer.structure.report.byte_count < 1.25 * heights.nbytes


@pytest.mark.parametrize(
    ("heights", "place", "message"),
    [
        ([[0.0, 1.0]], {}, r"heights: expected shape \(H, W\), at least \(2, 2\)"),
        (np.zeros(4), {}, "heights: expected shape"),
        (np.zeros((0, 5)), {}, "heights: expected shape"),
        ([[0, np.inf], [0, 0]], {}, "heights: some are infinite"),
        ([[0, 1e200], [0, 0]], {}, "heights: "),
        (np.zeros((2, 2)), {"spacing": 0.0}, "spacing: expected numbers other than 0"),
        (np.zeros((2, 2)), {"spacing": (1.0, np.nan)}, "origin, spacing: expected finite"),
        (np.zeros((2, 2)), {"spacing": (1.0, 2.0, 3.0)}, "spacing: expected one number or two"),
        (np.zeros((2, 2)), {"origin": (0.0, np.inf, 0.0)}, "origin, spacing: expected finite"),
        (np.zeros((2, 2)), {"origin": (0.0, 0.0)}, r"origin: expected shape \(3,\)"),
        (np.zeros((2, 2)), {"origin": (1e20, 0, 0)}, "spacing: .*move samples along x"),
        (np.zeros((2, 2)), {"material_id": 3}, "material_ids: expected 0 to 0"),
        (np.zeros((2, 2)), {"material_id": -1}, "material_id: expected the number"),
    ],
)
def test_bad_fields_are_named(heights, place, message) -> None:
    with pytest.raises(ValueError, match=message):
        rs.Scene.height_field(heights, **place)


def test_bad_kinds_are_named() -> None:
    with pytest.raises(TypeError, match="heights: expected real numbers"):
        rs.Scene.height_field([["a", "b"], ["c", "d"]])
    with pytest.raises(TypeError, match="heights: expected real numbers"):
        rs.Scene.height_field(np.zeros((2, 2), complex))


def test_a_spacing_that_float32_cannot_tell_apart_is_refused() -> None:
    ball = rs.Scene.spheres([[1e9, 0, 0]], 1.0)
    ground = rs.Scene.height_field(np.zeros((3, 3)), origin=(500.0, 500.0, 0.0), spacing=1e-6)
    with pytest.raises(ValueError, match=r"spacing: neighbouring samples .* in float32"):
        rs.Tracer(rs.Scene.combine([ground, ball]))


def test_heights_that_change_between_scene_and_tracer_are_noticed() -> None:
    heights = np.zeros((20, 20))
    scene = rs.Scene.height_field(heights)
    heights[3, 4] = np.inf
    with pytest.raises(ValueError, match="heights: the array has changed"):
        rs.Tracer(scene)


@pytest.mark.parametrize("structure", ["bvh", "brute"])
def test_a_field_without_data_is_empty(structure) -> None:
    scene = rs.Scene.height_field(np.full((6, 6), np.nan))
    tracer = rs.Tracer(scene, structure)
    assert tracer.first_hit([[2, 2, 5]], [0, 0, -1]).prim_id.tolist() == [-1]
    assert (scene.bounds == 0).all()
