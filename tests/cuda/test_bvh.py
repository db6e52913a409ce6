"""The binary layout of BVHs on GPUs: conservative boxes, complete leaves, and brute force's bits.

It is traced here by the kernels compiled for the CPU.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from extras import need

need("numba_cuda")

import raystream as rs
from cases import CASES, Case
from meshes import soup
from raystream.core.rays import RayBatch
from raystream.cuda.bvh import binary
from raystream.cuda.bvh.binary import unfold
from raystream.cuda.bvh.kernels import lay_out
from raystream.cuda.structures import kernels_of
from raystream.kernels.hits import HitAddresses, HitArrays
from raystream.kernels.queries import RayScene, RowAddresses
from raystream.kernels.ray_source import RaySource
from raystream.structures import build_structure
from strategies import meshes, scenes_and_rays
from test_agreement import case_of, expected_of

NOWHERE = np.uint64(0)


def bvh_of(vertices, faces, **options):
    scene = rs.Scene.from_arrays(vertices, faces)
    return build_structure("bvh", scene.triangles, **options)


# ---- Layouts, decoded.


def wide_leaves(tree):
    """Box and hittable triangles of each leaf of the CPU's tree."""
    for node, links in zip(tree.nodes, tree.children, strict=True):
        for lane in np.flatnonzero(links < 0):
            low, high = node[lane:48:16], node[8 + lane : 48 : 16]
            first = ~links[lane] >> 3
            blocks = slice(first, first + (~links[lane] & 7) + 1)
            ids = tree.prim_ids[blocks].ravel()
            is_solid = ~np.isnan(tree.leaves[blocks, :4].ravel())
            yield low, high, ids[is_solid]


def prim_ids_of(triangles):
    return triangles.view(np.int32)[:, 9]


def binary_leaves(nodes, triangles):
    """`wide_leaves` of the binary layout: all that contain a leaf."""
    links, is_last = nodes.view(np.int32)[:, 6::8], triangles.view(np.int32)[:, 10]
    pending = [(0, np.full(3, -np.inf), np.full(3, np.inf))] if len(nodes) else []
    while pending:
        row, outer_low, outer_high = pending.pop()
        for side in range(2):
            low, high = nodes[row, 8 * side : 8 * side + 6].reshape(3, 2).T
            link = int(links[row, side])
            if not (low <= high).all():
                continue
            low, high = np.maximum(low, outer_low), np.minimum(high, outer_high)
            if link >= 0:
                pending.append((link, low, high))
            else:
                last = ~link + int(np.argmax(is_last[~link:])) + 1
                yield low, high, prim_ids_of(triangles[~link:last])


def check_layout(structure):
    """Each triangle of a leaf is within leaves whose boxes, and those around them, contain it."""
    arrays = lay_out(structure).arrays
    found = {}
    for low, high, ids in binary_leaves(arrays["nodes"], arrays["leaves"]):
        for one in ids.tolist():
            found.setdefault(one, []).append((low, high))
    entries = 0
    for low, high, ids in wide_leaves(structure.tree):
        for one in ids.tolist():
            entries += 1
            assert any((a <= low).all() and (b >= high).all() for a, b in found[one])
    assert entries == len(arrays["leaves"]) == sum(map(len, found.values()))
    corners = arrays["leaves"][:, :9].reshape(-1, 3, 3)
    ids = prim_ids_of(arrays["leaves"])
    np.testing.assert_array_equal(corners, structure.triangles.corners[ids])


@settings(max_examples=15)
@given(
    meshes(max_triangles=40),
    st.sampled_from(["balanced", "fast"]),
    st.integers(1, 32),
)
def test_boxes_contain_the_exact_ones(mesh, quality, max_leaf_size):
    (vertices, faces), _, _ = mesh
    structure = bvh_of(vertices, faces, quality=quality, max_leaf_size=max_leaf_size)
    check_layout(structure)


@pytest.mark.parametrize("max_leaf_size", [1, 4, 32])
def test_deep_trees_are_laid_out(max_leaf_size):
    vertices, faces = soup(600)
    check_layout(bvh_of(vertices, faces, max_leaf_size=max_leaf_size))


def test_triangles_that_moved_away_are_left_out():
    """A refitted tree may have leaves without a triangle, and nodes without a box."""
    vertices, faces = soup(300)
    scene = rs.Scene.from_arrays(vertices, faces)
    tracer = rs.Tracer(scene, "bvh", max_leaf_size=2)
    vertices = vertices.copy()
    vertices[faces[:200].ravel()] = np.nan
    tracer.update(vertices, max_cost_growth=np.inf)
    check_layout(tracer.structure)


def depth_of(nodes):
    """Nodes on the longest path; parents come before their children."""
    depths = np.ones(len(nodes), int)
    for row, links in enumerate(nodes.view(np.int32)[:, 6::8]):
        depths[links[links > 0]] = depths[row] + 1
    return depths.max()


def test_too_deep_trees_are_balanced(monkeypatch):
    """Boxes each of which is four times the last one: the least area makes a list of them."""
    corners = np.repeat(4.0 ** np.arange(12), 3).reshape(-1, 3, 1) * np.eye(3)
    structure = bvh_of(corners.reshape(-1, 3), np.arange(36).reshape(-1, 3), max_leaf_size=1)
    most = 3 * structure.quality()["depth"]
    assert depth_of(unfold(*structure.tree).nodes) > most
    monkeypatch.setattr(binary, "ANY_SHAPE_DEPTH", 0)
    assert depth_of(unfold(*structure.tree).nodes) <= most
    check_layout(structure)


