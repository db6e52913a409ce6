"""The kd-tree as a structure: options, hard rays, and four traversals of the same leaves."""

import numpy as np
import pytest

import raystream as rs
from cases import CASES
from conftest import assert_same_bits
from meshes import dented_sphere, grid_floor, soup
from raystream.core.npz import read_npz, write_npz
from raystream.core.query import Kind, Query
from raystream.core.rays import RayBatch
from raystream.jit.cpu import kernel
from raystream.jit.simd import scratch
from raystream.kernels.local_frame import LocalRays
from raystream.kernels.ray import prepare_ray
from raystream.machines import Branching
from raystream.structures.kdtree.nodes import is_leaf, leaf_of
from raystream.structures.kdtree.options import LAYOUTS, TRAVERSALS
from raystream.structures.kdtree.state import STACK_BYTES
from raystream.structures.kdtree.structure import KdTreeStructure
from raystream.structures.kdtree.traversal import descend, initialize
from raystream.structures.kdtree.traversals import continue_search
from raystream.structures.kdtree.traversals.backtrack import backtrack
from raystream.structures.plane_distances import split_ray
from test_agreement import assert_same_answers, rays_of

FORMS = [(traversal, layout) for layout in LAYOUTS for traversal in TRAVERSALS]


def build(vertices, faces, **options):
    """A tracer, by default with costs that make a deep tree."""
    options = {"intersection_cost": 12.0, **options}
    return rs.Tracer(rs.Scene.from_arrays(vertices, faces), "kdtree", **options)


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("traversal", "ropes", "expected one of .*'short-stack', got 'ropes'"),
        ("layout", None, "expected one of 'compact', 'foley', got None"),
        ("traversal_cost", 0.0, "expected 1e-6 to 1e6, got 0.0"),
        ("intersection_cost", np.nan, "expected 1e-6 to 1e6, got nan"),
        ("empty_bonus", 1.5, "expected 0 to 1, got 1.5"),
        ("max_depth", 65, "expected 0 to 64, got 65"),
        ("max_depth", -1, "expected 0 to 64, got -1"),
        ("max_leaf_size", 0, "expected 1 to 1024, got 0"),
    ],
)
def test_options_are_checked(name, value, words):
    with pytest.raises(ValueError, match=f"{name}: {words}"):
        build(*soup(2), **{name: value})


def test_options_must_be_numbers():
    with pytest.raises(TypeError):
        build(*soup(2), max_depth=2.5)
    with pytest.raises(TypeError, match="leaf"):
        build(*soup(2), leaf=3)


@pytest.mark.parametrize(("traversal", "layout"), FORMS)
def test_bytes_are_reported(traversal, layout):
    structure = build(*soup(300, 1), traversal=traversal, layout=layout).structure
    quality = structure.quality()
    assert quality["leaves"] == (quality["nodes"] + 1) / 2
    splits = quality["nodes"] - quality["leaves"]
    node_bytes = (8 if layout == "compact" else 12) * quality["nodes"]
    if traversal == "backtrack":
        node_bytes += 32 * splits
    assert quality["bytes per node"] == node_bytes / quality["nodes"]
    held = {id(array): array.nbytes for array in (*structure.tree, *structure.arrays.values())}
    assert structure.report.byte_count == sum(held.values())
    assert structure.report.seconds > 0
    assert quality["cost"] > quality["splits per ray"] > 1
    assert quality["references"] >= 300


def test_quality_of_nothing():
    assert rs.Tracer(rs.Scene(), "kdtree").structure.quality()["nodes"] == 0


