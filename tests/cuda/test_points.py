"""Closest points on CUDA: the CPU's bits, from both structures."""

from __future__ import annotations

import numpy as np
import pytest

from extras import need

need("numba_cuda")

import raystream as rs
from meshes import cube, dented_sphere, lattice_soup, soup
from raystream.jit.cuda import is_simulated
from scene_cases import SCENE_CASES
from test_closest_point import assert_same_bits, points_around

SCENES = {
    "soup": lambda: soup(60, 1),
    "closed": lambda: dented_sphere(1),
    "lattice": lambda: lattice_soup(40),
    "far from the origin": lambda: (dented_sphere(1)[0] + [1e7, -3e7, 2e7], dented_sphere(1)[1]),
    "no triangles": lambda: (np.zeros((3, 3)), np.zeros((0, 3), int)),
}

#: The simulator takes a millisecond for a point.
COUNT = 30
SLOW = [pytest.mark.exhaustive] * is_simulated()


@pytest.mark.parametrize("structure", ["bvh", "brute"])
@pytest.mark.parametrize("name", SCENES)
def test_points_have_the_cpu_s_bits(gpu, structure, name):
    vertices, faces = SCENES[name]()
    scene = rs.Scene.from_arrays(vertices, faces)
    points = points_around(vertices, np.random.default_rng(len(name)), COUNT)
    points[0, 1], points[1, 2], points[2] = np.nan, np.inf, 2.0**201
    limits = np.where(np.arange(COUNT) % 3 == 0, 0.1 * np.ptp(vertices), np.inf)
    ours, theirs = rs.Tracer(scene, structure, "cuda"), rs.Tracer(scene, "brute")
    for limit in (np.inf, limits):
        expected = theirs.closest_point(points, max_distance=limit)
        assert_same_bits(ours.closest_point(points, max_distance=limit), expected)
    rows = theirs.closest_points(points, 3)
    assert_same_bits(ours.closest_points(points, 3), rows)
    assert rows.status.tolist()[:4] == [1, 1, 1, 0]


#: Kinds of scene besides triangles in float32.
KINDS = {
    "instances": lambda: SCENE_CASES["mirrors_and_uneven_scales"](np.random.default_rng(1))[0],
    "primitives": lambda: SCENE_CASES["primitives_of_all_kinds"](np.random.default_rng(1))[0],
    "float64": lambda: rs.Scene.from_arrays(*SCENES["far from the origin"]()),
}

#: The simulator compiles a tree's kernel for the processor in ten seconds; test_ptx.py has them
#: in a default run.
KINDS_OF_STRUCTURES = [
    ("brute", kind) if structure == "brute" else pytest.param(structure, kind, marks=SLOW)
    for structure in ("bvh", "brute")
    for kind in KINDS
]


@pytest.mark.parametrize(("structure", "kind"), KINDS_OF_STRUCTURES)
def test_points_of_other_kinds_have_the_cpu_s_bits(gpu, structure, kind):
    scene = KINDS[kind]()
    options = {"precision": "float64"} if kind == "float64" else {}
    theirs = rs.Tracer(scene, "brute", **options)
    ours = rs.Tracer(scene, structure, "cuda", **options)
    points = points_around(np.array(scene.bounds), np.random.default_rng(3), COUNT)
    points[0, 1], points[1, 2], points[2] = np.nan, np.inf, 2.0**201
    rows = theirs.closest_points(points, 3)
    assert_same_bits(ours.closest_points(points, 3), rows)
    limits = np.where(np.arange(COUNT) % 3 == 0, rows.distance[:, 0], np.inf)
    expected = theirs.closest_point(points, max_distance=limits)
    found = ours.closest_point(points, max_distance=limits)
    assert_same_bits(found, expected)
    if kind == "instances":
        np.testing.assert_array_equal(found.instance_id, expected.instance_id)
        moved = scene.placements.transforms + [0.0, 0.0, 0.0, 0.5]
        for one in (ours, theirs):
            one.update(transforms=moved)
        assert_same_bits(ours.closest_points(points, 3), theirs.closest_points(points, 3))


