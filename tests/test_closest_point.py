"""Closest points: against rationals and an oracle, and the same bits from both structures."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import raystream as rs
from meshes import cube, dented_sphere, grid_floor, icosphere, lattice_soup, soup, sticks
from point_oracles import check_feet, check_nearest, exact_square, local_scene, to_local
from strategies import COORDINATES, meshes

#: Stated in `Tracer.closest_point`.
STATED = 2.0**-48

quiet = settings(max_examples=60)


def tracers(vertices, faces):
    scene = rs.Scene.from_arrays(vertices, faces)
    return rs.Tracer(scene), rs.Tracer(scene, "brute")


def points_around(vertices, rng, count):
    """Points in a grown box, on and near triangles' vertices, and far away."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    size = max(float((high - low).max()), 1e-30)
    spread = low + (high - low) * rng.uniform(-0.5, 1.5, (count, 3))
    at = vertices[rng.integers(0, len(vertices), count)]
    between = (at + vertices[rng.integers(0, len(vertices), count)]) / 2
    near = at + rng.normal(size=(count, 3)) * size * 10.0 ** rng.uniform(-9, -1, (count, 1))
    far = at + rng.normal(size=(count, 3)) * size * 10.0 ** rng.uniform(1, 9, (count, 1))
    kind = rng.choice(5, count, p=[0.4, 0.1, 0.15, 0.2, 0.15])[:, None]
    return np.select([kind == k for k in range(5)], [spread, at, between, near, far])


SCENES = {
    "soup": lambda: soup(300, 1),
    "closed": lambda: dented_sphere(3),
    "lattice": lambda: lattice_soup(80),
    "flat": lambda: grid_floor(12),
    "needles": lambda: sticks(400, 1e-4),
    "thinner needles": lambda: sticks(400, 1e-6),
    "one triangle": lambda: soup(1, 4),
    "doubled": lambda: (dented_sphere(2)[0], np.tile(dented_sphere(2)[1], (3, 1))),
    "tiny": lambda: (dented_sphere(2)[0] * 1e-9, dented_sphere(2)[1]),
    "enormous": lambda: (dented_sphere(2)[0] * 1e20, dented_sphere(2)[1]),
    "far from the origin": lambda: (dented_sphere(2)[0] + [1e7, -3e7, 2e7], dented_sphere(2)[1]),
}


def assert_same_bits(found, expected):
    for name in ("distance", "positions", "u", "v", "prim_id", "status"):
        ours, other = getattr(found, name), getattr(expected, name)
        np.testing.assert_array_equal(ours, other, err_msg=name)
        assert ours.dtype == other.dtype


@pytest.mark.parametrize("name", SCENES)
def test_nearest_as_the_oracle_has_it(name):
    vertices, faces = SCENES[name]()
    bvh, brute = tracers(vertices, faces)
    points = points_around(vertices, np.random.default_rng(len(name)), 2_000)
    found = bvh.closest_point(points)
    assert check_nearest(bvh, points, found) == 2_000
    check_feet(bvh, points, found)
    assert_same_bits(found, brute.closest_point(points))


@pytest.mark.exhaustive
@pytest.mark.parametrize("name", SCENES)
def test_a_million_points(name):
    """Together over the scenes: 1.1 million points, none that differs."""
    vertices, faces = SCENES[name]()
    bvh, brute = tracers(vertices, faces)
    points = points_around(vertices, np.random.default_rng(2026), 100_000)
    found = bvh.closest_point(points)
    assert check_nearest(bvh, points, found) == 100_000
    check_feet(bvh, points, found)
    assert_same_bits(found, brute.closest_point(points))


@pytest.mark.parametrize("name", ["soup", "lattice", "needles", "thinner needles", "doubled"])
def test_all_distances_within_the_stated_error_of_rationals(name):
    vertices, faces = SCENES[name]()
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces[:60]))
    points = points_around(vertices, np.random.default_rng(9), 12)
    corners, ids = local_scene(tracer)
    found = tracer.closest_points(points, len(ids))
    local = to_local(tracer, points)
    size = np.linalg.norm(np.ptp(corners, axis=1), axis=-1)
    worst = 0.0
    for i in range(len(points)):
        assert sorted(found.prim_id[i].tolist()) == ids.tolist()
        for distance, prim_id in zip(found.distance[i], found.prim_id[i], strict=True):
            place = np.searchsorted(ids, prim_id)
            expected = math.sqrt(exact_square(local[i], corners[place]))
            worst = max(worst, abs(distance - expected) / (expected + size[place]))
    assert worst <= STATED


def test_shared_edges_and_vertices_are_ties():
    """Outside of a convex mesh: of the triangles at the nearest edge or vertex, the lowest wins."""
    vertices, faces = icosphere(2)
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces))
    rng = np.random.default_rng(3)
    corners, _ = local_scene(tracer)
    edges = rng.integers(0, len(faces), 60)
    share = rng.random((60, 1))
    on_edges = corners[edges, 0] * share + corners[edges, 1] * (1 - share)
    points = np.concatenate([on_edges * 1.5, vertices[rng.integers(0, len(vertices), 60)] * 1.5])
    found = tracer.closest_points(points, 6)
    tie_count = 0
    for point, distance, ids in zip(points, found.distance, found.prim_id, strict=True):
        exact = [exact_square(point, corners[prim_id]) for prim_id in ids]
        ties = [k for k in range(1, 6) if exact[k] == exact[0]]
        tie_count += len(ties)
        assert (distance[ties] == distance[0]).all()
        assert sorted(ids[: len(ties) + 1]) == ids[: len(ties) + 1].tolist()
    assert tie_count > 300


