"""No ray slips through a closed mesh, and a surface is crossed once where it is crossed."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from meshes import cube, dented_sphere, icosphere

#: Structures and rays: millions of rays aimed at edges and vertices.
#: Brute force, which tests every triangle, has fewer by default.
MANY = [
    ("brute", 50_000),
    ("bvh", 1_000_000),
    pytest.param("brute", 1_000_000, marks=pytest.mark.exhaustive),
]


def aimed_targets(vertices, faces, rng, count):
    """Vertices, edge midpoints and random points of edges, a third each, with their edges."""
    chosen = faces[rng.integers(0, len(faces), count)]
    share = np.select(
        [np.arange(count) % 3 == 0, np.arange(count) % 3 == 1], [0.0, 0.5], rng.random(count)
    )[:, None]
    return vertices[chosen[:, 0]] * (1 - share) + vertices[chosen[:, 1]] * share, chosen


@pytest.mark.parametrize(("structure", "count"), MANY)
def test_no_ray_escapes_from_inside(structure, count, rng):
    vertices, faces = dented_sphere(2 if structure == "brute" else 5)
    vertices = vertices.astype(np.float32)
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces), structure)
    targets, _ = aimed_targets(vertices.astype(float), faces, rng, count)
    origins = [0.3, -2.0, 1.1] + rng.normal(size=(count, 3)) * 0.05
    assert tracer.count_hits(origins[0], [1.0, 0, 0], crossings="surfaces") % 2 == 1  # inside
    escaped = ~tracer.any_hit(origins, targets - origins)
    assert np.count_nonzero(escaped) == 0
    assert (tracer.first_hit(origins, targets - origins).prim_id >= 0).all()


@pytest.mark.parametrize(("structure", "count"), MANY)
def test_a_convex_mesh_is_crossed_twice_or_grazed(structure, count, rng):
    vertices, faces = icosphere(2 if structure == "brute" else 5)
    vertices = vertices.astype(np.float32)
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces), structure)
    exact = vertices.astype(float)
    targets, _ = aimed_targets(exact, faces, rng, count)
    origins = rng.normal(size=(count, 3))
    origins *= rng.uniform(1.5, 6, (count, 1)) / np.linalg.norm(origins, axis=1, keepdims=True)
    directions = targets - origins
    counts = tracer.count_hits(origins, directions, crossings="surfaces")
    assert set(np.unique(counts)) <= {0, 2}
    # Zero is right only where the ray grazes the silhouette: it then meets the mesh near
    # its target at a right angle to the (smooth) sphere's normal, to the mesh's coarseness.
    grazing = counts == 0
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    outward = targets / np.linalg.norm(targets, axis=1, keepdims=True)
    cosine = np.abs(np.einsum("nk,nk->n", unit, outward))
    longest = np.linalg.norm(exact[faces[:, 0]] - exact[faces[:, 1]], axis=1).max()
    assert (cosine[grazing] < longest).all()
    assert 0 < np.count_nonzero(grazing) < count / 5
    assert (counts[cosine > longest] == 2).all()


@pytest.mark.parametrize("structure", ["brute", "bvh"])
def test_a_dented_mesh_is_crossed_an_even_number_of_times_from_outside(structure, rng):
    count = 200_000
    vertices, faces = dented_sphere(2)
    vertices = vertices.astype(np.float32)
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces), structure)
    targets, _ = aimed_targets(vertices.astype(float), faces, rng, count)
    origins = rng.normal(size=(count, 3))
    origins *= 12 / np.linalg.norm(origins, axis=1, keepdims=True)
    counts = tracer.count_hits(origins, targets - origins, crossings="surfaces")
    assert (counts % 2 == 0).all()
    assert counts.max() >= 4
    many = tracer.multi_hit(origins, targets - origins, crossings="surfaces")
    np.testing.assert_array_equal(many.counts, counts)


def test_crossings_along_a_cube_s_edges_and_diagonals_exactly(make_tracer_anywhere):
    """Integer arithmetic all the way: each ray passes exactly through edges or corners."""
    vertices, faces = cube()
    tracer = make_tracer_anywhere(rs.Scene.from_arrays(vertices, faces))
    corners = vertices
    directions = np.array(
        [
            [x, y, z]
            for x in (-1, 0, 1)
            for y in (-1, 0, 1)
            for z in (-1, 0, 1)
            if (x, y, z) != (0, 0, 0)
        ],
        float,
    )
    origins = (corners[:, None] - 3 * directions[None]).reshape(-1, 3)
    rays = origins, np.broadcast_to(directions, (8, 26, 3)).reshape(-1, 3)
    counts = tracer.count_hits(*rays, crossings="surfaces")
    assert set(counts) <= {0, 2}
    # The four space diagonals enter at one corner and leave at the other.
    diagonal = np.einsum("nk,nk->n", 0.5 - origins, rays[1]) ** 2 == (
        ((0.5 - origins) ** 2).sum(axis=1) * (rays[1] ** 2).sum(axis=1)
    )
    assert diagonal.sum() == 16
    assert (counts[diagonal] == 2).all()
    # Through a corner, all triangles there count as triangles.
    assert (tracer.count_hits(*rays)[diagonal] >= 6).all()


def test_a_shared_edge_is_hit_on_both_sides():
    """Aimed at the diagonal of a square: two triangles, one surface."""
    vertices = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    for structure in ("brute", "bvh"):
        tracer = rs.Tracer(rs.Scene.from_arrays(vertices, [[0, 1, 2], [0, 2, 3]]), structure)
        ray = [0.5, 0.5, 1], [0, 0, -1]
        assert tracer.count_hits(*ray) == 2
        assert tracer.count_hits(*ray, crossings="surfaces") == 1
        assert tracer.first_hit(*ray).prim_id == 0
        assert tracer.multi_hit(*ray).prim_id.tolist() == [0, 1]
