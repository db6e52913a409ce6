"""Building kd-trees: contents of leaves, bounded memory and depth, and untrusted files."""

import numpy as np
import pytest

import raystream as rs
from conftest import assert_same_bits
from meshes import cube, dented_sphere, grid_floor, soup
from raystream.core.triangles import Triangles
from raystream.structures.clip import BOUND
from raystream.structures.kdtree.build import MAX_REFERENCES, build_arrays
from raystream.structures.kdtree.foley_layout import extend, pack
from raystream.structures.kdtree.layout import check_arrays, measure
from raystream.structures.kdtree.options import MAX_DEPTH
from raystream.structures.kdtree.split import Costs
from raystream.structures.kdtree.subtree import BuildSettings
from raystream.structures.saved import solid_mask

COSTS = Costs(1.0, 1.5, 0.5)


def settings(max_depth=40, max_leaf_size=1, costs=COSTS):
    return BuildSettings(costs, max_depth, max_leaf_size)


def triangles_of(vertices, faces):
    return Triangles([(np.asarray(vertices, float), np.asarray(faces, np.int32))])


def sticks(count, seed=0):
    """Long thin triangles across the whole scene: each is in many cells."""
    rng = np.random.default_rng(seed)
    ends = rng.random((count, 2, 3))
    third = ends[:, 1] + rng.normal(size=(count, 3)) * 1e-3
    return np.concatenate([ends, third[:, None]], axis=1).reshape(-1, 3), np.arange(
        3 * count
    ).reshape(-1, 3)


MESHES = {
    "soup": soup(400),
    "closed": dented_sphere(2),
    "flat": grid_floor(8),
    "sticks": sticks(60),
    "cube": cube(),
}


def leaf_of(nodes, points):
    """The leaf that contains each point."""
    positions = nodes.view(np.float32)[:, 0].astype(float)
    node = np.zeros(len(points), int)
    for _ in range(MAX_DEPTH + 1):
        axis, number = nodes[node, 1] & 3, nodes[node, 1] >> 2
        inner = axis != 3
        at = points[np.arange(len(points)), np.minimum(axis, 2)]
        node = np.where(inner, number + (at >= positions[node]), node)
    return node