@kernel
def record_leaves(begin, end, tree, max_coordinate, rays, leaves, counts):
    """Every leaf along a ray; and counts of splits, leaves, backtracking steps and restarts."""
    stack = scratch(STACK_BYTES)
    o, d = rays.origins, rays.directions
    for i in range(np.uint64(begin), np.uint64(end)):
        ray = prepare_ray(o[i], d[i], max_coordinate)
        is_active, state = initialize(tree, ray, rays.t_min[i], rays.t_max[i])
        if not is_active:
            continue
        line = split_ray(ray)
        while True:
            while not is_leaf(tree, state.node):
                state = descend(tree, line, state, stack)
                counts[i, 0] += 1
            row = counts[i, 1]
            counts[i, 1] += 1
            triangles = leaf_of(tree, state.node)
            if counts[i, 1] > leaves.shape[1]:
                break
            leaves[i, row, 0], leaves[i, row, 1] = state.t_in, state.t_out
            leaves[i, row, 2] = np.float64(triangles.block - tree.blocks)
            leaves[i, row, 3] = np.float64(triangles.triangle_count)
            if state.t_out >= state.t_end:
                break
            state = continue_search(tree, state, stack)
            counts[i, 3] += 1
            while state.is_backtracking:
                state = backtrack(tree, line, state)
                counts[i, 2] += 1


def recorded(structure, origins, directions, t_min=-np.inf, t_max=np.inf):
    count = len(origins)
    rays = LocalRays(
        np.ascontiguousarray(origins, np.float32),
        np.ascontiguousarray(directions, np.float32),
        np.full(count, t_min, np.float32),
        np.full(count, t_max, np.float32),
    )
    leaves = np.zeros((count, int(structure.quality()["leaves"]) + 1, 4))
    counts = np.zeros((count, 4), np.int64)
    max_coordinate = structure.triangles.max_coordinate
    record_leaves(0, count, structure.view, max_coordinate, rays, leaves, counts)
    assert (counts[:, 1] < leaves.shape[1]).all(), "a ray sees no leaf twice"
    return leaves, counts


def rays_on_planes(structure, rng, count=400):
    """Rays in split planes, from points on them, along their edges; and ordinary ones."""
    nodes = structure.tree.nodes
    splits = np.flatnonzero(nodes[:, 1] & 3 != 3)
    low, high = structure.triangles.bounds.astype(float)
    origins = low + rng.random((count, 3)) * (high - low) * 1.5
    directions = rng.normal(size=(count, 3))
    for _ in range(2):
        split = rng.choice(splits, count)
        axis = nodes[split, 1] & 3
        rows = np.flatnonzero(rng.random(count) < 0.7)
        origins[rows, axis[rows]] = nodes.view(np.float32)[split[rows], 0]
        rows = np.flatnonzero(rng.random(count) < 0.5)
        directions[rows, axis[rows]] = rng.choice([0.0, -0.0, 1e-30, 1e-7], len(rows))
    directions[~directions.any(axis=1)] = (0, 1, 0)
    scale = 2.0 ** -np.floor(np.log2(np.abs(directions).max(axis=1, keepdims=True)))
    return origins.astype(np.float32), (directions * scale).astype(np.float32)


@pytest.mark.parametrize(
    "mesh",
    [
        soup(300),
        grid_floor(8),
        dented_sphere(2),
        pytest.param(dented_sphere(3), marks=pytest.mark.exhaustive),
    ],
)
def test_all_traversals_see_the_same_leaves(mesh, rng):
    """Foley 2005, section 4.1; and how often they go down."""
    rays = rays_on_planes(build(*mesh).structure, rng)
    structures = [build(*mesh, traversal=how, layout=layout).structure for how, layout in FORMS]
    (leaves, stack), *others = (recorded(structure, *rays) for structure in structures)
    assert stack[:, 1].max() > 2
    assert (stack[:, 2] == 0).all()
    for (traversal, _), (other_leaves, counts) in zip(FORMS[1:], others, strict=True):
        np.testing.assert_array_equal(other_leaves, leaves)
        np.testing.assert_array_equal(counts[:, 1], stack[:, 1])
        jumps = counts[:, 3]
        np.testing.assert_array_equal(jumps, np.maximum(stack[:, 1] - 1, 0))
        if traversal == "stack":
            np.testing.assert_array_equal(counts, stack)
        elif traversal == "backtrack":
            # Each jump goes down once more through the split that the stack had passed.
            np.testing.assert_array_equal(counts[:, 0], stack[:, 0] + jumps)
            assert (counts[:, 2] >= jumps).all()
        else:
            assert (counts[:, 0] >= stack[:, 0]).all()
            assert (counts[:, 2] == 0).all()
        if traversal == "short-stack":  # most of the way it is a stack
            assert counts[:, 0].sum() < 1.2 * stack[:, 0].sum()


