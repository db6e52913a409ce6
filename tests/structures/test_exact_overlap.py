"""Exact overlap of triangles and boxes, compared with clipping in rational numbers."""

from __future__ import annotations

import itertools
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import raystream as rs
from conftest import assert_same_bits
from meshes import cube, dented_sphere, grid_floor, soup
from raystream.jit.cpu import kernel
from raystream.jit.simd import address
from raystream.structures.clip import BOUND
from raystream.structures.exact_overlap import clip_to_triangle, edges_overlap
from raystream.structures.kdtree.layout import check_arrays
from raystream.structures.saved import solid_mask

quiet = settings(max_examples=150)

#: Coordinates that often lie on the faces of the boxes below, or in a plane of an axis.
numbers = st.one_of(
    st.sampled_from([-1.0, -0.5, 0.0, 0.5, 1.0]),
    st.floats(-2.0, 2.0, width=32).filter(lambda x: abs(x) > 1e-3),
)
points = st.tuples(numbers, numbers, numbers)


@kernel
def _clipped(corners, bound, box):
    return clip_to_triangle(address(corners), bound, address(box))


@kernel
def _edges_overlap(corners, half):
    a = corners[0, 0], corners[0, 1], corners[0, 2]
    b = corners[1, 0], corners[1, 1], corners[1, 2]
    c = corners[2, 0], corners[2, 1], corners[2, 2]
    return edges_overlap(a, b, c, (half[0], half[1], half[2]))


def polygon_in(corners, low, high):
    """The corners of the part of a triangle in a closed box, exactly; Sutherland and Hodgman."""
    polygon = [tuple(map(Fraction, map(float, corner))) for corner in corners]
    for axis in range(3):
        for sign, limit in ((1, Fraction(float(high[axis]))), (-1, -Fraction(float(low[axis])))):
            result = []
            for p, q in zip(polygon, polygon[1:] + polygon[:1], strict=True):
                at_p, at_q = sign * p[axis], sign * q[axis]
                if at_p <= limit:
                    result.append(p)
                if (at_p <= limit) != (at_q <= limit):
                    share = (limit - at_p) / (at_q - at_p)
                    result.append(tuple(x + share * (y - x) for x, y in zip(p, q, strict=True)))
            polygon = result
    return polygon


def has_edge_in_plane(corners, low, high):
    """Whether two corners of a box, as those of an edge, nearly lie in the plane of a triangle."""
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    ends = np.array(list(itertools.product(*zip(low, high, strict=True)))) - corners[0]
    return (np.abs(ends @ normal) <= 1e-2 * np.abs(normal).sum()).sum() > 1


def area_of(corners):
    a, b, c = np.asarray(corners, float)
    return np.linalg.norm(np.cross(b - a, c - a))


# ---- The functions.


@quiet
@given(st.tuples(points, points, points), st.sampled_from([0.5, 1.0, 1e-3]), st.integers(0, 3))
def test_thirteen_axes_are_an_exact_test(corners, size, flat):
    """With the box's own axes and the plane, which the caller tests."""
    corners = np.array(corners)
    half = np.full(3, size)
    half[:flat] *= 0.25
    grown = polygon_in(corners, -half * (1 + 1e-9), half * (1 + 1e-9))
    shrunk = polygon_in(corners, -half * (1 - 1e-9), half * (1 - 1e-9))
    assume(bool(grown) == bool(shrunk))
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    in_box = ((corners.min(axis=0) <= half) & (corners.max(axis=0) >= -half)).all()
    at_plane = abs(normal @ corners[0]) <= np.abs(normal) @ half
    assert bool(in_box and at_plane and _edges_overlap(corners, half)) == bool(grown)


@quiet
@given(st.tuples(points, points, points), points, st.sampled_from([(1, 1, 1), (0.25, 2, 0.5)]))
def test_a_clipped_box_is_that_of_the_clipped_triangle(corners, low, lengths):
    corners = np.array(corners, np.float32)
    assume(area_of(corners) > 1e-6)
    bound = 2.0**-10
    low = np.array(low, np.float32)
    high = (low + np.array(lengths)).astype(np.float32)
    box = np.stack([low, high])
    meets = _clipped(corners, np.float64(bound), box)
    close, far = bound * (1 - 2**-6), bound * (1 + 2**-6)
    least = polygon_in(corners, low.astype(float) - close, high.astype(float) + close)
    most = polygon_in(corners, low.astype(float) - far, high.astype(float) + far)
    # An edge of the box in the triangle's plane is taken for one that meets the triangle, if it
    # meets its bounding box: a reference more, never one less.
    assume(most or not has_edge_in_plane(corners.astype(float), low - bound, high + bound))
    assert bool(least) <= meets <= bool(most)
    if not meets:
        assert_same_bits(box, np.stack([low, high]))
        return
    if least:
        inner = np.array(least, float)
        assert (box[0] <= np.maximum(inner.min(axis=0) - bound, low) + 1e-6).all()
        assert (box[1] >= np.minimum(inner.max(axis=0) + bound, high) - 1e-6).all()
    normal = np.abs(np.cross(corners[1] - corners[0], corners[2] - corners[0]))
    if normal.min() <= 1e-6 * normal.sum():
        return  # an edge of the box may lie in the triangle's plane: then all of it may count
    outer = np.array(most, float)
    loose = 2 * bound
    assert (box[0] >= np.maximum(outer.min(axis=0) - loose, low) - 1e-6).all()
    assert (box[1] <= np.minimum(outer.max(axis=0) + loose, high) + 1e-6).all()