def listed(tree, leaf):
    count, first = tree.nodes[leaf, 1] >> 2, tree.nodes[leaf, 0]
    return tree.prim_ids[first : first + (count + 3) // 4].ravel()[:count]


@pytest.mark.parametrize("mesh", MESHES)
@pytest.mark.parametrize(
    ("max_depth", "costs"), [(40, COSTS), (64, Costs(0.01, 1.0, 0.9)), (5, Costs(8.0, 1.0, 0.5))]
)
def test_a_leaf_lists_all_whose_hits_may_be_in_it(mesh, max_depth, costs, rng):
    """Points of each triangle, and of its plane inside its box, moved by up to the bound."""
    triangles = triangles_of(*MESHES[mesh])
    tree = build_arrays(triangles, settings(max_depth, 1, costs))
    corners = triangles.corners.astype(float)
    low, high = corners.min(axis=1), corners.max(axis=1)
    inside = np.einsum("ftk,fkx->ftx", rng.dirichlet([0.5] * 3, (len(corners), 30)), corners)
    # Combinations with negative weights are in the plane, beyond the edges.
    weights = rng.uniform(-1.5, 1.5, (len(corners), 60, 2))
    weights = np.concatenate([weights, 1 - weights.sum(axis=2, keepdims=True)], axis=2)
    beyond = np.einsum("ftk,fkx->ftx", weights, corners)
    in_box = ((beyond >= low[:, None] - 1e-9) & (beyond <= high[:, None] + 1e-9)).all(axis=2)
    points = np.concatenate([inside, np.where(in_box[..., None], beyond, inside[:, :1])], axis=1)
    points += rng.uniform(-1, 1, points.shape) * 0.3 * BOUND * triangles.max_coordinate
    prim_id = np.repeat(np.arange(len(corners)), points.shape[1])
    leaves = leaf_of(tree.nodes, points.reshape(-1, 3))
    held = {leaf: set(listed(tree, leaf).tolist()) for leaf in np.unique(leaves)}
    assert all(p in held[leaf] for p, leaf in zip(prim_id.tolist(), leaves, strict=True))
    assert in_box.sum() > 50
    assert measure(tree.nodes, triangles.bounds)["depth"] <= max_depth


def test_leaves_list_few_triangles():
    """Otherwise listing all of them everywhere would pass."""
    triangles = triangles_of(*dented_sphere(4))
    tree = build_arrays(triangles, settings())
    found = measure(tree.nodes, triangles.bounds)
    assert found["tests per ray"] < 60
    assert found["references"] < 11 * len(triangles)
    assert found["leaves"] == len(tree.nodes) // 2 + 1


def test_a_leaf_lists_no_triangle_twice():
    triangles = triangles_of(*soup(300, 5))
    tree = build_arrays(triangles, settings())
    for leaf in np.flatnonzero(tree.nodes[:, 1] & 3 == 3):
        prim_ids = listed(tree, leaf)
        assert len(np.unique(prim_ids)) == len(prim_ids)


@pytest.mark.parametrize("mesh", [soup(20_000, 1, 0.02), sticks(3000)])
def test_the_tree_does_not_depend_on_the_number_of_threads(mesh):
    triangles = triangles_of(*mesh)
    trees = []
    for threads in (1, 2, 3):
        try:
            rs.set_thread_count(threads)
            trees.append(build_arrays(triangles, settings()))
        finally:
            rs.set_thread_count(None)
    for tree in trees[1:]:
        for a, b in zip(tree, trees[0], strict=True):
            assert_same_bits(a, b)


def test_references_are_bounded():
    """Sticks across the scene would be listed thousands of times."""
    triangles = triangles_of(*sticks(6000))
    tree = build_arrays(triangles, settings(64, 1, Costs(1e-6, 1.0, 0.5)))
    found = measure(tree.nodes, triangles.bounds)
    assert 3 * len(triangles) < found["references"] <= MAX_REFERENCES * len(triangles) + 1024
    assert len(tree.nodes) <= 4 * (MAX_REFERENCES * len(triangles) + 1024) + 1


@pytest.mark.parametrize("copies", [2, 5, 2000])
def test_equal_triangles_share_a_leaf(copies):
    vertices, _ = cube()
    triangles = triangles_of(vertices, np.tile([[0, 1, 2], [5, 6, 7]], (copies, 1)))
    tree = build_arrays(triangles, settings())
    found = measure(tree.nodes, triangles.bounds)
    assert found["references"] <= 6 * len(triangles)
    check_arrays(tree._asdict(), solid_mask(triangles))


def test_a_scene_that_grows_by_a_factor_from_triangle_to_triangle():
    sizes = 2.0 ** np.arange(-30.0, 30.0)
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.5]]) * sizes[:, None, None]
    triangles = triangles_of(vertices.reshape(-1, 3), np.arange(180).reshape(-1, 3))
    tree = build_arrays(triangles, settings(64))
    check_arrays(tree._asdict(), solid_mask(triangles))


@pytest.mark.parametrize(("max_depth", "most_leaves"), [(0, 1), (1, 2), (4, 16)])
def test_depth_is_limited(max_depth, most_leaves):
    triangles = triangles_of(*soup(9000, 3, 0.01))
    tree = build_arrays(triangles, settings(max_depth))
    found = measure(tree.nodes, triangles.bounds)
    assert found["depth"] == max_depth
    assert found["leaves"] <= most_leaves


def test_small_cells_are_not_split():
    triangles = triangles_of(*soup(5000, 3, 0.01))
    counts = [
        measure(build_arrays(triangles, settings(40, size)).nodes, triangles.bounds)["leaves"]
        for size in (1, 16, 256)
    ]
    assert counts[0] > 4 * counts[1] > 16 * counts[2]


