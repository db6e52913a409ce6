"""The kernels for many rays give the bits of brute force, whatever is in the scene."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import raystream as rs
from conftest import assert_same_bits
from field_rays import PLACES, mesh_of, random_heights, rays_at
from meshes import soup
from raystream.geometry.primitives import batches
from raystream.structures.batch_kernels import BatchKernel
from sphere_rays import SETTINGS, some_rays

KERNELS = ("packet", "wavefront")
COLUMNS = ("t", "u", "v", "prim_id")
#: More than are traced ray by ray; not a number of whole groups.
COUNT = 1500

Rays = dict[str, Any]


def assert_like_brute_force(scene: rs.Scene, rays: Rays, kernel: str) -> int:
    """All queries have the bits of brute force; returns the number of hits."""
    fast, slow = rs.Tracer(scene, rs.Bvh(kernel=kernel)), rs.Tracer(scene, "brute")
    a, b = fast.first_hit(**rays), slow.first_hit(**rays)
    for column in (*COLUMNS, "status"):
        assert_same_bits(getattr(a, column), getattr(b, column))
    assert_same_bits(fast.any_hit(**rays), b.is_hit)
    for crossings in ("triangles", "surfaces"):
        a, b = (one.multi_hit(**rays, crossings=crossings) for one in (fast, slow))
        for column in ("ray_splits", *COLUMNS, "status"):
            assert_same_bits(getattr(a, column), getattr(b, column))
        assert_same_bits(fast.count_hits(**rays, crossings=crossings), b.counts)
    return len(b.t)


def spheres_in(name: str, rng) -> tuple[rs.Scene, Rays]:
    """Spheres, of which some are twice in the same place, and hard rays at them."""
    count, size, offset, (least, most), spread = SETTINGS[name]
    centers = rng.uniform(-size, size, (count, 3)) + offset
    radii = np.exp(rng.uniform(np.log(least), np.log(most), count))
    centers[:8], radii[:8] = centers[8:16], radii[8:16]
    rays = some_rays(rng, centers, radii, rng.integers(0, count, COUNT), spread)
    names = "origins", "directions", "t_min", "t_max"
    return rs.Scene.spheres(centers, radii), dict(zip(names, rays, strict=True))


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("name", SETTINGS)
def test_spheres(name, kernel) -> None:
    scene, rays = spheres_in(name, np.random.default_rng(1))
    assert assert_like_brute_force(scene, rays, kernel) > 500


@pytest.mark.exhaustive
@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("name", SETTINGS)
def test_a_million_rays_at_spheres(name, kernel) -> None:
    for seed in range(2, 60):
        scene, rays = spheres_in(name, np.random.default_rng(seed))
        assert_like_brute_force(scene, rays, kernel)


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("name", PLACES)
def test_height_fields(name, kernel) -> None:
    shape, missing, place = PLACES[name]
    rng = np.random.default_rng(2)
    heights = random_heights(rng, *shape, missing)
    rays = rays_at(rng, mesh_of(heights, **place), COUNT)
    scene = rs.Scene.height_field(heights, **place)
    assert assert_like_brute_force(scene, rays, kernel) > 50


def test_a_height_field_in_flight_among_others(monkeypatch) -> None:
    """Spheres and a mesh are searched after it."""
    monkeypatch.setattr(batches, "_LEAST_CELLS", 1)
    rng = np.random.default_rng(5)
    scene = rs.Scene.combine(
        [
            rs.Scene.height_field(rng.random((75, 110)), spacing=0.02),
            rs.Scene.spheres(rng.random((30, 3)) * 2, 0.1),
            rs.Scene.from_arrays(*soup(150, 7)),
        ]
    )
    assert assert_like_brute_force(scene, picture(rng, 0.0, (37, 53)), "wavefront") > 100


def mixed(rng, offset: float = 0.0) -> rs.Scene:
    """Two height fields and one without data, spheres and a mesh."""
    place = np.array([offset, offset, 0.0])
    vertices, faces = soup(150, int(rng.integers(99)))
    parts = [
        rs.Scene.height_field(rng.random((13, 10)), origin=place, spacing=0.2),
        rs.Scene.height_field(np.full((4, 4), np.nan), origin=place),
        rs.Scene.spheres(rng.random((70, 3)) * 2 + place, rng.uniform(0.01, 0.3, 70)),
        rs.Scene.from_arrays(vertices + place, faces),
        rs.Scene.height_field(rng.random((5, 22)), origin=place + [0, 0, 1], spacing=-0.2),
    ]
    return rs.Scene.combine([one for one in parts if rng.random() < 0.8] or parts)


def picture(rng, offset: float, shape: tuple[int, int]) -> Rays:
    """The rays of an image, some of them invalid, far away, or limited."""
    eye = rng.uniform(-4.0, 6.0, 3)
    at = rng.uniform(0.5, 1.5, 3) + rng.uniform(-1.0, 1.0, (*shape, 1)) * rng.normal(size=3)
    directions = at + rng.uniform(-0.1, 0.1, (*shape, 3)) - eye
    origins = np.broadcast_to(eye + [offset, offset, 0.0], directions.shape).copy()
    kind = rng.integers(0, 12, shape)
    directions[kind == 0] = rng.choice([0.0, np.nan])
    origins[kind == 1] -= 1e5 * directions[kind == 1]
    directions[kind == 2] *= 1e-30
    t_max = np.where(kind == 3, rng.random(shape), np.inf)
    return {"origins": origins, "directions": directions, "t_max": t_max.astype(np.float32)}


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("offset", [0.0, 1e5])
def test_scenes_of_all_kinds(offset, kernel) -> None:
    rng = np.random.default_rng(3)
    rays = picture(rng, offset, (37, 53))
    assert assert_like_brute_force(mixed(rng, offset), rays, kernel) > 500


@given(st.integers(0, 2**20), st.sampled_from(KERNELS), st.sampled_from([0.0, 1e4]))
@settings(max_examples=25)
def test_any_scenes_agree(seed, kernel, offset) -> None:
    rng = np.random.default_rng(seed)
    rays = picture(rng, offset, (int(rng.integers(1, 30)), int(rng.integers(1, 40))))
    assert_like_brute_force(mixed(rng, offset), rays, kernel)


@pytest.mark.parametrize("kernel", KERNELS)
def test_equal_distances_go_to_triangles_first(kernel) -> None:
    flat = rs.Scene.from_arrays([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    ground, ball = rs.Scene.height_field(np.zeros((2, 2))), [[0.25, 0.25, -1.0]]
    scene = rs.Scene.combine([rs.Scene.spheres(ball * 2, 1.0), ground, flat])
    rays = np.full((COUNT, 3), [0.25, 0.25, 2.0]), [0.0, 0.0, -1.0]
    tracer = rs.Tracer(scene, rs.Bvh(kernel=kernel))
    assert (tracer.first_hit(*rays).prim_id == 0).all()
    many = tracer.multi_hit(*rays)
    assert (many.prim_id.reshape(COUNT, -1) == [0, 1, 2, 3, 4, 3, 4]).all()
    alone = rs.Tracer(rs.Scene.spheres(ball * 2, 1.0), rs.Bvh(kernel=kernel))
    assert (alone.first_hit(*rays).prim_id == 0).all()


def kernels_called(monkeypatch, tracer: rs.Tracer, query: str, rays: Rays) -> list[str]:
    """The kernels that a query calls."""
    called = []

    def noted(name: str, kernel: BatchKernel) -> BatchKernel:
        def bind(structure, batch):
            called.append(name)
            return kernel.bind(structure, batch)

        return kernel._replace(bind=bind)

    table = tracer.structure.batch_kernels
    for kind, known in table.items():
        kernels = {name: noted(name, one) for name, one in known.kernels.items()}
        monkeypatch.setitem(table, kind, known._replace(kernels=kernels))
    getattr(tracer, query)(**rays)
    monkeypatch.undo()
    return called


@pytest.mark.parametrize("query", ["first_hit", "any_hit", "count_hits", "multi_hit"])
@pytest.mark.parametrize(("count", "kernel"), [(100, "single"), (30_000, "wavefront")])
def test_kernels_suit_the_rays(monkeypatch, query, count, kernel) -> None:
    rng = np.random.default_rng(4)
    tracer = rs.Tracer(rs.Scene.spheres(rng.uniform(-1, 1, (count, 3)), 0.01))
    directions = rs.Camera((0.0, 0.0, 4.0), (0.0, 0.0, 0.0)).rays(160, 90)[1]
    rays = {"origins": [0.0, 0.0, 4.0], "directions": directions}
    assert kernels_called(monkeypatch, tracer, query, rays) == ["packet"]
    anywhere = {"origins": rng.uniform(-1, 1, (3000, 3)), "directions": rng.normal(size=(3000, 3))}
    assert kernels_called(monkeypatch, tracer, query, anywhere) == [kernel]


@pytest.mark.parametrize(("side", "kernel"), [(100, "single"), (750, "wavefront")])
def test_kernels_suit_height_fields(monkeypatch, side, kernel) -> None:
    rng = np.random.default_rng(4)
    tracer = rs.Tracer(rs.Scene.height_field(rng.random((side, side))))
    anywhere = {
        "origins": rng.uniform(0, side - 1, (3000, 3)),
        "directions": rng.normal(size=(3000, 3)),
    }
    for query in ("first_hit", "any_hit", "count_hits", "multi_hit"):
        assert kernels_called(monkeypatch, tracer, query, anywhere) == [kernel]