def test_distances_of_other_kinds_by_hand(gpu):
    """From the CPU's tests, one thread a point."""
    balls = rs.Scene.spheres([[0, 0, 0], [10, 0, 0]], [2.0, 1.0])
    slope = rs.Scene.height_field(np.add.outer(np.zeros(9), np.arange(9.0)))
    cubes = rs.Scene.instances(rs.Scene.from_arrays(*cube()), [np.diag([4.0, 1, 1]) @ np.eye(3, 4)])
    cases = (
        (balls, [[0, 0, 0], [0, 1, 0], [6, 0, 0], [10, 0, 0.5]], [2.0, 1.0, 3.0, 0.5]),
        (slope, [[4, 4, 6], [-3, 4, -4], [4, 12, 4]], [np.sqrt(2), 5.0, 4.0]),
        (cubes, [[2, 0.5, 3], [7, 0.5, 0.5]], [2.0, 3.0]),
    )
    for scene, points, expected in cases:
        found = rs.Tracer(scene, "brute", "cuda").closest_point(points)
        np.testing.assert_allclose(found.distance, expected, 1e-15)


def test_points_come_in_parts(gpu, monkeypatch):
    scene = rs.Scene.from_arrays(*soup(30, 2))
    points = points_around(soup(30, 2)[0], np.random.default_rng(1), COUNT).reshape(2, -1, 3)
    expected = rs.Tracer(scene).closest_points(points, 2, max_distance=[[0.5], [np.inf]])
    steps = []
    tracer = rs.Tracer(scene, "brute", "cuda", rays_at_once=7)
    found = tracer.closest_points(
        points,
        2,
        max_distance=[[0.5], [np.inf]],
        progress=lambda done, count: steps.append((done, count)),
    )
    assert_same_bits(found, expected)
    assert steps == [(done, COUNT) for done in (7, 14, 21, 28, 30)]
    monkeypatch.setattr("raystream.cuda.points._MOST_BYTES", 1)  # one at a time, at least
    assert_same_bits(
        tracer.closest_points(points[:, :2], 2), rs.Tracer(scene).closest_points(points[:, :2], 2)
    )
    none = tracer.closest_point(np.zeros((0, 3)))
    assert none.distance.shape == (0,)


def test_signed_distances_and_insides(gpu):
    scene = rs.Scene.from_arrays(*cube())
    low, high = scene.bounds
    points = low + (high - low) * np.random.default_rng(2).uniform(-0.5, 1.5, (COUNT, 3))
    ours, theirs = rs.Tracer(scene, device="cuda"), rs.Tracer(scene)
    np.testing.assert_array_equal(ours.signed_distance(points), theirs.signed_distance(points))
    inside = ours.contains(points)
    assert 0 < inside.sum() < COUNT
    np.testing.assert_array_equal(inside, theirs.contains(points))


@pytest.mark.parametrize("offset", [5.0, 2.0**30])  # also in another frame
def test_a_moved_scene_is_searched_where_it_is(gpu, offset):
    vertices, faces = cube()
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces), device="cuda")
    before = tracer.closest_point([9.0, 0.0, 0.0]).distance
    moved = rs.Scene.from_arrays(vertices + [offset, 0.0, 0.0], faces)
    tracer.update(vertices + [offset, 0.0, 0.0])
    expected = rs.Tracer(moved, "brute").closest_point([9.0 + offset, 0.0, 0.0]).distance
    assert tracer.closest_point([9.0 + offset, 0.0, 0.0]).distance == expected == before


def test_a_tree_that_was_built_on_the_device_is_searched_there(device):
    vertices, faces = soup(40, 5)
    tracer = rs.Tracer(rs.Scene.from_arrays(vertices, faces), device="cuda", build="device")
    points = points_around(vertices, np.random.default_rng(6), COUNT)
    for _ in range(2):
        expected = rs.Tracer(rs.Scene.from_arrays(vertices, faces), "brute").closest_points(
            points, 2
        )
        assert_same_bits(tracer.closest_points(points, 2), expected)
        vertices = vertices[::-1] * [1.0, -1.0, 1.0]
        tracer.update(vertices)


def test_what_finds_no_points_says_what_does(gpu):
    scene = rs.load("cornell")
    for structure in ("grid", "kdtree"):
        tracer = rs.Tracer(scene, structure, "cuda")
        with pytest.raises(ValueError, match="device='cpu' or 'cuda' and machine='branching'"):
            tracer.closest_point([0.0, 0.0, 0.0])