def test_figures_are_those_of_the_cells():
    triangles = triangles_of(*soup(100, 4))
    nodes = build_arrays(triangles, settings()).nodes
    found = measure(nodes, triangles.bounds)
    positions = nodes.view(np.float32)[:, 0]
    boxes = [triangles.bounds.astype(float)] + [None] * (len(nodes) - 1)
    areas = np.zeros(len(nodes))
    for node, (low, high) in enumerate(boxes):
        x, y, z = high - low
        areas[node] = x * y + y * z + z * x
        axis, number = nodes[node, 1] & 3, nodes[node, 1] >> 2
        if axis < 3:
            plane = np.clip(positions[node], low[axis], high[axis])
            boxes[number], boxes[number + 1] = np.array([low, high]), np.array([low, high])
            boxes[number][1, axis] = boxes[number + 1][0, axis] = plane
    areas /= areas[0]
    is_leaf = nodes[:, 1] & 3 == 3
    counts = nodes[is_leaf, 1] >> 2
    np.testing.assert_allclose(found["splits per ray"], areas[~is_leaf].sum(), rtol=1e-5)
    np.testing.assert_allclose(found["leaves per ray"], areas[is_leaf].sum(), rtol=1e-5)
    np.testing.assert_allclose(found["tests per ray"], areas[is_leaf] @ counts, rtol=1e-5)
    assert found["references"] == counts.sum()
    assert found["empty leaves"] == (counts == 0).sum()