def test_a_triangle_without_a_plane_keeps_its_box():
    box = np.array([[5, 5, 5], [6, 6, 6]], np.float32)
    line = np.array([[0, 0, 0], [1, 1, 1], [2, 2, 2]], np.float32)
    assert _clipped(line, np.float64(0.01), box)
    assert_same_bits(box, np.array([[5, 5, 5], [6, 6, 6]], np.float32))


# ---- Grids.


MESHES = {
    "soup": soup(60, 3, 0.4),
    "closed": dented_sphere(1),
    "floor": grid_floor(4),
    "cube": cube(),
}


def tracer_of(mesh, structure, **options):
    return rs.Tracer(rs.Scene.from_arrays(*mesh), structure, **options)


@pytest.mark.ci
@pytest.mark.parametrize("levels", [1, 2])
@pytest.mark.parametrize("mesh", MESHES)
def test_cells_list_the_triangles_that_overlap_them(mesh, levels):
    options = {"resolution": (5, 4, 3), "levels": levels}
    exact = tracer_of(MESHES[mesh], "grid", overlap="exact", **options).structure
    planes = tracer_of(MESHES[mesh], "grid", **options).structure
    lattice = exact.lattice
    assert not planes.lattice.is_exact
    sides = np.array(lattice.size, float)
    for cell in range(lattice.cell_count):
        i, rest = cell % lattice.counts[0], cell // lattice.counts[0]
        place = np.array([i, rest % lattice.counts[1], rest // lattice.counts[1]])
        low = np.array(lattice.low) + sides * place
        high = np.where(place == np.array(lattice.counts) - 1, lattice.high, low + sides)
        rows = slice(*exact.lists.splits[cell : cell + 2].tolist())
        found = set(exact.lists.references[rows].tolist())
        rows = slice(*planes.lists.splits[cell : cell + 2].tolist())
        assert found <= set(planes.lists.references[rows].tolist())
        for prim_id, corners in enumerate(exact.triangles.corners.astype(float)):
            near, far = 0.98 * lattice.growth, 1.02 * lattice.growth
            if polygon_in(corners, low - near, high + near):
                assert prim_id in found
            elif prim_id in found:
                assert polygon_in(corners, low - far, high + far)
    if mesh == "soup":
        assert len(exact.lists.references) < 0.95 * len(planes.lists.references)
        if levels == 2:
            assert len(exact.fine.lists.references) < 0.9 * len(planes.fine.lists.references)


def test_updated_and_saved_grids_stay_exact(tmp_path, rng):
    vertices, faces = soup(300, 5, 0.2)
    tracer = tracer_of((vertices, faces), "grid", resolution=8, overlap="exact")
    moved = vertices + rng.uniform(-0.01, 0.01, vertices.shape)
    outer = (vertices == vertices.min(axis=0)) | (vertices == vertices.max(axis=0))
    moved = np.where(outer, vertices, np.clip(moved, vertices.min(axis=0), vertices.max(axis=0)))
    tracer.update(moved)
    expected = tracer_of((moved, faces), "grid", resolution=8, overlap="exact")
    got = tracer.structure
    assert got.lattice == expected.structure.lattice
    assert_same_bits(got.lists.references, expected.structure.lists.references)
    planes = tracer_of((moved, faces), "grid", resolution=8).structure
    assert len(got.lists.references) < len(planes.lists.references)
    tracer.save(tmp_path / "grid.npz")
    loaded = rs.Tracer.load(tmp_path / "grid.npz", tracer.scene)
    assert loaded.structure.lattice.is_exact
    assert loaded.structure.options.overlap == "exact"


# ---- kd-trees.


def leaves_of(structure):
    """The cell and the triangles of each leaf."""
    nodes = structure.tree.nodes
    positions = nodes.view(np.float32)[:, 0].astype(float)
    pending = [(0, np.full(3, -np.inf), np.full(3, np.inf))]
    while pending:
        node, low, high = pending.pop()
        axis, number = nodes[node, 1] & 3, nodes[node, 1] >> 2
        if axis == 3:
            first = nodes[node, 0]
            held = structure.tree.prim_ids[first : first + (number + 3) // 4].ravel()[:number]
            yield low, high, set(held.tolist())
            continue
        below, above = high.copy(), low.copy()
        below[axis] = above[axis] = positions[node]
        pending += [(number, low, below), (number + 1, above, high)]


@pytest.mark.ci
@pytest.mark.parametrize("mesh", MESHES)
def test_leaves_list_the_triangles_that_overlap_them(mesh):
    structure = tracer_of(MESHES[mesh], "kdtree", intersection_cost=20.0, overlap="exact").structure
    triangles = structure.triangles
    bound = BOUND * float(triangles.max_coordinate)
    leaf_count = 0
    for low, high, held in leaves_of(structure):
        leaf_count += 1
        low, high = np.maximum(low, -1e3), np.minimum(high, 1e3)
        for prim_id, corners in enumerate(triangles.corners.astype(float)):
            near, far = 0.95 * bound, 1.05 * bound
            if polygon_in(corners, low - near, high + near):
                assert prim_id in held
            elif prim_id in held:
                assert polygon_in(corners, low - far, high + far)
    assert leaf_count > 8
    check_arrays(structure.tree._asdict(), solid_mask(triangles))


def test_a_looser_test_lists_more():
    options = {"intersection_cost": 8.0, "max_depth": 12}
    mesh = soup(2000, 3, 0.2)
    counts = [
        tracer_of(mesh, "kdtree", overlap=overlap, **options).structure.quality()["references"]
        for overlap in ("exact", "plane", "box")
    ]
    assert 2000 < counts[0] < 0.97 * counts[1] < 0.95 * counts[2]


# ---- Answers.


FORMS = [
    ("grid", {"resolution": 9}),
    ("grid", {"resolution": 4, "levels": 2}),
    ("kdtree", {"intersection_cost": 12.0}),
    ("kdtree", {"intersection_cost": 12.0, "traversal": "backtrack", "layout": "foley"}),
]


@pytest.mark.ci
@pytest.mark.parametrize(("structure", "options"), FORMS)
@pytest.mark.parametrize("mesh", MESHES)
def test_ordinary_rays_have_the_usual_hits(mesh, structure, options, rng):
    exact = tracer_of(MESHES[mesh], structure, overlap="exact", **options)
    oracle = rs.Tracer(exact.scene, "brute")
    rays = {"origins": rng.uniform(-1.5, 1.5, (5000, 3)), "directions": rng.normal(size=(5000, 3))}
    hits, expected = exact.first_hit(**rays), oracle.first_hit(**rays)
    for name in ("t", "u", "v", "prim_id"):
        assert_same_bits(getattr(hits, name), getattr(expected, name))
    assert (hits.prim_id >= 0).sum() > 100
    many, expected = exact.multi_hit(**rays), oracle.multi_hit(**rays)
    assert_same_bits(many.ray_splits, expected.ray_splits)
    assert_same_bits(many.t, expected.t)
    assert_same_bits(exact.any_hit(**rays), oracle.any_hit(**rays))


def grazing_rays(rng):
    """A scene, and rays almost in a large triangle's plane that pass its edges."""
    large = np.array([[-1.0, -0.9, -0.3], [1.0, -0.8, 0.2], [0.7, 1.0, 0.6]])
    small = rng.uniform(-1, 1, (3000, 1, 3)) + rng.normal(size=(3000, 3, 3)) * 0.01
    vertices = np.concatenate([large[None], small]).reshape(-1, 3)
    normal = np.cross(large[1] - large[0], large[2] - large[0])
    normal /= np.linalg.norm(normal)
    count = 6000
    share, edge = rng.random((count, 1)), rng.integers(0, 3, count)
    targets = large[edge] * (1 - share) + large[(edge + 1) % 3] * share
    directions = rng.normal(size=(count, 3))
    directions -= np.outer(directions @ normal, normal)
    directions += 1e-9 * rng.normal(size=(count, 1)) * normal
    origins = targets - directions * rng.uniform(0.5, 2, (count, 1))
    mesh = vertices, np.arange(len(vertices)).reshape(-1, 3)
    return mesh, {"origins": origins, "directions": directions}


@pytest.mark.parametrize(("structure", "options"), FORMS)
def test_grazing_rays_may_lose_hits(structure, options, rng):
    """What the guarantee is for; the default, and a whole box per cell, lose none."""
    mesh, rays = grazing_rays(rng)
    oracle = tracer_of(mesh, "brute").count_hits(**rays)
    usual = tracer_of(mesh, structure, **options)
    assert_same_bits(usual.count_hits(**rays), oracle)
    exact = rs.Tracer(usual.scene, structure, overlap="exact", **options)
    lost = oracle.astype(int) - exact.count_hits(**rays).astype(int)
    assert (lost >= 0).all()
    assert 10 < lost.sum() < 0.5 * oracle.sum()
    if structure == "kdtree":
        boxes = rs.Tracer(usual.scene, structure, overlap="box", **options)
        assert_same_bits(boxes.count_hits(**rays), oracle)


@pytest.mark.parametrize(
    ("structure", "words"),
    [
        ("grid", "overlap: expected one of 'plane', 'exact', got 'box'"),
        ("kdtree", "overlap: expected one of 'plane', 'exact', 'box', got 'sat'"),
    ],
)
def test_options_are_checked(structure, words):
    with pytest.raises(ValueError, match=words):
        tracer_of(cube(), structure, overlap="box" if structure == "grid" else "sat")
