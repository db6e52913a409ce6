"""GPU layouts of BVHs: conservative boxes, complete leaves, and brute force's bits.

They are traced here by the kernels compiled for the CPU.
"""

from __future__ import annotations

from itertools import permutations

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
from raystream.cuda.bvh.compressed import LEAF_SIZE, compress
from raystream.cuda.bvh.kernels import KERNELS, lay_out
from raystream.cuda.bvh.pairs import depth_of
from raystream.cuda.bvh.slots import assign_slots
from raystream.cuda.query_kernels import RowAddresses
from raystream.cuda.structures import kernels_of
from raystream.kernels.hits import HitAddresses, HitArrays
from raystream.kernels.ray_source import RaySource, ResultAddresses
from raystream.structures import build_structure
from strategies import meshes, scenes_and_rays
from test_agreement import case_of, expected_of

NOWHERE = np.uint64(0)

#: Those made for GPUs.
LAYOUTS = ("compressed", "binary")


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
    return triangles.view(np.int32)[:, 3]


def compressed_leaves(nodes, triangles):
    """`wide_leaves` of the compressed layout, with float64 boxes: all that contain a leaf."""
    bytes_ = nodes.view(np.uint8)
    pending = [(0, np.full(3, -np.inf), np.full(3, np.inf))] if len(nodes) else []
    visited = 0
    while pending:
        row, outer_low, outer_high = pending.pop()
        visited += 1
        origin = nodes[row, :3].view(np.float32).astype(np.float64)
        step = 2.0 ** (bytes_[row, 12:15].astype(int) - 127)
        inner, kinds = bytes_[row, 15], bytes_[row, 24:32]
        low = origin + bytes_[row, 32:56].reshape(3, 8).T * step
        high = origin + bytes_[row, 56:80].reshape(3, 8).T * step
        low, high = np.maximum(low, outer_low), np.minimum(high, outer_high)
        child, offset = nodes[row, 4], 0
        for slot in range(8):
            size = int(kinds[slot]) >> 5
            assert (size == 7) == bool(inner >> slot & 1)
            if size == 7:
                pending.append((int(child), low[slot], high[slot]))
                child += 1
            elif size:
                assert kinds[slot] & 31 == offset
                first = int(nodes[row, 5]) + offset
                offset += size
                yield low[slot], high[slot], prim_ids_of(triangles[first : first + size])
    assert visited == len(nodes)


def binary_leaves(nodes, triangles):
    """`compressed_leaves` of the binary layout."""
    links, is_last = nodes.view(np.int32)[:, 12:14], triangles.view(np.int32)[:, 7]
    pending = [(0, np.full(3, -np.inf), np.full(3, np.inf))] if len(nodes) else []
    while pending:
        row, outer_low, outer_high = pending.pop()
        for side in range(2):
            places = [[4 * side, 4 * side + 2, 8 + 2 * side]]
            low, high = nodes[row, np.add(places, [[0], [1]])]
            link = int(links[row, side])
            if not (low <= high).all():
                continue
            low, high = np.maximum(low, outer_low), np.minimum(high, outer_high)
            if link >= 0:
                pending.append((link, low, high))
            else:
                last = ~link + int(np.argmax(is_last[~link:])) + 1
                yield low, high, prim_ids_of(triangles[~link:last])


DECODED = {"compressed": compressed_leaves, "binary": binary_leaves}


def check_layout(structure, layout):
    """Each triangle of a leaf is within leaves whose boxes, and those around them, contain it."""
    _, arrays = lay_out(structure, layout)
    found = {}
    for low, high, ids in DECODED[layout](arrays["nodes"], arrays["triangles"]):
        for one in ids.tolist():
            found.setdefault(one, []).append((low, high))
    entries = 0
    for low, high, ids in wide_leaves(structure.tree):
        for one in ids.tolist():
            entries += 1
            assert any((a <= low).all() and (b >= high).all() for a, b in found[one])
    assert entries == len(arrays["triangles"]) == sum(map(len, found.values()))
    corners = arrays["triangles"].reshape(-1, 3, 4)[:, :, :3]
    ids = prim_ids_of(arrays["triangles"])
    np.testing.assert_array_equal(corners, structure.triangles.corners[ids])


@settings(max_examples=15, deadline=None)
@given(
    meshes(max_triangles=40),
    st.sampled_from(["balanced", "fast"]),
    st.integers(1, 32),
    st.sampled_from(LAYOUTS),
)
def test_boxes_contain_the_exact_ones(mesh, quality, max_leaf_size, layout):
    (vertices, faces), _, _ = mesh
    structure = bvh_of(vertices, faces, quality=quality, max_leaf_size=max_leaf_size)
    check_layout(structure, layout)


@pytest.mark.parametrize("max_leaf_size", [1, 4, 32])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_deep_trees_are_laid_out(layout, max_leaf_size):
    vertices, faces = soup(600)
    check_layout(bvh_of(vertices, faces, max_leaf_size=max_leaf_size), layout)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_triangles_that_moved_away_are_left_out(layout):
    """A refitted tree may have leaves without a triangle, and nodes without a box."""
    vertices, faces = soup(300)
    scene = rs.Scene.from_arrays(vertices, faces)
    tracer = rs.Tracer(scene, "bvh", max_leaf_size=2)
    vertices = vertices.copy()
    vertices[faces[:200].ravel()] = np.nan
    tracer.update(vertices, max_cost_growth=np.inf)
    check_layout(tracer.structure, layout)


