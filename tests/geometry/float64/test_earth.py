"""A scene of the Earth's size with millimetres: every answer is that of exact arithmetic."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from exact_oracle import nearest_many, on_grain
from meshes import cube, icosphere

RADIUS = 6.4e6


def earth(seed: int, cube_count: int) -> tuple[np.ndarray, np.ndarray]:
    """A sphere of the Earth's size, and cubes of millimetres on its triangles."""
    rng = np.random.default_rng(seed)
    points, faces = icosphere(1)
    points = points.astype(np.float64) * RADIUS
    all_points, all_faces = [points], [faces]
    corners, cube_faces = cube()
    for _ in range(cube_count):
        weights = rng.dirichlet([1.0, 1.0, 1.0])
        spot = weights @ points[faces[rng.integers(len(faces))]]
        size = 10.0 ** rng.uniform(-3.0, -2.0)
        all_faces.append(cube_faces + sum(map(len, all_points)))
        all_points.append(spot + (corners - corners.mean(axis=0)) * size)
    return on_grain(np.concatenate(all_points)), np.concatenate(all_faces)


def rays_at(seed: int, count: int, vertices, faces) -> tuple[np.ndarray, np.ndarray]:
    """Rays at vertices, points of edges and insides of small and large triangles.

    From a millimetre to ten thousand kilometres away; some directions are exact, most are rounded.
    """
    rng = np.random.default_rng(seed)
    corners = vertices[faces[rng.integers(0, len(faces), count)]]
    weights = rng.dirichlet([0.6, 0.6, 0.6], count)
    kinds = rng.integers(0, 4, count)
    weights[kinds == 0] = [1.0, 0.0, 0.0]
    weights[kinds == 1] = [0.5, 0.5, 0.0]
    targets = np.einsum("nk,nkx->nx", weights, corners)
    way = rng.normal(size=(count, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    way = np.where((way * targets).sum(axis=1, keepdims=True) < 0.0, -way, way)
    origins = on_grain(targets + way * 10.0 ** rng.uniform(-3.0, 7.0, (count, 1)))
    return origins, on_grain(targets - origins)


def check(count: int, cube_count: int, seed: int) -> None:
    vertices, faces = earth(seed, cube_count)
    origins, directions = rays_at(seed, count, vertices, faces)
    t, prim_id = nearest_many(origins, directions, vertices[faces])
    assert 0.3 < (prim_id >= 80).mean() < 1.0  # millimetres
    scene = rs.Scene.from_arrays(vertices, faces)
    for structure in ("bvh", rs.Bvh(kernel="single"), "brute"):
        hits = rs.Tracer(scene, structure, precision="float64").first_hit(origins, directions)
        assert np.array_equal(hits.prim_id, prim_id)
        assert np.array_equal(hits.t, t)
        # Positions are as exact as world coordinates are.
        spots = origins + directions * t[:, None]
        is_hit = hits.is_hit
        error = np.abs(hits.positions[is_hit] - spots[is_hit]).max()
        assert error < 1e-7


def test_rays_agree_with_exact_arithmetic():
    check(20_000, 20, seed=1)


@pytest.mark.exhaustive
@pytest.mark.parametrize("part", range(20))
def test_a_million_rays_agree_with_exact_arithmetic(part):
    check(50_000, 20, seed=100 + part)


def test_float32_is_too_coarse_here():
    """What the precision is for: the same scene in float32 finds few of the same triangles."""
    vertices, faces = earth(1, 20)
    origins, directions = rays_at(1, 2000, vertices, faces)
    scene = rs.Scene.from_arrays(vertices, faces)
    exact = rs.Tracer(scene, precision="float64").first_hit(origins, directions)
    coarse = rs.Tracer(scene).first_hit(origins, directions)
    assert (exact.prim_id != coarse.prim_id).mean() > 0.5