def test_leaves_divide_a_ray_without_gap_or_overlap(rng):
    structure = build(*soup(300)).structure
    leaves, counts = recorded(structure, *rays_on_planes(structure, rng))
    for row, (_, number, _, _) in zip(leaves, counts.tolist(), strict=True):
        t_in, t_out = row[:number, 0], row[:number, 1]
        assert (t_in < t_out).all()
        np.testing.assert_array_equal(t_in[1:], t_out[:-1])


@pytest.mark.parametrize("traversal", TRAVERSALS)
def test_rays_in_and_on_split_planes(traversal, rng):
    for mesh in (soup(300), grid_floor(6), dented_sphere(2)):
        tracer = build(*mesh, traversal=traversal)
        origins, directions = rays_on_planes(tracer.structure, rng)
        for limits in ((0.0, np.inf), (-np.inf, np.inf), (0.25, 0.75)):
            rays = {"origins": origins, "directions": directions}
            rays |= {"t_min": limits[0], "t_max": limits[1]}
            assert_same_answers(tracer, rs.Tracer(tracer.scene, "brute"), rays)


def test_hits_beyond_a_triangle_s_edges(rng):
    """Rays almost in a triangle's plane that pass its edge: rounding accepts hits anywhere.

    Small triangles all around make planes between a large one's edges and its hits.
    """
    large = np.array([[-1.0, -0.9, -0.3], [1.0, -0.8, 0.2], [0.7, 1.0, 0.6]])
    small = rng.uniform(-1, 1, (3000, 1, 3)) + rng.normal(size=(3000, 3, 3)) * 0.01
    vertices = np.concatenate([large[None], small]).reshape(-1, 3)
    tracer = build(vertices, np.arange(len(vertices)).reshape(-1, 3))
    oracle = rs.Tracer(tracer.scene, "brute")
    normal = np.cross(large[1] - large[0], large[2] - large[0])
    normal /= np.linalg.norm(normal)
    outside = 0
    for slope in 10.0 ** np.arange(-9.0, -2.0):
        count = 2000
        share = rng.random((count, 1))
        edge = rng.integers(0, 3, count)
        targets = large[edge] * (1 - share) + large[(edge + 1) % 3] * share
        directions = rng.normal(size=(count, 3))
        directions -= np.outer(directions @ normal, normal)
        directions += slope * rng.normal(size=(count, 1)) * normal
        rays = {"origins": targets - directions * rng.uniform(0.5, 2, (count, 1))}
        rays["directions"] = directions
        many, expected = tracer.multi_hit(**rays), oracle.multi_hit(**rays)
        for column in ("ray_splits", "t", "u", "v", "prim_id"):
            assert_same_bits(getattr(many, column), getattr(expected, column))
        first, expected = tracer.first_hit(**rays), oracle.first_hit(**rays)
        assert_same_bits(first.t, expected.t)
        assert_same_bits(first.prim_id, expected.prim_id)
        on_large = many.prim_id == 0
        points = rays["origins"][many.ray_id[on_large]].astype(float)
        points += directions[many.ray_id[on_large]] * many.t[on_large, None]
        outside += np.count_nonzero(
            np.linalg.norm(points - targets[many.ray_id[on_large]], axis=1) > 1e-3
        )
    assert outside > 100  # so the case occurs