def test_packed_forms_say_the_same():
    nodes = build_arrays(triangles_of(*soup(300)), settings()).nodes
    packed = pack(nodes)
    assert len(packed.splits) + len(packed.leaves) == len(nodes)
    compact, other = extend(nodes, False), extend(nodes, True)
    rows = []

    def compare(node, pointer, parent, low, high):
        is_leaf, row = pointer >> 31, pointer & (2**30 - 1)
        axis, number = nodes[node, 1] & 3, nodes[node, 1] >> 2
        assert is_leaf == (axis == 3)
        if is_leaf:
            assert packed.leaves[row].tolist() == [number, nodes[node, 0], parent]
            return
        position, below, above = packed.splits[row].tolist()
        assert position == nodes.view(np.uint32)[node, 0]
        assert (below >> 30 & 1) + 2 * (above >> 30 & 1) == axis
        bounds = np.array(low + high, np.float32)
        assert_same_bits(compact[number // 2, :6], bounds)
        assert_same_bits(other[row, :6], bounds)
        assert compact.view(np.int32)[number // 2, 6] == node
        assert other.view(np.int32)[row, 6] == parent
        rows.append(row)
        plane = float(nodes.view(np.float32)[node, 0])
        inner = [*high[:axis], plane, *high[axis + 1 :]]
        compare(number, below, row, low, inner)
        compare(number + 1, above, row, [*low[:axis], plane, *low[axis + 1 :]], high)

    compare(0, 0, 2**30 - 1, [-np.inf] * 3, [np.inf] * 3)
    assert sorted(rows) == list(range(len(packed.splits)))


class TestCheckArrays:
    """No file may make a traversal read out of bounds, or run forever."""

    @pytest.fixture
    def triangles(self):
        return triangles_of(*soup(300))

    def check(self, triangles, **changes):
        arrays = build_arrays(triangles, settings())._asdict()
        for name, change in changes.items():
            arrays[name] = change(arrays[name])
        return check_arrays(arrays, solid_mask(triangles))

    def test_what_was_built_is_taken(self, triangles):
        for a, b in zip(self.check(triangles), build_arrays(triangles, settings()), strict=True):
            assert_same_bits(a, b)
        nothing = {"nodes": np.zeros((0, 2), np.int32), "prim_ids": np.zeros((0, 4), np.int32)}
        check_arrays(nothing, np.empty(0, np.bool_))

    @pytest.mark.parametrize("link", [10**6, -(10**6), 0, 1, 2, 2**29 - 1, -(2**29)])
    def test_a_child_out_of_range_or_with_two_parents(self, triangles, link):
        def change(nodes):
            inner = np.flatnonzero(nodes[:, 1] & 3 != 3)[3]
            nodes[inner, 1] = link << 2 | 1
            return nodes

        with pytest.raises(ValueError, match="out of range or has two parents"):
            self.check(triangles, nodes=change)

    def test_a_leaf_made_a_split_with_the_children_of_another(self, triangles):
        """Its nodes would lie deeper than where they are found last, and a stack overflow."""

        def change(nodes):
            is_inner = nodes[:, 1] & 3 != 3
            last = np.flatnonzero(is_inner)[-1]
            leaf = np.flatnonzero(~is_inner & (np.arange(len(nodes)) < nodes[last, 1] >> 2))[0]
            nodes[leaf] = nodes[last]
            return nodes

        with pytest.raises(ValueError, match="out of range or has two parents"):
            self.check(triangles, nodes=change)

    @pytest.mark.parametrize("position", [np.nan, np.inf, -np.inf])
    def test_a_plane_nowhere(self, triangles, position):
        def change(nodes):
            nodes.view(np.float32)[0, 0] = position
            return nodes

        with pytest.raises(ValueError, match="plane of a split is not finite"):
            self.check(triangles, nodes=change)

    @pytest.mark.parametrize(
        ("column", "value"), [(0, -1), (0, 2**31 - 1), (1, 2**31 - 1), (1, -1), (1, 10**6 << 2 | 3)]
    )
    def test_a_leaf_out_of_range(self, triangles, column, value):
        def change(nodes):
            leaf = np.flatnonzero(nodes[:, 1] & ~3 != 0)
            leaf = leaf[nodes[leaf, 1] & 3 == 3][0]
            nodes[leaf, column] = value
            return nodes

        with pytest.raises(ValueError, match="leaf's list is out of range"):
            self.check(triangles, nodes=change)

    @pytest.mark.parametrize("prim_id", [-2, -1, 300, 2**31 - 1])
    def test_triangles_that_are_none(self, triangles, prim_id):
        def change(prim_ids):
            prim_ids[10, 0] = prim_id
            return prim_ids

        with pytest.raises(ValueError, match="invalid triangle"):
            self.check(triangles, prim_ids=change)

    def test_a_missing_triangle(self, triangles):
        def change(prim_ids):
            prim_ids[prim_ids == 7] = 8
            return prim_ids

        with pytest.raises(ValueError, match="in no leaf"):
            self.check(triangles, prim_ids=change)
        nothing = {"nodes": np.zeros((0, 2), np.int32), "prim_ids": np.zeros((0, 4), np.int32)}
        with pytest.raises(ValueError, match="in no leaf"):
            check_arrays(nothing, solid_mask(triangles))

    def test_a_degenerate_triangle(self, triangles):
        arrays = build_arrays(triangles, settings())._asdict()
        with pytest.raises(ValueError, match="invalid triangle"):
            check_arrays(arrays, np.arange(len(triangles)) != triangles.prim_ids[0])

    def test_too_deep(self):
        depth = MAX_DEPTH + 1
        nodes = np.zeros((2 * depth + 1, 2), np.int32)
        nodes[:, 1] = 3
        nodes[2 * np.arange(depth), 1] = (2 * np.arange(depth) + 1) << 2
        nodes[-1] = 0, 1 << 2 | 3
        arrays = {"nodes": nodes, "prim_ids": np.array([[0, -1, -1, -1]], np.int32)}
        with pytest.raises(ValueError, match="65 splits deep"):
            check_arrays(arrays, np.ones(1, np.bool_))

    @pytest.mark.parametrize("name", ["nodes", "prim_ids"])
    def test_wrong_arrays(self, triangles, name):
        with pytest.raises(ValueError, match=name):
            self.check(triangles, **{name: lambda array: array.astype(np.int64)})
        with pytest.raises(ValueError, match=name):
            self.check(triangles, **{name: lambda array: array[:, 1:]})
        with pytest.raises(ValueError, match=r"range|cannot have|triangle"):
            self.check(triangles, **{name: lambda array: array[:-1]})


def test_progress_while_building():
    seen = []
    triangles = triangles_of(*soup(20_000, 9, 0.01))
    build_arrays(triangles, settings(), lambda done, total: seen.append((done, total)))
    assert seen[-1] == (20_000, 20_000)
    assert seen == sorted(seen)


def test_building_can_be_interrupted():
    def interrupt(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        build_arrays(triangles_of(*soup(20_000, 9, 0.01)), settings(), interrupt)