# ---- Trees whose leaves are not triangles.


def links_below(nodes, first, end):
    """Links to leaves of the binary tree in some rows, which must all be reached."""
    links = nodes[first:end].view(np.int32)[:, 6::8]
    is_box = (nodes[first:end, 0::8] <= nodes[first:end, 1::8]).ravel()
    inner = links[links > 0]
    assert np.array_equal(np.sort(inner), np.arange(1, end - first))
    return np.sort(links.ravel()[is_box & (links.ravel() < 0)])


def wide_links(nodes):
    links = nodes.view(np.int32)[:, 48:56]
    return np.sort(links[links < 0])


def test_blocks_of_spheres_and_of_float64_keep_their_links():
    rng = np.random.default_rng(5)
    balls = rs.Scene.spheres(rng.normal(size=(300, 3)), 0.1)
    vertices, faces = soup(300)
    mesh = rs.Scene.from_arrays(vertices, faces)
    spheres = rs.Tracer(rs.Scene.combine([mesh, balls])).structure
    exact = rs.Tracer(mesh, precision="float64").structure
    for structure, name in ((spheres, "sphere_nodes"), (exact, "nodes")):
        nodes = lay_out(structure).arrays[name]
        expected = wide_links(structure.arrays[name])
        assert np.array_equal(links_below(nodes, 0, len(nodes)), expected)
    check_layout(spheres._inner)


def test_trees_of_worlds_stay_apart():
    """All are expanded together; links are within the tree of each world."""
    count = 200
    places = np.tile(np.eye(3, 4), (count, 1, 1))
    places[:, :, 3] = np.random.default_rng(6).normal(size=(count, 3)) * 5.0
    worlds = np.where(np.arange(count) < 20, -1, np.arange(count) % 3)
    scene = rs.Scene.instances(rs.load("cornell"), places, worlds=worlds)
    structure = rs.Tracer(scene).structure
    tree, arrays, objects = lay_out(structure)
    ends = structure.trees.first_nodes
    starts = (arrays["trees"]["nodes"] - np.uint64(arrays["nodes"].ctypes.data)) // 64
    assert int(tree.shared - tree.trees) == 16 * (len(starts) - 1)
    starts = [*map(int, starts), len(arrays["nodes"])]
    for world in range(4):
        found = links_below(arrays["nodes"], *starts[world : world + 2])
        wide = structure.arrays["nodes"][slice(*ends[world : world + 2])]
        assert np.array_equal(found, wide_links(wide))
        assert len(found) == (20 if world == 3 else 60)
    (held,) = structure.objects
    for ours, theirs in zip(objects(), unfold(*held.tree)[:2], strict=True):
        assert ours.tobytes() == theirs.tobytes()


# ---- Traversals.


def traced(structure, case, splits):
    """First hits, and all hits for which there are rows, by the layout's kernels on the CPU."""
    kernels, (tree, *_kept) = kernels_of("bvh"), lay_out(structure)
    batch = RayBatch(case.origins, case.directions, case.t_min, case.t_max)
    source, _also = RaySource.of(batch.origins, batch.directions, batch.limits)
    status = np.zeros(len(batch), np.uint8)
    first, many = HitArrays.empty(len(batch)), HitArrays.empty(int(splits[-1]))
    found = np.empty(len(batch), np.int64)
    to, rows = (HitAddresses(*map(address, hits)) for hits in (first, many))
    to_rows = RowAddresses(False, address(splits), rows, address(found))
    shared = RayScene(source, structure.frame, tree, address(status), None, None)
    for i in map(np.uint64, range(len(batch))):
        kernels.first_hit.function(i, shared, to)
        kernels.multi_hit.function(i, shared, to_rows)
    np.testing.assert_array_equal(found, np.diff(splits))
    return first, many


def address(array):
    return np.uint64(array.ctypes.data)


@pytest.mark.parametrize("name", CASES)
def test_the_traversal_has_brute_force_bits(name):
    case, expected = case_of(name), expected_of(name)
    structure = build_structure("bvh", case.scene.triangles, max_leaf_size=6)
    splits = expected["multi_hit, triangles, None: ray_splits"]
    first, many = traced(structure, case, splits)
    for column in ("t", "u", "v", "prim_id"):
        for query, hits in (("first_hit", first), ("multi_hit, triangles, None", many)):
            assert getattr(hits, column).tobytes() == expected[f"{query}: {column}"].tobytes()


@settings(max_examples=20)
@given(scenes_and_rays())
def test_rays_on_lattices_have_brute_force_bits(drawn):
    case = Case(*drawn)
    oracle = rs.Tracer(case.scene, "brute")
    expected = oracle.multi_hit(case.origins, case.directions)
    structure = build_structure("bvh", case.scene.triangles, max_leaf_size=2)
    first, many = traced(structure, case, expected.ray_splits)
    nearest = oracle.first_hit(case.origins, case.directions)
    for column in ("t", "u", "v", "prim_id"):
        assert getattr(first, column).tobytes() == getattr(nearest, column).tobytes()
        assert getattr(many, column).tobytes() == getattr(expected, column).tobytes()