def test_many_coplanar_triangles(rng):
    vertices, faces = grid_floor(230)
    assert len(faces) > 100_000
    tracer = build(vertices, faces)
    assert tracer.structure.quality()["tests per ray"] < 1000
    x, z = rng.uniform(vertices[:, 0].min(), vertices[:, 0].max(), (2, 500))
    origins = np.stack([x, np.full(500, 1.0), z], axis=1)
    origins[:200, 1] = 0.0  # rays in the floor hit nothing, and see many leaves
    directions = np.where(np.arange(500)[:, None] < 200, [1.0, 0.0, 0.3], [0.0, -1.0, 0.0])
    hits = tracer.first_hit(origins, directions)
    expected = rs.Tracer(tracer.scene, "brute").first_hit(origins, directions)
    for column in ("t", "u", "v", "prim_id"):
        assert_same_bits(getattr(hits, column), getattr(expected, column))
    assert hits.is_hit[200:].all()


def changed(path, name, change):
    arrays = read_npz(path)
    arrays[name] = change(arrays[name].copy())
    target = path.with_name("changed.npz")
    write_npz(target, arrays)
    return target


@pytest.mark.parametrize("value", [0.0, -1.0, 3e38, 1e-40])
def test_planes_anywhere_end_every_ray(value, tmp_path, rng):
    """A file may contain an invalid tree; all traversals then agree, and end."""
    case = CASES["random_soup"](rng)
    results = []
    for traversal, layout in FORMS:
        tracer = build(case.vertices, case.faces, traversal=traversal, layout=layout)
        tracer.save(tmp_path / "x.npz")

        def shuffle(nodes):
            splits = nodes[:, 1] & 3 != 3
            planes = np.random.default_rng(5).permutation(nodes.view(np.float32)[splits, 0])
            planes[::7] = value
            nodes.view(np.float32)[splits, 0] = planes
            return nodes

        loaded = rs.Tracer.load(changed(tmp_path / "x.npz", "structure.nodes", shuffle))
        results.append(loaded.multi_hit(**rays_of(case)))
    for many in results[1:]:
        assert_same_bits(many.ray_splits, results[0].ray_splits)
        assert_same_bits(many.t, results[0].t)


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("structure.nodes", lambda a: a[:-1]),
        ("structure.nodes", lambda a: a[::-1].copy()),
        ("structure.prim_ids", lambda a: a + 1),
    ],
)
def test_hostile_files_are_refused(name, change, tmp_path):
    build(*soup(50)).save(tmp_path / "x.npz")
    with pytest.raises(rs.FileFormatError, match=r"changed\.npz: "):
        rs.Tracer.load(changed(tmp_path / "x.npz", name, change))


def test_an_update_builds_it_anew(rng):
    vertices, faces = dented_sphere(2)
    tracer = build(vertices, faces, traversal="backtrack", layout="foley")
    assert tracer.update(vertices * [1, 2, 3]).rebuilt
    assert tracer.structure.options.layout == "foley"
    assert not np.isnan(tracer.structure.report.seconds)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_one_tree_is_searched_in_three_ways(layout, rng):
    rays = rng.uniform(-2, 2, (2, 500, 3))
    built = build(*soup(300, 1), layout=layout).structure
    for traversal in TRAVERSALS:
        other = built.with_traversal(traversal)
        expected = build(*soup(300, 1), layout=layout, traversal=traversal)
        assert other.options == expected.structure.options
        assert other.tree is built.tree
        hits = [
            Branching(one).answer(Query(Kind.FIRST_HIT), RayBatch(*rays, 0.0, np.inf)).hits
            for one in (other, expected.structure)
        ]
        assert all(np.array_equal(a, b) for a, b in zip(*hits, strict=True))
    assert built.options.traversal == "stack"
    with pytest.raises(ValueError, match="traversal: expected one of"):
        built.with_traversal("ropes")


@pytest.mark.parametrize("prim_id", [2**31 - 1, -2])
def test_blocks_that_no_leaf_lists_are_checked_too(prim_id):
    """Corners are looked up for every block of a file."""
    tree = rs.Tracer(rs.load("cornell"), "kdtree").structure
    arrays = tree.saved_arrays()
    arrays["prim_ids"] = np.vstack([arrays["prim_ids"], np.full((1, 4), prim_id, np.int32)])
    with pytest.raises(ValueError, match="an invalid triangle"):
        KdTreeStructure.from_arrays(tree.triangles, arrays, tree.options)