@pytest.mark.parametrize("child_count", [1, 3, 5])
def test_slots_are_the_best(rng, child_count):
    """The assignment of children to slots maximizes the sum of gains."""
    entries = np.zeros((1, 8, 8), np.float32)
    words = entries.view(np.int32)
    corners = np.sort(rng.normal(size=(child_count, 2, 3)), axis=1)
    entries[0, :child_count, :3], entries[0, :child_count, 4:7] = corners[:, 0], corners[:, 1]
    words[0, :child_count, 3] = 1 + np.arange(child_count)
    boxes = entries[0, :child_count].astype(np.float64)
    low, high = boxes[:, :3], boxes[:, 4:7]
    offsets = low + high - (low.min(axis=0) + high.max(axis=0))
    gains = offsets @ np.where(np.arange(8) >> np.arange(3)[:, None] & 1, 1.0, -1.0)
    ways = np.array(list(permutations(range(8), child_count)))
    best = gains[np.arange(child_count), ways].sum(axis=1).max()
    assign_slots(0, 1, entries, words)
    slots = np.flatnonzero(words[0, :, 3])
    children = words[0, slots, 3] - 1
    assert sorted(children) == list(range(child_count))
    np.testing.assert_allclose(gains[children, slots].sum(), best)


def test_too_deep_trees_are_balanced(monkeypatch):
    """Boxes each of which is four times the last one: the least area makes a list of them."""
    corners = np.repeat(4.0 ** np.arange(12), 3).reshape(-1, 3, 1) * np.eye(3)
    structure = bvh_of(corners.reshape(-1, 3), np.arange(36).reshape(-1, 3), max_leaf_size=1)

    def depth():
        links = unfold(structure.tree)[1]["nodes"].view(np.int32)
        return depth_of(links, np.zeros(len(links), np.int32))

    most = 3 * structure.quality()["depth"]
    assert depth() > most
    monkeypatch.setattr(binary, "STACK_BYTES", 0)
    assert depth() <= most
    check_layout(structure, "binary")


def test_large_leaves_become_nodes():
    """32 triangles that cannot be told apart are one leaf on the CPU."""
    vertices, faces = np.eye(3), np.tile(np.arange(3), (32, 1))
    structure = bvh_of(vertices, faces, max_leaf_size=32)
    nodes = compress(structure.tree)[1]["nodes"]
    assert len(nodes) == 2
    assert (nodes.view(np.uint8)[1, 24:32] >> 5 == LEAF_SIZE).all()


# ---- Traversals.


def traced(structure, layout, case, splits):
    """First hits, and all hits for which there are rows, by a layout's kernels on the CPU."""
    kernels, (tree, _kept) = kernels_of("bvh", layout), lay_out(structure, layout)
    batch = RayBatch(case.origins, case.directions, case.t_min, case.t_max)
    source, _also = RaySource.of(batch.origins, batch.directions, batch.limits)
    status = np.zeros(len(batch), np.uint8)
    first, many = HitArrays.empty(len(batch)), HitArrays.empty(int(splits[-1]))
    found = np.empty(len(batch), np.int64)
    to = ResultAddresses(*map(address, first), NOWHERE, address(status))
    rows = HitAddresses(*map(address, many))
    to_rows = RowAddresses(address(splits), rows, address(found))
    shared = source, structure.frame, tree, None
    for i in map(np.uint64, range(len(batch))):
        kernels.first_hit.function(i, *shared, to)
        kernels.multi_hit.function(i, *shared, False, to_rows)
    np.testing.assert_array_equal(found, np.diff(splits))
    return first, many


def address(array):
    return np.uint64(array.ctypes.data)


@pytest.mark.parametrize(
    "layout",
    [
        "compressed",
        *(pytest.param(one, marks=pytest.mark.exhaustive) for one in ("binary", "packet")),
    ],
)
@pytest.mark.parametrize("name", CASES)
def test_traversals_have_brute_force_bits(layout, name):
    case, expected = case_of(name), expected_of(name)
    structure = build_structure("bvh", case.scene.triangles, max_leaf_size=6)
    splits = expected["multi_hit, triangles, None: ray_splits"]
    first, many = traced(structure, layout, case, splits)
    for column in ("t", "u", "v", "prim_id"):
        for query, hits in (("first_hit", first), ("multi_hit, triangles, None", many)):
            assert getattr(hits, column).tobytes() == expected[f"{query}: {column}"].tobytes()


@settings(max_examples=20, deadline=None)
@given(scenes_and_rays(), st.sampled_from(LAYOUTS))
def test_rays_on_lattices_have_brute_force_bits(drawn, layout):
    case = Case(*drawn)
    oracle = rs.Tracer(case.scene, "brute")
    expected = oracle.multi_hit(case.origins, case.directions)
    structure = build_structure("bvh", case.scene.triangles, max_leaf_size=2)
    first, many = traced(structure, layout, case, expected.ray_splits)
    nearest = oracle.first_hit(case.origins, case.directions)
    for column in ("t", "u", "v", "prim_id"):
        assert getattr(first, column).tobytes() == getattr(nearest, column).tobytes()
        assert getattr(many, column).tobytes() == getattr(expected, column).tobytes()


# ---- Options.


def test_kernels_have_names(gpu):
    scene = case_of("closed_mesh").scene
    assert KERNELS[0] == "auto"
    with pytest.raises(ValueError, match=r"kernel: expected one of 'auto', .* got 'single'"):
        rs.Tracer(scene, "bvh", "cuda", kernel="single")
    with pytest.raises(TypeError, match="grid: has no option 'kernel'"):
        rs.Tracer(scene, "grid", "cuda", kernel="binary")
    with pytest.raises(ValueError, match="launch: expected one of 'range', 'persistent', got"):
        rs.Tracer(scene, "bvh", "cuda", launch="soon")