def test_lattice_points_find_the_lowest_of_equals():
    vertices, faces = lattice_soup(60)
    bvh, _ = tracers(vertices, faces)
    corners, ids = local_scene(bvh)
    points = np.random.default_rng(1).integers(-4, 5, (60, 3)).astype(float)
    found = bvh.closest_point(points)
    for point, distance, prim_id in zip(points, found.distance, found.prim_id, strict=True):
        squares = [exact_square(point, triangle) for triangle in corners]
        assert abs(distance - math.sqrt(min(squares))) <= STATED * (distance + 12)
        # Doubled triangles, with the opposite winding, are behind the first half.
        assert prim_id < 60
        if min(squares) == 0:
            assert prim_id == ids[squares.index(0)]


@st.composite
def scenes_and_points(draw):
    (vertices, faces), scale, offset = draw(meshes())
    rows = st.lists(COORDINATES, min_size=3, max_size=3)
    count = draw(st.integers(1, 8))
    points = np.array(draw(st.lists(rows, min_size=count, max_size=count)))
    points = points * draw(st.sampled_from([1.0, 1.0, 1e-3, 1e6])) * scale + offset
    at = vertices[np.arange(count) % len(vertices)]
    kind = draw(st.sampled_from(["free", "at vertices", "between", "above"]))
    if kind == "at vertices":
        points = at
    elif kind == "between":
        points = (at + vertices[np.arange(1, count + 1) % len(vertices)]) / 2
    elif kind == "above":
        points = at + np.eye(3)[draw(st.integers(0, 2))] * scale
    return vertices, faces, points


@quiet
@given(scenes_and_points(), st.integers(1, 5))
def test_bvh_has_the_bits_of_brute_force(drawn, k):
    vertices, faces, points = drawn
    bvh, brute = tracers(vertices, faces)
    assert_same_bits(bvh.closest_points(points, k), brute.closest_points(points, k))
    nearest, rows = bvh.closest_point(points), bvh.closest_points(points, k)
    np.testing.assert_array_equal(nearest.distance, rows.distance[:, 0])
    np.testing.assert_array_equal(nearest.prim_id, rows.prim_id[:, 0])
    assert (rows.distance[:, :-1] <= rows.distance[:, 1:]).all()
    is_tie = (rows.distance[:, :-1] == rows.distance[:, 1:]) & rows.is_found[:, 1:]
    # Squares that differ may have equal roots.
    assert (rows.prim_id[:, :-1] != rows.prim_id[:, 1:])[is_tie].all()
    if len(local_scene(bvh)[1]):
        check_nearest(bvh, points, nearest)


@quiet
@given(scenes_and_points(), st.randoms(use_true_random=False))
def test_the_order_of_triangles_changes_only_ids(drawn, random):
    vertices, faces, points = drawn
    shuffled = list(range(len(faces)))
    random.shuffle(shuffled)
    first = tracers(vertices, faces)[0].closest_point(points)
    second = tracers(vertices, faces[shuffled])[0].closest_point(points)
    np.testing.assert_array_equal(first.distance, second.distance)


@quiet
@given(scenes_and_points())
def test_the_limit_is_inclusive(drawn):
    vertices, faces, points = drawn
    tracer = tracers(vertices, faces)[0]
    nearest = tracer.closest_point(points)
    limits = np.where(np.isfinite(nearest.distance), nearest.distance, 1.0)
    assert_same_bits(tracer.closest_point(points, max_distance=limits), nearest)
    below = np.nextafter(limits, 0.0)
    is_less = below < limits
    missed = tracer.closest_point(points, max_distance=below)
    assert (missed.prim_id[is_less] == -1).all()
    assert (missed.distance[is_less] == np.inf).all()


@pytest.mark.parametrize("k", [1, 7])
def test_other_points_of_the_batch_change_nothing(k):
    """Each search begins with the triangles of the previous point's."""
    vertices, faces = soup(500, 2, 0.05)
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces))
    rng = np.random.default_rng(8)
    points = points_around(vertices, rng, 3_000)
    points[::100] = np.nan
    whole = tracer.closest_points(points, k)
    some = rng.permutation(len(points))[:900]
    picked = tracer.closest_points(points[some], k)
    np.testing.assert_array_equal(picked.distance, whole.distance[some])
    np.testing.assert_array_equal(picked.prim_id, whole.prim_id[some])
    for i in range(0, 3_000, 150):
        alone = tracer.closest_points(points[i], k)
        np.testing.assert_array_equal(alone.positions, whole.positions[i])
        np.testing.assert_array_equal(alone.prim_id, whole.prim_id[i])


def test_boxes_of_the_same_depth_are_told_apart_from_afar():
    """A million sizes away, where float32 knows nothing of the scene's extent."""
    vertices, faces = dented_sphere(3)
    bvh, brute = tracers(vertices, faces)
    points = np.random.default_rng(0).normal(size=(500, 3))
    for factor in (1e3, 1e6, 1e9, 1e30, 1e58):
        found = bvh.closest_point(points * factor)
        assert_same_bits(found, brute.closest_point(points * factor))
        gap = np.linalg.norm(points * factor, axis=1)
        np.testing.assert_allclose(found.distance, gap, rtol=1e-12, atol=5)


def test_cube_by_hand():
    vertices, faces = cube()
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces))
    points = [[0.5, 0.5, 0.75], [2, 2, 2], [0.5, 2, 2], [-3, 0.25, 0.5], [1, 1, 1]]
    found = tracer.closest_point(points)
    expected = [0.25, math.sqrt(3), math.sqrt(2), 3, 0]
    np.testing.assert_array_equal(found.distance, expected)
    np.testing.assert_array_equal(
        found.positions, [[0.5, 0.5, 1], [1, 1, 1], [0.5, 1, 1], [0, 0.25, 0.5], [1, 1, 1]]
    )
